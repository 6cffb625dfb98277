"""Steps of the vehicles' equations of motion, with actuators before and after in one array."""

from collections.abc import Callable
from functools import partial

import numpy as np

from vessel_gym.vehicles.corvette_equations import corvette_rates
from vessel_gym.vehicles.puna import puna_rates
from vessel_gym.vehicles.segorogeni import segorogeni_rates
from vessel_gym.vehicles.simulated import Rates, runge_kutta

Step = Callable[..., np.ndarray]


def step(
    rates: Rates,
    state: np.ndarray,
    control: np.ndarray,
    flow: np.ndarray,
    c: np.ndarray,
    dt: float,
    substeps: int,
) -> np.ndarray:
    """The state ``(..., n)`` after ``dt``; control ``(..., 2 a)`` holds the actuators before and after."""
    before, after = np.split(control, 2, -1)
    return runge_kutta(rates, state, before, after - before, flow, c, dt, substeps)


corvette_step: Step = partial(step, corvette_rates)
segorogeni_step: Step = partial(step, segorogeni_rates)
puna_step: Step = partial(step, puna_rates)
