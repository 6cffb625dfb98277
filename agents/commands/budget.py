"""Find the cheapest sensors that do: ``vessel-gym budget SigmaCorvette-v0 --keep 0.95``."""

from pathlib import Path
from typing import Any

from agents.commands.console import asked, in_range, print_table, progress
from agents.refusal import Refusal


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    keep: float = 0.95,
    prices: Path | None = None,
    rates: tuple[float, ...] = (),
    estimator: str | None = None,
    agent: str = "autopilot",
    disturbance: str = "moderate",
    episodes: int = 1024,
    first_seed: int = 0,
    out: Path | None = None,
    processes: int = 2,
) -> int:
    """Find the cheapest grades of sensors that keep a share of the score on the truth, and confirm them on fresh seeds.

    Results are kept in the output folder. After an interruption, run the same command again: it
    goes on with what is missing.

    Args:
        env_id: Registered environment.
        keep: Share of the score on the truth that is asked for, above 0 and at most 1.
        prices: TOML file with a table for each sensor and a number for each of its grades, in any
            currency; without it, each step to a better grade costs 1. Every run writes such a file,
            prices.toml, to begin with.
        rates: Lower rates [Hz] to try, too, for each grade.
        estimator: The environment's default if not given.
        agent: A controller of the task (autopilot, lqg, pid), ppo (comes with the package), the
            path of a checkpoint, or your own as module:object, whose code is run.
        disturbance: calm, moderate or rough.
        episodes: The most episodes of a suite in the search, and their number in the confirmation.
        first_seed: Number of the first evaluation seed, counted from 0; the fresh seeds begin
            500,000 above.
        out: Folder for results and report; results/budget-ENVIRONMENT if not given.
        processes: Processes on this machine.

    Returns:
        The exit status: 1 if no suite is confirmed.
    """
    from agents.budget.flights import World
    from agents.budget.suites import choices_of, suites_of
    from agents.files import check_folder
    from agents.page import listed
    from agents.studies.worlds import environment_id, system_of
    from vessel_gym.extras import require
    from vessel_gym.toml_file import TomlFile

    with asked():
        environment_id(env_id)
        _check_numbers(keep, episodes, first_seed, processes)
        system = system_of(env_id)
        choices = choices_of(system, rates)
        suites = suites_of(choices, None if prices is None else TomlFile(prices).data)
        world = World(env_id, estimator, agent, disturbance)
        world.check()
        require("matplotlib", "jinja2", "joblib")
        out = out or Path("results") / f"budget-{env_id.rpartition(':')[2]}"
        check_folder(out)
    if fixed := [sensor.name for sensor in system.nominal_sensors if sensor.name not in choices]:
        print(
            f"the vehicle's file of grades has no choice for {listed(fixed)}: flown as in the"
            " environment"
        )
    return _search(world, suites, keep, episodes, first_seed, out, processes, prices is not None)


def _check_numbers(keep: float, episodes: int, first_seed: int, processes: int) -> None:
    """Refuse numbers out of range."""
    from agents.budget.result import FRESH
    from agents.budget.search import FIRST_LOOK
    from agents.seeds import evaluation_seeds

    if not 0.0 < keep <= 1.0:
        raise ValueError(f"--keep must be above 0 and at most 1, got {keep:g}")
    in_range("--processes", processes, 1)
    in_range("--episodes", episodes, FIRST_LOOK)
    in_range("--first-seed", first_seed, 0, FRESH - 1)
    evaluation_seeds(episodes, first_seed + FRESH)


def _search(
    world: Any,
    suites: Any,
    keep: float,
    episodes: int,
    first_seed: int,
    out: Path,
    processes: int,
    priced: bool,
) -> int:
    """Search and confirm, write the report, and print the answer; the exit status."""
    from rich.console import Console

    from agents.budget import result
    from agents.budget.flights import Flights
    from agents.budget.report import conclusion, guarantees, write_report
    from agents.budget.suites import prices_toml
    from agents.files import replacing

    if not (out / "prices.toml").exists():  # the user's own may lie there
        with replacing(out / "prices.toml") as path:
            path.write_text(prices_toml(suites), encoding="utf-8")
    with progress(f"{len(suites)} suites", counted=True) as show:
        flights = Flights(world, suites, out, processes, first_seed)
        try:
            found = result.cheapest(flights, keep, episodes, show)
        except RuntimeError as error:
            raise Refusal(str(error)) from error
    report = write_report(found, out, priced)
    console = Console(markup=False, highlight=False, soft_wrap=True)
    console.print(*conclusion(found), sep="\n")
    _show(found)
    console.print(guarantees(found, priced)[-1], f"Report: {report}", sep="\n")
    return int(found.answer is None)


def _show(found: Any) -> None:
    """Print the table of the suites round the answer."""
    from agents.budget.report import summary

    beside = summary(found)
    header = [beside.first, *(label for label, _ in beside.head)]
    sections = (
        [[name, *map(str, entries)] for name, entries in rows] for _, rows in beside.sections
    )
    print_table(beside.title, header, sections)
