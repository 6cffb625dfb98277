"""Fly what the tables of docs/ show, and write them anew: ``python -m scripts.tables``."""

import csv
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from scripts.console import Refusal, command, in_checkout, progress_bar, put

ROOT = Path(__file__).parents[1]
EPISODES = 100
WITHOUT = "–"


@dataclass(frozen=True)
class Way:
    """How the autopilot flies: on an estimator, in a world."""

    label: str
    estimator: str
    options: dict[str, Any] = field(default_factory=dict)
    world: dict[str, Any] = field(default_factory=dict)


class Flown(NamedTuple):
    """What `EPISODES` flights were like: figures by their key, the share of times in the chi-square band."""

    scores: dict[str, np.ndarray]
    arrived: int
    position_band: float | None
    band: float | None


PLAIN = {"localisation": None}
UNINFLATED = {"localisation": None, "inflation": 1.0}
MISMATCH, DEGRADED, ROUGH = {"mismatch": 0.2}, {"sensors": "degraded"}, {"disturbance": "rough"}
DIVES = (
    Way("`truth`", "truth"),
    Way("`enkf`, localised", "enkf"),
    Way("`enkf`, plain", "enkf", PLAIN),
    Way("`enkf-sr`, localised", "enkf-sr"),
    Way("`enkf-sr`, plain", "enkf-sr", PLAIN),
    *(Way(f"`{name}`", name) for name in ("ekf", "ukf", "huber-kf", "measurement", "dead-reckoning")),
)
FLIGHTS = (
    Way("`truth`", "truth"),
    Way("`enkf`, localised", "enkf"),
    Way("`enkf`, plain, inflation 1", "enkf", UNINFLATED),
    Way("`enkf`, plain, inflation 1.01", "enkf", PLAIN),
    Way("`enkf-sr`, localised", "enkf-sr"),
    Way("`enkf-sr`, plain, inflation 1", "enkf-sr", UNINFLATED),
    Way("`enkf-sr`, plain, inflation 1.01", "enkf-sr", PLAIN),
    *(Way(f"`{name}`", name) for name in ("ekf", "ukf", "huber-kf", "robust-kf", "measurement", "dead-reckoning")),
)


def elsewhere(default: str) -> tuple[Way, ...]:
    """Other members, models, sensors and seas, on an environment's default estimator and its rivals."""
    return (
        Way("default, 1,000 members, inflation 1", default, {"members": 1000, "inflation": 1.0}),
        Way("default, mismatch 0.1", default, world={"mismatch": 0.1}),
        Way("default, mismatch 0.2", default, world=MISMATCH),
        Way("`ekf`, mismatch 0.2", "ekf", world=MISMATCH),
        Way("`truth`, mismatch 0.2", "truth", world=MISMATCH),
        Way("default, degraded", default, world=DEGRADED),
        Way("`ekf`, degraded", "ekf", world=DEGRADED),
        Way("`huber-kf`, degraded", "huber-kf", world=DEGRADED),
        Way("default, rough", default, world=ROUGH),
        Way("`ekf`, rough", "ekf", world=ROUGH),
        Way("`truth`, rough", "truth", world=ROUGH),
    )


JOURNEYS = {
    "SegorogeniAUV-v0": (*DIVES, *elsewhere("enkf")),
    "ItsunusaAUV-v0": (*DIVES, *elsewhere("enkf-sr")),
    "PunaUAV-v0": (*FLIGHTS, *elsewhere("enkf")),
}
"""The ways of each environment's table."""
SHORT = {
    "SegorogeniAUV-v0": ("Segorogeni (`enkf`)", "`truth`", "`enkf`, localised", "`enkf`, plain"),
    "ItsunusaAUV-v0": ("ITSUNUSA (`enkf-sr`)", "`truth`", "`enkf-sr`, localised", "`enkf-sr`, plain"),
    "PunaUAV-v0": ("PUNA (`enkf`)", "`truth`", "`enkf`, localised", "`enkf`, plain, inflation 1"),
}
"""What an environment's own page calls it, and which of the ways it shows beside those that it shows of all."""
OTHER = {"moderate": "calm", "rough": "moderate"}
"""A sea that a filter is told of wrongly."""


def turns_in(sea: str) -> tuple[Way, ...]:
    """Ways of telling filters of the corvette's sea."""
    met, other = ({"told": {"disturbance": name, "as": "states"}} for name in (sea, OTHER[sea]))
    still = {"told": {"disturbance": replace(_corvette().disturbances[sea].believed, current=0.0)}}
    return (
        Way("`truth`", "truth"),
        Way("`kf-umv-ui`", "kf-umv-ui"),
        Way("`kf-umv-ui`, without a current", "kf-umv-ui", still),
        Way("`ekf`, waves as states, as the ship meets them", "ekf", met),
        Way(f"`ekf`, likewise, told of a {OTHER[sea]} sea", "ekf", other),
        Way("`ekf`, waves as states, of no direction", "ekf", {"told": {"as": "states"}}),
        Way("`ekf`, waves in Q and R, without a current", "ekf", {"told": {"as": "noise"}}),
        Way("`ekf`, nothing of waves", "ekf"),
        Way("`kf-umv-ui`, linear", "kf-umv-ui", {"model": "linear"}),
        Way("`kf` told d's variance, linear", "kf", {"told": {"as": "white"}}),
        *(Way(f"`{name}`, linear", name) for name in ("ulise", "kf", "huber-kf", "robust-kf")),
        *(Way(f"`{name}`", name) for name in ("measurement", "dead-reckoning")),
    )


def _corvette() -> Any:
    from vessel_gym.envs.sigma_corvette import SIGMA_CORVETTE

    return SIGMA_CORVETTE


TOLD = {"calm": 2.2e-7, "moderate": 1.29e-5, "rough": 7.92e-5}
"""The variance of the thesis' corvette's unknown input in each sea."""


@cache
def flown(env_id: str, label: str) -> Flown:
    """Fly one of an environment's ways."""
    from agents import rollout
    from agents.metrics import components, consistency
    from agents.scores import scores
    from agents.seeds import evaluation_seeds

    way = next(way for way in JOURNEYS[env_id] if way.label == label)
    world = {"estimator": way.estimator, "estimator_options": way.options, **way.world}
    flight = rollout("autopilot", env_id, evaluation_seeds(EPISODES), world)
    position, of_all = (consistency(flight, where) for where in (components(flight, "x", "y", "z", "h"), None))
    return Flown(scores(flight), int((flight.end == "arrived").sum()), position, of_all)


def journeys(env_id: str) -> str:
    """What estimators are worth in a dive or a flight."""
    from agents.metrics import WITHOUT_COVARIANCE

    altitude = env_id == "PunaUAV-v0"
    heads = ("estimates", f"arrived of {EPISODES}", "off [m]", *(("altitude [m]",) if altitude else ()), "score",
             "position error [m]", "position NEES/n", "in band", "NEES/n, all", "in band")  # fmt: skip
    rows = []
    for way in JOURNEYS[env_id]:
        of = flown(env_id, way.label)
        off = "cross_track" if env_id != "ItsunusaAUV-v0" else "normal"
        sure = way.estimator not in WITHOUT_COVARIANCE
        rows.append((
            way.label, str(of.arrived), number(of.scores[off], 3),
            *((number(of.scores["altitude"], 2),) if altitude else ()), shown(of.scores["score"]),
            number(of.scores["position_rmse"], 3), number(of.scores["position_nees"], 2) if sure else WITHOUT,
            percent(of.position_band), number(of.scores["nees"], 2) if sure else WITHOUT, percent(of.band),
        ))  # fmt: skip
    return table(heads, rows)


def turns(sea: str) -> str:
    """What estimators are worth to the corvette in a sea, and what they see."""
    from agents import rollout
    from agents.scores import scores
    from agents.seeds import evaluation_seeds

    def fly(way: Way, mismatch: float) -> dict[str, np.ndarray]:
        world = {"estimator": way.estimator, "estimator_options": way.options, "disturbance": sea, "mismatch": mismatch}
        return scores(rollout("autopilot", "SigmaCorvette-v0", evaluation_seeds(EPISODES), world))

    heads = ("estimates", "score", "model 10 % off", "less than `kf-umv-ui`", "off track [m]", "place [m]",
             "heading [mrad]", "yaw rate [mrad/s]", "d [mrad]", "NEES/n")  # fmt: skip
    ways = turns_in(sea)
    ours, rows = fly(ways[1], 0.0)["score"], []
    for way in ways:
        of, off = fly(way, 0.0), fly(way, 0.1)
        seen = ((name, digits) for name, digits in (
            ("track_error", 1), ("position_rmse", 2), ("heading_rmse", 2), ("yaw_rate_rmse", 2), ("input_rmse", 2),
            ("nees", 2),
        ))  # fmt: skip
        less = WITHOUT if way is ways[1] else shown(ours - of["score"])
        rows.append((
            way.label, shown(of["score"]), shown(off["score"]), less,
            *(WITHOUT if np.isnan(of[name]).any() else number(of[name], digits) for name, digits in seen),
        ))  # fmt: skip
    return table(heads, rows)


def worth(plain: str, env_id: str) -> str:
    """Of a journey's table, what the environment's own page shows."""
    same = ("`ekf`", "`measurement`", "`dead-reckoning`")
    name, *labels = SHORT[env_id]
    found = (flown(env_id, label) for label in (*labels, *same))
    row = (name, *(f"{shown(of.scores['score'])} ({of.arrived})" for of in found))
    return table((f"Score (arrived of {EPISODES})", "`truth`", "default", plain, *same), [row])


def insurance() -> str:
    """The thesis' corvette's heading error with `kf`, told of a sea, over that with `kf-umv-ui`."""
    from agents import rollout
    from agents.scores import scores
    from agents.seeds import evaluation_seeds

    def error(sea: str, estimator: str, **options: Any) -> np.ndarray:
        world = {"estimator": estimator, "estimator_options": options, "disturbance": sea}
        return scores(rollout("autopilot", "ThesisCorvette-v0", evaluation_seeds(EPISODES), world))["heading_rmse"]

    ours = {sea: error(sea, "kf-umv-ui") for sea in TOLD}
    rows = []
    for told, variance in (*TOLD.items(), ("nothing", None)):
        cells = []
        for sea in TOLD:
            ratio = error(sea, "kf", **({} if variance is None else {"input_cov": variance})) / ours[sea]
            cells.append(f"**{shown(ratio)}**" if told == sea else shown(ratio))
        rows.append((told if variance is None else f"a {told} sea", *cells))
    return table(("`kf` is told of", *(f"{sea} sea" for sea in TOLD)), rows)


class Faulty(NamedTuple):
    """A vehicle, and which of its actuators are at fault."""

    name: str
    env_id: str
    actuators: tuple[str, ...]

    def fault(self, weather: str, **fault: float) -> Any:
        """The same fault of each, beside the water or the air of the environment."""
        from functools import reduce

        from agents.studies.worlds import system_of
        from vessel_gym.disturbances import Fault

        beside = system_of(self.env_id).disturbances[weather]
        return reduce(lambda beside, actuator: Fault(actuator, beside=beside, **fault), self.actuators, beside)


FAULTY = (
    Faulty("Segorogeni, rudder and stern plane", "SegorogeniAUV-v0", ("rudder", "stern plane")),
    Faulty("ITSUNUSA, stern plane", "ItsunusaAUV-v0", ("stern plane",)),
    Faulty("PUNA, bank", "PunaUAV-v0", ("bank",)),
)
FAULTS = {
    "none": {},
    "5° off": {"bias": np.deg2rad(5.0)},
    "±10° in 2 s": {"amplitude": np.deg2rad(10.0), "period": 2.0},
}
SEEDS = 60


def faults() -> str:
    """The score of filters of faulty vehicles: of those that know where the fault is, how fast it walks, or nothing."""
    heads = ("", "fault", "`truth`", "default", "`ekf`", "`ekf`, 10 Q", "`ekf-ui-wdf`", "`ukf-umv`", "`kf-umv-ui-wdf`",
             "`ekf`, slow walk", "`ekf`, fast walk")  # fmt: skip
    rows = []
    for vehicle in FAULTY:
        for weather in ("moderate", "rough"):
            flyers: dict[str, tuple[str | None, dict[str, Any]]] = {
                "truth": ("truth", {}), "default": (None, {}), "ekf": ("ekf", {}), "Q": ("ekf", {"told": {"Q": 10.0}}),
                "ekf-ui-wdf": ("ekf-ui-wdf", {}), "ukf-umv": ("ukf-umv", {}), "linear": ("kf-umv-ui-wdf", {}),
            }  # fmt: skip
            for name, degrees in (("slow", 0.3), ("fast", 3.0)):  # a second, as a random walk
                walk = vehicle.fault(weather, start=np.deg2rad(2.0), walk=np.deg2rad(degrees))
                flyers[name] = "ekf", {"told": {"disturbance": walk, "as": "states"}}
            for label, fault in FAULTS.items():
                world = {"disturbance": vehicle.fault(weather, **fault)}
                scores = (_flown(vehicle.env_id, *flyer, world) for flyer in flyers.values())
                cells = (WITHOUT if isinstance(of, str) else f"{of['score'].mean():.3f}" for of in scores)
                rows.append((f"{vehicle.name}; {weather}", label, *cells))
    return table(heads, rows)


def faults_found() -> str:
    """The error of the input's estimate, in units of its prior."""
    from agents.studies.worlds import system_of
    from vessel_gym.sensors import SensorSuite

    heads = ("", "sensors", "`ekf-ui-wdf`", "`ukf-umv`", "`kf-umv-ui-wdf`")
    rows = []
    for vehicle in FAULTY:
        lossy = SensorSuite(noise=1.0, dropout=0.1).of(system_of(vehicle.env_id).vehicle.sensors)
        for label, sensors in (("nominal", "nominal"), ("10 % lost", list(lossy)), ("degraded", "degraded")):
            world = {"disturbance": vehicle.fault("moderate", bias=np.deg2rad(5.0)), "sensors": sensors}
            found = [_flown(vehicle.env_id, name, {}, world) for name in ("ekf-ui-wdf", "ukf-umv", "kf-umv-ui-wdf")]
            cells = (WITHOUT if isinstance(of, str) else f"{of['input_rmse'].mean():.2f}" for of in found)
            rows.append((vehicle.name, label, *cells))
    return table(heads, rows)


def inputs() -> str:
    """Every filter of an unknown input with every vehicle: its share of the `ekf`'s score, or why it is refused."""
    from vessel_gym.disturbances import Fault

    names = ("kf-umv-ui", "kf-umv-ui-wdf", "ulise", "ekf-ui-wdf", "ukf-umv")
    worlds: list[tuple[str, str, Any]] = [
        ("corvette, waves", "SigmaCorvette-v0", "moderate"),
        ("thesis' corvette, waves and gusts", "ThesisCorvette-v0", "moderate"),
    ]
    for vehicle in FAULTY:
        worlds.append((vehicle.name, vehicle.env_id, vehicle.fault("moderate")))
    for vehicle, actuator, size in ((FAULTY[0], "thrust", 1.0), (FAULTY[1], "thrust", 2.0), (FAULTY[2], "thrust", 1.0),
                                    (FAULTY[2], "angle of attack", np.deg2rad(2.0))):  # fmt: skip
        beside = vehicle.fault("moderate").beside
        beside = beside if len(vehicle.actuators) == 1 else beside.beside
        name = vehicle.name.split(",")[0]
        worlds.append((f"{name}, {actuator}", vehicle.env_id, Fault(actuator, size=float(size), beside=beside)))
    rows = []
    for label, env_id, disturbance in worlds:
        plain, *found = (_flown(env_id, name, {}, {"disturbance": disturbance}) for name in ("ekf", *names))
        assert not isinstance(plain, str)
        cells = (of if isinstance(of, str) else f"{of['score'].mean() / plain['score'].mean():.3f}" for of in found)
        rows.append((label, *cells))
    return table(("", *(f"`{name}`" for name in names)), rows)


def _flown(env_id: str, estimator: str | None, options: dict[str, Any], world: dict[str, Any]) -> Any:
    """Figures of `SEEDS` flights, or why the environment refuses the filter."""
    from agents import rollout
    from agents.scores import scores
    from agents.seeds import evaluation_seeds

    chosen = world | {"estimator_options": options} | ({} if estimator is None else {"estimator": estimator})
    try:
        return scores(rollout("autopilot", env_id, evaluation_seeds(SEEDS), chosen))
    except ValueError as error:
        why = str(error).removeprefix(f"{estimator} ").split("; tell it")[0]
        return why.split(": ")[-1 if why.startswith("cannot") else 0]


ABLATED = (
    "truth", "kf-umv-ui", "ekf told waves", "ekf", "ekf, no current", "kf told d", "kf", "measurement",
    "dead-reckoning",
)  # fmt: skip
"""Of the corvette's study, what her page shows."""
HEADLINE = ("truth", "kf-umv-ui", "ekf", "kf", "measurement", "dead-reckoning")
"""And the README."""


def ablation(results: Path, estimators: Sequence[str] = ABLATED, agents: Sequence[str] = ("autopilot", "PPO")) -> str:
    """Scores of the corvette's study, by its condition and agent."""
    with (results / "episodes.csv").open(encoding="utf-8") as file:
        episodes = list(csv.DictReader(file))
    scores: dict[tuple[str, ...], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for one in sorted(episodes, key=lambda one: int(one["seed"])):
        scores[one["condition"], one["agent"], one["estimator"]][one["training_seed"]].append(float(one["score"]))
    rows = [
        (f"{sea}, {agent}",
         *(shown(np.array(list(scores[sea, agent, name].values()))) for name in estimators))
        for sea in ("moderate", "rough") for agent in agents
    ]  # fmt: skip
    return table(("Score", *estimators), rows)


def pilots() -> str:
    """The trained agents of the package beside the autopilots, on default estimates."""
    from agents import rollout
    from agents.checkpoint import description, packaged
    from agents.seeds import evaluation_seeds
    from agents.studies.worlds import system_of

    heads = ("", "estimates", "`autopilot`", "`ppo`", "`ppo` − `autopilot`", f"reached the end, of {EPISODES}",
             "training: seed, steps")  # fmt: skip
    rows = []
    for env_id in ("SigmaCorvette-v0", "ThesisCorvette-v0", *JOURNEYS):
        flights = {
            name: rollout(name, env_id, evaluation_seeds(EPISODES), record=False) for name in ("autopilot", "ppo")
        }
        system, told = system_of(env_id), description(packaged(env_id)) or {}
        there = (str(int((flight.end == system.task.success).sum())) for flight in flights.values())
        scores = [flight.score for flight in flights.values()]
        rows.append((
            f"`{env_id}`", f"`{system.estimator}`", *map(shown, scores), shown(scores[1] - scores[0]),
            " and ".join(there), f"{told['seed']}, {told['trained_steps']:,}",
        ))  # fmt: skip
    return table(heads, rows)


LATE = {"fused": "", "as new": ", as new", "discarded": ", discarded"}
"""Ways with late readings, and what they add to the names of estimators."""


def latency(results: Path) -> str:
    """Score, position error and its NEES in the study of late fixes: in time, and by what is done with late ones."""
    with (results / "episodes.csv").open(encoding="utf-8") as file:
        episodes = sorted(csv.DictReader(file), key=lambda one: int(one["seed"]))
    flown: dict[tuple[str, ...], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for one in episodes:
        for figure in ("score", "position_rmse", "position_nees"):
            flown[one["environment"], one["condition"], one["estimator"]][figure].append(float(one[figure] or "nan"))

    def cell(*where: str) -> str:
        of = {figure: np.array(values) for figure, values in flown[where].items()}
        error, nees = number(of["position_rmse"], 2), number(of["position_nees"], 2)
        return f"{shown(of['score'])}; {error} m; {nees}"

    rows = [
        (f"{environment.removesuffix('-v0')}, `{estimator}`", condition, cell(environment, "in time", estimator),
         *(cell(environment, condition, estimator + way) for way in LATE.values()))
        for environment in dict.fromkeys(one["environment"] for one in episodes)
        for estimator in ("ekf", "enkf")
        for condition in ("1 s late", "2 s late")
    ]  # fmt: skip
    return table(("score; position error; its NEES/n", "the fix is", "in time", *LATE), rows)


GAP = 6.0
"""Seconds after the start at which Segorogeni's fix is switched off."""


def gap() -> str:
    """What becomes of Segorogeni's position without a fix, and what `robust-kf` makes of its heading."""
    fewer = {"told": {"R": 400.0}}
    ways = (
        Way("`ekf`", "ekf"),
        *(Way(f"`robust-kf`, radius {radius:g}", "robust-kf", {"radius": radius}) for radius in (1e-4, 1e-3, 1e-2)),
        Way("radius 0.01, readings with a twentieth of their noise", "robust-kf", {"radius": 1e-2} | fewer,
            {"sensors": "clean"}),
    )  # fmt: skip
    times = (0.0, 2.0, 4.0, 6.0)
    heads = ("after", *(f"{after:g} s [m]" for after in times), "claimed [m]", "a radian of heading moves it by [m]")
    return table(heads, [(way.label, *_without_a_fix(way, times)) for way in ways])


def _without_a_fix(way: Way, times: Sequence[float]) -> list[str]:
    """RMS errors of the position so long after the fix was switched off; what is claimed at the end, and the gain."""
    from agents.studies.worlds import system_of
    from vessel_gym.core import Core
    from vessel_gym.sensor_faults import SensorFault

    off = [SensorFault("acoustic position", "off", begin=GAP)]
    core = Core(system_of("SegorogeniAUV-v0"), SEEDS, way.estimator, way.options, sensor_faults=off, **way.world)
    core.start(0)
    x, heading, dt = [core.composition.names.index(name) for name in ("x", "y")], [0.0], core.vehicle.dt
    cells, estimate, filter = [], core.loop.estimate, core.filter

    def looked_at(readings: Any, u: np.ndarray, steps: np.ndarray) -> None:
        predicted = filter.predict(core.belief, u)
        C, R = filter.model.linearise_measurement(predicted.mean, u, predicted.cov)[1], filter.model.R
        C = np.where(readings[1][..., None], C, 0.0)
        gain = predicted.cov @ C.mT @ np.linalg.inv(C @ predicted.cov @ C.mT + R)
        heading[0] = float(np.median(np.linalg.norm(gain[:, x, core.sensors.gives.index("psi")], axis=1)))
        estimate(readings, u, steps)

    core.loop.estimate = looked_at  # type: ignore[method-assign]
    for step in range(1, round((GAP + times[-1]) / dt) + 1):
        action = np.zeros((SEEDS, core.action_size))
        action[:, 0] = 0.5 * np.sin(step / 20.0)
        core.step(action)
        if any(step == round((GAP + after) / dt) for after in times):
            error = (core.estimated(core.truth) - core.belief.mean)[:, x]
            cells.append(f"{np.sqrt(np.square(error).sum(1).mean()):.2f}")
    variance = np.diagonal(core.belief.cov, axis1=1, axis2=2)[:, x]
    return [*cells, f"{np.sqrt(variance.sum(1).mean()):.2f}", f"{heading[0]:.3g}"]


WATCHED = {"Segorogeni": ("SegorogeniAUV-v0", "acoustic position"), "PUNA": ("PunaUAV-v0", "GNSS")}
"""Vehicles, and the fix of each, whose first two channels are its place."""
MONITORS = ("cusum", "chi-square")
STATED = 1e-4
"""The rate of false alarms a step that monitors are asked for."""
WRONG = {
    "off": "off", "stuck": "stuck", "bias": "bias, 4 σ in plan", "drift": "drift, 0.4 σ/s in plan",
    "scale": "scale, 1.1", "garbage": "garbage, 10 σ",
}  # fmt: skip
"""Faults of a fix by their kind; σ is what it says of itself."""


def alarms() -> str:
    """What monitors find of faults of a fix, and how often they raise an alarm in vain."""
    ways = [(*vehicle, monitor) for vehicle in WATCHED.values() for monitor in MONITORS]
    rows = []
    for estimator in ("ekf", "enkf"):
        found = (_watched(*way, estimator) for way in ways)
        rows.append((f"no fault, `{estimator}`", *(f"{number(of['false_alarms'], 1)} an hour" for of in found)))
    for kind, label in WRONG.items():
        rows.append((label, *(_finding(_watched(*way, "ekf", kind)) for way in ways)))
    return table(("", *(f"{name}, `{monitor}`" for name in WATCHED for monitor in MONITORS)), rows)


def _finding(of: dict[str, np.ndarray]) -> str:
    """Share of the faults that were detected, after how long, and in how many of these the right sensor is accused."""
    detected = np.nanmean(of["detected"])
    if detected == 0.0:
        return "0 %"
    return f"{detected:.0f} %; {np.nanmean(of['detection_delay']):.1f} s; {np.nanmean(of['right_sensor']):.0f} %"


def _watched(env_id: str, fix: str, monitor: str, estimator: str, kind: str | None = None) -> dict[str, np.ndarray]:
    """Figures of `EPISODES` flights under a monitor, with a fault of the fix that begins after 10 to 20 s."""
    from agents import rollout
    from agents.scores import scores
    from agents.seeds import evaluation_seeds
    from agents.studies.worlds import system_of
    from vessel_gym.sensor_faults import SensorFault

    faults = []
    if kind is not None:
        (sd,) = (np.array(sensor.sd) for sensor in system_of(env_id).vehicle.sensors if sensor.name == fix)
        plan = np.where(np.arange(len(sd)) < 2, sd, 0.0)
        sizes = {"bias": 4.0 * plan, "drift": 0.4 * plan, "scale": np.full(len(sd), 1.1), "garbage": 10.0 * sd}
        size = tuple(sizes[kind].tolist()) if kind in sizes else None
        faults = [SensorFault(fix, kind, size, begin=(10.0, 20.0))]
    watch = {"monitor": {"kind": monitor, "false_alarms": STATED}}
    world = {"estimator": estimator, "estimator_options": watch, "sensor_faults": faults}
    return scores(rollout("autopilot", env_id, evaluation_seeds(EPISODES), world))


def rows_of(page: Path) -> str:
    """The table alone of a report's page."""
    return "\n".join(line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("|"))


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """In Markdown."""
    return "\n".join("| " + " | ".join(line) + " |" for line in (heads, ["---"] * len(heads), *rows))


def shown(values: np.ndarray, decimals: int = 3) -> str:
    """The mean ``(seeds,)`` or ``(runs, seeds)`` with its 95 % interval."""
    from agents.statistics import crossed_interval

    interval = crossed_interval(np.atleast_2d(values))
    return WITHOUT if interval is None else f"{interval.mean:,.{decimals}f} ± {interval.half:.{decimals}f}"


def number(values: np.ndarray, decimals: int) -> str:
    """The mean over flights."""
    return f"{np.mean(values):.{decimals}f}"


def percent(share: float | None) -> str:
    """Of times; where there are none, that."""
    return WITHOUT if share is None else f"{100.0 * share:.0f} %"


ENVIRONMENTS = ROOT / "docs/environments"
TABLES: dict[str, tuple[Path, Callable[[], str]]] = {
    "segorogeni": (ROOT / "docs/dives.md", lambda: journeys("SegorogeniAUV-v0")),
    "itsunusa": (ROOT / "docs/dives.md", lambda: journeys("ItsunusaAUV-v0")),
    "puna": (ROOT / "docs/flight.md", lambda: journeys("PunaUAV-v0")),
    "moderate": (ROOT / "docs/seaway.md", lambda: turns("moderate")),
    "rough": (ROOT / "docs/seaway.md", lambda: turns("rough")),
    "segorogeni, short": (ENVIRONMENTS / "segorogeni-auv.md", lambda: worth("plain ensemble", "SegorogeniAUV-v0")),
    "itsunusa, short": (ENVIRONMENTS / "itsunusa-auv.md", lambda: worth("plain ensemble", "ItsunusaAUV-v0")),
    "puna, short": (ENVIRONMENTS / "puna-uav.md", lambda: worth("plain ensemble, inflation 1", "PunaUAV-v0")),
    "insurance": (ROOT / "docs/estimators/unknown-input.md", insurance),
    "inputs": (ROOT / "docs/estimators/unknown-input.md", inputs),
    "faults": (ROOT / "docs/estimators/unknown-input-faults.md", faults),
    "faults found": (ROOT / "docs/estimators/unknown-input-faults.md", faults_found),
    "pilots": (ROOT / "docs/pilots.md", pilots),
    "latency": (ROOT / "docs/late-fixes.md", lambda: latency(ROOT / "results/latency")),
    "gap": (ROOT / "docs/late-fixes.md", gap),
    "alarms": (ROOT / "docs/time-at-sea.md", alarms),
    "headline": (ROOT / "README.md", lambda: ablation(ROOT / "results/ablation", HEADLINE, ("autopilot",))),
    "ablation": (ENVIRONMENTS / "sigma-corvette.md", lambda: ablation(ROOT / "results/ablation")),
    "shares": (ROOT / "docs/findings.md", lambda: rows_of(ROOT / "results/quick/tables/ranking.md")),
}
"""Where each table stands, and what makes it."""


def main(names: tuple[str, ...] = tuple(TABLES), /) -> None:
    """Write tables of docs/ anew: dives, flights, faults and others are flown, in half an hour.

    Those of studies are taken from results/ablation, results/quick and results/latency, where `make ablation` and
    `python -m scripts.ablate studies/quick.toml --out results/quick` (or latency) leave them.

    Args:
        names: Which.
    """
    in_checkout()
    for name in names:
        if name not in TABLES:
            raise Refusal(f"there is no table {name!r}: known are {', '.join(TABLES)}")
    with progress_bar("tables", len(names)) as advance:
        for name in names:
            page, made = TABLES[name]
            put(page, f"table: {name}", made())
            advance()


if __name__ == "__main__":
    command(main)
