"""Effects of waves and wind on a ship: loads of long waves, first-order motion, and wind loads.

The angle beta is the direction of the waves minus the heading; 0 is a following sea, 180 degrees a
head sea (Fossen 2021, ch. 10).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from estimators.engine import sincos
from vessel_gym.processes import interpolated
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.vehicle import GRAVITY

_AIR_DENSITY = 1.224  # kg/m3
Motion = Callable[..., list[Any]]
"""Momentary sway velocity [m/s], yaw rate [rad/s] and roll moment [N m] ``(...)`` in a wave.

Arguments are the frequency of the wave [rad/s], its constant by `StripTheory.frequency_constant`,
its wave numbers along the hull ``k cos(beta)`` and across it ``k sin(beta)`` [1/m], the frequency
of encounter [rad/s], and the elevation of the surface amidships [m], real and imaginary part.
"""


def encounter_frequency(frequency: np.ndarray, beta: np.ndarray, speed: float) -> np.ndarray:
    """Frequency of encounter [rad/s]; negative if the ship overtakes the waves.

    Args:
        frequency: Frequency of the waves [rad/s].
        beta: Direction of the waves relative to the heading [rad].
        speed: Speed of the ship [m/s].
    """
    return frequency - frequency**2 * speed * np.cos(beta) / GRAVITY


def wind_loads(
    ship: CorvetteParameters, along: np.ndarray, across: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Surge and sway force [N] and yaw moment [N m] ``(...)`` of the wind relative to a ship.

    Coefficients of a destroyer by Blendermann (1994).

    Args:
        ship: Parameters of the ship.
        along: Relative wind to the bow [m/s].
        across: Relative wind to starboard [m/s].
    """
    frontal = ship.frontal_area or 0.82 * ship.beam**2
    lateral = ship.lateral_area or 0.083 * ship.length**2
    angle = np.abs(np.arctan2(-across, -along))  # between the bow and the wind's origin
    front = np.where(angle < 0.5 * np.pi, 0.60, 0.65)
    sin_angle, cos_angle = sincos(angle)
    sin_twice = 2.0 * sin_angle * cos_angle
    shape = 1.0 - 0.5 * 0.65 * (1.0 - front * frontal / lateral / 0.85) * sin_twice * sin_twice
    pressure = 0.5 * _AIR_DENSITY * (along * along + across * across)
    side = 0.85 * sin_angle / shape * np.where(across > 0.0, 1.0, -1.0) * pressure * lateral
    moment = side * (1.04 * ship.length) * 0.18 * (0.5 * np.pi - angle)
    return -pressure * frontal * front * cos_angle / shape, side, moment


def sway_yaw_matrices(
    ship: CorvetteParameters, speed: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inertia of sway and yaw with and without added mass, and M, each ``(2, 2)``.

    M is the damping at a ``speed`` [m/s], with the Coriolis force of the ship's own mass.
    """
    c = ship.values()
    inertia = np.array([[c.sway_inertia, c.sway_yaw_inertia], [c.yaw_sway_inertia, c.yaw_inertia]])
    turning = ship.mass * ((ship.yaw_radius * ship.length) ** 2 + ship.x_g**2)
    body = np.array([[ship.mass, c.mass_x_g], [c.mass_x_g, turning]])
    # at rest a rudder without a race has no derivative, as its inflow has no direction
    slopes = ship.jacobian(np.array([max(speed, 1e-100), 0.0, 0.0, 0.0]))
    return inertia, body, -inertia @ slopes[1:, 1:3]


def complex_motion(moved: Callable[[float, float], Any]) -> np.ndarray:
    """Complex amplitudes ``(..., 3)`` of a motion that is linear in a complex number.

    Args:
        moved: Real parts ``(...)`` of the motion, as a function of the number's real and imaginary
            part.
    """
    real, turned = (
        np.stack(np.broadcast_arrays(*moved(*number)), -1) for number in ((1.0, 0.0), (0.0, 1.0))
    )
    return real - 1j * turned


@dataclass(frozen=True, eq=False)
class StripTheory:
    """Linear, first-order motion of a ship on a straight course in waves.

    The motion is superposed on manoeuvring, Fossen (2021), ch. 10. It has no pole at an encounter
    frequency of 0. For a directionally unstable ship it is the particular solution at the frequency
    of encounter; the growing free motion is part of manoeuvring.

    A ship at rest moves as the water along its hull does: its mean velocity and gradient at half
    the draught, ``n = (even, -j odd)`` in a wave ``exp(j (w t - k x))``. The roll moment about the
    centre of gravity is the righting moment for the slope of the waves: in long waves the ship
    follows the surface, Froude (1861). The moment of its motion relative to the water is left out.

    Loads on a slender hull that is fixed in the wave are the Froude-Krylov and diffraction forces
    of strip theory, Salvesen, Tuck & Faltinsen (1970), ``j w B n + j w_e A n + D n``: the pressure
    of the wave accelerates the ship like the displaced water (B, inertia of the body), and added
    mass A and damping D act on the motion relative to the water. The ship answers them by ``(M + j
    w_e I)^-1``, where ``I = A + B``, and M is D with the Coriolis force of B at the speed U. Hence
    it moves by ``n + (M + j w_e I)^-1 U B c`` with ``c = (j k cos(beta) n_1 - n_2, j k cos(beta)
    n_2)``. In waves much longer than the ship it moves with the water.
    """

    ship: CorvetteParameters

    @cached_property
    def _moving(self) -> np.ndarray:
        """M by speed ``(26, 4)``: sway force and yaw moment per unit of sway and yaw."""
        speeds = self.ship.speed * _SPEEDS
        return np.array([sway_yaw_matrices(self.ship, speed)[2].ravel() for speed in speeds])

    def motion(self, frequency: np.ndarray, beta: np.ndarray, speed: float) -> np.ndarray:
        """Complex sway velocity [m/s], yaw rate [rad/s] and roll moment [N m] ``(..., 3)``.

        They are per metre of amplitude.

        Args:
            frequency: Frequency of the wave [rad/s].
            beta: Direction of the wave relative to the heading [rad].
            speed: Speed of the ship [m/s].
        """
        k, moved = frequency**2 / GRAVITY, self.at(np.array(speed))
        constant, ahead, abeam = self.frequency_constant(frequency), np.cos(beta), np.sin(beta)
        met = encounter_frequency(frequency, beta, speed)
        return complex_motion(
            lambda *wave: moved(frequency, constant, k * ahead, k * abeam, met, wave)
        )

    def frequency_constant(self, frequency: np.ndarray) -> np.ndarray:
        """Orbital velocity at half the draught by amplitude and wave number [m/s]."""
        decay = np.exp((-0.5 * self.ship.draught / GRAVITY) * frequency * frequency)
        return GRAVITY / frequency * decay

    def effect_of_speed(self, speed: np.ndarray) -> tuple[Any, Any, Any]:
        """Factors of ``(M + j w_e I)^-1 B`` at speeds ``(...)`` [m/s].

        M is interpolated between tabled speeds.

        Returns:
            p, q and s of the determinant ``p - s w_e^2 + j q w_e``, and the adjugates of M and of
            I, each times B.
        """
        place = (len(_SPEEDS) - 1) / _SPEEDS[-1] / self.ship.speed * speed
        table = interpolated(self._moving, np.clip(place, 0.0, len(_SPEEDS) - 1.0))
        M = [[table[..., 2 * i + j] for j in range(2)] for i in range(2)]
        inertia, body, _ = sway_yaw_matrices(self.ship, 0.0)
        (a, b), (c, d) = inertia
        cross = M[0][0] * d + M[1][1] * a - M[0][1] * c - M[1][0] * b
        determinants = M[0][0] * M[1][1] - M[0][1] * M[1][0], cross, a * d - b * c
        return determinants, _adjugate_times(M, body), _adjugate_times(inertia, body)

    def at(self, speed: np.ndarray) -> Motion:
        """`Motion` of the ship at speeds ``(...)`` [m/s]."""
        (p_M, q_M, s), damped, inert = self.effect_of_speed(speed)
        length, righting = self.ship.length, self.ship.mass * self.ship.stiffness

        def moved(
            w: Any, orbital: Any, ahead: Any, abeam: Any, met: Any, wave: tuple[Any, Any]
        ) -> list[Any]:
            side = orbital * abeam  # velocity of the water to the ship's side
            side = side * wave[0], side * wave[1]
            X = 0.5 * length * ahead  # phase between amidships and the end
            safe = np.where(np.abs(X) < 1e-6, 1e-6, X)
            sin, cos = sincos(safe)
            p, q = p_M - s * met * met, q_M * met
            size = p * p + q * q
            over = 1.0 / (safe * size)  # one quotient for both
            inverse = over * size
            even = sin * inverse
            odd = (even - cos) * (X * inverse * inverse) * (6.0 / length)
            scale = speed * (over * safe)
            p, q = p * scale, q * scale
            real, imaginary = ahead * odd, odd + ahead * even
            met_real, met_imaginary = met * real, met * imaginary
            a, b = side[0] * p + side[1] * q, side[1] * p - side[0] * q  # side U / det
            sway, yaw = (
                (m[1] * real - n[0] * met_imaginary) * a - (m[0] * imaginary + n[1] * met_real) * b
                for m, n in zip(damped, inert, strict=True)
            )
            # the righting moment, times g k / w = w
            return [even * side[0] + sway, odd * side[1] + yaw, -righting * w * even * side[1]]

        return moved


_SPEEDS = np.linspace(0.0, 1.25, 26)
"""Tabled speeds in units of the service speed."""


def _adjugate_times(M: Any, B: np.ndarray) -> list[list[Any]]:
    """Adjugate of M times B ``(2, 2)``: the determinant of M, times the inverse of M, times B."""
    return [
        [M[1][1] * B[0, j] - M[0][1] * B[1, j] for j in range(2)],
        [M[0][0] * B[1, j] - M[1][0] * B[0, j] for j in range(2)],
    ]
