"""`vessel-gym list`: what there is, of environments of others too."""

import re
from collections.abc import Iterable, Iterator
from contextlib import suppress

import gymnasium as gym
import pytest

from agents.commands import list as command
from agents.commands.console import print_table
from agents.refusal import Refusal
from vessel_gym.models.estimation import estimator_names

SWINGING = "swinging:Swinging-v0"


def cells(printed: str) -> list[list[str]]:
    """Cells of a table without lines, whose columns begin where the words of its header do."""
    _, header, *rows = printed.splitlines()
    begins = [found.start() for found in re.finditer(r"(?<!\S )\b\w", header)]
    ends = [*begins[1:], None]
    return [
        [row[a:b].strip() for a, b in zip(begins, ends, strict=True)] for row in (header, *rows)
    ]


def test_an_environment_of_others_lists_what_its_wrapper_takes(capsys):
    command.main("estimators", SWINGING)
    header, *rows = cells(capsys.readouterr().out)
    assert header == ["estimator", "default", "variants"]
    found = {name: default for name, default, _ in rows}
    assert [name for name, default in found.items() if default] == ["ukf"]
    assert {"ekf", "truth", "dead-reckoning"} < found.keys()
    assert not {"kf", "kf-umv-ui", "measurement"} & found.keys()  # of linear models, and of ours
    command.main("sensors", SWINGING)
    assert cells(capsys.readouterr().out)[1:] == [["y0", "nominal"]]


def test_one_without_the_keyword_is_one_sentence():
    from swinging import make

    gym.register("Fixed-v0", entry_point=lambda: make(), max_episode_steps=40)
    try:
        with pytest.raises(Refusal, match=r"^Fixed-v0 takes no option 'estimator': [^\n]*$"):
            command.main("estimators", "Fixed-v0")
    finally:
        del gym.registry["Fixed-v0"]


def accepted(names: Iterable[str]) -> Iterator[str]:
    """Those of some estimators that an environment takes."""
    for name in names:
        with suppress(ValueError):
            gym.make("SigmaCorvette-v0", estimator=name)
            yield name


def test_ours_lists_the_estimators_that_its_models_carry(capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    command.main("estimators")
    _, *rows = cells(capsys.readouterr().out)
    assert [name for name, *_ in rows] == [*accepted(estimator_names())]
    (variants,) = (words.split(", ") for name, _, words in rows if name == "kf")
    names = tuple(f"kf-{last}" for last in ("linear", "nonlinear", "waves", "white"))
    assert variants == [*accepted(names)]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ("PunaUAV-v0",),
            "unknown list 'PunaUAV-v0': choose from environments, estimators, sensors",
        ),
        (("nosuch",), "unknown list 'nosuch'"),
    ],
)
def test_what_is_no_list_is_one_sentence_that_helps(words, sentence):
    with pytest.raises(Refusal, match=r"^[^\n]*$") as refused:
        command.main(*words)
    assert sentence in str(refused.value)


@pytest.mark.parametrize("width", [40, 80, 100, 300])
def test_tables_fit_a_terminal_and_break_no_word(capsys, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    row = [f"word{i} and 0.123 ± 0.456" + " many more of them" * (i == 5) for i in range(12)]
    print_table("title", [f"head{i}{'-long' * (i % 3)}" for i in range(12)], [row, row])
    text = re.sub(r"\x1b\[[\d;]*m", "", capsys.readouterr().out)
    assert max(map(len, text.splitlines())) <= min(width, 100)
    for i in range(12):
        assert re.search(rf"\bhead{i}{'-long' * (i % 3)}\b", text)
        assert len(re.findall(rf"\bword{i}\b", text)) >= 2


def test_piped_table_has_whole_values_and_no_lines(capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    long = "long words " * 30
    print_table("title", ["name", "value"], [["one", long], ["two", "1.5"]])
    printed = capsys.readouterr().out.splitlines()
    assert [re.sub(" {2,}", "  ", line.strip()) for line in printed] == [
        "title", "name  value", f"one  {long}".strip(), "two  1.5",
    ]  # fmt: skip
