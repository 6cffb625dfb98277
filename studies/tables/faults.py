"""Tables about faults: of actuators, as unknown inputs, and of sensors, late or switched off."""

import re
from collections.abc import Sequence
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.studies.worlds import system_of
from studies.tables.arms import Arm
from studies.tables.markdown import WITHOUT, number, shown, table
from studies.tables.suites import environments, flown
from vessel_gym.core import Core
from vessel_gym.disturbances import Fault
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import SensorSuite


class Faulty(NamedTuple):
    """A vehicle, and which of its actuators are at fault."""

    name: str
    env_id: str
    actuators: tuple[str, ...]

    def fault(self, weather: str, **fault: float) -> Any:
        """The same fault of each, beside the water or the air of the environment."""
        beside = system_of(self.env_id).disturbances[weather]
        return reduce(
            lambda beside, actuator: Fault(actuator, beside=beside, **fault), self.actuators, beside
        )


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
            flyers: dict[str, tuple[Any, Any]] = {
                "truth": ("truth", {}), "default": (None, {}), "ekf": ("ekf", {}), "Q": ("ekf", {"assume": {"Q":
                10.0}}), "ekf-ui-wdf": ("ekf-ui-wdf", {}), "ukf-umv": ("ukf-umv", {}), "linear": ("kf-umv-ui-wdf", {}),
            }  # fmt: skip
            for name, degrees in (("slow", 0.3), ("fast", 3.0)):  # a second, as a random walk
                walk = vehicle.fault(weather, start=np.deg2rad(2.0), walk=np.deg2rad(degrees))
                flyers[name] = "ekf", {"assume": {"disturbance": walk, "as": "states"}}
            for label, fault in FAULTS.items():
                world = {"disturbance": vehicle.fault(weather, **fault)}
                scores = (_flown(vehicle.env_id, *flyer, world) for flyer in flyers.values())
                cells = (
                    WITHOUT if isinstance(of, str) else f"{of['score'].mean():.3f}" for of in scores
                )
                rows.append((f"{vehicle.name}; {weather}", label, *cells))
    return table(heads, rows)


def faults_found() -> str:
    """The error of the input's estimate, in units of its prior."""
    heads = ("", "sensors", "`ekf-ui-wdf`", "`ukf-umv`", "`kf-umv-ui-wdf`")
    rows = []
    for vehicle in FAULTY:
        lossy = SensorSuite(noise=1.0, dropout=0.1).of(system_of(vehicle.env_id).vehicle.sensors)
        for label, sensors in (
            ("nominal", "nominal"),
            ("10 % lost", list(lossy)),
            ("degraded", "degraded"),
        ):
            world = {
                "disturbance": vehicle.fault("moderate", bias=np.deg2rad(5.0)),
                "sensors": sensors,
            }
            found = [
                _flown(vehicle.env_id, name, {}, world)
                for name in ("ekf-ui-wdf", "ukf-umv", "kf-umv-ui-wdf")
            ]
            cells = (
                WITHOUT if isinstance(of, str) else f"{of['input_rmse'].mean():.2f}" for of in found
            )
            rows.append((vehicle.name, label, *cells))
    return table(heads, rows)


def inputs() -> str:
    """Every filter of an unknown input with every vehicle: its share of the `ekf`'s score, or its refusal in short."""
    names = ("kf-umv-ui", "kf-umv-ui-wdf", "ulise", "ekf-ui-wdf", "ukf-umv")
    worlds: list[tuple[str, str, Any]] = [
        ("corvette, waves", "SigmaCorvette-v0", "moderate"),
        ("thesis' corvette, a step", "ThesisCorvette-v0", "moderate"),
        *((vehicle.name, vehicle.env_id, vehicle.fault("moderate")) for vehicle in FAULTY),
    ]
    for vehicle, actuator, size in ((FAULTY[0], "thrust", 1.0), (FAULTY[1], "thrust", 2.0), (FAULTY[2], "thrust", 1.0),
                                    (FAULTY[2], "angle of attack", np.deg2rad(2.0))):  # fmt: skip
        beside, name = (
            system_of(vehicle.env_id).disturbances["moderate"],
            vehicle.name.split(",")[0],
        )
        worlds.append(
            (
                f"{name}, {actuator}",
                vehicle.env_id,
                Fault(actuator, size=float(size), beside=beside),
            )
        )
    rows = []
    for label, env_id, disturbance in worlds:
        plain, *found = (
            _flown(env_id, name, {}, {"disturbance": disturbance}) for name in ("ekf", *names)
        )
        cells = (
            of if isinstance(of, str) else f"{of['score'].mean() / plain['score'].mean():.3f}"
            for of in found
        )
        rows.append((label, *cells))
    return table(("", *(f"`{name}`" for name in names)), rows)


def _flown(
    env_id: str, estimator: str | None, options: dict[str, Any], world: dict[str, Any]
) -> Any:
    """Figures of `SEEDS` flights, or in short why the environment refuses the filter."""
    try:
        return Arm("", estimator, options, world).scores(env_id, SEEDS)
    except ValueError as error:
        why = str(error)
    for pattern, short in REASONS.items():
        if found := re.search(pattern, why):
            return short.format(*found.groups())
    return why


REASONS = {
    "needs a LinearModel": "nonlinear model",
    r"needs rank\(H\) = (\d+) unknown inputs?, got (\d+)": "rank H = {1}, not {0}",
    r"standard deviation of (\S+) times": "σ = {0}",
}
"""Refusals of filters, and how a table shows them."""


LATE = {"fused": "", "as new": ", as new", "discarded": ", discarded"}
"""Ways with late measurements, and what they add to the names of estimators."""


def latency(results: Path) -> str:
    """Score, position error and its NEES in the study of late fixes: in time, and by what is done with late ones."""

    def cell(environment: str, condition: str, estimator: str) -> str:
        score, error, nees = (
            flown(results, environment, "autopilot", key)[condition, estimator]
            for key in ("score", "position_rmse", "position_nees")
        )
        return f"{shown(score)}; {number(error, 2)} m; {number(nees, 2)}"

    rows = [
        (f"{environment.removesuffix('-v0')}, `{estimator}`", condition, cell(environment, "in time", estimator),
         *(cell(environment, condition, estimator + way) for way in LATE.values()))
        for environment in environments(results)
        for estimator in ("ekf", "enkf")
        for condition in ("1 s late", "2 s late")
    ]  # fmt: skip
    return table(("score; position error; its NEES/n", "the fix is", "in time", *LATE), rows)


GAP = 6.0
"""Seconds after the start at which Segorogeni's fix is switched off."""


def gap() -> str:
    """Segorogeni's position without a fix, and the heading of `robust-kf`."""
    fewer = {"assume": {"R": 400.0}}
    ways = (
        Arm("`ekf`", "ekf"),
        *(Arm(f"`robust-kf`, radius {radius:g}", "robust-kf", {"radius": radius}) for radius in (1e-4, 1e-3, 1e-2)),
        Arm("radius 0.01, measurements with a twentieth of their noise", "robust-kf", {"radius": 1e-2} | fewer,
            {"sensors": "clean"}),
    )  # fmt: skip
    times = (0.0, 2.0, 4.0, 6.0)
    heads = (
        "after",
        *(f"{after:g} s [m]" for after in times),
        "claimed [m]",
        "a radian of heading moves it by [m]",
    )
    return table(heads, [(way.label, *_without_a_fix(way, times)) for way in ways])


def _without_a_fix(way: Arm, times: Sequence[float]) -> list[str]:
    """RMS errors of the position so long after the fix was switched off; what is claimed at the end, and the gain."""
    off = [SensorFault("acoustic position", "off", begin=GAP)]
    core = Core(
        system_of("SegorogeniAUV-v0"),
        SEEDS,
        way.estimator,
        way.options,
        sensor_faults=off,
        **way.world,
    )
    core.start(0)
    x, heading, dt = (
        [core.composition.names.index(name) for name in ("x", "y")],
        [0.0],
        core.vehicle.dt,
    )
    cells, estimate, filter = [], core.loop.estimate, core.filter

    def looked_at(measurements: Any, u: np.ndarray, steps: np.ndarray) -> None:
        predicted = filter.predict(core.belief, u)
        C, R = (
            filter.model.linearise_measurement(predicted.mean, u, predicted.cov)[1],
            filter.model.R,
        )
        C = np.where(measurements[1][..., None], C, 0.0)
        gain = predicted.cov @ C.mT @ np.linalg.inv(C @ predicted.cov @ C.mT + R)
        heading[0] = float(
            np.median(np.linalg.norm(gain[:, x, core.sensors.gives.index("psi")], axis=1))
        )
        estimate(measurements, u, steps)

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
