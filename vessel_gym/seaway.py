"""A sea for turning ships: waves by frequency and angle of encounter, wind, drift and a current."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from math import factorial

import numpy as np

from estimators.engine import along, compiled, lookup, sincos
from vessel_gym.checks import check_numbers, instance
from vessel_gym.disturbances import Disturbance, Sea
from vessel_gym.processes import Process, integrated
from vessel_gym.vehicles.corvette_equations import AROUND, STATE, CorvetteParameters, corvette_rates
from vessel_gym.vehicles.equilibrium import root
from vessel_gym.vehicles.seakeeping import SHORT_CREST, WaveMotion, wave_loads, wave_response
from vessel_gym.waves import BANDS, GRAVITY, WaveBands, WaveField, encounter_frequency

_AIR_DENSITY = 1.224  # kg/m3
_REFLECTED = 0.25  # share of the waves' energy that a ship abeam reflects; assumed
# rad, least yaw increment that filters assume: half a compass' noise, the least that is observable
_LEAST = 1e-3


@compiled
@dataclass(frozen=True, eq=False)
class Seaway(Disturbance):
    """Disturbance of a ship that turns in a sea: first-order wave motion, wind, drift and current.

    The waves are a `WaveField`. The ship meets them at the frequency ``w - k U cos(beta)``, which
    is zero or negative in following seas, and responds by the yaw rate and the sway velocity of
    `wave_response`. These motions are superposed on manoeuvring (Fossen 2021, ch. 10): the yaw rate
    turns the heading, and the sway velocity shifts the track. The roll moment acts on the ship.
    Wind (Blendermann 1994, a destroyer) and the drift of reflected waves (Faltinsen 1990) push her
    to leeward, which positions cannot distinguish from a current.

    The current carries the ship and the waves, whose field is at rest in the water. The wind is
    given relative to the ground. Its force follows from the wind relative to the ship, which the
    current carries. Waves and wind run to the north, unless ``direction`` is set.

    `effect` and `effect_at` return eight components ``(..., 8)``: yaw increment [rad], current
    north and east [m/s], surge and sway force [N], yaw and roll moment [N m], and sway velocity by
    waves [m/s].

    Raises:
        ValueError: for a number out of range.
        TypeError: for a ship that is no `CorvetteParameters`.
    """

    ship: CorvetteParameters
    height: float  # significant wave height, m
    period: float  # peak period of the spectrum, s
    wind: float  # speed over ground, m/s
    current: float  # RMS speed, m/s
    dt: float
    direction: float = 0.0  # direction to which waves and wind run, rad
    current_time: float = 1000.0  # s

    names = ("current north", "current east", "water north", "water east")
    forces = ("yaw increment", *AROUND)
    assumed_as = "unknown-input"
    averaged = ("roll moment", "wave sway")
    uniforms = WaveField.uniforms
    scale = (1.0, 1.0, 1.0, 1.0)  # m/s and m

    def __post_init__(self) -> None:
        instance("ship of Seaway", self.ship, CorvetteParameters)
        kinds = {
            "positive": "height period dt current_time",
            "not_negative": "wind current",
            "direction": "direction",
        }
        check_numbers("a seaway", vars(self), **kinds)

    @cached_property
    def waves(self) -> WaveField:
        """The wave field alone."""
        return WaveField(self.height, self.period)

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Current, and distances [m] by which it has carried the water north and east."""
        return integrated(self._current, (0, 1), self.dt)

    @cached_property
    def _current(self) -> Process:
        sd = self.current / np.sqrt(2.0)
        return Process.wandering((sd, sd), self.current_time, self.dt)

    def yaw_rate(self, beta: np.ndarray, speed: float, dt: float = 0.0) -> np.ndarray:
        """RMS of the yaw rate in waves ``(...)`` [rad/s].

        Args:
            beta: Direction of the waves relative to the heading [rad].
            speed: Speed of the ship [m/s].
            dt: Time [s] over which the rate is averaged.
        """
        beta = np.asarray(beta)
        w, spectrum = (each.reshape((-1,) + beta.ndim * (1,)) for each in self.waves.spectrum)
        half = 0.5 * dt * encounter_frequency(w, beta, np.asarray(speed))
        yaw = np.sinc(half / np.pi) * np.abs(wave_response(self.ship, w, beta, speed)[..., 1])
        return np.sqrt(np.trapezoid(spectrum * yaw**2, w, axis=0))

    @cached_property
    def believed(self) -> Sea:  # type: ignore[override]
        """Default assumption of filters, a `Sea` whose current includes the leeway.

        The variance of its yaw rate is the mean over all directions of the waves, from either side.
        """
        beta = np.linspace(0.0, np.pi, 37)
        yaw = self.yaw_rate(beta, 0.8 * self.ship.speed, self.dt)
        wave = max(np.sqrt(np.trapezoid(yaw**2, beta) / np.pi), _LEAST / self.dt)
        return Sea(
            wave=float(wave), peak=2.0 * np.pi / self.period, gust=0.0,
            current=float(np.hypot(self.current, self.leeway)), current_time=100.0, dt=self.dt,
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
        """Sway speed [m/s] of the ship on a steady heading, with wind and waves abeam.

        Rudder and surge speed are those of the equilibrium.
        """
        heading, moving = STATE.index("psi"), [STATE.index("u"), STATE.index("v")]

        def accelerations(balance: np.ndarray, _: None) -> np.ndarray:
            """Surge, sway and yaw; ``balance``: rudder [rad], relative surge and sway."""
            state = np.zeros((*balance.shape[:-1], len(STATE)))
            state[..., heading] = self.direction + 0.5 * np.pi
            state[..., moving] = balance[..., 1:] * self.ship.speed
            around = self.effect(np.zeros_like(state), state)[..., 1:]  # in water at rest
            rates = corvette_rates(state, balance[..., :1], around, self.ship.vector())
            return rates[..., 3:6] * [1.0, 1.0, self.ship.length]

        return float(abs(root(accelerations, np.array([0.0, 1.0, 0.0]))[2]) * self.ship.speed)

    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Constants of an episode's waves: frequencies, phases, and velocities.

        Frequencies are in rad/s, phases in rad, and orbital velocities [m/s] are at half the ship's
        draught.
        """
        drawn = self.waves.draw(uniforms)
        w = drawn[..., : WaveField.components]
        velocity = self.waves.amplitude * w * np.exp((-0.5 * self.ship.draught / GRAVITY) * w * w)
        return np.concatenate([drawn, velocity], -1)

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
        sin_mu, cos_mu = sincos(self.direction)
        place = (x - z[..., 2]) * cos_mu + (y - z[..., 3]) * sin_mu
        sin_beta, cos_beta = sincos(self.direction - psi)
        hull = self._hull.at(u)

        def moved(w: np.ndarray, phase: np.ndarray, velocity: np.ndarray) -> list[np.ndarray]:
            k_cos = w * w * cos_beta * (1.0 / GRAVITY)
            met = w - k_cos * u
            half = 0.5 * self.dt * met  # half of the phase in a step
            mean = _mean(half)
            sin, cos = sincos(phase + half)
            side = (
                velocity * (sin_beta * cos - SHORT_CREST * sin),
                velocity * (sin_beta * sin + SHORT_CREST * cos),
            )
            sway, yaw, roll = hull.moved(w, k_cos, met, side)
            return [mean * sway, mean * yaw, _held(mean) * roll]

        waves = *self.waves.phases(drawn, time, place), drawn[..., WaveField.uniforms :]
        total = [each.sum(-1) for each in along(moved, *waves)]
        return self._acting(total, z[..., :2], state)

    def _acting(
        self, motion: Sequence[np.ndarray], current: np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Yaw increment, and flow and loads `AROUND` the ship.

        The motion is the waves' sway velocity, yaw rate and roll moment.
        """
        psi, u, v = np.moveaxis(state[..., 2:5], -1, 0)
        sin_beta, _ = sincos(self.direction - psi)
        sin_mu, cos_mu = sincos(self.direction)
        north, east = self.wind * cos_mu - current[..., 0], self.wind * sin_mu - current[..., 1]
        sin, cos = sincos(psi)
        surge_force, side_force, turning = self._wind(
            north * cos + east * sin - u, east * cos - north * sin - v
        )
        side = side_force + self._drift * sin_beta * np.abs(sin_beta)
        sway, yaw, roll = motion
        return np.stack([
            self.dt * yaw, current[..., 0], current[..., 1], surge_force, side, turning, roll, sway,
        ], -1)  # fmt: skip

    def _wind(
        self, along: np.ndarray, across: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Surge and sway force [N] and yaw moment [N m] ``(...)`` of the relative wind [m/s].

        Coefficients by Blendermann (1994).
        """
        ship = self.ship
        frontal = 0.82 * ship.beam**2 if ship.frontal_area is None else ship.frontal_area
        lateral = 0.083 * ship.length**2 if ship.lateral_area is None else ship.lateral_area
        angle = np.abs(np.arctan2(-across, -along))  # between the bow and the wind's origin
        front = np.where(angle < 0.5 * np.pi, 0.60, 0.65)
        sin_angle, cos_angle = sincos(angle)
        sin_twice = 2.0 * sin_angle * cos_angle
        shape = 1.0 - 0.5 * 0.65 * (1.0 - front * frontal / lateral / 0.85) * sin_twice * sin_twice
        pressure = 0.5 * _AIR_DENSITY * (along * along + across * across)
        side = 0.85 * sin_angle / shape * np.where(across > 0.0, 1.0, -1.0) * pressure * lateral
        moment = side * (1.04 * ship.length) * 0.18 * (0.5 * np.pi - angle)
        return -pressure * frontal * front * cos_angle / shape, side, moment

    @cached_property
    def _drift(self) -> float:
        """Drift force [N] of the waves that a ship abeam reflects."""
        return (
            self.ship.water_density
            * GRAVITY
            * self.ship.length
            * self.height**2
            / 16.0
            * _REFLECTED
        )

    @cached_property
    def _hull(self) -> WaveMotion:
        return WaveMotion(self.ship)


@compiled
@dataclass(frozen=True, eq=False)
class BandedSeaway(Seaway):
    """A filter's model of a `Seaway`, with `WaveBands` as the ship meets them.

    `WaveBands` are three frequency bands of waves. The response to a band has the amplitude of all
    its waves together, and the phase at the band's frequency. The phases are those at the ship and
    turn as she moves. The ship's motion therefore changes the frequency of encounter, but the waves
    give no position. With phases at a fixed place, the filter would infer positions from waves,
    although it can predict waves for only half a minute.
    """

    names = (*WaveBands.names, "current north", "current east")  # type: ignore[assignment]
    uniforms = 0
    modelled = scale = None  # type: ignore[assignment]

    @cached_property
    def bands(self) -> WaveBands:
        """The frequency bands of the waves alone."""
        return WaveBands(self.height, self.period)

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Rotating frequency bands of the waves, then the current."""
        return Process.joined(self.bands.process(self.dt), self._current)

    def response(self, beta: np.ndarray, speed: float) -> np.ndarray:
        """Complex response ``(3, ..., 3)`` to a unit of each band.

        The first axis is the three bands. The last axis is sway velocity [m/s], yaw rate [rad/s]
        and roll moment [N m].

        Args:
            beta: Direction of the waves relative to the heading [rad].
            speed: Speed of the ship [m/s].
        """
        bands, each = self.bands, []
        for band, frequencies in enumerate(bands.within):
            w = np.append(frequencies, bands.frequencies[band]).reshape(
                (-1,) + np.ndim(beta) * (1,)
            )
            motion, loads = (
                wave_response(self.ship, w, beta, speed),
                wave_loads(self.ship, w, beta)[..., 2:],
            )
            given = np.concatenate([motion, loads], -1)
            each.append(np.sqrt(bands.power(band, given[:-1])) * np.exp(1j * np.angle(given[-1])))
        return np.stack(each)

    def mean_response(self, beta: np.ndarray, speed: float) -> np.ndarray:
        """`response` averaged over the coming step."""
        w = self.bands.frequencies.reshape((-1,) + np.ndim(beta) * (1,))
        half = 0.5 * self.dt * encounter_frequency(w, beta, np.asarray(speed))
        return (np.sinc(half / np.pi) * np.exp(1j * half))[..., None] * self.response(beta, speed)

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Components ``(..., 8)`` of the effect, see `Seaway`, in the waves of the bands."""
        psi, u = state[..., 2], state[..., 3]
        total, response = [np.zeros_like(u)] * 3, self._interpolated(self.direction - psi, u)
        for band in range(BANDS):
            real, imaginary = z[..., 2 * band], z[..., 2 * band + 1]
            own = [response[..., 6 * band + k] for k in range(6)]
            total = [total[k] + (own[k] * real - own[k + 3] * imaginary) for k in range(3)]
        return self._acting(total, z[..., -2:], state)

    def met(self, z: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """State with the waves' phases at the place of the ship after a step through the water."""
        sin_mu, cos_mu = sincos(self.direction)
        north, east = ((after - before)[..., i] - self.dt * z[..., i - 2] for i in range(2))
        parts = self.bands.at(z, north * cos_mu + east * sin_mu)
        return np.stack([*(each for part in parts for each in part), z[..., -2], z[..., -1]], -1)

    def _interpolated(self, beta: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Real and imaginary parts of `mean_response` ``(..., bands * 6)``."""
        turn = beta / (2.0 * np.pi)
        at = (turn - np.floor(turn)) * _BETAS
        i = np.minimum(np.floor(at), _BETAS - 1.0)
        slowest, fastest = _TABLED[[0, -1]] * self.ship.speed
        to = np.minimum(np.maximum((speed - slowest) / (fastest - slowest), 0.0), 1.0) * (
            len(_TABLED) - 1
        )
        j = np.minimum(np.floor(to), len(_TABLED) - 2.0)
        f, g, first = (at - i)[..., None], (to - j)[..., None], j * (_BETAS + 1) + i
        near, beside, far, last = (
            lookup(self._table, first + k) for k in (0, 1, _BETAS + 1, _BETAS + 2)
        )
        response = (1.0 - g) * ((1.0 - f) * near + f * beside)
        return response + g * ((1.0 - f) * far + f * last)

    @cached_property
    def _table(self) -> np.ndarray:
        """Real and imaginary parts of `mean_response` on a grid.

        The shape is ``(speeds * betas, bands * 6)``.
        """
        beta = np.linspace(0.0, 2.0 * np.pi, _BETAS + 1)
        response = np.stack(
            [self.mean_response(beta, speed) for speed in _TABLED * self.ship.speed]
        )
        parts = np.moveaxis(np.concatenate([response.real, response.imag], -1), 1, 2)
        return parts.reshape(len(_TABLED) * (_BETAS + 1), -1)


def _held(mean: np.ndarray) -> np.ndarray:
    """Factor on a roll moment that is constant over a step, from `_mean`.

    The factor is ``1 / mean`` up to half a wave a step. Steps would alias faster waves into slow
    ones; so the factor falls to 0 at two thirds of a wave a step.
    """
    half_a_wave, last = 2.0 / np.pi, np.sin(2.0 * np.pi / 3.0) / (2.0 * np.pi / 3.0)
    share = np.minimum(np.maximum((mean - last) / (half_a_wave - last), 0.0), 1.0)
    return share / np.maximum(mean, half_a_wave)


def _mean(half: np.ndarray) -> np.ndarray:
    """Mean of a wave over +-``half`` [rad] of phase: ``sin(half) / half``, and 0 from pi on."""
    square = np.minimum(half * half, np.pi**2)
    total = np.zeros_like(square)
    for i in range(9, -1, -1):  # Taylor's series, to 2e-10
        total = total * square + (-1.0) ** i / factorial(2 * i + 1)
    return total


_TABLED, _BETAS = np.linspace(0.25, 1.25, 21), 120
"""Tabled speeds in units of the service speed, and number of tabled directions."""
