"""A ship identified from logs as an environment uses it, and what moves her beside her model."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from estimators.engine import compiled
from vessel_gym.checks import check_numbers, instance
from vessel_gym.disturbances import Disturbance
from vessel_gym.processes import Process, linear
from vessel_gym.sensors import Sensor, plain
from vessel_gym.vehicles.corvette import COMPASS
from vessel_gym.vehicles.files import FromFile
from vessel_gym.vehicles.manoeuvring import COEFFICIENTS, STATE, rates
from vessel_gym.vehicles.measured_ship import MeasuredShip
from vessel_gym.vehicles.steered import SteeredByRate
from vessel_gym.vehicles.whole_state import WholeState
from vessel_gym.verified import verified

FLOWS = (
    "current north", "current east", "surge acceleration", "sway acceleration", "yaw acceleration", "wind from north",
    "wind from east",
)  # fmt: skip
"""What is around the ship: the current [m/s], accelerations that the model does not explain [m/s2, rad/s2], the true
wind [m/s]."""
_CLIP = 2.0


@compiled
def _rates(state: np.ndarray, actuators: np.ndarray, flow: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Rates ``(..., 6)``; velocities are those in the moving water, ``c`` ends in particulars and revolutions."""
    current, extra, wind = flow[..., :2], flow[..., 2:5], flow[..., 5:]
    k = len(COEFFICIENTS)
    control = np.concatenate([actuators, c[..., -1:] + 0.0 * actuators], -1)
    moved = rates(state, control, np.concatenate([wind + current, 0.0 * wind], -1), c[..., :k], c[..., k:-1])
    return moved + np.concatenate([current, 0.0 * extra[..., :1], extra], -1)


@verified
@linear
def _yaw_rate(state: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
    """The yaw rate ``(..., 1)``."""
    return state[..., 5:6]


@dataclass(frozen=True)
class IdentifiedShip(FromFile, SteeredByRate, WholeState, verified=True):
    """A measured ship at service revolutions; the action is the rudder rate.

    Filters have the identified model, with the accelerations that it left unexplained in the logs as states.
    """

    ship: MeasuredShip
    dt: float
    substeps: int = 1

    state_names = STATE
    equations = staticmethod(_rates)
    parameter_names: ClassVar[tuple[str, ...]] = (*COEFFICIENTS, *(f"particular {i}" for i in range(10)), "revolutions")
    ambient_flows: ClassVar[tuple[str, ...]] = FLOWS
    normals: ClassVar[int] = len(COEFFICIENTS)
    largest_mismatch: ClassVar[float] = 1.0
    """At which the truth's coefficients are drawn from the distribution of the estimates."""

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """Coefficients ``(B, k)`` of the truth: those of the file, with a share of their correlated errors."""
        drawn = self.ship.drawn(mismatch * np.clip(normals, -_CLIP, _CLIP))
        known = np.append(self.ship.particulars.vector(), self.ship.revolutions)
        return np.concatenate([drawn, np.broadcast_to(known, (*drawn.shape[:-1], len(known)))], -1)

    @cached_property
    def sensors(self) -> tuple[Sensor, ...]:
        """Gyro compass, rate gyro and receiver with the noise of the logs."""
        noise, length = self.ship.noise, self.ship.length
        position, turning = noise["position"], noise["yaw rate"]
        return (
            replace(COMPASS, sd=(noise["heading"],)),
            Sensor("rate gyro", ("yaw rate [rad/s]",), _yaw_rate, (turning,), scale=(0.1 * self.ship.speed / length,),
                   gives=("r",)),
            Sensor("receiver", ("north [m]", "east [m]"), plain((0, 1)), (position, position),
                   scale=(2.0 * length, 2.0 * length), gives=("x", "y")),
        )  # fmt: skip

    @property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """Straight on to the north at service speed."""
        return np.array([0.0, 0.0, 0.0, self.ship.speed, 0.0, 0.0]), np.zeros(2)


@dataclass(frozen=True, eq=False)
class MeasuredSea(Disturbance, verified=True):
    """Disturbance of an identified ship: the accelerations that logs left unexplained, a current, and wind.

    Each is a first-order Gauss-Markov process, the accelerations of the size and time constant of the file.
    """

    vessel: MeasuredShip
    wind: float  # RMS speed, m/s
    current: float  # RMS speed, m/s
    dt: float

    names = FLOWS
    forces = FLOWS

    def __post_init__(self) -> None:
        instance("vessel of MeasuredSea", self.vessel, MeasuredShip)
        check_numbers(self, not_negative="wind current", positive="dt")

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Current, accelerations, wind; current and wind change in a hundred lengths' time."""
        noise, slow = self.vessel.noise, 100.0 * self.vessel.length / self.vessel.speed
        pushed = tuple((1.0 + noise["growth"]) * noise[name] for name in ("surge", "sway", "yaw"))
        flow, wind = ((size / np.sqrt(2.0),) * 2 for size in (self.current, self.wind))
        return Process.joined(
            Process.wandering(flow, slow, self.dt),
            Process.wandering(pushed, noise["time constant"], self.dt),
            Process.wandering(wind, slow, self.dt),
        )
