"""A sea for turning ships: waves by frequency and angle of encounter, wind, drift and a current."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from math import factorial
from typing import Any

import numpy as np

from estimators.angles import ahead_and_aside
from estimators.engine import along, compiled, sincos
from vessel_gym.checks import check_numbers, instance
from vessel_gym.disturbances.spectrum import WaveSpectrum
from vessel_gym.disturbances.wave_response import TabledResponse, WaveResponse
from vessel_gym.disturbances.waves import InWaves, Sea, WaveBands, WaveField
from vessel_gym.processes import Process, integrated, interpolated
from vessel_gym.vehicles.corvette_equations import (
    AROUND,
    STATE,
    CorvetteParameters,
    corvette_rates,
)
from vessel_gym.vehicles.seakeeping import StripTheory, encounter_frequency, wind_loads
from vessel_gym.vehicles.simulated import root
from vessel_gym.vehicles.vehicle import GRAVITY

_REFLECTED = 0.25  # share of the waves' energy that a ship abeam reflects; assumed
_ODD = 1, 3, 5  # orders of the Fourier series of the drift force
# rad, least yaw increment that filters assume: half a compass' noise, the least that is observable
_LEAST = 1e-3


@compiled
@dataclass(frozen=True, eq=False)
class Seaway(InWaves):
    """Disturbance of a ship that turns in a sea: first-order wave motion, wind, drift and current.

    The waves are a `WaveField` of a `WaveSpectrum`. The ship meets a wave at the frequency
    ``w - k U cos(beta)``, which is zero or negative if the ship overtakes it, and responds by a yaw
    rate and a sway velocity: those of `StripTheory`, or of a `WaveResponse` of your own hull.
    They are superposed on manoeuvring (Fossen 2021, ch. 10): the yaw rate turns the heading, and
    the sway velocity shifts the track. The roll moment acts on the ship. Wind (Blendermann 1994, a
    destroyer) and the drift of reflected waves (Faltinsen 1990) push it to leeward, which
    positions cannot distinguish from a current.

    The current carries the ship and the waves, whose field is at rest in the water. The wind is
    given relative to the ground. Its force follows from the wind relative to the ship, which the
    current carries. The water is deep.

    `effect` and `effect_at` return eight components ``(..., 8)``: yaw increment [rad], current
    north and east [m/s], surge and sway force [N], yaw and roll moment [N m], and sway velocity by
    waves [m/s].

    Raises:
        ValueError: for a number out of range, or a response that lacks frequencies at which the
            sea has energy.
        TypeError: for a ship that is no `CorvetteParameters`, a spectrum that is no `WaveSpectrum`,
            or a response that is no `WaveResponse`.
    """

    ship: CorvetteParameters
    spectrum: WaveSpectrum
    wind: float  # speed over ground, m/s
    current: float  # RMS speed, m/s
    dt: float
    wind_direction: float = 0.0  # direction to which the wind blows, rad from north
    current_time: float = 1000.0  # s
    response: WaveResponse | None = None  # of the ship to waves; None: strip theory

    names = ("current north", "current east", "water north", "water east")
    forces = ("yaw increment", *AROUND)
    assumed_as = "unknown-input"
    averaged = ("roll moment", "wave sway")
    scale = (1.0, 1.0, 1.0, 1.0)  # m/s and m

    def __post_init__(self) -> None:
        instance("ship of Seaway", self.ship, CorvetteParameters)
        instance("spectrum of Seaway", self.spectrum, WaveSpectrum)
        check_numbers(
            "a seaway", vars(self), positive="dt current_time", not_negative="wind current",
            direction="wind_direction",
        )  # fmt: skip
        if self.response is not None:
            instance("response of Seaway", self.response, WaveResponse)
            low, high = self.spectrum.frequency_at(np.array([0.01, 0.99]))
            own = self.response.frequency
            if low < own[0] or high > own[-1]:
                raise ValueError(
                    f"response of Seaway must have frequencies from {low:.3g} to {high:.3g} rad/s,"
                    f" where the sea has energy, got {own[0]:.3g} to {own[-1]:.3g}"
                )

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Current, and distances [m] by which it has carried the water north and east."""
        return integrated(self._current, (0, 1), self.dt)

    @cached_property
    def _current(self) -> Process:
        sd = self.current / np.sqrt(2.0)
        return Process.wandering((sd, sd), self.current_time, self.dt)

    def yaw_rate(self, heading: np.ndarray, speed: float, dt: float = 0.0) -> np.ndarray:
        """RMS of the yaw rate by waves ``(...)`` [rad/s], over frequencies and directions.

        Args:
            heading: Heading of the ship [rad].
            speed: Speed of the ship [m/s].
            dt: Time [s] over which the rate is averaged.
        """
        w, directions, energy = self.spectrum.cells
        beta = directions - np.asarray(heading)[..., None, None]
        yaw = np.abs(self.mean_motion(w, beta, speed, dt)[..., 1])
        return np.sqrt((energy * yaw**2).sum((-2, -1)))

    def mean_motion(
        self, frequency: np.ndarray, beta: np.ndarray, speed: float, dt: float
    ) -> np.ndarray:
        """Complex sway velocity, yaw rate and roll moment ``(..., 3)``, means over a time.

        Args:
            frequency: Frequency of the waves [rad/s].
            beta: Direction of the waves relative to the heading [rad].
            speed: Speed of the ship [m/s].
            dt: Coming time [s] over which the motion is averaged.
        """
        half = 0.5 * dt * encounter_frequency(frequency, beta, speed)
        mean = np.sinc(half / np.pi) * np.exp(1j * half)
        return mean[..., None] * self.hull.motion(frequency, beta, speed)

    @cached_property
    def believed(self) -> Sea:  # type: ignore[override]
        """Default assumption of filters, a `Sea` whose current includes the leeway.

        The variance of its yaw rate is the mean over all headings, which does not depend on how the
        waves are spread.
        """
        w = self.spectrum.frequency_at((np.arange(200)[:, None] + 0.5) / 200.0)
        yaw = self.mean_motion(w, _AROUND, 0.8 * self.ship.speed, self.dt)[..., 1]
        wave = 0.25 * self.spectrum.height * np.sqrt((np.abs(yaw) ** 2).mean())
        return Sea(
            wave=max(float(wave), _LEAST / self.dt), peak=2.0 * np.pi / self.spectrum.period,
            gust=0.0, current=float(np.hypot(self.current, self.leeway)), current_time=100.0,
            dt=self.dt,
        )  # fmt: skip

    @cached_property
    def modelled(self) -> "BandedSeaway":  # type: ignore[override]
        """The sea that replaces this one in a filter's model: waves in frequency bands."""
        return BandedSeaway(*(getattr(self, each.name) for each in fields(Seaway)))

    @cached_property
    def input_sd(self) -> tuple[float, ...]:  # type: ignore[override]
        """Standard deviation of the yaw increment over all headings."""
        return (self.dt * self.believed.wave,)

    @cached_property
    def leeway(self) -> float:
        """Speed [m/s] of `steady_sway` with the wind abeam."""
        return float(abs(self.steady_sway(np.array(self.wind_direction + 0.5 * np.pi))))

    def steady_sway(self, heading: np.ndarray) -> np.ndarray:
        """Sway velocity ``(...)`` [m/s] of the ship on steady headings ``(...)`` [rad].

        Wind and drift act on the ship, in water at rest. Rudder and surge speed are those of the
        equilibrium.
        """

        def accelerations(balance: np.ndarray, heading: np.ndarray) -> np.ndarray:
            """Surge, sway and yaw; ``balance``: rudder [rad], relative surge and sway."""
            state = np.zeros((*balance.shape[:-1], len(STATE)))
            state[..., 2:3], state[..., 3:5] = heading, balance[..., 1:] * self.ship.speed
            around = self.effect(np.zeros_like(state), state)[..., 1:]
            rates = corvette_rates(state, balance[..., :1], around, self.ship.vector())
            return rates[..., 3:6] * [1.0, 1.0, self.ship.length]

        guess = np.broadcast_to([0.0, 1.0, 0.0], (*heading.shape, 3))
        return root(accelerations, guess, heading[..., None])[..., 2] * self.ship.speed

    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Constants of an episode's waves ``(..., 5 n)``.

        They are those of `WaveField.draw`, and the constant of the ship's response by frequency.
        """
        drawn = self.waves.draw(uniforms)
        of_ship = along(lambda w: [self.hull.frequency_constant(w)], self.waves.constants(drawn)[0])
        return np.concatenate([drawn, *of_ship], -1)

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Components ``(..., 8)`` of the effect, see `Seaway`, without waves."""
        none = np.zeros_like(state[..., 0])
        return self._acting((none, none, none), z[..., :2], state)

    @compiled(axes=(1, 0, 1, 1))
    def effect_at(
        self, drawn: np.ndarray, time: np.ndarray, z: np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Components ``(..., 8)`` of the effect, see `Seaway`, in an episode's waves.

        Yaw increment and sway velocity of the waves are means over the coming step, so that the
        heading swings as far as in continuous time. If a step is a large part of the waves' period,
        these means are smaller than momentary values. The roll moment is constant over a step,
        which reduces a wave's effect by the factor ``sinc(w_e dt / 2)``. The moment is therefore
        that in the middle of the step, divided by this factor, and the roll is as large as in
        continuous time.
        """
        x, y, psi, u = np.moveaxis(state[..., :4], -1, 0)
        moved, (sin_psi, cos_psi) = self.hull.at(u), sincos(psi)
        north, east = x - z[..., 2], y - z[..., 3]

        def in_step(w: Any, kx: Any, ky: Any, phase: Any, of_ship: Any) -> list[Any]:
            ahead, abeam = kx * cos_psi + ky * sin_psi, ky * cos_psi - kx * sin_psi
            met = w - ahead * u
            half = 0.5 * self.dt * met  # half of the phase in a step
            mean = _mean(half)
            sin, cos = sincos(phase + half)
            sway, yaw, roll = moved(w, of_ship, ahead, abeam, met, (cos, sin))
            return [mean * sway, mean * yaw, _held(mean) * roll]

        of_ship = drawn[..., 4 * WaveField.components :]
        total = self.waves.superposition(in_step, drawn, time, north, east, of_ship)
        return self._acting(total, z[..., :2], state)

    def _acting(
        self, motion: Sequence[np.ndarray], current: np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Yaw increment, and flow and loads `AROUND` the ship.

        The motion is the waves' sway velocity, yaw rate and roll moment.
        """
        psi, u, v = np.moveaxis(state[..., 2:5], -1, 0)
        sin_mu, cos_mu = sincos(self.wind_direction)
        north, east = self.wind * cos_mu - current[..., 0], self.wind * sin_mu - current[..., 1]
        ahead, aside = ahead_and_aside(north, east, psi)
        surge_force, side_force, turning = wind_loads(self.ship, ahead - u, aside - v)
        sway, yaw, roll = motion
        return np.stack([
            self.dt * yaw, current[..., 0], current[..., 1], surge_force,
            side_force + self._drift(psi), turning, roll, sway,
        ], -1)  # fmt: skip

    def _drift(self, psi: np.ndarray) -> np.ndarray:
        """Sway force [N] of the waves that the ship reflects ``(...)``, at a heading [rad].

        A wave pushes by ``sin(beta) |sin(beta)|``, of which three terms of the Fourier series are
        kept.
        """
        total = np.zeros_like(psi)
        for order, moment in zip(_ODD, self._reflected, strict=True):
            sin, cos = sincos(order * psi)
            total = total + (moment.imag * cos - moment.real * sin)
        return total

    @cached_property
    def _reflected(self) -> list[complex]:
        """Moments [N] of the reflected energy's directions, of the orders `_ODD`.

        A part that rounds to 0 in some seas is made tiny instead, since programs of different
        numbers share their machine code, but a 0 is a constant of that code.
        """
        _, directions, energy = self.spectrum.cells
        by_energy = self.ship.water_density * GRAVITY * self.ship.length * _REFLECTED
        return [
            -8.0 / (np.pi * m * (m * m - 4)) * by_energy
            * (energy.sum(0) * np.exp(1j * m * directions)).sum()
            + m * 1e-300j
            for m in _ODD
        ]  # fmt: skip

    @cached_property
    def hull(self) -> StripTheory:
        """Response of the ship to waves."""
        if self.response is None:
            return StripTheory(self.ship)
        return TabledResponse(self.ship, self.response)


@compiled
@dataclass(frozen=True, eq=False)
class BandedSeaway(Seaway):
    """A filter's model of a `Seaway`, with `WaveBands` as the ship meets them.

    The response to both waves of a frequency band has the power of all waves in the band. The
    phases are those at the ship and turn as it moves. The ship's motion therefore changes the
    frequency of encounter, but the waves give no position. With phases at a fixed place, the filter
    would infer positions from waves, although it can predict waves for only half a minute.
    """

    names = (*WaveBands.names, "current north", "current east")  # type: ignore[assignment]
    uniforms = 0
    modelled = scale = None  # type: ignore[assignment]

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Rotating waves, then the current."""
        return Process.joined(self.bands.process(self.dt), self._current)

    def loadings(self, heading: np.ndarray, speed: float) -> np.ndarray:
        """Complex response ``(4, ..., 3)`` to a unit of each wave, averaged over the coming step.

        The first axis is the waves of the bands. The last axis is sway velocity [m/s], yaw rate
        [rad/s] and roll moment [N m].

        Args:
            heading: Heading of the ship [rad].
            speed: Speed of the ship [m/s].
        """

        def of_waves(w: np.ndarray, direction: np.ndarray) -> np.ndarray:
            w, direction = (
                each.reshape((-1,) + np.ndim(heading) * (1,)) for each in (w, direction)
            )
            return self.mean_motion(w, direction - heading, speed, self.dt)

        return self.bands.loadings(of_waves)

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Components ``(..., 8)`` of the effect, see `Seaway`, in the waves of the bands."""
        turn, speed = state[..., 2] / (2.0 * np.pi), state[..., 3]
        slowest, fastest = _TABLED[[0, -1]] * self.ship.speed
        share = np.clip((speed - slowest) / (fastest - slowest), 0.0, 1.0)
        heading = (turn - np.floor(turn)) * _HEADINGS
        response = interpolated(self._table, share * (len(_TABLED) - 1.0), heading)
        total = [np.zeros_like(speed)] * 3
        for wave in range(len(WaveBands.names) // 2):
            real, imaginary = z[..., 2 * wave], z[..., 2 * wave + 1]
            own = [response[..., 6 * wave + k] for k in range(6)]
            total = [total[k] + (own[k] * real - own[k + 3] * imaginary) for k in range(3)]
        return self._acting(total, z[..., -2:], state)

    def met(self, z: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """State with the waves' phases at the place of the ship after a step through the water."""
        north, east = ((after - before)[..., i] - self.dt * z[..., i - 2] for i in range(2))
        parts = self.bands.at(z, north, east)
        return np.stack([*(each for part in parts for each in part), z[..., -2], z[..., -1]], -1)

    @cached_property
    def _table(self) -> np.ndarray:
        """Real and imaginary parts of `loadings` ``(speeds, headings, waves * 6)`` on a grid."""
        heading = np.linspace(0.0, 2.0 * np.pi, _HEADINGS + 1)
        response = np.stack([self.loadings(heading, speed) for speed in _TABLED * self.ship.speed])
        parts = np.moveaxis(np.concatenate([response.real, response.imag], -1), 1, 2)
        return parts.reshape(*parts.shape[:2], -1)


def _held(mean: np.ndarray) -> np.ndarray:
    """Factor on a roll moment that is constant over a step, from `_mean`.

    The factor is ``1 / mean`` up to half a wave a step. Steps would alias faster waves into slow
    ones; so the factor falls to 0 at two thirds of a wave a step.
    """
    half_a_wave, last = 2.0 / np.pi, np.sin(2.0 * np.pi / 3.0) / (2.0 * np.pi / 3.0)
    share = np.minimum(np.maximum((mean - last) * (1.0 / (half_a_wave - last)), 0.0), 1.0)
    return share / np.maximum(mean, half_a_wave)


def _mean(half: np.ndarray) -> np.ndarray:
    """Mean of a wave over +-``half`` [rad] of phase: ``sin(half) / half``, and 0 from pi on."""
    square = np.minimum(half * half, np.pi**2)
    total = np.zeros_like(square)
    for i in range(9, -1, -1):  # Taylor's series, to 2e-10
        total = total * square + (-1.0) ** i / factorial(2 * i + 1)
    return total


_TABLED, _HEADINGS = np.linspace(0.25, 1.25, 21), 120
"""Tabled speeds in units of the service speed, and number of tabled headings."""
_AROUND = 2.0 * np.pi / 72.0 * np.arange(72.0)
"""Directions around the ship [rad]."""
