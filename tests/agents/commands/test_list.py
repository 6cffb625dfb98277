"""`vessel-gym list`: what there is, of environments of others too."""

import gymnasium as gym
import pytest

from agents.commands import list as command
from agents.commands.console import print_answer
from agents.refusal import Refusal
from vessel_gym.models.estimation import accepted, chosen_disturbance

SWINGING = "swinging:Swinging-v0"


def cells(printed: str) -> list[list[str]]:
    rows = (line for line in printed.splitlines() if line[:1] in "│┃")
    return [[cell.strip() for cell in row.strip("│┃").replace("┃", "│").split("│")] for row in rows]


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


def test_ours_lists_the_estimators_that_its_models_carry(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    from vessel_gym.envs import SigmaCorvetteEnv

    command.main("estimators")
    system = SigmaCorvetteEnv.system
    world = system.sensors_of("nominal"), chosen_disturbance(system, "moderate")
    _, *rows = cells(capsys.readouterr().out)
    assert [name for name, *_ in rows] == list(accepted(system, *world))
    (variants,) = (words.split(", ") for name, _, words in rows if name == "kf")
    names = tuple(f"kf-{last}" for last in ("linear", "nonlinear", "waves", "white"))
    assert variants == list(accepted(system, *world, names))


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


def test_a_table_is_as_wide_as_columns_says(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    command.main("studies")
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) == 60
    assert cells(printed)[0] == ["study", "question"]


@pytest.mark.parametrize("terminal", [True, False])
def test_the_first_line_of_an_answer_is_bold_in_a_terminal_alone(capsys, monkeypatch, terminal):
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr("sys.stdout.isatty", lambda: terminal)
    print_answer([f"The [answer] {'is long ' * 30}", "More."])
    first, rest = capsys.readouterr().out.splitlines()
    assert first.startswith("\x1b[1mThe [answer]" if terminal else "The [answer]")
    assert rest == "More."
