"""Anything that is typed or passed to `agents`: one sentence, and exit status 2 for a command."""

import contextlib
import io
import re
import sys
from collections.abc import Iterator, Sequence
from inspect import signature
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import agents
import agents.jobs
import agents.training.algorithms
from agents import commands, rollout
from agents.commands import ablate, budget, evaluate, reproduce, train, watch
from agents.commands.console import command
from agents.commands.options import ENVIRONMENT
from agents.episodes import recording
from agents.studies.study import StudyError, read_study
from studies import speed

COMMANDS: dict[str, Any] = {
    "ablate": ablate.main,
    "budget": budget.main,
    "evaluate": evaluate.main,
    "speed": speed.main,
    "reproduce": reproduce.main,
    "train": train.main,
    "watch": watch.main,
}
STUDY = """
title = "A small study"
episodes = 2
training_seeds = 1

[environments]
SigmaCorvette-v0 = {}

[estimators]
mine = { estimator = "kf", options = { input_cov = 1e-4 }, environments = ["SigmaCorvette-v0"] }

[agents]
PPO = { kind = "ppo", memory = "frames", trained_on = ["truth"], steps = { SigmaCorvette-v0 = 8192 } }

[conditions]
odd = { sensors = "degraded", disturbance = "rough", mismatch = 0.1 }
"""


class Begun(BaseException):
    """The expensive work would begin now."""


@pytest.fixture(scope="module", autouse=True)
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with good and bad files in which every command stops where its work would begin."""

    def begin(*_: Any, **__: Any) -> None:
        raise Begun

    folder = tmp_path_factory.mktemp("workplace")
    (folder / "folder.gif").mkdir()
    (folder / "file").touch()
    (folder / "bytes").write_bytes(bytes(range(256)))
    (folder / "study.toml").write_text(STUDY)
    (folder / "wrong.toml").write_text(
        "estimators = 3\nagents = [1]\nconditions = 'x'\nenvironments = 1979-05-27\n"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("SDL_VIDEODRIVER", "offscreen")  # no display
        for place, name in (
            (agents, "rollout"),
            (recording, "typical_page"),
            (agents.training.algorithms, "_learn"),
            (agents.jobs, "run"),
            (watch, "record"),
            (speed, "report"),
        ):
            patch.setattr(place, name, begin)
        yield folder


def call(name: str, arguments: Sequence[str]) -> int | None:
    """The console command, or a command that it does not know."""
    if name in COMMANDS and name not in commands.COMMANDS:
        return command(COMMANDS[name], arguments)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["vessel-gym", name, *arguments])
        return commands.main()


def refused(name: str, *arguments: str, encoding: str | None = None) -> str | None:
    """The sentence with which a command refuses its arguments, in any encoding; None if its work would begin."""
    encoding = encoding or ("utf-8", "ascii", "cp1252")[sum(map(len, arguments)) % 3]
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding, write_through=True) for _ in range(2))
    status: Any = "neither refused nor begun"
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = call(name, arguments)
        except Begun:
            return None
        except SystemExit as stop:
            status = stop.code
    assert status == 2
    text, printed = (stream.buffer.getvalue().decode(encoding) for stream in (err, out))  # type: ignore[attr-defined]
    assert not printed
    assert text.startswith("error: ")
    assert len(text) > len("error: \n") + 10
    assert "Traceback" not in text
    assert "\n\n" not in text, "more than a paragraph"
    return text.strip()


WORDS = [
    "", " ", "-1", "0", "1", "nan", "inf", "-inf", "1e3", "9" * 30, "9" * 5000, "None", "[1]",
    "{}", "--", "ünïcode", "a\nb", "x" * 300, "\udcff", "folder.gif", "file", "file/x.gif",
    "bytes", "new/x.gif", "/dev/null/x.gif", "study.toml", "wrong.toml", "nobody.toml",
    "SigmaCorvette-v0", "CartPole-v1", "SigmaCorvete-v0", "os:path", "no_module:x", "..:x", "::",
    "autopilot", "kf", "truth", "measurement", "frames", "environment", "all", "robust",
    "tcp://10.0.0.1:8786", "[::1]:1", "127.0.0.1:99999", "3/2",
]  # fmt: skip
# Nothing is written outside the folder, and no process takes a zero byte.
any_word = st.sampled_from(WORDS) | st.text(
    st.characters(exclude_characters="/\0", exclude_categories=["Cs"]), max_size=20
)
word = any_word.filter(lambda text: text not in (".", "..") and text not in ("-h", "--help"))
FIRST = {"ablate": ["study.toml"], "reproduce": ["robust"], "watch": ["--out", "turn.gif"]}


@st.composite
def command_line(draw: st.DrawFn) -> tuple[str, list[str]]:
    """A command and its real options, each with any words; sometimes an option or a command that there is not."""
    name = draw(st.sampled_from(sorted(COMMANDS)) | word)
    main = COMMANDS.get(name, train.main)
    options = [
        "",
        *(f"--{key.replace('_', '-')}" for key in (*signature(main).parameters, *ENVIRONMENT)),
    ]
    arguments = list(FIRST.get(name, [])) if draw(st.booleans()) else []
    for option in draw(
        st.lists(st.sampled_from(options) | word.map(lambda text: f"--{text}"), max_size=3)
    ):
        arguments += ([option] if option else []) + draw(st.lists(word, max_size=2))
    return name, [argument for argument in arguments if argument not in ("-h", "--help")]


@pytest.mark.slow
@settings(max_examples=150)
@given(command_line())
def test_any_command_line_is_refused_in_one_sentence_or_begins(
    line: tuple[str, list[str]],
):
    name, arguments = line
    refused(name, *arguments)


LINES = [
    ("evaluate --estimator", "--estimator: expected at least one argument"),
    (
        "evaluate --first-seed 999999 --episodes 2",
        "evaluation seeds, numbered from 0: ask for one or more of these, got 2 from 999999",
    ),
    ("evaluate --estimatr kf", "did you mean '--estimator'?"),
    ("train --resume=maybe", "maybe"),
    ("evaluate CartPole-v1", "autopilot flies the environments of vessel_gym alone: name random"),
    ("evaluate --agent random --estimator kf σ-filter", "unknown estimator"),
    ("evaluate --agent größe:Steuer", "größe"),
    ("train CartPole-v1", "'CartPole-v1' is no environment of vessel_gym"),
    ("train --sensors cléan", "choose from clean, nominal, degraded"),
    ("train --out /dev/null/ppo.zip", "cannot write /dev/null/ppo.npz"),
    ("watch --out turn.avi", "'.avi': choose from .html, .pdf, .svg, .gif, .mp4, .png"),
    ("watch --out turn.gif --estimator ekf kf", "turn.gif shows one estimator: name one, or"),
    (
        "speed --page study.toml",
        "study.toml needs one line <!-- measured --> and a line <!-- end --> below it",
    ),
    ("evaluate --estimator kf ekf --compare-to eekf", "compare to 'eekf' (did you mean 'ekf'?)"),
    ("plot nowhere", "no evaluations.npz is in nowhere: name what vessel-gym train wrote"),
    ("evaluate --out table.xlsx", "unknown kind of file '.xlsx': choose from .csv"),
    ("ablate quik", "unknown study 'quik' (did you mean 'quick'?)"),
    ("ablate folder.gif", "cannot read folder.gif: Is a directory"),
    ("ablate bytes", "bytes: line 1: the file is not text in UTF-8"),
    ("wacth PunaUAV-v0", "unknown command 'wacth' (did you mean 'watch'?)"),
]


@pytest.mark.parametrize(("line", "sentence"), LINES)
def test_bad_word_is_named_in_every_encoding(line: str, sentence: str):
    name, *arguments = line.split()
    before = sorted(Path().rglob("*"))
    assert sentence in str(refused(name, *arguments, encoding="utf-8"))
    assert str(refused(name, *arguments, encoding="ascii")).isascii()
    assert sorted(Path().rglob("*")) == before


@pytest.mark.parametrize("arguments", [["study.toml", "--out", ""], ["study.toml", "--out="], [""]])
def test_an_empty_word_is_not_taken_for_the_present_folder(arguments: list[str]):
    assert refused("ablate", *arguments) == "error: an argument is empty"


@pytest.mark.parametrize(
    "line",
    [
        "evaluate vessel_gym:SigmaCorvette-v0 --estimator kf default --episodes 1",
        "evaluate vessel_gym/Ship-v0 --agent random --no-guidance --vessel mariner --mismatch 0.1",
        "train --out new/ppo --steps 128",
        "watch --out turn.png",
        "watch --out turn.pdf --estimator ekf estimators:UnscentedKalmanFilter",
        "speed PunaUAV-v0 --rows 2",
        "reproduce robust puna --processes 1",
        "ablate study.toml --processes 3",
        "ablate quick --out new/quick",
        "budget vessel_gym:SigmaCorvette-v0 --keep 1 --rates 1 0.5 --out new/budget",
    ],
)
def test_what_can_be_meant_begins(line: str):
    name, *arguments = line.split()
    assert refused(name, *arguments) is None


def test_a_mistake_of_ours_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch):
    def broken(*_: Any, **__: Any) -> None:
        raise ValueError("of ours")

    monkeypatch.setattr(speed, "report", broken)
    with pytest.raises(ValueError, match=r"^of ours$"), contextlib.redirect_stderr(io.StringIO()):
        command(speed.main, [])


def test_too_little_memory_is_one_sentence(monkeypatch: pytest.MonkeyPatch):
    def greedy(*_: Any, **__: Any) -> None:
        raise MemoryError("Unable to allocate 7 TiB")

    monkeypatch.setattr(speed, "report", greedy)
    refusal = refused("speed", "--rows", "1000000000")
    assert refusal == "error: this machine has too little memory for that: Unable to allocate 7 TiB"


# --- study files ----------------------------------------------------------------------------------

PIECES = [
    "3", "-1", '"x"', '""', "[]", "{}", "nan", "-inf", "true", "1979-05-27", "07:32:00",
    '[1, "a"]', "{ a = 1 }", '"kf"', "1e999", "9" * 40, "9" * 400, "9" * 5000, "[" * 2000,
    '"os:path"', '"no_module:x"', '"..:x"', '"none"', '[["x"]]', "[{}]", '"\\u0000"', "\n", "=",
    "[", "]", "{", "}", '"', "#", ",", ".", "\n[agents]\n", "\n[[agents]]\n",
    "\n[estimators.x]\n", 'model = "nonlinear"', "\x00", "é",
]  # fmt: skip
VALUES = [match.span() for match in re.finditer(r'"[^"]*"|\[[^\[\]]*\]|\{[^{}]*\}|[\w.-]+', STUDY)]


@st.composite
def mutated(draw: st.DrawFn) -> str:
    """The study with one value replaced and some text put in or cut out."""
    start, end = draw(st.sampled_from(VALUES))
    text = STUDY[:start] + draw(st.sampled_from(PIECES)) + STUDY[end:]
    for _ in range(draw(st.integers(0, 2))):
        start = draw(st.integers(0, len(text)))
        end = draw(st.sampled_from([start, start + draw(st.integers(1, 20))]))
        text = text[:start] + draw(st.sampled_from(["", *PIECES])) + text[end:]
    return text


@given(mutated())
def test_any_study_file_is_read_or_refused_by_sentences(
    text: str,
):
    path = Path("mutated.toml")
    path.write_text(text, encoding="utf-8")
    said, mistakes = str(path), [(0, "none")]
    try:
        read_study(path)
    except StudyError as error:
        said, mistakes = str(error), error.mistakes
    assert said.startswith(str(path))
    assert mistakes
    for line, mistake in mistakes:
        assert 0 <= line <= len(text.splitlines()) + 1
        assert mistake
        assert "\n" not in mistake


# --- public functions -----------------------------------------------------------------------------

GOOD: dict[str, Any] = {
    "agent": "autopilot",
    "env_id": "SigmaCorvette-v0",
    "seeds": [0, 1],
    "env_options": {"max_episode_steps": 2},
    "record": True,
}


@pytest.mark.parametrize(
    ("key", "wrong", "sentence"),
    [
        (
            "agent",
            None,
            "an agent is a name, the path of a checkpoint, or has reset and act, got None",
        ),
        ("env_id", 3, "env_id must be the name of a registered environment, got 3"),
        *(
            ("seeds", wrong, f"seeds must be a list of one or more whole numbers >= 0, got {wrong}")
            for wrong in ([0, -1], [], 5)
        ),
        (
            "env_options",
            ["kf"],
            "env_options must be a dictionary of values by name, or None, got ['kf']",
        ),
    ],
)
def test_what_a_rollout_cannot_mean_is_named(key: str, wrong: Any, sentence: str):
    with pytest.raises((ValueError, TypeError), match=f"^{re.escape(sentence)}$"):
        rollout(**GOOD | {key: wrong})
