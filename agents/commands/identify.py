"""Identify a ship from logs of her trials: ``vessel-gym identify turn.csv zigzag.csv --vessel particulars.toml``."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from agents.commands.console import asked, print_table


def main(
    logs: Annotated[tuple[Path, ...], tyro.conf.Positional],
    /,
    vessel: Path,
    columns: Path | None = None,
    out: Path = Path("results/identified.toml"),
    check: tuple[Path, ...] = (),
    fixed: tuple[str, ...] = (),
) -> None:
    """Identify a manoeuvring model with its uncertainty, and compare it with logs.

    The file that it writes is a vessel: `vessel-gym estimate` and `vessel_gym/Ship-v0` take it.

    Args:
        logs: Logs of trials with position, heading, yaw rate, rudder and revolutions, and the true wind if it was
            measured.
        vessel: TOML file of the ship's particulars (kind = "measured ship").
        columns: Column map of the logs; columns are recognised by their names without one.
        out: Vessel file to write.
        check: Logs to compare the model with; those that it is identified from if none are given.
        fixed: Coefficients that keep what is assumed of them, e.g. kc.
    """
    from agents.files import check_file
    from vessel_gym.identification.filtering import NOISE, sampling
    from vessel_gym.identification.fit import identify
    from vessel_gym.identification.trial import common_step, trials
    from vessel_gym.identification.tuning import tune
    from vessel_gym.logs import Columns, read, read_columns
    from vessel_gym.vehicles.manoeuvring import COEFFICIENTS, WIND
    from vessel_gym.vehicles.measured_ship import read as read_ship

    with asked():
        known = read_ship(vessel)
        particulars = known.particulars
        chosen = read_columns(columns) if columns else Columns({})
        check_file(out)
        found = [read(path, chosen) for path in logs]
        step = common_step(found, particulars)
        parts = [part for log in found for part in trials(log, step)]
        windless = not any(part.air.any() for part in parts)
        still = {*fixed, *(COEFFICIENTS[i] for i in WIND if windless)}
        compared = [part for path in check for part in trials(read(path, chosen), step)] or parts
        sampled = _sampled(found, sampling(parts, known))
        minutes = sum(len(part) for part in parts) * step / 60.0
        print(f"identifying the model from {minutes:.0f} minutes of {len(found)} logs", file=sys.stderr)
        ship = identify(parts, particulars, still)
        print("tuning the noise that filters assume", file=sys.stderr)
        ship = replace(ship, noise=dict(zip(NOISE, map(float, tune(ship, sampled)), strict=True)))
        ship.write(out)
    _report(ship)
    _compare(ship, parts, compared, "logs that were not used" if check else "the logs themselves")
    _gaps(ship, compared)
    print(f"vessel: {out}")


def _sampled(logs: Sequence[Any], step: float) -> list[Any]:
    """Voyages on which the noise of filters is tuned; of a log that is too short for them a sentence.

    Raises:
        LogError: if every log is too short.
    """
    from vessel_gym.identification.filtering import voyages
    from vessel_gym.logs import LogError

    found, short = [], []
    for log in logs:
        try:
            found += voyages(log, step)
        except LogError as error:
            short.append(error)
    if not found:
        raise short[0]
    for each in short:
        print(f"{each}: this log says nothing of the noise of filters", file=sys.stderr)
    return found


def _report(ship: Any) -> None:
    """Print the coefficients."""
    from vessel_gym.vehicles.manoeuvring import COEFFICIENTS

    rows, unknown = [], []
    for name, value, (low, high), known, assumed in zip(
        COEFFICIENTS, ship.coefficients, ship.intervals, ship.determined, ship.particulars.coefficients, strict=True
    ):
        if known:
            label = f"{name}: {assumed.meaning}"
            rows.append((label, f"{value:.4g}", f"{low:.3g} to {high:.3g}", f"{assumed.mean:.3g} ± {assumed.sd:.2g}"))
        else:
            unknown.append(name)
    print_table("Coefficients that the logs determine", ("", "estimate", "95 % interval", "assumed before"), [rows])
    if unknown:
        print(f"Not determined, close to what was assumed of them: {', '.join(unknown)}.")


def _compare(ship: Any, parts: Any, compared: Any, which: str) -> None:
    """Print errors of the model and of its rivals."""
    import numpy as np

    from vessel_gym.identification.fit import window_lengths
    from vessel_gym.identification.nomoto import identify_nomoto
    from vessel_gym.identification.score import ahead, predictors, whole

    seconds = float(f"{window_lengths(parts, ship.particulars)[0]:.1g}")
    nomoto = {f"Nomoto, order {order}": identify_nomoto(parts, seconds, order) for order in (1, 2)}
    rows = []
    for name, predict in predictors(ship, parts[0].dt, nomoto).items():
        errors = np.array([ahead(predict, part, ship.particulars.length, seconds) for part in compared])
        runs = np.array([whole(predict, part) for part in compared])
        heading, position = np.nanmedian(errors, 0)
        rows.append((name, f"{np.rad2deg(heading):.1f}", f"{position:.2f}", f"{np.median(runs):.2f}"))
    head = ("", "heading [deg]", "position [lengths]", "yaw rate [share]")
    print_table(f"Median RMS error over {which}", head, [rows])
    print(f"Heading and position {seconds:.0f} s ahead of any moment; yaw rate over a whole run as a share of its RMS.")


def _gaps(ship: Any, compared: Any) -> None:
    """Print numbers of manoeuvres, measured and simulated."""
    import numpy as np

    from vessel_gym.identification.manoeuvres import compare
    from vessel_gym.identification.score import predictors

    length, rows = ship.particulars.length, []
    for part in compared:
        found = compare(predictors(ship, part.dt, {})["identified model"], part)
        if found is None:
            continue
        scales = (length, length, 0.01)
        numbers = [
            [getattr(each, name) / scale for each in found]
            for name, scale in zip(("advance", "tactical_diameter", "speed_loss"), scales, strict=True)
        ]
        overshoots = np.rad2deg([each.overshoots for each in found])
        both = np.isfinite(overshoots).all(0)
        numbers.append(list(overshoots[:, both].mean(1)) if both.any() else [np.nan, np.nan])
        if np.isfinite(numbers).any():
            rows.append(
                (part.name, *("" if np.isnan(pair).any() else "{:.1f} / {:.1f}".format(*pair) for pair in numbers))
            )
    if rows:
        head = ("", "advance [lengths]", "tactical diameter [lengths]", "speed loss [%]", "mean overshoot [deg]")
        print_table("Manoeuvres, measured / simulated from where the rudder is put over", head, [rows])
