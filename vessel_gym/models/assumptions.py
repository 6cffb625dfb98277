"""Assumptions of a filter that differ from the world, as the option ``assume`` gives them."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from estimators import factory
from estimators.checks import number
from vessel_gym import checks
from vessel_gym.disturbances import Disturbance
from vessel_gym.models.assumed import ASSUMED
from vessel_gym.sensors import Sensors


@dataclass(frozen=True)
class Assumptions:
    """Assumptions of a filter that differ from the world: ``estimator_options={"assume": {...}}``.

    Attributes:
        disturbance: Assumed disturbance, by name or as an object; None: the true one.
        how: One of `vessel_gym.models.assumed.ASSUMED` (``"as"`` in the options); None: the
            disturbance's default.
        Q: Factor on the covariances of process noise and of a white input.
        R: Factor on the covariance of measurement noise, or factors by the names of sensors.
        prior: Factor on the covariance of the prior.
    """

    disturbance: str | Disturbance | None = None
    how: str | None = None
    Q: float = 1.0
    R: float | tuple[tuple[str, float], ...] = 1.0
    prior: float = 1.0

    @classmethod
    def of(cls, options: object) -> "Assumptions":
        """Assumptions from the value of the option ``assume``.

        Raises:
            TypeError: for anything but a dictionary, or an unknown key.
            ValueError: for a factor that is not positive, or an unknown way to assume a
                disturbance.
        """
        given = checks.options("assume", options)
        known = ("disturbance", "as", "Q", "R", "prior")
        for key in given:
            if key not in known:
                raise TypeError(factory.unknown("key of assume", key, known))
        for key in ("Q", "R", "prior"):
            if key not in given:
                continue
            if key == "R" and isinstance(given[key], dict):
                given[key] = (
                    *((name, _factor(f"R of {name}", f)) for name, f in given[key].items()),
                )
            else:
                given[key] = _factor(f"{key} of assume", given[key])
        if "as" in given:
            how = given.pop("as")
            given["how"] = checks.one_of("way to assume a disturbance", how, ASSUMED)
        return cls(**given)

    def scaled(self, model: Any, sensors: Sensors) -> Any:
        """A model with the factors on Q and R.

        Raises:
            ValueError: for a factor of a sensor that is not there.
        """
        if self.Q == self.R == 1.0:
            return model
        Q, R = (
            noise.changed(partial(np.multiply, factor)) if callable(noise) else factor * noise
            for factor, noise in ((self.Q, model.Q), (self._R(sensors), model.R))
        )
        return replace(model, Q=Q, R=R)

    def _R(self, sensors: Sensors) -> float | np.ndarray:
        """The factor on R, or factors ``(p, p)`` if sensors have their own."""
        if not isinstance(self.R, tuple):
            return self.R
        root, names = np.ones(sensors.size), [sensor.name for sensor in sensors.each]
        for name, factor in self.R:
            if name not in names:
                raise ValueError(factory.unknown("sensor in R of assume", name, names))
            root[sensors.owner == names.index(name)] = np.sqrt(factor)
        return root[:, None] * root


def _factor(name: str, value: object) -> float:
    """A factor of assumptions."""
    return number(name, value, low=0.0, what="a factor above 0")
