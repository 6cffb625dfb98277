"""`vessel-gym budget`: from an environment and prices to the cheapest suite, whatever happens on the way."""

import contextlib
import csv
import io
from collections.abc import Iterator
from pathlib import Path

import pytest

import agents.jobs
from agents.budget import flights
from agents.budget.flights import Flights, World
from agents.budget.result import Budget, cheapest
from agents.budget.search import TRUTH, Request, share_kept
from agents.budget.suites import choices_of, sensors_of, suites_of
from agents.commands import budget
from agents.commands.console import Refusal
from agents.studies.worlds import system_of

HERE = Path(__file__).parents[1]
ENVIRONMENT = "few_grades:FewGradesVectorEnv"
PRICES = """
[receiver]
nominal = 900
"four metres" = 400
"twelve metres" = 50
["gyro compass"]
nominal = 20_000
worst = 300
"""


@pytest.fixture(autouse=True)
def _importable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(HERE))


def flown(out: Path) -> list[dict[str, str]]:
    """The suites of a run as it writes them."""
    with (out / "budget.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def results(out: Path) -> dict[str, int]:
    """The files of a run's flights, each with a number that changes when it is written again."""
    return {path.name: path.stat().st_ino for path in (out / "jobs").iterdir()}


def small(out: Path, prices: Path | None, processes: int = 1) -> int:
    return budget.main(
        ENVIRONMENT, keep=0.8, prices=prices, episodes=128, out=out, processes=processes
    )


@pytest.fixture(scope="module")
def run_of_one(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, str]:
    """Prices, where a run in one process with them wrote, and what it printed."""
    folder, printed = tmp_path_factory.mktemp("budget"), io.StringIO()
    (folder / "prices.toml").write_text(PRICES)
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.syspath_prepend(str(HERE))
        assert small(folder / "whole", folder / "prices.toml") == 0
    return folder / "prices.toml", folder / "whole", printed.getvalue()


@pytest.mark.slow
def test_the_answer_is_printed_and_written_and_an_interrupted_run_goes_on(
    run_of_one, tmp_path, monkeypatch
):
    (prices, whole, printed), broken = run_of_one, tmp_path / "broken"
    rows = flown(whole)
    answer = next(line for line in printed.splitlines() if line.startswith("The cheapest suite"))
    (found,) = {row["price"] for row in rows if f"receiver {row['receiver']}" in answer} & {
        row["price"] for row in rows if row["verdict"] == "confirmed"
    }
    assert f"Its price is {found}" in printed
    assert sum(len(line) > 0 and line[0] == "│" for line in printed.splitlines()) <= 40
    page = (whole / "budget.html").read_text(encoding="utf-8")
    assert "The cheapest sensors that keep 80 %" in page
    assert page.count("data:image/svg+xml") == 1
    assert (whole / "budget.png").stat().st_size > 10_000

    runs: Iterator[int] = iter(range(100))

    def interrupted(*arguments: object, **named: object) -> object:
        if next(runs) == 2:
            raise KeyboardInterrupt
        return run(*arguments, **named)

    run = agents.jobs.run
    monkeypatch.setattr(agents.jobs, "run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        small(broken, prices)
    done = results(broken)
    assert 0 < len(done) < len(results(whole))
    assert small(broken, prices) == 0
    assert done.items() <= results(broken).items()
    assert results(broken).keys() == results(whole).keys()
    assert (broken / "budget.csv").read_bytes() == (whole / "budget.csv").read_bytes()
    assert (broken / "budget.html").read_bytes() == (whole / "budget.html").read_bytes()


@pytest.mark.slow
def test_two_processes_find_what_one_does(run_of_one, tmp_path):
    prices, whole, _ = run_of_one
    assert small(tmp_path, prices, processes=2) == 0
    assert (tmp_path / "budget.csv").read_bytes() == (whole / "budget.csv").read_bytes()


def test_the_prices_that_a_run_writes_can_be_given_to_the_next(tmp_path, monkeypatch):
    def begun(*_: object) -> None:
        raise InterruptedError

    monkeypatch.setattr("agents.budget.result.cheapest", begun)
    for given in (None, tmp_path / "out" / "prices.toml"):
        with pytest.raises(InterruptedError):
            small(tmp_path / "out", given)


def test_sensors_have_the_grades_and_rates_that_are_chosen():
    system = system_of(ENVIRONMENT)
    compass, gyro, receiver = sensors_of(
        system, {"receiver": ["twelve metres", 0.25], "gyro compass": ["worst", None]}
    )
    assert (receiver.sd, receiver.rate) == ((12.0, 12.0), 0.25)
    assert compass.sd == (2e-2,)
    assert gyro.sd == system.nominal_sensors[1].sd


def test_lower_rates_are_choices_of_their_own():
    choices = choices_of(system_of(ENVIRONMENT), (1.0, 0.5))
    assert [str(each) for each in choices["receiver"]] == [
        "nominal", "nominal at 0.5 Hz", "four metres", "four metres at 1 Hz", "four metres at 0.5 Hz", "twelve metres",
    ]  # fmt: skip
    assert [str(each) for each in choices["rate gyro"]] == [
        "nominal",
        "nominal at 1 Hz",
        "nominal at 0.5 Hz",
    ]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"keep": 0.0}, "--keep must be above 0 and at most 1, got 0"),
        ({"keep": float("nan")}, "--keep must be above 0 and at most 1, got nan"),
        ({"episodes": 31}, "--episodes must be at least 32, got 31"),
        ({"first_seed": 500_000}, "--first-seed must be at most 499999, got 500000"),
        ({"rates": (0.3,)}, "reads at 0.3 Hz, which does not divide the 2 steps a second"),
        (
            {"rates": (0.5, 2.0)},
            "--rates must be above 0 and below 2 Hz, the highest of any grade, got 2",
        ),
        ({"agent": "nosuch"}, "nosuch"),
    ],
)
def test_what_cannot_be_meant_is_one_sentence(tmp_path, arguments, sentence):
    with pytest.raises(Refusal, match=r"^[^\n]*$") as refused:
        budget.main(ENVIRONMENT, out=tmp_path / "out", **arguments)
    assert sentence in str(refused.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("receiver = [", "not TOML"),
        (PRICES.replace("worst = 300", ""), "the prices lack the grade 'worst' of gyro compass"),
        (
            PRICES.replace("900", "-900"),
            "the price of receiver, nominal, must be a number from 0 to 1e+12, got -900",
        ),
        (PRICES.replace("worst", "wrost"), "unknown grade of gyro compass in the prices 'wrost'"),
    ],
)
def test_prices_that_cannot_be_meant_are_one_sentence(tmp_path, text, sentence):
    path = tmp_path / "prices.toml"
    path.write_text(text)
    with pytest.raises(Refusal, match=r"^[^\n]*$") as refused:
        budget.main(ENVIRONMENT, prices=path, out=tmp_path / "out")
    assert sentence in str(refused.value)
    with pytest.raises(OSError, match=r"cannot read .*nobody\.toml: No such file"):
        budget.main(ENVIRONMENT, prices=tmp_path / "nobody.toml", out=tmp_path / "out")


def test_an_environment_without_grades_is_refused(tmp_path, monkeypatch):
    system = system_of(ENVIRONMENT)
    monkeypatch.setattr(type(system.vehicle), "grades", None)
    with pytest.raises(Refusal, match="FewGrades has no grades of sensors"):
        budget.main(ENVIRONMENT, out=tmp_path / "out")


def test_a_suite_of_which_the_filter_cannot_be_built_is_refused_with_the_reason(monkeypatch):
    def refuse(*_: object) -> None:
        raise ValueError("no such filter on these sensors")

    monkeypatch.setattr(World, "made", refuse)
    found = flights.fly(
        ENVIRONMENT, None, "autopilot", "moderate", {"receiver": ["nominal", None]}, 0, 2, {}
    )
    assert found == {"refused": "no such filter on these sensors"}


SHARE = 0.86
"""A hard case: on 1,000 seeds the cheapest suite but one keeps 0.857, and the cheapest that keeps this share 0.882."""


def searched(out: Path, first_seed: int) -> tuple[Budget, Flights]:
    suites = suites_of(choices_of(system_of(ENVIRONMENT)))
    made = Flights(World(ENVIRONMENT), suites, out, None, first_seed)
    return cheapest(made, SHARE, 256), made


@pytest.mark.nightly
def test_the_answer_holds_on_fresh_seeds_in_19_of_20_repetitions(tmp_path):
    """Each repetition has seeds of its own, and its answer is flown on 1,000 more.

    If an answer is wrong in 2.5 % of cases, which it is only at the very border, two or more of 20
    are in 9 %.
    """
    held, answers = 0, set()
    for repetition in range(20):
        found, made = searched(tmp_path, 2_000 * repetition)
        assert found.answer is not None
        truth, scores = made([Request(i, 200_000, 1000) for i in (TRUTH, found.answer)])
        assert truth is not None
        assert scores is not None
        share = share_kept(scores, truth)
        held += share.mean >= SHARE
        answers.add(str(found.suites[found.answer]))
        print(repetition, found.suites[found.answer], share)
    assert held >= 19, answers
