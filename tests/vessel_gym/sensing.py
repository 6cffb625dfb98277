"""A vehicle's sensors, what they give without a filter, and a sea: what the tests of all vehicles share."""

import numpy as np

from estimators import Gaussian, Model
from vessel_gym.disturbances import Disturbance
from vessel_gym.models.assumed import assumed_space
from vessel_gym.models.linear import filter_model
from vessel_gym.models.reference_filters import ZeroOrderHold
from vessel_gym.models.state_space import StateSpace
from vessel_gym.processes import Process
from vessel_gym.sensors import Sensors
from vessel_gym.system import Vehicle


def sensors_of(vehicle: Vehicle) -> Sensors:
    """A vehicle's own sensors."""
    return Sensors(
        vehicle.sensors, vehicle.state_names, vehicle.increments + vehicle.ambient_flows, vehicle.dt
    )


def exogenous(vehicle: Vehicle, flow: np.ndarray) -> np.ndarray:
    """The exogenous input ``(..., f)`` of a flow without increments."""
    return np.concatenate([np.zeros((*flow.shape[:-1], len(vehicle.increments))), flow], -1)


class UnevenWater(Disturbance):
    """Water that shakes every velocity by another amount, in a current of another size along every axis.

    Args:
        vehicle: What is shaken.
        increments: Standard deviations of what a step adds to each of its velocities.
        currents: Of the components of the current [m/s], which change in 200 s.
    """

    def __init__(
        self, vehicle: Vehicle, increments: tuple[float, ...], currents: tuple[float, ...]
    ) -> None:
        self.names = self.forces = vehicle.ambient_flows
        self.white_increments, self.white = vehicle.increments, np.diag(increments)
        self.process = Process.wandering(currents, 200.0, vehicle.dt)


def assumed(
    vehicle: Vehicle,
    kind: str,
    disturbance: Disturbance,
    sensors: Sensors,
    how: str | None = None,
) -> tuple[StateSpace, Model]:
    """A filter's state space, and its model."""
    space = assumed_space(vehicle, kind, disturbance, sensors, how)
    return space, filter_model(space)


def without_a_filter(
    assumed: tuple[StateSpace, Model],
    inputs: tuple[str, ...],
    measurements: np.ndarray,
    previous: np.ndarray | None = None,
    steps: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """State ``(B, n)`` and unknown input ``(B, q)`` that the last measurements ``(B, p)`` give, held.

    Args:
        assumed: State space and model of a filter.
        inputs: Names of the unknown input.
        measurements: The last ones.
        previous: Those before; None: these are the first.
        steps: How many steps lie between the two.
    """
    space, model = assumed
    held = ZeroOrderHold(space, model, inputs)
    n = len(space.names)
    belief = held.init(Gaussian(np.zeros((len(measurements), n)), np.eye(n)))
    if previous is not None:
        belief = held.update(belief, previous, u=space.vehicle.cruise[1])
        for _ in range(steps):
            belief = held.predict(belief, space.vehicle.cruise[1])
    belief = held.update(belief, measurements, u=space.vehicle.cruise[1])
    assert belief.input_mean is not None
    return belief.mean, belief.input_mean
