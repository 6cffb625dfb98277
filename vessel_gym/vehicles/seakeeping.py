"""Effects of waves on a ship: the loads of long waves, and the first-order motion that follows.

Angles: beta is the direction in which the waves run less the heading; 0 is a following sea, 180 degrees a head sea
(Fossen 2021, ch. 10).
"""

import numpy as np

from estimators.checks import finite_array, number
from vessel_gym.checks import instance
from vessel_gym.vehicles.corvette import sway_yaw_jacobian
from vessel_gym.vehicles.corvette_equations import COEFFICIENTS, CorvetteParameters
from vessel_gym.waves import GRAVITY, encounter_frequency

SHORT_CREST = 0.15
"""Allowance for the crests' shortness: a share of the side force that comes a quarter of a period later, so that a
sea ahead or astern does not leave a ship entirely alone; assumed."""


def wave_loads(ship: CorvetteParameters, frequency: np.ndarray, beta: np.ndarray, speed: float = 0.0) -> np.ndarray:
    """Sway force [N], yaw and roll moments [N m] per metre of a wave's amplitude ``(..., 3)``, complex.

    On a slender hull held in a wave ``exp(j (w t - k x))``: Froude-Krylov and diffraction forces as in strip theory,
    Salvesen, Tuck & Faltinsen (1970). With the sway velocity and yaw rate ``n_w`` of the water along the hull, its
    mean velocity and gradient at half the draught, they are::

        j w M_body n_w + j w_e M_added n_w + D(U) n_w

    The wave's pressure accelerates the ship as it accelerates the water that she displaces; added mass and damping act
    on the motion relative to the water. In waves much longer than the ship she therefore moves as the water does.

    The roll moment about the centre of gravity is the righting moment for the slope of the waves: in long ones the ship
    lies along the surface, Froude (1861). The moment of her motion relative to the water is left out.

    Args:
        ship: Parameters.
        frequency: Of the wave [rad/s].
        beta: Where it runs to, from the heading on [rad].
        speed: Of the ship [m/s].
    """
    instance("ship of wave_loads", ship, CorvetteParameters)
    frequency, beta, speed = _checked(frequency, beta, speed)
    frequency, beta = np.broadcast_arrays(frequency, beta)
    k, met = frequency**2 / GRAVITY, encounter_frequency(frequency, beta, np.asarray(speed))
    X = 0.5 * k * ship.length * np.cos(beta)  # phase between amidships and the end
    even = np.sinc(X / np.pi)
    small = np.abs(X) < 1e-3
    safe = np.where(small, 1.0, X)
    odd = np.where(small, X / 3.0, np.sin(safe) / safe**2 - np.cos(safe) / safe)
    side = (np.sin(beta) + 1j * SHORT_CREST) * np.exp(-0.5 * k * ship.draught)
    water = frequency[..., None] * np.stack([side * even, -6j / ship.length * side * odd], -1)
    inertia, body, damping = sway_yaw_matrices(ship, speed)
    accelerated = 1j * (frequency[..., None] * (water @ body.T) + met[..., None] * (water @ (inertia - body).T))
    roll = 1j * ship.mass * GRAVITY * ship.stiffness * k * side * even
    return np.concatenate([accelerated + water @ damping.T, roll[..., None]], -1)


def wave_response(ship: CorvetteParameters, frequency: np.ndarray, beta: np.ndarray, speed: float) -> np.ndarray:
    """First-order sway velocity [m/s] and yaw rate [rad/s] per metre of a wave's amplitude ``(..., 2)``, complex.

    Of the ship that goes straight on, linearised: no pole at an encounter frequency of 0. Superposed on manoeuvring,
    Fossen (2021), ch. 10. Arguments as `wave_loads`.
    """
    instance("ship of wave_response", ship, CorvetteParameters)
    frequency, beta, speed = _checked(frequency, beta, speed)
    inertia, body, damping = sway_yaw_matrices(ship, speed)
    met = encounter_frequency(frequency, beta, np.asarray(speed))[..., None, None]
    moving = damping + speed * np.outer(body[:, 0], [0.0, 1.0])  # with the Coriolis force of the ship's own mass
    loads = wave_loads(ship, frequency, beta, speed)[..., :2]
    return np.linalg.solve(1j * met * inertia + moving, loads[..., None])[..., 0]


def _checked(frequency: object, beta: object, speed: object) -> tuple[np.ndarray, np.ndarray, float]:
    """Finite numbers, of which frequencies are not negative."""
    frequency, beta = finite_array("frequency", frequency, "..."), finite_array("beta", beta, "...")
    if (frequency < 0.0).any():
        raise ValueError("frequency of waves must be at least 0 [rad/s]")
    return frequency, beta, number("speed", speed, what="a finite number")


def sway_yaw_matrices(ship: CorvetteParameters, speed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inertia of sway and yaw with added mass and without, and damping at a ``speed`` [m/s], ``(2, 2)`` each."""
    c = dict(zip(COEFFICIENTS, ship.vector(), strict=True))
    inertia = np.array([[c["sway_inertia"], c["sway_yaw_inertia"]], [c["yaw_sway_inertia"], c["yaw_inertia"]]])
    turning = ship.mass * ((ship.yaw_radius * ship.length) ** 2 + ship.x_g**2)
    body = np.array([[ship.mass, c["mass_x_g"]], [c["mass_x_g"], turning]])
    A, _ = sway_yaw_jacobian(np.array([speed, 0.0, 0.0]), np.array(0.0), ship)
    return inertia, body, -inertia @ A - speed * np.outer(body[:, 0], [0.0, 1.0])
