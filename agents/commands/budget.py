"""Find the cheapest sensors that suffice: ``vessel-gym budget SigmaCorvette-v0 --keep 0.95``."""

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

from agents.commands.console import asked, print_answer, print_table, progress

ROWS = 5
"""The most rows of the table in the console; the page has all suites that were simulated."""

OPTIONS = {
    "keep": "share of the reference score (truth: perfect state knowledge) that is asked for, above"
    " 0 and at most 1",
    "prices": "TOML file with a table for each sensor and a number for each of its grades; without"
    " it, each step to a grade of smaller error costs 1. Every run writes such a file, prices.toml,"
    " to begin with",
    "rates": "lower rates [Hz] to try, too, for each grade",
    "estimator": "the environment's default if not given",
    "disturbance": "calm, moderate or rough",
    "tune": "candidates with which estimator and controller are tuned for each suite, and for the"
    " truth; 0: as delivered",
    "episodes": "most episodes of a suite in the search, and those of the confirmation",
    "out": "folder for results and report; results/budget-ENV if not given",
}


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    keep: float = 0.95,
    prices: Path | None = None,
    rates: tuple[float, ...] = (),
    estimator: str | None = None,
    agent: str = "autopilot",
    disturbance: str = "moderate",
    tune: int = 0,
    episodes: int = 1024,
    first_seed: int = 0,
    out: Path | None = None,
    processes: int = 2,
) -> int:
    """Find the cheapest grades of sensors that reach a share of the reference score.

    They are confirmed on fresh seeds. Results are kept in the output folder. After an interruption,
    run the same command again: it goes on with what is missing.

    Returns:
        The exit status: 1 if no suite is confirmed.
    """
    from agents.budget.result import Budget, budget_study
    from agents.budget.suites import suites_of
    from agents.files import check_folder, write_tables
    from agents.studies.records import DEFAULT
    from agents.studies.worlds import environment_id
    from vessel_gym.extras import require

    with asked():
        environment_id(env_id)
        _check_numbers(keep, episodes, first_seed)
        choices, costs, notes = _candidates(env_id, rates, prices)
        suites = suites_of(choices, costs)
        tuning = _tuning(tune, agent, env_id)
        study = budget_study(env_id, estimator or DEFAULT, agent, disturbance, suites)
        require("matplotlib", "jinja2", "joblib", "pyarrow")
        out = out or Path("results") / f"budget-{env_id.rpartition(':')[2]}"
        check_folder(out)
    if not (out / "prices.toml").exists():  # the user's own may lie there
        write_tables(out / "prices.toml", "Prices for --prices, in any currency.", costs)
    if tune:
        notes.append(f"Every arm is tuned with {tune} candidates, the truth included.")
    study = replace(study, episodes=episodes, first_seed=first_seed, tune=tuning)
    return _search(Budget(study, suites, keep, out, processes), notes)


def _candidates(env_id: str, rates: Sequence[float], prices: Path | None) -> tuple[Any, ...]:
    """Choices worth their prices, the price of every choice, and notes for the report."""
    from agents.budget.suites import choices_of, price_list, worthwhile
    from agents.studies.worlds import system_of
    from vessel_gym.toml_file import TomlFile

    choices = choices_of(system_of(env_id), rates)
    costs = price_list(choices, None if prices is None else TomlFile(prices).data)
    kept, notes = worthwhile(choices, costs)
    if prices is None:
        notes.append(
            "No prices were given, so each step to a grade of smaller error counts 1. Other suites"
            " of the same price may suffice, too. Give prices with --prices."
        )
    return kept, costs, notes


def _tuning(candidates: int, agent: str, env_id: str) -> Any:
    """The tuning of each arm for its suite; None if it stays as delivered."""
    from agents.controllers import is_controller
    from agents.studies.records import EACH, Tuning
    from agents.studies.worlds import system_of
    from estimators.checks import integer

    if not integer("--tune", candidates, 0):
        return None
    if not is_controller(agent, system_of(env_id)):
        raise ValueError("--tune is for controllers: leave it out for a trained policy")
    return Tuning(candidates, tunings=1, conditions=(EACH,))


def _check_numbers(keep: float, episodes: int, first_seed: int) -> None:
    """Refuse numbers out of range."""
    from agents.budget.result import FRESH
    from agents.budget.search import FIRST_LOOK
    from estimators.checks import UP_TO_1, number

    last = FRESH - episodes
    number("--keep", keep, 0.0, UP_TO_1, "above 0 and at most 1")
    number("--episodes", episodes, FIRST_LOOK - 1, FRESH + 1, f"from {FIRST_LOOK} to {FRESH}")
    number("--first-seed", first_seed, high=last + 1, what=f"at most {last}")


def _search(budget: Any, notes: list[str]) -> int:
    """Search and confirm, write the report, and print the answer; the exit status."""
    from agents.budget.report import assumption, conclusion, suites_table, write_report
    from agents.budget.result import FRESH

    try:
        with progress("suites decided", slow=inf) as show:
            budget.run(show)
            budget.confirm(FRESH)
    except KeyboardInterrupt:
        kept = "what was finished is kept, and the same command goes on from there"
        raise KeyboardInterrupt(kept) from None
    report = write_report(budget, notes)
    print_answer([*conclusion(budget), assumption(budget), *notes])
    table = suites_table(budget, ROWS)
    print_table("Suites near the answer", [table.index.name, *table.columns], table.itertuples())
    print(f"Report: {report}")
    return int(budget.answer is None)
