"""What waves do to a ship: the loads of long waves, and the first-order motion that follows.

Angles: beta is the direction in which the waves run less the heading; 0 is a following sea, 180 degrees a head sea
(Fossen 2021, ch. 10).
"""

import numpy as np

from vessel_gym.vehicles.corvette import sway_yaw_jacobian
from vessel_gym.vehicles.corvette_equations import COEFFICIENTS, CorvetteParameters
from vessel_gym.waves import GRAVITY, encounter_frequency

SHORT_CREST = 0.15
"""What stands for the crests' shortness: a share of the side force that comes a quarter of a period later, so that a
sea ahead or astern does not leave a ship entirely alone; assumed."""


def wave_loads(ship: CorvetteParameters, frequency: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Sway force [N], yaw and roll moments [N m] per metre of a wave's amplitude ``(..., 3)``, complex.

    On a wave ``exp(j (w t - k x))``: a slender hull of one section in the water's relative acceleration at half its
    draught, Faltinsen (1990).

    Args:
        ship: Parameters.
        frequency: Of the wave [rad/s].
        beta: Where it runs to, from the heading on [rad].
    """
    c = dict(zip(COEFFICIENTS, ship.vector(), strict=True))
    frequency, beta = np.broadcast_arrays(np.asarray(frequency, float), np.asarray(beta, float))
    k = frequency**2 / GRAVITY
    X = 0.5 * k * ship.length * np.cos(beta)  # phase between amidships and the end
    even = np.sinc(X / np.pi)
    small = np.abs(X) < 1e-3
    safe = np.where(small, 1.0, X)
    odd = np.where(small, X / 3.0, np.sin(safe) / safe**2 - np.cos(safe) / safe)
    side = (np.sin(beta) + 1j * SHORT_CREST) * np.exp(-0.5 * k * ship.draught)
    push = c["sway_inertia"] * frequency**2 * side
    roll = -1j * c["righting"] * k * side
    return np.stack([1j * push * even, 0.5 * ship.length * push * odd, roll * even], -1)


def wave_response(ship: CorvetteParameters, frequency: np.ndarray, beta: np.ndarray, speed: float) -> np.ndarray:
    """First-order sway velocity [m/s] and yaw rate [rad/s] per metre of a wave's amplitude ``(..., 2)``, complex.

    Of the ship that goes straight on, linearised: no pole at an encounter frequency of 0. Superposed on manoeuvring,
    Fossen (2021), ch. 10.

    Args:
        ship: Parameters.
        frequency: Of the wave [rad/s].
        beta: Where it runs to, from the heading on [rad].
        speed: [m/s].
    """
    c = dict(zip(COEFFICIENTS, ship.vector(), strict=True))
    mass = np.array([[c["sway_inertia"], c["sway_yaw_inertia"]], [c["yaw_sway_inertia"], c["yaw_inertia"]]])
    A, _ = sway_yaw_jacobian(np.array([speed, 0.0, 0.0]), np.array(0.0), ship)
    accelerations = wave_loads(ship, frequency, beta)[..., :2] @ np.linalg.inv(mass).T
    met = encounter_frequency(frequency, beta, np.asarray(speed))[..., None, None]
    return np.linalg.solve(1j * met * np.eye(2) - A, accelerations[..., None])[..., 0]
