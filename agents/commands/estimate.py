"""Estimate a ship's motion from a log: ``vessel-gym estimate voyage.csv --vessel identified.toml``."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from agents.commands.console import asked, print_table

_FILTERS = ("ekf", "ukf", "iekf", "enkf", "etkf", "enkf-sr", "huber-kf")
_UNITS = ((1.0, "m"), (180.0 / np.pi, "deg"), (180.0 / np.pi, "deg/s"))
_STATES = ("x", "y", "heading", "surge", "sway", "yaw rate")


def main(
    log: Annotated[Path, tyro.conf.Positional],
    /,
    vessel: Path,
    columns: Path | None = None,
    estimators: tuple[str, ...] = _FILTERS,
    out: Path = Path("results/estimates.csv"),
    tune: bool = False,
    seed: int = 0,
    page: Path | None = None,
) -> None:
    """Estimate motion with its uncertainty, and judge filters where there is no truth.

    Each sensor is withheld in turn, and its measurements are compared with those that a filter without it foretells.
    With - as the log, lines are read from a pipe, and estimates of the first filter are printed as they are made.

    Args:
        log: CSV, Parquet, NMEA 0183 or ULog file, or - for a pipe of CSV or NMEA 0183.
        vessel: Vessel file of `vessel-gym identify`.
        columns: Column map of the log; columns are recognised by their names without one.
        estimators: Filters; the table of estimates is that of the first.
        out: CSV file of estimates and standard deviations to write.
        tune: Tune the noise on the first half of the log and judge on the second; otherwise the vessel file's is used.
        seed: Of filters that draw numbers; those of a pipe have seed 0.
        page: HTML file to write: track, estimates, innovations and NIS of every filter that keeps its estimates.
    """
    from agents.files import check_file
    from estimators import names
    from estimators.factory import unknown
    from vessel_gym.identification.filtering import sampling, voyages
    from vessel_gym.identification.trial import common_step, trials
    from vessel_gym.logs import Columns, read, read_columns
    from vessel_gym.vehicles.measured_ship import read as read_ship

    with asked():
        for name in estimators:
            if name not in names():
                raise ValueError(unknown("filter", name, names()))
        if not estimators:
            raise ValueError("--estimators needs at least one filter")
        ship = read_ship(vessel)
        chosen = read_columns(columns) if columns else Columns({})
        if str(log) == "-":
            _check_of_pipe(page, seed)
            return _stream(sys.stdin, chosen, ship, estimators[0])
        for file in filter(None, (out, page)):
            check_file(file)
        found = read(log, chosen)
        step = sampling(trials(found, common_step([found], ship.particulars)), ship)
        parts = voyages(found, step)
        tables, judged = _judged(parts, ship, estimators, tune, seed)
    _write(out, tables)
    print(f"estimates of {estimators[0]}: {out}")
    if page is not None and judged[1]:
        from agents.episodes.voyages import voyage_page

        voyage_page(ship.particulars.length, *judged).save(page)
        print(f"page: {page}")
    return None


def _judged(parts: Any, ship: Any, estimators: tuple[str, ...], tuned: bool, seed: int) -> tuple[list[Any], Any]:
    """Judge the filters on the longest part, and print it.

    Returns:
        The first filter's estimates of every part; the longest part with name, estimates and verdict of each filter.
    """
    from vessel_gym.identification.consistency import filtered, judge, simulated
    from vessel_gym.identification.filtering import estimate, noise_of
    from vessel_gym.identification.tuning import tune

    longest = max(parts, key=lambda part: len(part.u))
    half = len(longest.u) // 2 if tuned else 0
    noise = tune(ship, [longest.part(0, half)]) if tuned else noise_of(ship)
    judged = longest.part(half, len(longest.u))
    drawn = simulated(ship, judged, noise, seed)
    rows, found = [], []
    for name in estimators:
        try:
            series, verdict = judge(name, ship, judged, noise, seed)
            _, (inside, ratio, *_) = filtered(name, ship, drawn, noise, seed)
        except ValueError as error:
            rows.append((name, str(error), *[""] * 6))
            continue
        found.append((name, series, verdict))
        rows.append(
            (
                name,
                f"no: {', '.join(verdict.doubts)}" if verdict.doubts else "yes",
                f"{100.0 * verdict.inside:.0f} %",
                f"{verdict.ratio:.2f}",
                f"{100.0 * verdict.rejected:.1f} %",
                f"{verdict.lag:.2f}",
                f"{100.0 * inside:.0f} %",
                f"{ratio:.2f}",
            )
        )
    head = ("", "trust", "NIS inside", "NIS ratio", "rejected", "lag 1", "simulated: NIS inside", "NIS ratio")
    print_table(f"Consistency of filters at steps of {judged.trial.dt:g} s", head, [rows])
    print(
        "NIS inside: within its central 95 % interval, rejected measurements included. NIS ratio: mean over that of "
        "a consistent filter, of those that the gate let through. Rejected: share of measured values. "
        "Lag 1: correlation of successive innovations, 0 if consistent. "
        "Simulated: the same on a voyage drawn from the filter's own model, with the inputs of the log."
    )
    if found:
        _print_withheld(found)
    return [(each, estimate(estimators[0], ship, each, noise, rng=seed)) for each in parts], (judged, found)


def _print_withheld(found: list[tuple[str, Any, Any]]) -> None:
    """Print what filters foretell of sensors that they do not get."""
    rows = [
        (
            name,
            *(
                f"{100.0 * share:.0f} % of ± {2.0 * verdict.deviations[label] * scale:.2g} {unit}"
                for (label, share), (scale, unit) in zip(verdict.withheld.items(), _UNITS, strict=True)
            ),
        )
        for name, _, verdict in found
    ]
    print_table("Sensors withheld in turn", ("", *found[0][2].withheld), [rows])
    print(
        "Share of the withheld sensor's measurements within two standard deviations of those foretold, 95 % if "
        "consistent, and the median of two deviations."
    )


def _write(path: Path, tables: list[tuple[Any, Any]]) -> None:
    """Write estimates as CSV: time, state, standard deviations, NIS."""
    from agents.files import replacing
    from vessel_gym.identification.consistency import nis_of

    with replacing(path) as written, written.open("w", encoding="utf-8") as file:
        file.write(_header(("NIS", "degrees of freedom")))
        for voyage, series in tables:
            square, count = nis_of(series)
            for k, (mean, cov) in enumerate(zip(series.mean, series.cov, strict=True)):
                time = voyage.trial.start + k * voyage.trial.dt
                file.write(_row(time, mean, cov, (square[k], count[k])))


def _header(others: Iterable[str] = ()) -> str:
    return ",".join(("time", *_STATES, *(f"sd of {name}" for name in _STATES), *others)) + "\n"


def _row(time: float, mean: np.ndarray, cov: np.ndarray, others: Iterable[float] = ()) -> str:
    sd = np.sqrt(np.diagonal(cov))[: len(_STATES)]
    return ",".join(f"{number:.9g}" for number in (time, *mean[: len(_STATES)], *sd, *others)) + "\n"


def _check_of_pipe(page: Path | None, seed: int) -> None:
    """Refuse options that a pipe has no use for.

    Raises:
        ValueError: if there is a page or a seed.
    """
    if page is not None:
        raise ValueError("--page needs a log that ends: a pipe has none")
    if seed:
        raise ValueError("--seed needs a log that ends: the filter of a pipe has seed 0")


def _stream(lines: Iterable[str], columns: Any, ship: Any, name: str) -> None:
    """Print estimates as the lines come."""
    from vessel_gym.identification.stream import estimates

    print(_header(), end="", flush=True)
    for time, mean, cov in estimates(lines, columns, ship, name):
        print(_row(time, mean, cov), end="", flush=True)
