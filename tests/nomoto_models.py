"""Nomoto's model of how a ship steers, from a record of a trial or from the equations of motion.

Maintainers hold the ships that come with the package against published figures with it. Source: Nomoto, Taguchi,
Honda & Hirano (1957), On the steering qualities of ships.
"""

from dataclasses import dataclass, replace

import numpy as np

from vessel_gym.vehicles.corvette import sway_yaw_jacobian
from vessel_gym.vehicles.corvette_equations import CorvetteParameters


@dataclass(frozen=True)
class Nomoto:
    """Nomoto's model ``r / delta = K (1 + T3 s) / ((1 + T1 s) (1 + T2 s))``, made non-dimensional with L and U.

    ``K' = K L / U`` and ``T' = T U / L``; ``T = T1 + T2 - T3`` is the time constant of the first-order model with
    the same response to slow helm.
    """

    K: float
    T: float
    T1: float | None  # the longer of the two; None both where the two modes are not plain decays or growths
    T2: float | None
    T3: float


def nomoto_fit(time: np.ndarray, rudder: np.ndarray, yaw_rate: np.ndarray, speed: float, length: float) -> Nomoto:
    """The second-order Nomoto model of a record, by least squares.

    A rudder that moves linearly between samples makes the sampled model exactly
    ``r[k+1] = a1 r[k] + a2 r[k-1] + b0 d[k+1] + b1 d[k] + b2 d[k-1]`` (first-order hold), which is linear in its
    five numbers. K is its gain at zero frequency and T the slope there:
    ``G(s) = K (1 - T s + ...)``.

    For simulated records: noise in the yaw rate biases least squares. Small helm only: cross-flow drag takes
    1.5 % off K' and 3 % off T' of the corvette at a quarter of a degree, and four times that at one degree.

    Args:
        time: ``(k,)`` equally spaced [s].
        rudder: ``(k,)`` [rad].
        yaw_rate: ``(k,)`` [rad/s].
        speed: U [m/s], to make the figures non-dimensional.
        length: L [m], likewise.

    Raises:
        ValueError: for a record that does not determine the model: unevenly sampled, too short, or at rest.
    """
    d, r = rudder, yaw_rate
    if len(time) < 8 or not np.allclose(np.diff(time), time[1] - time[0], rtol=1e-6, atol=0.0):
        raise ValueError("the record must be equally spaced in time, with eight samples or more")
    h = float(time[1] - time[0])
    columns = np.stack([r[1:-1], r[:-2], d[2:], d[1:-1], d[:-2]], -1)
    size = np.abs(columns).max(0)
    if not size.all():
        raise ValueError("the record must contain a turn: rudder or yaw rate is zero throughout")
    scaled, _, rank, _ = np.linalg.lstsq(columns / size, r[2:], rcond=1e-13)
    if rank < 5:
        raise ValueError("the helm of this record is too simple to tell the model's five numbers apart")
    a1, a2, b0, b1, b2 = scaled / size
    rest, gain = 1.0 - a1 - a2, b0 + b1 + b2
    T = h * ((1.0 + a2) / rest - (b0 - b2) / gain)
    poles = np.roots([1.0, -a1, -a2])
    if np.isreal(poles).all() and (poles > 0.0).all():
        T1, T2 = sorted((-h / np.log(poles.real)).tolist(), key=abs, reverse=True)
        total = T1 + T2
    else:
        T1 = T2 = None
        total = float(np.sum(-h / np.log(poles.astype(complex))).real)
    return _nondimensional(gain / rest, T, T1, T2, total - T, speed, length)


def nomoto_linear(ship: CorvetteParameters, speed: float | None = None) -> Nomoto:
    """The same figures from the true equations linearised on the straight course.

    Args:
        ship: Parameters.
        speed: [m/s]; None: the service speed.
    """
    speed = ship.speed if speed is None else speed
    ship = replace(ship, speed=speed, resistance=ship.resistance * (speed / ship.speed) ** 2)
    A, B = sway_yaw_jacobian(np.array([speed, 0.0, 0.0]), np.array(0.0), ship)
    # r(s) / delta(s) = (b2 s + a21 b1 - a11 b2) / (s^2 - tr s + det)
    determinant, trace = np.linalg.det(A), np.trace(A)
    numerator = A[1, 0] * B[0, 0] - A[0, 0] * B[1, 0]
    T3, total = B[1, 0] / numerator, -trace / determinant
    poles = np.linalg.eigvals(A)
    T1 = T2 = None
    if np.isreal(poles).all():
        T1, T2 = sorted((-1.0 / poles.real).tolist(), key=abs, reverse=True)
    return _nondimensional(numerator / determinant, total - T3, T1, T2, T3, speed, ship.length)


def _nondimensional(
    K: float, T: float, T1: float | None, T2: float | None, T3: float, speed: float, length: float
) -> Nomoto:
    unit = length / speed
    return Nomoto(
        K=float(K * unit),
        T=float(T / unit),
        T1=None if T1 is None else float(T1 / unit),
        T2=None if T2 is None else float(T2 / unit),
        T3=float(T3 / unit),
    )
