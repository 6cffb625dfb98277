"""Tables of docs/, computed and written into their pages: ``python -m studies.tables``.

The label of a row or a column is an arm of a comparison: an estimator, or ``default``, and one of
the `VARIANTS` of filter and world.
"""

import csv
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import combinations, product
from math import comb
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd

from agents import rollout
from agents.commands.console import command, progress_bar
from agents.metrics import components, consistency, scores
from agents.page import listed, markdown_table
from agents.policies.checkpoint import description, packaged
from agents.refusal import Refusal
from agents.seeds import evaluation_seeds
from agents.statistics import Interval, crossed_interval, paired_difference, share_interval
from agents.studies.records import FLOOR, ORACLE
from agents.studies.worlds import system_of
from estimators import input_conditions
from studies.lorenz.benchmarks import BENCHMARKS, analysis_rmse
from studies.papers.measures import papers_page, readme_line
from studies.papers.robust.experiment import Condition, StateSpace, simulate, track
from vessel_gym.core import Core
from vessel_gym.disturbances import Fault
from vessel_gym.envs import VesselVectorEnv
from vessel_gym.envs.ship import SIGMA_CORVETTE
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import Bias, Sensor, SensorSuite
from vessel_gym.sensors.grades import NOMINAL, read_grades
from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.vehicles.corvette import MOTION_UNIT

ROOT = Path(__file__).parents[1]
CORVETTE, CHANNEL, THESIS = "SigmaCorvette-v0", "SigmaChannel-v0", "ThesisCorvette-v0"
SEGOROGENI, ITSUNUSA, PUNA = JOURNEYS = "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0"
EPISODES, FEWER = 100, 60
HELD, PLAIN, INFORMED = "measurement", "ekf", "ekf assuming waves"
NONE = "–"

# --- Markdown ---------------------------------------------------------------------------------


def around(page: Path, mark: str) -> tuple[str, str]:
    """A page up to its line ``<!-- mark -->``, and from the next line ``<!-- end -->``.

    Raises:
        Refusal: if the page has no such lines, or several for this mark.
    """
    line = f"(?m)^(<!-- {re.escape(mark)} -->\n)"
    before, *inside = re.split(line, page.read_text(encoding="utf-8"))
    if len(inside) != 2 or "\n<!-- end -->" not in inside[1]:
        raise Refusal(f"{page} needs one line <!-- {mark} --> and a line <!-- end --> below it")
    return before + inside[0], inside[1][inside[1].index("<!-- end -->") :]


def put(page: Path, mark: str, text: str) -> None:
    """Write a text into a page, in place of what stands between the lines of its mark."""
    before, after = around(page, mark)
    page.write_text(f"{before}\n{text.strip()}\n\n{after}", encoding="utf-8")


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    return markdown_table(heads, rows, len(heads))


def interval(of: Interval | None, decimals: int = 3) -> str:
    """A mean and half of its interval; a dash without an interval."""
    return NONE if of is None else f"{of.mean:,.{decimals}f} ± {of.half:.{decimals}f}"


def shown(values: np.ndarray, decimals: int = 3) -> str:
    """The mean ``(seeds,)`` or ``(runs, seeds)`` with its 95 % interval."""
    return interval(crossed_interval(np.atleast_2d(values)), decimals)


def number(values: np.ndarray, decimals: int) -> str:
    """The mean over episodes; a dash where one has no value."""
    return NONE if np.isnan(values).any() else f"{np.mean(values):.{decimals}f}"


# --- rollouts by label --------------------------------------------------------------------------

VARIANTS: dict[str, dict[str, Any]] = {
    "": {},
    "independent draws": {"estimator_options": {"members": 100, "draws": "independent"}},
    "1,000 members": {"estimator_options": {"members": 1000}},
    "mismatch 0.1": {"mismatch": 0.1},
    "mismatch 0.2": {"mismatch": 0.2},
    "degraded": {"sensors": "degraded"},
    "rough": {"disturbance": "rough"},
    "10 Q": {"estimator_options": {"assume": {"Q": 10.0}}},
    "linear": {"estimator_options": {"model": "linear"}},
    "nonlinear": {"estimator_options": {"model": "nonlinear"}},
}
"""Options of an environment, by what follows the estimator in a label."""


def assuming(disturbance: Any = None, role: str | None = None) -> dict[str, Any]:
    """Options of a filter that assumes a disturbance, in a role: states, process noise, input."""
    told = {"disturbance": disturbance, "as": role}
    return {"estimator_options": {"assume": {key: v for key, v in told.items() if v is not None}}}


def fly(
    env_id: str, label: str, variants: dict[str, Any] = VARIANTS, episodes: int = 0, **world: Any
) -> Any:
    """Rollout of the arm of a label under the autopilot; ``world`` holds further options."""
    found = re.fullmatch(r"`?([\w-]+)`?,? ?(.*)", label)
    assert found is not None
    options = variants[found[2]] | ({} if found[1] == "default" else {"estimator": found[1]})
    agent, asked = world.pop("agent", "autopilot"), world.pop("reset_options", None)
    seeds = evaluation_seeds(episodes or EPISODES)
    return rollout(agent, env_id, seeds, options | world, reset_options=asked)


def measured(*arm: Any, **world: Any) -> dict[str, np.ndarray]:
    """Metrics of the rollout of `fly`, one number an episode ``(episodes,)``."""
    return scores(fly(*arm, **world))


RIVALS = "`ekf`", "`measurement`", "`dead-reckoning`"
DRAWN = ("`truth`", "`enkf`", "`enkf`, independent draws", "`enkf-sr`",
         "`enkf-sr`, independent draws", "`ekf`", "`ukf`", "`huber-kf`")  # fmt: skip
ELSEWHERE = (
    *(f"default, {each}" for each in ("1,000 members", "mismatch 0.1", "mismatch 0.2")),
    *("`ekf`, mismatch 0.2", "`truth`, mismatch 0.2"),
    *("default, degraded", "`ekf`, degraded", "`huber-kf`, degraded"),
    *("default, rough", "`ekf`, rough", "`truth`, rough"),
)


def journeys(env_id: str) -> str:
    """Scores of estimators in a dive or a flight."""
    columns = [("off [m]", "normal" if env_id == ITSUNUSA else "cross_track", 3)]
    columns += [("altitude [m]", "altitude", 2)] if env_id == PUNA else []
    heads = [head for head, *_ in columns]
    robust = ("`robust-kf`",) if env_id == PUNA else ()
    rows = []
    for label in (*DRAWN, *robust, *RIVALS[1:], *ELSEWHERE):
        flight = fly(env_id, label)
        of, arrived = scores(flight), (flight.end == "arrived").sum()
        row = [label, str(arrived), *(number(of[key], digits) for _, key, digits in columns)]
        row += [shown(of["score"]), number(of["position_rmse"], 3)]
        for nees, where in (("position_nees", components(flight, *"xyzh")), ("nees", None)):
            share = consistency(flight, where)
            row += [number(of[nees], 2), NONE if share is None else f"{100.0 * share:.0f} %"]
        rows.append(row)
    return table(("estimates", f"arrived of {EPISODES}", *heads, "score", "position error [m]",
                  "position NEES/n", "in band", "NEES/n, all", "in band"), rows)  # fmt: skip


def short(env_id: str, name: str) -> str:
    """Scores for the page of a dive or a flight."""
    default = f"`{system_of(env_id).estimator}`"
    labels = "`truth`", default, f"{default}, independent draws", *RIVALS
    flights = [fly(env_id, label) for label in labels]
    cells = (f"{shown(of.score)} ({(of.end == 'arrived').sum()})" for of in flights)
    heads = f"Score (arrived of {EPISODES})", "`truth`", "default", "independent draws", *RIVALS
    return table(heads, [(f"{name} ({default})", *cells)])


def paired_flights() -> str:
    """Paired differences of the aircraft's scores."""
    pairs = [("`truth`", "default"), ("default", "`measurement`"), ("`ekf`", "default"),
             ("`ukf`", "default"), ("default", "independent draws"),
             ("`ekf`", "`huber-kf`")]  # fmt: skip
    arms = {"default": "`enkf`", "independent draws": "`enkf`, independent draws"}
    score = {name: fly(PUNA, arms.get(name, name)).score for pair in pairs for name in pair}
    row = [shown(score[one] - score[other]) for one, other in pairs]
    return table([f"{one} − {other}" for one, other in pairs], [row])


def turns(sea: str, other: str) -> str:
    """Scores and errors of filters that assume the corvette's sea rightly, wrongly or not."""
    believed: Any = SIGMA_CORVETTE.disturbances[sea].believed
    variants = VARIANTS | {
        "without a current": assuming(replace(believed, current=0.0)),
        "waves as states, as the ship meets them": assuming(sea, "states"),
        f"likewise, assuming a {other} sea": assuming(other, "states"),
        "waves as states, of no direction": assuming(None, "states"),
        "waves as process noise, without a current": assuming(None, "process-noise"),
        "nothing of waves": {},
        "with d's variance, linear": assuming(None, "white-input"),
    }
    labels = ["`truth`", "`kf-umv-ui`", "`kf-umv-ui`, without a current"]
    labels += [f"`ekf`, {variant}" for variant in [*variants][-6:-1]]
    labels += ["`kf-umv-ui`, linear", "`kf` with d's variance, linear"]
    labels += [f"`{name}`, linear" for name in ("ulise", "kf", "huber-kf", "robust-kf")]
    seen = {"track_error": 1, "position_rmse": 2, "heading_rmse": 2, "yaw_rate_rmse": 2,
            "input_rmse": 2, "nees": 2}  # fmt: skip
    rows, ours = [], measured(CORVETTE, labels[1], disturbance=sea)["score"]
    for label in (*labels, *RIVALS[1:]):
        of, off = (
            measured(CORVETTE, label, variants, disturbance=sea, mismatch=share)
            for share in (0.0, 0.1)
        )
        less = NONE if label == labels[1] else shown(ours - of["score"])
        errors = (number(of[key], digits) for key, digits in seen.items())
        rows.append((label, shown(of["score"]), shown(off["score"]), less, *errors))
    return table(("estimates", "score", "model 10 % off", "less than `kf-umv-ui`", "off track [m]",
                  "place [m]", "heading [mrad]", "yaw rate [mrad/s]", "d [mrad]",
                  "NEES/n"), rows)  # fmt: skip


def surface_waves() -> str:
    """Scores of the dives under surface waves, which filters assume or not."""
    heads = ("moderate water", "surface waves", "surface waves, assuming moderate water")
    rows = []
    for env_id, names in ((SEGOROGENI, ("truth", "enkf", "ekf")), (ITSUNUSA, ("truth", "enkf-sr"))):
        for name in names:
            seas = [("moderate", {}), ("surface", {}), ("surface", assuming("moderate"))]
            flown = (fly(env_id, name, {"": told}, FEWER, disturbance=sea).score
                     for sea, told in (seas[:2] if name == "truth" else seas))  # fmt: skip
            cells = [*map(shown, flown), NONE][:3]
            rows.append((f"{env_id.removesuffix('-v0')}, `{name}`", *cells))
    return table(("", *heads), rows)


def sensor_sets() -> str:
    """The corvette on `kf-umv-ui` with fewer and other sensors."""
    compass, gyro, receiver = SIGMA_CORVETTE.vehicle.sensors
    sets = {
        "compass, rate gyro, receiver": [compass, gyro, receiver],
        "motion unit instead of the gyro": [compass, MOTION_UNIT, receiver],
        "motion unit besides": [compass, gyro, MOTION_UNIT, receiver],
        "compass and receiver": [compass, receiver],
        "gyro and receiver": [gyro, receiver],
        "compass and gyro": [compass, gyro],
    }
    keys, rows = ("heading_rmse", "input_rmse", "position_rmse"), []
    for label, sensors in sets.items():
        of = measured(CORVETTE, "kf-umv-ui", sensors=sensors)
        rows.append((label, shown(of["score"]), *(number(of[key], 2) for key in keys)))
    return table(("sensors", "score", "heading [mrad]", "d [mrad]", "place [m]"), rows)


def insurance() -> str:
    """Heading errors with `kf`, which assumes a size of d, over those with `kf-umv-ui`."""
    simulations = {"I": "I: d of 0.01 rad", "II": "II: larger Q", "III": "III: larger R",
                   "V": "V: d of 0.1 rad"}  # fmt: skip
    kinds = {"0.01 rad": 0.01, "0.1 rad": 0.1, "1 rad": 1.0}
    sizes = {kind: {"estimator_options": {"input_cov": sd**2}} for kind, sd in kinds.items()}
    cells: dict[str, list[str]] = {kind: [] for kind in (*sizes, "nothing")}
    for name in simulations:
        world = {"reset_options": {"simulation": name}}
        ours = measured(THESIS, "kf-umv-ui", **world)["heading_rmse"]
        for kind, row in cells.items():
            options = {"": sizes.get(kind, {})}
            row.append(shown(measured(THESIS, "kf", options, **world)["heading_rmse"] / ours))
    rows = [(kind, *row) for kind, row in cells.items()]
    return table(("`kf` assumes for d", *simulations.values()), rows)


def channel() -> str:
    """Scores and steering travel in the channel in every sea."""
    labels = "`truth`", "`kf-umv-ui`", "`ekf` assuming waves", "`ekf`", "`measurement`"
    seas = [f"{size}{side}" for side in ("", " quartering") for size in ("moderate", "rough")]
    of = {
        sea: [
            measured(
                CHANNEL,
                label,
                VARIANTS | {"assuming waves": assuming(sea, "states")},
                disturbance=sea,
            )
            for label in labels
        ]
        for sea in seas
    }
    kinds = ("score", "score", 3), ("steering_travel", "rudder travel [deg/min]", 0)
    rows = [(f"{sea}, {words}", *(shown(each[key], digits) for each in of[sea]))
            for key, words, digits in kinds for sea in seas]  # fmt: skip
    return table(("", *labels), rows)


def compass() -> str:
    """Scores by the correlation time [s] of the `budget` compass."""
    ours, *labels = "`kf-umv-ui`", "`ekf` assuming waves", "`huber-kf`, nonlinear", "`ekf`", "`kf`"
    variants = VARIANTS | {"assuming waves": assuming("moderate", "states")}
    rows = []
    for time in (10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0):
        first, *rest = (
            fly(CORVETTE, label, variants, sensors=with_memory(time)).score
            for label in (ours, *labels)
        )
        rows.append((f"{time:g} s", shown(first), *(shown(score - first) for score in rest)))
    heads = (f"{label.removesuffix(', nonlinear')} − {ours}" for label in labels)
    return table(("correlation time", ours, *heads), rows)


def with_memory(time: float) -> list[Sensor]:
    """Sensors of the suite `budget` with another correlation time [s] of the compass."""
    return [
        replace(each, bias=replace(each.bias, time=time)) if each.name == "gyro compass" else each
        for each in system_of(CORVETTE).sensors_of("budget").each
    ]


def packaged_agents() -> str:
    """The trained agents of the package beside the autopilots, on default estimates."""
    rows = []
    for env_id in (CORVETTE, *JOURNEYS):
        seeds = evaluation_seeds(EPISODES)
        flights = [rollout(name, env_id, seeds, record=False) for name in ("autopilot", "ppo")]
        system, told = system_of(env_id), description(packaged(env_id)) or {}
        there = (str(int((flight.end == system.task.success).sum())) for flight in flights)
        one, other = (flight.score for flight in flights)
        rows.append((
            f"`{env_id}`", f"`{system.estimator}`", *map(shown, (one, other, other - one)),
            " and ".join(there), f"{told['seed']}, {told['trained_steps']:,}",
        ))  # fmt: skip
    return table(("", "estimates", "`autopilot`", "`ppo`", "`ppo` − `autopilot`",
                  f"reached the end, of {EPISODES}", "training: seed, steps"), rows)  # fmt: skip


# --- faults ---------------------------------------------------------------------------------------

FAULTY = {
    "Segorogeni, rudder and stern plane": (SEGOROGENI, ("rudder", "stern plane")),
    "ITSUNUSA, stern plane": (ITSUNUSA, ("stern plane",)),
    "PUNA, bank": (PUNA, ("bank",)),
}
"""Environments and the actuators at fault, by label."""
UNKNOWN = "`ekf-ui-wdf`", "`ukf-umv`", "`kf-umv-ui-wdf`"
REASONS = {
    "needs a LinearModel": "nonlinear model",
    r"needs rank\(H\) = (\d+) unknown inputs?, got (\d+)": "rank H = {1}, not {0}",
    r"standard deviation of (\S+) times": "σ = {0}",
}
"""Refusals of filters, and how a table shows them."""


def faulty(vehicle: str, weather: str = "moderate", **fault: float) -> Any:
    """A fault of each of a vehicle's actuators, beside the water or the air."""
    env_id, actuators = FAULTY[vehicle]
    beside = system_of(env_id).disturbances[weather]
    for actuator in actuators:
        beside = Fault(actuator, beside=beside, **fault)
    return beside


def figure_of(env_id: str, label: str, key: str, *variants: Any, **world: Any) -> Any:
    """Mean of a metric, or in short why the environment refuses the filter."""
    try:
        return float(measured(env_id, label, *variants, episodes=FEWER, **world)[key].mean())
    except ValueError as error:
        for pattern, reason in REASONS.items():
            if found := re.search(pattern, str(error)):
                return reason.format(*found.groups())
        raise


def faults() -> str:
    """Scores of filters of faulty vehicles, by what they know of the fault."""
    labels = (
        "`truth`",
        "default",
        "`ekf`",
        "`ekf`, 10 Q",
        *UNKNOWN,
        "`ekf`, slow walk",
        "`ekf`, fast walk",
    )
    kinds = {"none": {}, "5° off": {"bias": np.deg2rad(5.0)},
             "±10° in 2 s": {"amplitude": np.deg2rad(10.0), "period": 2.0}}  # fmt: skip
    rows = []
    for vehicle, weather in product(FAULTY, ("moderate", "rough")):
        walks = {
            f"{name} walk": assuming(
                faulty(vehicle, weather, start=np.deg2rad(2.0), walk=np.deg2rad(pace)), "states"
            )
            for name, pace in (("slow", 0.3), ("fast", 3.0))
        }
        for kind, fault in kinds.items():
            world = faulty(vehicle, weather, **fault)
            variants, env_id = VARIANTS | walks, FAULTY[vehicle][0]
            found = (figure_of(env_id, of, "score", variants, disturbance=world) for of in labels)
            cells = (NONE if isinstance(of, str) else f"{of:.3f}" for of in found)
            rows.append((f"{vehicle}; {weather}", kind, *cells))
    return table(("", "fault", *labels), rows)


def faults_found() -> str:
    """Errors of the input's estimate, in units of its prior."""
    rows = []
    for vehicle, (env_id, _) in FAULTY.items():
        lossy = SensorSuite(noise=1.0, dropout=0.1).of(system_of(env_id).vehicle.sensors)
        for kind, sensors in (
            ("nominal", "nominal"), ("10 % lost", list(lossy)), ("degraded", "degraded"),
        ):  # fmt: skip
            world = {"disturbance": faulty(vehicle, bias=np.deg2rad(5.0)), "sensors": sensors}
            found = (figure_of(env_id, label, "input_rmse", **world) for label in UNKNOWN)
            cells = (NONE if isinstance(of, str) else f"{of:.2f}" for of in found)
            rows.append((vehicle, kind, *cells))
    return table(("", "sensors", *UNKNOWN), rows)


def inputs() -> str:
    """Scores of every filter of an unknown input over those of the `ekf`, or its refusal."""
    labels = "`kf-umv-ui`", "`kf-umv-ui-wdf`", "`ulise`", "`ekf-ui-wdf`", "`ukf-umv`"
    worlds: dict[str, tuple[str, Any]] = {
        "corvette, waves": (CORVETTE, "moderate"),
        "thesis' corvette, a step": (THESIS, "moderate"),
        **{vehicle: (env_id, faulty(vehicle)) for vehicle, (env_id, _) in FAULTY.items()},
    }
    for name, env_id, actuator, size in (
        ("Segorogeni", SEGOROGENI, "thrust", 1.0), ("ITSUNUSA", ITSUNUSA, "thrust", 2.0),
        ("PUNA", PUNA, "thrust", 1.0), ("PUNA", PUNA, "angle of attack", float(np.deg2rad(2.0))),
    ):  # fmt: skip
        beside = system_of(env_id).disturbances["moderate"]
        worlds[f"{name}, {actuator}"] = env_id, Fault(actuator, size=size, beside=beside)
    rows = []
    for world, (env_id, disturbance) in worlds.items():
        plain, *found = (figure_of(env_id, label, "score", disturbance=disturbance)
                         for label in ("ekf", *labels))  # fmt: skip
        cells = (of if isinstance(of, str) else f"{of / plain:.3f}" for of in found)
        rows.append((world, *cells))
    return table(("", *labels), rows)


GAP, AFTER = 6.0, (0.0, 2.0, 4.0, 6.0)
"""Seconds after the start at which Segorogeni's fix is switched off; seconds after that."""


def gap() -> str:
    """Segorogeni's position without a fix, and the heading of `robust-kf`."""
    arms: dict[str, tuple[str, dict[str, Any], str]] = {"`ekf`": ("ekf", {}, "nominal")}
    for radius in (1e-4, 1e-3, 1e-2):
        arms[f"`robust-kf`, radius {radius:g}"] = "robust-kf", {"radius": radius}, "nominal"
    sure = {"radius": 1e-2, "assume": {"R": 400.0}}
    arms["radius 0.01, measurements with a twentieth of their noise"] = "robust-kf", sure, "clean"
    heads = "after", *(f"{after:g} s [m]" for after in AFTER), "claimed [m]"
    return table((*heads, "a radian of heading moves it by [m]"),
                 [(label, *without_a_fix(*arm)) for label, arm in arms.items()])  # fmt: skip


def without_a_fix(estimator: str, options: dict[str, Any], sensors: str) -> list[str]:
    """RMS errors of the position without a fix, what the filter claims, and its heading's gain."""
    off = [SensorFault("acoustic position", "off", begin=GAP)]
    system = system_of(SEGOROGENI)
    core = Core(system, FEWER, estimator, options, sensor_faults=off, sensors=sensors)
    core.start(0)
    place = [core.composition.names.index(name) for name in "xy"]
    cells, gains, estimate, filter = [], [0.0], core.loop.estimate, core.filter

    def noting_the_gain(measurements: Any, u: np.ndarray, steps: np.ndarray) -> None:
        prior = filter.predict(core.belief, u)
        C = filter.model.linearise_measurement(prior.mean, u, prior.cov)[1]
        C = np.where(measurements[1][..., None], C, 0.0)
        gain = prior.cov @ C.mT @ np.linalg.inv(C @ prior.cov @ C.mT + filter.model.R)
        moved = np.linalg.norm(gain[:, place, core.sensors.gives.index("psi")], axis=1)
        gains[0] = float(np.median(moved))
        estimate(measurements, u, steps)

    core.loop.estimate = noting_the_gain  # type: ignore[method-assign]
    for step in range(1, round((GAP + AFTER[-1]) / core.vehicle.dt) + 1):
        action = np.zeros((FEWER, core.action_size))
        action[:, 0] = 0.5 * np.sin(step / 20.0)
        core.step(action)
        if any(step == round((GAP + after) / core.vehicle.dt) for after in AFTER):
            error = (core.estimated(core.truth) - core.belief.mean)[:, place]
            cells.append(f"{np.sqrt(np.square(error).sum(1).mean()):.2f}")
    variance = np.diagonal(core.belief.cov, axis1=1, axis2=2)[:, place]
    return [*cells, f"{np.sqrt(variance.sum(1).mean()):.2f}", f"{gains[0]:.3g}"]


# --- filters alone --------------------------------------------------------------------------------

RUNS, STEPS, SKIPPED = 1000, 200, 20
"""Runs and steps of the tables of robust filters, and steps that are not scored."""
OUTLIERS = {
    "Gaussian": {},
    "10 % at 10 σ": {"rate": 0.1, "size": 10.0},
    "10 % at 100 σ": {"rate": 0.1, "size": 100.0},
}


def constant_velocity(intensity: float, measurement: float = 1.0) -> StateSpace:
    """Constant velocity under white acceleration [m2/s3]; the position is measured at 1 Hz."""
    Q = intensity * np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]])
    A, B, C = np.array([[1.0, 1.0], [0.0, 1.0]]), np.zeros((2, 1)), np.array([[1.0, 0.0]])
    A, B, C, Q = (each[None, None] for each in (A, B, C, Q))
    return StateSpace(A, B, C, Q, np.array([[measurement]]))


def squared_errors(model: StateSpace, record: Any, name: str, **options: Any) -> np.ndarray:
    """Squared error of the updated state, mean over time, one number a run ``(RUNS,)``."""
    beliefs = track({"kind": name, **options}, model, record.y)
    squares = [
        ((after.mean - x) ** 2).sum(-1) for (_, after), x in zip(beliefs, record.x, strict=True)
    ]
    return np.mean(squares[SKIPPED:], axis=0)[0]


def ratio(errors: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """RMSE over that of a reference on the same runs, and half of its linearised 95 % interval."""
    mean = float(np.sqrt(errors.mean() / reference.mean()))
    influence = 0.5 * mean * (errors / errors.mean() - reference / reference.mean())
    return mean, 1.96 * float(influence.std(ddof=1)) / np.sqrt(len(errors))


def huber_iterations() -> str:
    """RMSE of `huber-kf` over that of `kf`, by the number of iterations of its weights."""
    counts, rows = (1, 2, 3, 5, 10, 100), []
    for intensity, (label, condition) in product((0.01, 0.1, 1.0), OUTLIERS.items()):
        model = constant_velocity(intensity)
        record = simulate(model, model, Condition(**condition), STEPS, RUNS, 0)
        plain = squared_errors(model, record, "kf")
        found = [
            ratio(squared_errors(model, record, "huber-kf", iterations=n), plain) for n in counts
        ]
        cells = (*(f"{mean:.2f}" for mean, _ in found), f"{max(half for _, half in found):.3f}")
        rows.append((f"{intensity:g}", label, *cells))
    return table(("q", "measurements", *map(str, counts), "widest half interval"), rows)


def robust_losses() -> str:
    """RMSE of robust filters over that of `kf` with a right model and with wrong ones."""
    model = constant_velocity(0.01)
    cases: dict[str, tuple[StateSpace, dict[str, float]]] = {
        "as the model says": (model, {}),
        "10 % of measurements at 10 σ": (model, OUTLIERS["10 % at 10 σ"]),
        "least-favourable model, 0.01": (model, {"tolerance": 0.01}),
        "least-favourable model, 0.1": (model, {"tolerance": 0.1}),
        "true Q ten times as large": (constant_velocity(10.0 * 0.01), {}),
        "true R four times as large": (constant_velocity(0.01, 4.0), {}),
    }
    rows = []
    for label, (world, condition) in cases.items():
        record = simulate(model, world, Condition(**condition), STEPS, RUNS, 1)
        plain = squared_errors(model, record, "kf")
        robust = (squared_errors(model, record, "robust-kf", radius=of) for of in (0.01, 0.1))
        found = (ratio(of, plain) for of in (squared_errors(model, record, "huber-kf"), *robust))
        cells = (f"{mean:.3f} ± {half:.3f}" for mean, half in found)
        rows.append((label, f"{np.sqrt(plain.mean()):.2f}", *cells))
    return table(("data", "`kf` RMSE", "`huber-kf`", "`robust-kf`, 0.01", "`robust-kf`, 0.1"), rows)


def unstable_zeros(systems: int = 400) -> str:
    """Share of random systems in which an unknown input adds a zero on or outside the unit circle.

    Four states and one input; A has normal entries and a spectral radius of 0.98, C, G and H have
    normal entries.
    """
    kinds = {
        "at once, `kf-umv-ui`": 1.0,
        "at once, H ten times as large": 10.0,
        "one step late": 0.0,
    }
    rows = []
    for label, gain in kinds.items():
        cells = []
        for p in (1, 2, 3):
            rng, hits = np.random.default_rng([p, round(gain)]), 0
            for _ in range(systems):
                A, C, G, H = (rng.normal(size=shape) for shape in ((4, 4), (p, 4), (4, 1), (p, 1)))
                A *= 0.98 / np.abs(np.linalg.eigvals(A)).max()
                zeros = input_conditions(A, C, G, gain * H, np.eye(4), np.eye(p), 1.0).zeros
                hits += bool((np.abs(zeros) >= 1.0).any())
            of = share_interval(hits, systems).times(100.0)
            cells.append(f"{of.mean:.1f} % [{of.low:.1f}, {of.high:.1f}]")
        rows.append((label, *cells))
    return table(("d reaches the measurements", "1 measurement", "2", "3"), rows)


def published_scores(runs: int = 20) -> str:
    """Analysis RMSE of ensemble and particle filters on the Lorenz systems, beside published ones.

    Filters that are the same transform share a row and are run once, under the first name. Exact
    draws are beside them, with as many members as these need; without process noise only `enkf` has
    other numbers after the start.
    """
    rows = []
    for row in BENCHMARKS:
        ours, name, beside = analysis_rmse(row, row.filters[0], runs), row.filters[0], NONE
        if name != "pf":
            members = max(row.members, len(row.setting.start) + len(row.setting.read) + 2)
            exact = analysis_rmse(replace(row, draws="exact", members=members), name, runs)
            beside = f"{np.median(exact):.3f}, N = {members}"
        published = f"{row.published:g}{' (reported only)' if row.reported_only else ''}"
        rows.append((row.setting.name, ", ".join(row.filters), str(row.members), row.described,
                     shown(ours), f"{np.median(ours):.3f}", beside, published))  # fmt: skip
    return table(("system", "filter", "N", "options", "ours", "median", "exact draws, median",
                  "published"), rows)  # fmt: skip


# --- grades of sensors ----------------------------------------------------------------------------

GRADED = {CORVETTE: "Ships", SEGOROGENI: "Underwater vehicles", PUNA: "Small aircraft",
          THESIS: "The ship of the thesis"}  # fmt: skip


def sensor_grades() -> str:
    """Tables of the grades of sensors for each kind of vehicle, with their suites and sources."""
    heads = ("sensor", "grade", "white noise", "slow error; its time; constant error", "every",
             "source")  # fmt: skip
    parts = []
    for env_id, heading in GRADED.items():
        grades, rows = read_grades(system_of(env_id)), []
        for name, grade in ((name, grade) for name, of in grades.sensors.items() for grade in of):
            suites = [suite for suite, of in grades.suites.items() if of.get(name) == grade]
            suites = [*([NOMINAL] if grade == NOMINAL else []), *suites]
            label = f"{grade} (`{'`, `'.join(suites)}`)" if suites else grade
            figures = _figures(grades.sensors[name][grade], grades.assumed[name][grade])
            rows.append((name, label, *figures, grades.sources[name][grade]))
        parts.append(f"### {heading}\n\n{table(heads, rows)}")
    return "\n\n".join(parts)


def _figures(sensor: Sensor, assumed: tuple[str, ...]) -> tuple[str, str, str]:
    """White noise, bias, and time between measurements, marked where no document states it."""
    every = ("rate", "step" if sensor.rate is None else f"{1.0 / sensor.rate:g} s")
    losses = [("dropout", f"{sensor.dropout:.0%} lost")] if sensor.dropout else []
    slow = _bias(sensor.bias) if sensor.bias else [("", NONE)]
    white, slow_, often = (
        [f"{text} (assumed)" if key in assumed else text for key, text in part]
        for part in ([("sd", _values(sensor.sd))], slow, [every, *losses])
    )
    return white[0], "; ".join(slow_), ", ".join(often)


def _bias(bias: Bias) -> list[tuple[str, str]]:
    """Keys and values of a bias."""
    if bias.time is None and not any(bias.pace):
        return [("start", f"constant {_values(bias.start)}")]
    if bias.time is None:
        return [("start", _values(bias.start)), ("pace", f"{_values(bias.pace)}/√s")]
    constant = [("constant", f"constant {_values(bias.constant)}")] if any(bias.constant) else []
    return [("start", _values(bias.start)), ("time", f"{bias.time:g} s"), *constant]


def _values(values: tuple[float, ...]) -> str:
    """One number for all channels, or one for each."""
    return ", ".join(f"{value:g}" for value in (values[:1] if len(set(values)) == 1 else values))


# --- studies --------------------------------------------------------------------------------------


@cache
def stored(study: str) -> pd.DataFrame:
    """Episodes of a study in the order of their seeds."""
    return pd.read_csv(ROOT / "results" / study / "episodes.csv").sort_values("seed", kind="stable")


def flown(
    study: str, environment: str, agent: str = "autopilot", key: str = "score"
) -> dict[tuple[str, str], np.ndarray]:
    """A metric of a study ``(runs, seeds)`` by condition and estimator, dead reckoning last.

    Raises:
        Refusal: if the agent flew nothing there.
    """
    of = stored(study)
    of = of[(of.environment == environment) & (of.agent == agent)]
    if of.empty:
        raise Refusal(f"{agent} flew nothing in {environment} of results/{study}")
    found: dict[Any, np.ndarray] = {
        place: np.array([run[key] for _, run in each.groupby("training_seed", dropna=False)])
        for place, each in of.groupby(["condition", "estimator"], sort=False)
    }
    return dict(sorted(found.items(), key=lambda item: item[0][1] == FLOOR))


class Column(NamedTuple):
    """Scores of an environment in a condition by estimator, ``(runs, seeds)`` each.

    ``comparisons`` is the number of pairs of estimators in all columns of the environment.
    """

    environment: str
    condition: str
    scores: dict[str, np.ndarray]
    comparisons: int = 1

    def __str__(self) -> str:
        return f"{self.environment}, {self.condition}"

    def gap(self, one: str, other: str) -> Interval | None:
        """Paired difference of scores; 95 % hold for all pairs of the environment."""
        if one == other or not {one, other} <= set(self.scores):
            return None
        pair = self.scores[one][0], self.scores[other][0]
        return paired_difference(*pair, comparisons=self.comparisons)

    def best(self, *without: str) -> str:
        """The filter with the highest mean score."""
        filters = [name for name in self.scores if name not in (ORACLE, FLOOR, HELD, *without)]
        return max(filters, key=lambda name: self.scores[name].mean())


def columns(study: str) -> Iterator[Column]:
    """Columns of the autopilot, by environment and condition."""
    for environment in stored(study).environment.unique():
        of = flown(study, environment)
        each = {at: {name: of[at, name] for to, name in of if to == at} for at, _ in of}
        pairs = sum(comb(len(scores), 2) for scores in each.values())
        yield from (Column(environment, at, scores, pairs) for at, scores in each.items())


SUITE = "nominal", "budget", "denied"
HEADLINE = ("truth", "kf-umv-ui, nonlinear", INFORMED, "huber-kf, nonlinear", "ekf, nonlinear",
            "kf, linear", "fixed gain, nonlinear", HELD, FLOOR)  # fmt: skip
"""Estimators of the corvette's study in the README and on her page."""


def by_suite(
    study: str, environment: str, sea: str = "", agent: str = "autopilot", which: str = ""
) -> str:
    """Score and steering travel of estimators in each suite; 95 % hold for all scores at once."""
    score, travel = (flown(study, environment, agent, key) for key in ("score", "steering_travel"))
    places = [f"{sea}, {suite}" if sea else suite for suite in SUITE]
    every = tuple(dict.fromkeys(name for place, name in score if place in places))
    names = HEADLINE if which else every
    count = len(names) * len(places)
    rows = []
    for name in names:
        row = [f"`{name}`"]
        for place in places:
            of, steered = score.get((place, name)), travel.get((place, name))
            cell = f"{interval(crossed_interval(of, count))}; " if of is not None else NONE
            row.append(cell + ("" if steered is None else f"{np.nanmean(steered):.0f}"))
        rows.append(row)
    return table(("Score; steering travel [°/min]", *SUITE), rows)


MARGIN = 0.05
"""Difference of scores above which cells are bold."""


def differences(study: str) -> str:
    """The best filter of each column against its rivals and the truth."""
    rows = []
    for at in columns(study):
        best, default = at.best(), system_of(at.environment).estimator
        rival = at.best(PLAIN, INFORMED, "kf")  # on the model of `ekf`
        pairs = (best, HELD), (rival, PLAIN), (best, default), (ORACLE, best)
        gaps = [at.gap(*pair) for pair in pairs]
        bold = ["**" if gap and gap.low > MARGIN else "" for gap in gaps]
        cells = (f"{star}{interval(gap)}{star}" for gap, star in zip(gaps, bold, strict=True))
        rows.append((str(at), f"`{best}`", *cells))
    return table(("", "best filter", "best − `measurement`", "best other on its model − `ekf`",
                  "best − default", "`truth` − best"), rows)  # fmt: skip


def above(study: str, which: Callable[[Column], dict[str, str]]) -> list[str]:
    """Estimators that score more than a rival beyond chance, rivals by estimator."""
    return [
        f"`{name}` in {at}, by {interval(gap)}"
        for at in columns(study)
        for name, rival in which(at).items()
        if (gap := at.gap(name, rival)) and gap.low > 0.0
    ]


def truth_first(study: str) -> str:
    """Columns with the highest mean on the truth; scores above it, and scores without a filter."""
    every = [{name: each.mean() for name, each in at.scores.items()} for at in columns(study)]
    first = sum(max(of.values()) == of[ORACLE] for of in every)
    held = above(study, lambda at: dict.fromkeys((HELD, FLOOR), at.best()))
    ahead = above(study, lambda at: dict.fromkeys(at.scores, ORACLE))
    text = (
        f"The truth has the highest mean in {first} of {len(every)} columns. Beyond chance above"
        f" the truth: {listed(ahead or ['none'])}. Beyond chance above the best filter, without"
        f" any: {listed(held or ['none'])}."
    )
    return fill(text, 140, break_on_hyphens=False)


def headline(study: str, environment: str, sea: str) -> str:
    """Score lost against the truth, and steering, in each suite."""
    travel = flown(study, environment, key="steering_travel")
    at = {str(each): each for each in columns(study)}
    chosen = [at[f"{environment}, {sea}, {suite}"] for suite in SUITE]
    lost = [
        listed(
            [f"{gap.mean:.3f}" for each in chosen if (gap := each.gap(ORACLE, name or each.best()))]
        )
        for name in ("", HELD)
    ]
    of = [np.nanmean(travel[each.condition, HELD]) / np.nanmean(travel[each.condition, each.best()])
          for each in chosen]  # fmt: skip
    text = (
        f"With {listed([f'`{suite}`' for suite in SUITE])} sensors the autopilot loses {lost[0]} of"
        f" the score against the truth on the best filter, and {lost[1]} on held measurements"
        f" (`measurement`), which steer {min(of):.1f} to {max(of):.1f} times as much."
    )
    return fill(text, 140, break_on_hyphens=False)


def wild_and_wrong(study: str) -> str:
    """Differences of scores with wild measurements and with wrong models."""
    best = shares(study).splitlines()[2].split("|")[1].strip()
    pairs = [(world, "bad sensors", "huber-kf", PLAIN) for world in (PUNA, ITSUNUSA, SEGOROGENI)]
    pairs += [(PUNA, f"model {share} % off", ORACLE, best) for share in (10, 20)]
    rows = []
    for world, condition, one, other in pairs:
        of = flown(study, world)
        gap = shown(of[condition, one] - of[condition, other])
        rows.append((f"{world}, {condition}", f"`{one}` − `{other}`", gap))
    return table(("", "scores", "difference"), rows)


def pairing(study: str) -> str:
    """Factor of episodes that pairing saves, over all pairs of filters in the first condition."""
    rows = []
    for environment in stored(study).environment.unique():
        of = flown(study, environment).items()
        filters = [values[0] for (at, name), values in of
                   if at == "nominal" and name not in (ORACLE, HELD, FLOOR)]  # fmt: skip
        pairs = [(a, b) for a, b in combinations(filters, 2) if (a != b).any()]
        factors = [(a.var() + b.var()) / (a - b).var() for a, b in pairs]
        cells = (f"{factor:.1f}" for factor in np.quantile(factors, (0.0, 0.25, 0.5, 0.75)))
        rows.append((environment, str(len(pairs)), *cells))
    return table(
        ("Environment", "pairs", "least", "lower quartile", "median", "upper quartile"), rows
    )


def latency(study: str) -> str:
    """Score, position error and its NEES with late fixes, by what is done with them."""
    ways = {"fused": "", "as new": ", as new", "discarded": ", discarded"}
    rows = []
    for world in stored(study).environment.unique():
        score, error, nees = (
            flown(study, world, key=key) for key in ("score", "position_rmse", "position_nees")
        )
        for name, condition in product(("ekf", "enkf"), ("1 s late", "2 s late")):
            places = [("in time", name), *((condition, name + way) for way in ways.values())]
            cells = (f"{shown(score[at])}; {number(error[at], 2)} m; {number(nees[at], 2)}"
                     for at in places)  # fmt: skip
            rows.append((f"{world.removesuffix('-v0')}, `{name}`", condition, *cells))
    return table(("score; position error; its NEES/n", "the fix is", "in time", *ways), rows)


def shares(study: str) -> str:
    """The ranking of a study, from its report."""
    page = ROOT / "results" / study / "tables" / "ranking.md"
    lines = page.read_text(encoding="utf-8").splitlines()
    return "\n".join(line for line in lines if line.startswith("|"))


def advice(study: str) -> str:
    """The answer of a study without the times of its machine."""
    lines = (ROOT / "results" / study / "answer.md").read_text(encoding="utf-8").splitlines()
    text = " ".join(line for line in lines if not line.startswith("A step on"))
    return fill(text, 140, break_on_hyphens=False)


# --- what would overturn them ---------------------------------------------------------------------

CONSTANTS = {
    "DISTANCE_TOLERANCE": "tolerance off the track",
    "COURSE_TOLERANCE": "tolerance of the course",
    "RATE_TOLERANCE": "tolerance of the yaw rate",
    "RUDDER_PRICE": "price of steering",
    "ENOUGH": "progress that is enough",
}
"""Constants of the corvette's score that are halved and doubled."""


def variations() -> dict[str, dict[str, Any]]:
    """Arguments of `varied` by condition; the first is the world of the studies."""
    lossy = [replace(each, dropout=0.1) for each in SIGMA_CORVETTE.vehicle.sensors]
    return {
        "as in the studies": {},
        **{f"{sea} sea": {"disturbance": sea, "sea": sea} for sea in ("calm", "rough")},
        **{f"waves assumed {sea}": {"sea": sea} for sea in ("calm", "rough")},
        **{f"`{suite}` sensors": {"sensors": suite} for suite in SUITE[1:]},
        "a tenth of measurements lost": {"sensors": lossy},
        "`degraded` sensors": {"sensors": "degraded"},
        "model 10 % off": {"mismatch": 0.1},
        **{f"controller `{name}`": {"agent": name} for name in ("lqg", "pid")},
        "half the weight of the course": {"COURSE_SHARE": 0.3 / 0.7},
        "twice the weight of the course": {"COURSE_SHARE": 1.2 / 1.6},
        **{
            f"{word} the {what}": {name: factor * getattr(CircleTrack, name)}
            for (name, what), (word, factor) in product(
                CONSTANTS.items(), (("half", 0.5), ("twice", 2.0))
            )
        },
    }


def varied(condition: str, sea: str = "moderate", **changes: Any) -> Column:
    """Scores of the corvette with other constants of the score, in capitals, or another world.

    The filter that assumes waves assumes those of the ``sea``.
    """
    constants = {name: changes.pop(name) for name in list(changes) if name.isupper()}
    task: Any = type("Scored", (CircleTrack,), constants, verified=True)
    corvette: Any = SIGMA_CORVETTE
    system = replace(corvette, task=task(corvette.vehicle.ship))
    env: Any = type("Env", (VesselVectorEnv,), {"system": system})
    env_id = f"Scored{len(gym.registry)}-v0"
    gym.register(env_id, vector_entry_point=env, max_episode_steps=corvette.task.horizon)
    arms = {name: name for name in ("kf-umv-ui", INFORMED, PLAIN, "huber-kf", "enkf-sr", HELD)}
    arms["huber-kf"] += ", nonlinear"
    variants = VARIANTS | {"assuming waves": assuming(sea, "states")}
    scores = {name: fly(env_id, arm, variants, **changes).score for name, arm in arms.items()}
    return Column("", condition, {name: score[None] for name, score in scores.items()})


def overturn() -> str:
    """Differences in each variation, and how often their sign holds, flips or is not decided."""
    found = [varied(name, **changes) for name, changes in variations().items()]
    apart = max(abs(gap.mean) for at in found if (gap := at.gap("enkf-sr", PLAIN)))
    heads, rows = ["", "best filter"], [[at.condition, f"`{at.best()}`"] for at in found]
    total = ["the sign holds, flips, is not decided", ""]
    for one, other in (
        ("", HELD),
        ("kf-umv-ui", PLAIN),
        (INFORMED, "kf-umv-ui"),
        ("huber-kf", PLAIN),
    ):
        gaps: list[Any] = [at.gap(one or at.best(), other) for at in found]
        heads.append(f"`{one}` − `{other}`" if one else f"best − `{other}`")
        rows = [[*row, interval(gap)] for row, gap in zip(rows, gaps, strict=True)]
        same = [gap.mean * gaps[0].mean > 0.0 for gap in gaps[1:] if gap.excludes_zero]
        total.append(f"{sum(same)}, {len(same) - sum(same)}, {len(gaps) - 1 - len(same)}")
    sentence = f"Means of `enkf-sr` and `{PLAIN}` differ by at most {apart:.4f}."
    return f"{sentence}\n\n{table(heads, [*rows, total])}"


# --- pages ----------------------------------------------------------------------------------------


def papers(counted: str = "") -> str:
    """The papers' measures as ``scripts.reproduce`` stored them, or a sentence that counts them."""
    kept, last = (ROOT / f"{at}/summary.json" for at in ("studies/papers", "results/reproduction"))
    if last.exists():
        kept.write_text(last.read_text(encoding="utf-8"), encoding="utf-8")
    return (readme_line if counted else papers_page)(json.loads(kept.read_text(encoding="utf-8")))


with (ROOT / "docs" / "tables.csv").open(encoding="utf-8") as _file:
    BLOCKS = {
        row["mark"].partition(": ")[2]: (
            ROOT / row["page"],
            row["mark"],
            partial(globals()[row["function"]], *filter(None, row["arguments"].split(";"))),
        )
        for row in csv.DictReader(_file)
    }
"""Page and mark of each table and sentence, and the function that writes it."""


OPTIONS = {"names": "which; all if not given"}


def main(names: tuple[str, ...] = (), /) -> None:
    """Write tables of docs/ anew: dives, flights, faults and others are flown, in an hour.

    Tables of studies are taken from results/ablation, results/suites,
    results/quick and results/latency, where `make ablation` and `vessel-gym ablate suites` (or
    quick, or latency) leave them.
    """
    names = names or tuple(BLOCKS)
    for name in names:
        if name not in BLOCKS:
            raise Refusal(f"there is no table {name!r}: known are {', '.join(BLOCKS)}")
    with progress_bar("tables", len(names)) as advance:
        for name in names:
            page, mark, made = BLOCKS[name]
            put(page, mark, made())
            advance()


if __name__ == "__main__":
    command(main)
