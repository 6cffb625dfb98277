"""Components of a vehicle's state in words and displayed units, and its position and attitude."""

from collections.abc import Sequence

import numpy as np

from estimators.angles import difference
from vessel_gym.models.estimation import WITHOUT_COVARIANCE
from vessel_gym.simulation.core import Core

_WORDS = {
    "x": ("north position", "m"), "y": ("east position", "m"),
    "z": ("depth", "m"), "h": ("altitude", "m"),
    "phi": ("roll", "°"), "theta": ("pitch", "°"), "psi": ("heading", "°"),
    "u": ("surge speed", "m/s"), "v": ("sway speed", "m/s"), "w": ("heave speed", "m/s"),
    "p": ("roll rate", "°/s"), "q": ("pitch rate", "°/s"), "r": ("yaw rate", "°/s"),
    "north": ("speed north", "m/s"), "east": ("speed east", "m/s"), "climb": ("climb rate", "m/s"),
    "unknown yaw increment": ("yaw increment", "mrad"),
}  # fmt: skip
_FACTORS = {"°": float(np.rad2deg(1.0)), "°/s": float(np.rad2deg(1.0)), "mrad": 1e3}
"""Factors from SI to the displayed units; others are 1."""


def pose(states: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """Positions and attitudes ``(T, 6)``: north, east, down [m], unwrapped roll, pitch, yaw [rad].

    Components that the state lacks are 0; without a heading, the yaw is the course.

    Args:
        states: ``(T, n)`` states.
        names: Names of the components of a state.
    """

    def of(name: str) -> np.ndarray:
        return states[:, names.index(name)] if name in names else np.zeros(len(states))

    yaw, pitch = of("psi"), of("theta")
    if "psi" not in names and "north" in names:
        yaw = np.arctan2(of("east"), of("north"))
        pitch = np.arctan2(of("climb"), np.hypot(of("east"), of("north")))
    return np.stack([of("x"), of("y"), of("z") - of("h"), of("phi"), pitch, np.unwrap(yaw)], -1)


def in_words(name: str, angles: Sequence[str]) -> tuple[str, str, float]:
    """A state component's name in words, its displayed unit, and the factor from SI to that unit.

    Args:
        name: Name of the component.
        angles: Names of the components that are angles.
    """
    words, unit = _WORDS.get(name, (name, "°" if name in angles else ""))
    return words, unit, _FACTORS.get(unit, 1.0)


class Components:
    """Estimated components of the vehicle's state, in displayed units.

    Args:
        core: Core of the environment.
        history: History of one environment.
        names: Names of the components.

    Attributes:
        words: Words, unit and factor from SI of each component.
        true: ``(T, k)``.
        error: ``(T, k)`` estimate minus truth; angles modulo a full turn.
        cov: ``(T, k, k)``; None for an estimator without covariance.
        measured: ``(T, k)`` measurement minus truth; NaN without a measurement.
        axes: ``(k, 3)`` metres north, east and down in SI units of each component; 0 for components
            that are no position.
        members: ``(t, m, k)`` deviations of the ensemble from its mean; None without an ensemble.
    """

    def __init__(self, core: Core, history: dict[str, np.ndarray], names: Sequence[str]) -> None:
        config, vehicle = core.config, core.config.system.vehicle
        state, turns = vehicle.state_names, [name in vehicle.angles for name in names]
        at = [config.estimation.space.names.index(name) for name in names]
        angles = tuple(np.flatnonzero(turns).tolist())
        self.names, self.words = names, [in_words(name, vehicle.angles) for name in names]
        scale = np.array([factor for *_, factor in self.words])
        columns = [state.index(name) for name in names]
        true, self.cov = history["truth"][:, columns], None
        self.true = scale * true
        self.error = scale * difference(history["estimate"][:, at], true, angles)
        if config.estimation.filter.name not in WITHOUT_COVARIANCE:
            self.cov = history["covariance"][:, at][:, :, at] * np.outer(scale, scale)
        measured = np.full(true.shape, np.nan)
        for channel, name in enumerate(config.sensors.gives):
            if name in names:
                came = history["available"][:, channel]
                measured[came, names.index(name)] = history["measurement"][came, channel]
        self.measured = scale * difference(measured, true, angles)
        self.axes = pose(np.eye(len(state)), state)[columns, :3]
        self.members = None
        if "ensemble" in history:
            mean = history["estimate"][-len(history["ensemble"]) :, None, at]
            self.members = scale * difference(history["ensemble"][..., at], mean, angles)
