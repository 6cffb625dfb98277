"""Contents of an image of an episode, computed once for frames and pages.

A scene is computed from the history of one environment: the arrays of ``info`` from a rollout,
``(T, ...)`` by key.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vessel_gym.disturbances.seaway import Seaway
from vessel_gym.disturbances.waves import InWaves
from vessel_gym.rendering.components import Components, in_words, pose
from vessel_gym.simulation.core import Core
from vessel_gym.tasks.task import Workspace

RECORDED = (
    "truth", "estimate", "covariance", "measurement", "available", "unknown_input",
    "input_estimate", "score",
)  # fmt: skip
"""Keys of a history that a scene needs; ``ensemble`` is optional."""
_FIRST = ("x", "y", "psi", "u", "climb", "z", "h", "theta")
"""Components whose charts come first."""
_POSE = ("x", "y", "z", "h", "phi", "theta", "psi")
"""Components on maps, whose charts show the error of the estimate."""


class Series(NamedTuple):
    """One line of a chart; its ``label`` is in the legend of the chart."""

    label: str
    colour: str  # its name in the palette
    value: np.ndarray  # (T,), NaN for missing values


class Chart(NamedTuple):
    """Lines over time; the last one is on top."""

    title: str  # quantity and unit
    series: Sequence[Series]
    # lower and upper edge of a pale area below the lines
    band: tuple[np.ndarray, np.ndarray] | None = None
    # (T,) measurements of the last line's quantity, NaN where none came
    measured: np.ndarray | None = None


class Ambient(NamedTuple):
    """Wind, waves or current at the vehicle."""

    name: str
    unit: str
    # (T, 2) north and east, its direction of motion; the length is the speed or significant height
    vector: np.ndarray


def ambients(core: Core, history: dict[str, np.ndarray]) -> list[Ambient]:
    """Wind, waves and current of an episode, if its disturbance has them.

    Args:
        core: Core of the environment.
        history: History of one environment, with ``truth`` ``(T, n)``.
    """
    truth = dict(zip(core.config.true_state.names, history["truth"].T, strict=True))
    disturbance, still = core.config.world.disturbance, np.zeros(len(history["truth"]))

    def level(name: str) -> np.ndarray:
        return np.stack([truth[f"{name} north"], truth[f"{name} east"]], -1)

    def toward(direction: float, size: float) -> np.ndarray:
        return still[:, None] + size * np.array([np.cos(direction), np.sin(direction)])

    found = []
    if "current north" in truth:
        found.append(Ambient("Current", "m/s", level("current")))
    elif "current" in truth:  # of a vehicle in a vertical plane, which lies north
        found.append(Ambient("Current", "m/s", np.stack([truth["current"], still], -1)))
    if "mean wind north" in truth:
        found.append(Ambient("Wind", "m/s", level("mean wind") + level("gust")))
    if isinstance(disturbance, Seaway):
        wind = toward(disturbance.wind_direction, disturbance.wind)
        found.append(Ambient("Wind", "m/s", wind))
    if isinstance(disturbance, InWaves):
        spectrum = disturbance.spectrum
        found.append(Ambient("Waves", "m", toward(spectrum.direction, spectrum.height)))
    return found


def waves_of(core: Core, constants: np.ndarray) -> np.ndarray | None:
    """Directions [rad from north] to which the waves of an episode run, and frequencies [Hz].

    The shape is ``(2, n)``; None if the disturbance has no waves.

    Args:
        core: Core of the environment.
        constants: Constants of the disturbance ``(e,)`` that the episode has drawn.
    """
    disturbance = core.config.world.disturbance
    if not isinstance(disturbance, InWaves):
        return None
    w, _, kx, ky = disturbance.waves.constants(constants)
    return np.stack([np.arctan2(ky, kx), w / (2.0 * np.pi)])


class Scene:
    """Contents of an image of an episode.

    Args:
        core: Core of the environment.
        workspace: Workspace of the episode.
        history: History of one environment: `RECORDED`, and optionally ``ensemble`` ``(t, m, n)``
            of the last t moments.

    Attributes:
        estimated: Names of the estimated components, those on maps first.
        time: ``(T,)`` [s].
        true: True positions and attitudes of the vehicle ``(T, 6)``, see
            `vessel_gym.rendering.components.pose`.
        believed: Estimated positions and attitudes ``(T, 6)``, with true values in components that
            are not estimated.
        position: Estimated components of the position; without any, the heading or the first
            component.
        located: Is a component of the position estimated?
        fixes: ``(T, k)`` measurement of the position minus the truth; NaN unless all components
            were measured.
    """

    def __init__(self, core: Core, workspace: Workspace, history: dict[str, np.ndarray]) -> None:
        self.core, self.workspace, self.history = core, workspace, history
        config = core.config
        names = config.estimation.space.vehicle_states
        self.estimated = sorted(names, key=(*_FIRST, *names).index)
        states = history["truth"].copy()
        self.time = np.arange(len(states)) * config.system.vehicle.dt
        true_names = config.true_state.names
        self.true = pose(states, true_names)
        states[:, [true_names.index(name) for name in names]] = history["estimate"][:, : len(names)]
        self.believed = pose(states, true_names)
        placed = [name for name in ("y", "x", "z", "h") if name in names]
        self.position = Components(core, history, placed or ["psi" if "psi" in names else names[0]])
        self.located = bool(placed)
        measured = self.position.measured
        fixed = np.isfinite(measured).all(1, keepdims=True)
        self.fixes = np.where(fixed, measured, np.nan)

    def charts(self, most: int) -> list[Chart]:
        """Charts of estimates, of a single unknown input and of the score.

        Args:
            most: Largest number of charts.
        """
        core, history, rest = self.core, self.history, list[Chart]()
        if len(core.config.estimation.inputs) == 1 and np.isfinite(history["unknown_input"]).all():
            rest.append(self._unknown_input())
        rest.append(Chart("Score so far", [Series("", "true", history["score"])]))
        return [*map(self._component, self.estimated[: most - len(rest)]), *rest]

    def _component(self, name: str) -> Chart:
        """Chart of a component, or of its error if maps show the component."""
        component = Components(self.core, self.history, [name])
        true, error = component.true[:, 0], component.error[:, 0]
        measured, band, sigmas = component.measured[:, 0], None, ""
        middle = np.zeros(len(error)) if name in _POSE else true + error
        if component.cov is not None:
            sd = np.sqrt(np.maximum(component.cov[:, 0, 0], 0.0))
            band, sigmas = (middle - 2.0 * sd, middle + 2.0 * sd), " ±2σ"
        if name in _POSE:
            lines = [Series(f"estimate − truth{sigmas}", "believed", error)]
        else:
            measured = true + measured
            lines = [_true(true), Series(f"estimate{sigmas}", "believed", middle)]
        measured = measured if np.isfinite(measured).any() else None
        return Chart(_title(*component.words[0][:2]), lines, band, measured)

    def _unknown_input(self) -> Chart:
        """Chart of the unknown input, with estimates shifted by their delay."""
        estimation, history = self.core.config.estimation, self.history
        words, unit, scale = in_words(f"unknown {estimation.inputs[0]}", ())
        lines = [_true(scale * history["unknown_input"][:, 0])]
        if self.core.now.belief.input_mean is not None:
            estimate = scale * history["input_estimate"][estimation.input_delay :, 0]
            value = np.full(len(self.time), np.nan)
            value[: len(estimate)] = estimate
            lines.append(Series("estimate", "believed", value))
        return Chart(_title(words, unit), lines)

    @property
    def conditions(self) -> list[str]:
        """Conditions of the episode in words."""
        options, words = self.core.config.options, []
        for what in "disturbance", "sensors":
            choice = getattr(options, what)
            words.append(f"{choice if isinstance(choice, str) else 'own'} {what}")
        return [*words, f"mismatch {100 * options.mismatch:g} %"] if options.mismatch else words

    @property
    def legend(self) -> dict[str, str]:
        """Names of the marks that maps show, by kind."""
        around, position = self.workspace, self.position
        labels = {"true": "true vehicle", "believed": "estimated vehicle"}
        if self.located and position.cov is not None:
            labels["ellipse"] = "estimate ±2σ"
        if self.located and position.members is not None:
            labels["cloud"] = f"ensemble of {position.members.shape[1]}"
        if self.located and set(position.names) <= set(self.core.config.sensors.gives):
            labels["fix"] = "position fix"
        labels["start"] = "start"
        if around.surface is not None:
            labels["surface"] = "surface of the water"
        if len(around.path):
            labels["path"] = "path to follow"
        if len(around.fairway):
            labels["fairway"] = "channel"
        if around.goal is not None:
            labels["goal"] = f"goal, within {around.goal[3]:g} m"
        if len(around.obstacles):
            labels["obstacle"] = "obstacle"
        return labels


def _true(value: np.ndarray) -> Series:
    return Series("true", "true_soft", value)


def _title(words: str, unit: str) -> str:
    return words[:1].upper() + words[1:] + (f" [{unit}]" if unit else "")


def nice(value: float) -> float:
    """Smallest of 1, 2 and 5 times a power of ten that is at least a positive value."""
    power = 10.0 ** np.floor(np.log10(value))
    return next(float(k * power) for k in (1.0, 2.0, 5.0, 10.0) if k * power >= 0.9999 * value)
