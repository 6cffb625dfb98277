"""Response of your own hull to waves, from a table of complex amplitudes."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from estimators.checks import finite_array, frozen
from vessel_gym.processes import interpolated
from vessel_gym.vehicles.seakeeping import Motion, StripTheory, complex_motion
from vessel_gym.vehicles.vehicle import GRAVITY

_TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class WaveResponse:
    """First-order motion of a hull in waves, by frequency, direction and speed.

    The amplitudes are those for a wave ``exp(j (w t - k x))`` of 1 m, which has its crest amidships
    at t = 0. The motion is the real part of ``amplitude exp(j w_e t)`` with the frequency of
    encounter w_e. Axes are those of the ship: x forward, y to starboard, z down. The sway velocity
    and yaw rate are those of a ship that is free to sway and yaw. The roll moment acts about the
    centre of gravity of this ship while it is upright.

    One speed is enough: `TabledResponse` says what holds between the speeds, and beyond them.

    Attributes:
        frequency: Increasing frequencies of the waves ``(f,)`` [rad/s], not of encounter, from
            0.001 up.
        direction: Directions ``(d,)`` [rad] to which waves run minus the heading, in regular steps
            from 0, a following sea, to pi. The hull is symmetric: the motion in waves from the
            other side is the negative.
        speed: Increasing speeds of the ship ``(s,)`` [m/s].
        sway: Complex sway velocities ``(f, d, s)`` [m/s] per metre of amplitude.
        yaw: Complex yaw rates ``(f, d, s)`` [rad/s] per metre of amplitude.
        roll: Complex roll moments ``(f, d, s)`` [N m] per metre of amplitude.

    Raises:
        ValueError: for frequencies or speeds that are too low or do not increase, directions other
            than those above, and amplitudes that are not complex, not finite or of another shape.
    """

    frequency: np.ndarray
    direction: np.ndarray
    speed: np.ndarray
    sway: np.ndarray
    yaw: np.ndarray
    roll: np.ndarray

    def __post_init__(self) -> None:
        values = {
            "frequency": _increasing("frequency", self.frequency, 1e-3),
            "direction": _half_circle(self.direction),
            "speed": _increasing("speed", self.speed, 0.0),
        }
        shape = tuple(map(len, values.values()))
        for name in ("sway", "yaw", "roll"):
            values[name] = _amplitudes(name, getattr(self, name), shape)
        vars(self).update({name: frozen(array) for name, array in values.items()})


@dataclass(frozen=True, eq=False)
class TabledResponse(StripTheory):
    """A `WaveResponse` of a ship, whose own equations give the effect of its speed.

    The motion depends much on the speed: that of the corvette at rest has from 0.55 to 1.34 times
    the RMS yaw rate at 15.4 m/s, by direction of a moderate sea. It also has a sharp peak where the
    frequency of encounter is near 0. Therefore the equations of `StripTheory` reduce the table to a
    response at rest, which is interpolated linearly in real and imaginary parts, and lead back from
    it. At its entries the table is reproduced. Between its speeds and beyond them the effect of the
    speed is that of strip theory. If the table is that of a ship at rest, which a panel method
    gives, this holds at all speeds.
    """

    response: WaveResponse

    @cached_property
    def _table(self) -> np.ndarray:
        """Real and imaginary parts of responses at rest ``(f, 2 d - 1, s, 6)`` from -pi to pi."""
        given = self.response
        w, speed = given.frequency[:, None, None, None], given.speed[:, None]
        ahead = w**2 / GRAVITY * np.cos(given.direction)[:, None, None]
        under_way, units = self._under_way(speed), np.eye(3)
        answers = complex_motion(
            lambda *n: under_way(ahead, w - ahead * speed, *np.multiply.outer(n, units))
        )
        motion = np.stack([given.sway, given.yaw, given.roll], -1)
        at_rest = np.linalg.solve(answers.mT, motion[..., None])[..., 0]
        around = np.concatenate([-at_rest[:, :0:-1], at_rest], 1)
        return np.concatenate([around.real, around.imag], -1)

    def frequency_constant(self, frequency: np.ndarray) -> np.ndarray:
        """Index ``(...)`` of frequencies [rad/s] among those of the table."""
        return _index(self.response.frequency, frequency)

    def _under_way(self, speed: np.ndarray) -> Callable[..., list[Any]]:
        """Function that adds the effect of speeds ``(...)`` [m/s] to a response at rest n.

        Its arguments are the wave number along the hull [1/m], the frequency of encounter [rad/s],
        and real and imaginary parts of n. It returns the real part of the response.
        """
        (p_M, q_M, s), damped, inert = self.effect_of_speed(speed)

        def moved(ahead: Any, met: Any, real: Any, imaginary: Any) -> list[Any]:
            c_real = -real[1] - ahead * imaginary[0], -ahead * imaginary[1]
            c_imaginary = ahead * real[0] - imaginary[1], ahead * real[1]
            p, q = p_M - s * met * met, q_M * met
            over = speed / (p * p + q * q)
            answer = list(real)
            for i, (m, n) in enumerate(zip(damped, inert, strict=True)):
                above = _dot(m, c_real) - met * _dot(n, c_imaginary)
                across = _dot(m, c_imaginary) + met * _dot(n, c_real)
                answer[i] = answer[i] + (above * p + across * q) * over
            return answer

        return moved

    def at(self, speed: np.ndarray) -> Motion:
        """`Motion` of the ship at speeds ``(...)`` [m/s]."""
        under_way, speeds = self._under_way(speed), _index(self.response.speed, speed)

        def moved(
            w: Any, row: Any, ahead: Any, abeam: Any, met: Any, wave: tuple[Any, Any]
        ) -> list[Any]:
            turns = np.arctan2(abeam, ahead) / _TURN + 0.5
            place = (turns - np.floor(turns)) * (self._table.shape[1] - 1.0)
            parts = interpolated(self._table, row, place, speeds)
            real = [parts[..., k] * wave[0] - parts[..., k + 3] * wave[1] for k in range(3)]
            imaginary = [parts[..., k] * wave[1] + parts[..., k + 3] * wave[0] for k in range(2)]
            return under_way(ahead, met, real, imaginary)

        return moved


def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1]


def _index(table: np.ndarray, value: Any) -> Any:
    """Place of values among increasing numbers, for `interpolated`."""
    return np.interp(value, table, np.arange(len(table)))


def _increasing(name: str, given: object, least: float) -> np.ndarray:
    values = finite_array(f"{name} of WaveResponse", given, name[0])
    if not len(values) or values[0] < least or (np.diff(values) <= 0.0).any():
        raise ValueError(f"{name} of WaveResponse must be numbers from {least:g} up that increase")
    return values


def _half_circle(given: object) -> np.ndarray:
    """Directions in regular steps from 0 to pi."""
    values = finite_array("direction of WaveResponse", given, "d")
    regular = np.linspace(0.0, np.pi, len(values))
    if len(values) < 3 or not np.allclose(values, regular, atol=1e-3):
        raise ValueError("direction of WaveResponse must go in regular steps from 0 to pi [rad]")
    return regular


def _amplitudes(name: str, given: Any, shape: tuple[int, ...]) -> np.ndarray:
    values = np.ma.filled(given, np.nan)
    if values.shape != shape or values.dtype.kind != "c":
        raise ValueError(
            f"{name} of WaveResponse must be complex of shape {shape}, frequencies by directions by"
            f" speeds, got {values.dtype} of shape {values.shape}"
        )
    if not np.isfinite(values).all():
        raise ValueError(f"{name} of WaveResponse must be finite")
    return values
