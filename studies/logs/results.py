"""Numbers of the gap between logs and simulation: manoeuvres, track errors, and consistency of filters."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.commands.console import progress_bar
from studies.logs.accuracy import AHEAD, TESTS, accuracy
from vessel_gym.identification.consistency import filtered, judge, simulated
from vessel_gym.identification.filtering import NOISE, Voyage, noise_of, sampling, voyages
from vessel_gym.identification.fit import identify
from vessel_gym.identification.manoeuvres import compare, executed, periods, track_errors
from vessel_gym.identification.nomoto import identify_nomoto
from vessel_gym.identification.score import predictors
from vessel_gym.identification.trial import Trial, common_step, trials
from vessel_gym.identification.tuning import tune
from vessel_gym.logs import Columns, Log, read
from vessel_gym.logs.lag import lag
from vessel_gym.logs.scale import scale
from vessel_gym.vehicles.manoeuvring import Particulars
from vessel_gym.vehicles.measured_ship import MeasuredShip

SHIP = Particulars(
    length=3.0, beam=0.489, draught=0.201, mass=244.6, propeller_diameter=0.084, rudder_area=0.0106, x_g=0.094,
    frontal_area=0.135, lateral_area=0.520,
)  # fmt: skip
"""The model of the Esso Osaka."""
COLUMNS = Columns({
    channel: {"column": column}
    for channel, column in {
        "time": "t [s]", "x": "x_position_mid [m]", "y": "y_position_mid [m]", "surge": "u_velo [m/s]",
        "sway": "vm_velo [m/s]", "heading": "psi_hat [rad]", "yaw rate": "r_angvelo [rad/s]",
        "revolutions": "n_prop [rps]", "rudder": "delta_rudder [rad]", "wind speed": "wind_velo_true [m/s]",
        "wind direction": "wind_dir_true [rad]",
    }.items()
})  # fmt: skip
FOLDS = 4
DISTANCES = (1.0, 5.0, 10.0)
"""Ship lengths after which tracks are compared."""
FILTERS = ("ekf", "ukf", "iekf", "enkf", "etkf", "enkf-sr", "huber-kf")


def read_folder(folder: Path) -> list[Log]:
    """The logs of a folder, by name.

    Raises:
        ValueError: if they are fewer than the folds.
        LogError: if one cannot be used.
    """
    files = sorted(folder.glob("*.csv"))
    if len(files) < FOLDS:
        raise ValueError(f"{folder} has {len(files)} CSV files; {FOLDS} or more are needed")
    return [read(path, COLUMNS) for path in files]


def computed(logs: Sequence[Log], filters: Sequence[str]) -> dict[str, Any]:
    """Results by run: each is compared with a ship that was identified on runs of other folds."""
    step = common_step(logs, SHIP)
    parts = [[part for part in trials(log, step) if _sailed(part) > SHIP.length] for log in logs]
    sensors = [{"surge's lag": lag(log, "surge"), "gyro's scale": scale(log)} for log in logs]
    found: dict[str, Any] = {"runs": [], "filters": {name: [] for name in filters}, "sensors": _plain(sensors)}
    with progress_bar("logs", len(logs)) as advance:
        for fold in range(FOLDS):
            of_others = [i for i in range(len(logs)) if i % FOLDS != fold]
            ship, nomoto = _identified([logs[i] for i in of_others], [part for i in of_others for part in parts[i]])
            for i in range(fold, len(logs), FOLDS):
                found["runs"] += [_compared(ship, part, nomoto) for part in parts[i]]
                longest = max(voyages(logs[i], sampling(parts[i], ship)), key=lambda each: len(each.u))
                for name in filters:
                    found["filters"][name].append(_judged(name, ship, longest))
                advance()
    found["runs"].sort(key=lambda run: (run["name"], -run["sailed"]))
    return found


def _sailed(part: Trial) -> float:
    return float(np.hypot(*np.diff(part.states[:, :2], axis=0).T).sum())


def _identified(logs: Sequence[Log], parts: Sequence[Trial]) -> tuple[MeasuredShip, dict[str, Any]]:
    """The ship, her noise, and Nomoto's models."""
    ship = identify(parts, SHIP)
    sampled = [voyage for log in logs for voyage in voyages(log, sampling(parts, ship))]
    ship = replace(ship, noise=dict(zip(NOISE, map(float, tune(ship, sampled)), strict=True)))
    return ship, {f"Nomoto, order {order}": identify_nomoto(parts, AHEAD, order) for order in (1, 2)}


def _compared(ship: MeasuredShip, part: Trial, nomoto: dict[str, Any]) -> dict[str, Any]:
    """Numbers of a run in ship lengths, degrees and seconds, pairs measured and simulated; None for what is missing.

    Tracks of turns and zig-zags begin where the rudder is put over, others where the run does.
    """
    predict = predictors(ship, part.dt, nomoto)
    model, length = predict["identified model"], SHIP.length
    both, begun = compare(model, part), executed(part)
    if both is None or begun is None:
        raise ValueError(f"{part.name} has no manoeuvre: its rudder stays amidships")
    tested = begun if part.name.startswith(TESTS) else part
    return {
        "name": part.name.removesuffix(".csv"),
        "sailed": _plain(_sailed(tested) / length),
        "advance": _plain([each.advance / length for each in both]),
        "tactical diameter": _plain([each.tactical_diameter / length for each in both]),
        "speed loss": _plain([100.0 * each.speed_loss for each in both]),
        "overshoots": _plain([np.rad2deg(each.overshoots) for each in both]),
        "periods": _plain(periods(model, begun)),
        "track error": {
            name: _plain(track_errors(each, tested, np.multiply(DISTANCES, length)) / length)
            for name, each in predict.items()
        },
        "accuracy": {name: _plain(accuracy(each, part, tested, length)) for name, each in predict.items()},
    }


def _judged(name: str, ship: MeasuredShip, voyage: Voyage) -> dict[str, Any]:
    """Consistency of a filter on a run, and on one drawn from its own model; an error instead where it fails."""
    noise, run = noise_of(ship), voyage.trial.name.removesuffix(".csv")
    try:
        _, verdict = judge(name, ship, voyage, noise)
        _, (inside, ratio, _, lag) = filtered(name, ship, simulated(ship, voyage, noise), noise)
    except ValueError as error:
        return {"run": run, "error": str(error)}
    return {
        "run": run,
        "steps": len(voyage.u),
        "measured": _plain(
            {key: getattr(verdict, key) for key in ("inside", "ratio", "lag", "withheld", "deviations")}
        ),
        "simulated": _plain({"inside": inside, "ratio": ratio, "lag": lag}),
    }


def _plain(values: Any) -> Any:
    """Numbers as JSON holds them, to four digits; None for NaN."""
    if isinstance(values, float | np.floating):
        return float(f"{values:.4g}") if np.isfinite(values) else None
    if isinstance(values, dict):
        return {key: _plain(each) for key, each in values.items()}
    return None if values is None else [_plain(each) for each in values]
