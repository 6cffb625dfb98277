"""A vehicle's sensors, what they give without a filter, and a sea: what the tests of all vehicles share."""

import numpy as np

from estimators import Gaussian
from vessel_gym.disturbances import Disturbance
from vessel_gym.filter_models.build import Composition
from vessel_gym.processes import Process
from vessel_gym.reference_filters import ZeroOrderHold
from vessel_gym.sensors import Sensors, SensorSuite
from vessel_gym.system import Vehicle


def sensors_of(vehicle: Vehicle, noise: float = 1.0) -> Sensors:
    """A vehicle's sensors with so many times their nominal noise."""
    each = SensorSuite(noise=noise).of(vehicle.sensors)
    return Sensors(
        each, vehicle.state_names, vehicle.increments + vehicle.ambient_flows, vehicle.dt
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


def without_a_filter(
    composition: Composition,
    inputs: tuple[str, ...],
    measurements: np.ndarray,
    previous: np.ndarray | None = None,
    steps: int = 1,
) -> tuple[np.ndarray, np.ndarray]:
    """State ``(B, n)`` and unknown input ``(B, q)`` that the last measurements ``(B, p)`` give, held.

    Args:
        composition: What is known of the world.
        inputs: Names of the unknown input.
        measurements: The last ones.
        previous: Those before; None: these are the first.
        steps: How many steps lie between the two.
    """
    held = ZeroOrderHold(composition, inputs)
    n = len(composition.names)
    belief = held.init(Gaussian(np.zeros((len(measurements), n)), np.eye(n)))
    if previous is not None:
        belief = held.update(belief, previous, u=composition.vehicle.cruise[1])
        for _ in range(steps):
            belief = held.predict(belief, composition.vehicle.cruise[1])
    belief = held.update(belief, measurements, u=composition.vehicle.cruise[1])
    assert belief.input_mean is not None
    return belief.mean, belief.input_mean
