"""A sea that knows the ship: long waves at the frequency and angle at which she meets them, wind, drift, a current."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import root

from estimators.engine import lookup, sincos
from vessel_gym.checks import check_numbers, instance
from vessel_gym.disturbances import Disturbance, Sea
from vessel_gym.processes import Process
from vessel_gym.vehicles.corvette_equations import AROUND, STATE, CorvetteParameters, corvette_rates
from vessel_gym.vehicles.seakeeping import wave_loads, wave_response
from vessel_gym.waves import GRAVITY, WaveField, encounter_frequency

_AIR_DENSITY = 1.224  # kg/m3
_REFLECTED = 0.25  # share of the waves' energy that a ship abeam reflects; assumed
_LEAST = 1e-3  # rad, least yaw increment that filters assume: half a compass' noise, below which nothing shows it


@dataclass(frozen=True, eq=False)
class Seaway(Disturbance, verified=True):
    """Disturbance of a ship that turns in a sea: first-order motion in waves, and slow loads.

    The waves are a `WaveField`, which the ship sees from where she is: the frequency of encounter
    ``w - k U cos(beta)``, zero and negative in following seas, follows from how she moves, and her yaw rate and sway
    velocity from `wave_response`.
    Superposed on manoeuvring (Fossen 2021, ch. 10), the first turns the heading, the second carries the track; the
    roll moment acts on the ship. Wind (Blendermann 1994, a destroyer) and the drift of the waves that she reflects
    (Faltinsen 1990) push her to leeward, which nobody can tell from a current by her position.

    Waves and wind run to the north, unless ``direction`` says otherwise.

    Raises:
        ValueError: for a number that no sea has.
        TypeError: for a ship that is none.
    """

    ship: CorvetteParameters
    height: float  # significant, m
    period: float  # of the spectrum's peak, s
    wind: float  # m/s
    current: float  # RMS speed, m/s
    dt: float
    direction: float = 0.0  # to which waves and wind run, rad
    current_time: float = 1000.0  # s

    names = (*WaveField.names, "current north", "current east")
    forces = ("yaw increment", *AROUND)
    assumed_as = "unknown-input"
    averaged = ("roll moment", "wave sway")

    def __post_init__(self) -> None:
        instance("ship of Seaway", self.ship, CorvetteParameters)
        kinds = {"positive": "height period dt current_time", "not_negative": "wind current", "direction": "direction"}
        check_numbers("a seaway", vars(self), **kinds)

    @cached_property
    def waves(self) -> WaveField:
        """The waves alone."""
        return WaveField(self.height, self.period)

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """The bands, rotating, and the current."""
        sd = self.current / np.sqrt(2.0)
        return Process.joined(self.waves.process(self.dt), Process.wandering((sd, sd), self.current_time, self.dt))

    def response(self, beta: np.ndarray, speed: float) -> np.ndarray:
        """Sway velocity [m/s], yaw rate [rad/s] and roll moment [N m] of a unit of each band ``(3, ..., 3)``, complex.

        As strong as all waves of the band together, in the phase of those at its frequency.

        Args:
            beta: Where the waves run to, from the heading on [rad].
            speed: [m/s].
        """
        waves, each = self.waves, []
        for band, frequencies in enumerate(waves.within):
            w = np.append(frequencies, waves.frequencies[band]).reshape((-1,) + np.ndim(beta) * (1,))
            motion, loads = wave_response(self.ship, w, beta, speed), wave_loads(self.ship, w, beta)[..., 2:]
            given = np.concatenate([motion, loads], -1)
            each.append(np.sqrt(waves.power(band, given[:-1])) * np.exp(1j * np.angle(given[-1])))
        return np.stack(each)

    def mean_response(self, beta: np.ndarray, speed: float) -> np.ndarray:
        """`response` averaged over the coming step, in which the ship meets the waves: what a step holds of it.

        Over steps that are long for the waves it is smaller, and the heading swings as far as in continuous time.
        """
        w = self.waves.frequencies.reshape((-1,) + np.ndim(beta) * (1,))
        half = 0.5 * self.dt * encounter_frequency(w, beta, np.asarray(speed))
        return (np.sinc(half / np.pi) * np.exp(1j * half))[..., None] * self.response(beta, speed)

    def yaw_rate(self, beta: np.ndarray, speed: float) -> np.ndarray:
        """RMS of the yaw rate in waves ``(...)`` [rad/s]; arguments as `response`."""
        return np.sqrt((np.abs(self.response(beta, speed)[..., 1]) ** 2).sum(0))

    @cached_property
    def believed(self) -> Sea:  # type: ignore[override]
        """Disturbance that filters assume by default: yaw of no direction, and a current that leeway moves."""
        beta = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
        yaw = self.mean_response(beta, 0.8 * self.ship.speed)[..., 1]
        wave = max(np.sqrt((np.abs(yaw) ** 2).sum(0).mean()), _LEAST / self.dt)
        return Sea(
            wave=float(wave), peak=float(self.waves.frequencies[1]), gust=0.0,
            current=float(np.hypot(self.current, self.leeway)), current_time=100.0, dt=self.dt,
        )  # fmt: skip

    @cached_property
    def input_sd(self) -> tuple[float, ...]:  # type: ignore[override]
        """Of the yaw increment, over all headings."""
        return (self.dt * self.believed.wave,)

    @cached_property
    def leeway(self) -> float:
        """Sway [m/s] of the ship that her rudder holds across wind and drift, at the speed that she keeps there."""
        state, c = np.zeros(len(STATE)), self.ship.vector()
        state[STATE.index("psi")] = self.direction + 0.5 * np.pi
        moving = [STATE.index("u"), STATE.index("v")]

        def accelerations(balance: np.ndarray) -> np.ndarray:
            """In surge, sway and yaw, at a rudder angle [rad] and surge and sway in units of the service speed."""
            state[moving] = balance[1:] * self.ship.speed
            around = self.effect(np.zeros(len(self.names)), state)[1:]
            return corvette_rates(state, balance[:1], around, c)[3:6] * [1.0, 1.0, self.ship.length]

        return float(abs(root(accelerations, [0.0, 1.0, 0.0]).x[2]) * self.ship.speed)

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """The yaw increment [rad], and what is `AROUND` the ship, ``(..., 8)``."""
        x, y, psi, u, v = np.moveaxis(state[..., :5], -1, 0)
        beta = self.direction - psi
        sway, yaw, roll = self._motion(z, x, y, beta, u)
        surge_force, side_force, turning = self._wind(beta, u, v)
        sin_beta, _ = sincos(beta)
        side = side_force + self._drift * sin_beta * np.abs(sin_beta)
        bands = 2 * len(self.waves.numbers)
        return np.stack([
            self.dt * yaw, z[..., bands], z[..., bands + 1], surge_force, side, turning, roll, sway,
        ], -1)  # fmt: skip

    def _motion(
        self, z: np.ndarray, x: np.ndarray, y: np.ndarray, beta: np.ndarray, speed: np.ndarray
    ) -> list[np.ndarray]:
        """Sway velocity [m/s], yaw rate [rad/s] and roll moment [N m] of the waves ``(...)`` at a place."""
        turn = beta / (2.0 * np.pi)
        at = (turn - np.floor(turn)) * _BETAS
        i = np.minimum(np.floor(at), _BETAS - 1.0)
        slowest, fastest = _speeds(self.ship)[[0, -1]]
        to = np.minimum(np.maximum((speed - slowest) / (fastest - slowest), 0.0), 1.0) * (_SPEEDS - 1)
        j = np.minimum(np.floor(to), _SPEEDS - 2.0)
        f, g, first = (at - i)[..., None], (to - j)[..., None], j * (_BETAS + 1) + i
        near, beside, far, last = (lookup(self._table, first + k) for k in (0, 1, _BETAS + 1, _BETAS + 2))
        response = (1.0 - g) * ((1.0 - f) * near + f * beside)
        response = response + g * ((1.0 - f) * far + f * last)
        sin_mu, cos_mu = sincos(self.direction)
        total = [np.zeros_like(x)] * 3
        for band, number in enumerate(self.waves.numbers):
            sin, cos = sincos(number * (x * cos_mu + y * sin_mu))
            real, imaginary = z[..., 2 * band], z[..., 2 * band + 1]
            real, imaginary = real * cos + imaginary * sin, imaginary * cos - real * sin  # z exp(-j k x)
            own = [response[..., 6 * band + k] for k in range(6)]
            total = [total[k] + (own[k] * real - own[k + 3] * imaginary) for k in range(3)]
        return total

    def _wind(self, beta: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Surge and sway force [N] and yaw moment [N m] of the wind ``(...)``, Blendermann (1994)."""
        ship = self.ship
        frontal = 0.82 * ship.beam**2 if ship.frontal_area is None else ship.frontal_area
        lateral = 0.083 * ship.length**2 if ship.lateral_area is None else ship.lateral_area
        sin_beta, cos_beta = sincos(beta)
        along, across = self.wind * cos_beta - u, self.wind * sin_beta - v  # of the air, as the ship feels it
        angle = np.abs(np.arctan2(-across, -along))  # from the bow, from which it comes
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
        return self.ship.water_density * GRAVITY * self.ship.length * self.height**2 / 16.0 * _REFLECTED

    @cached_property
    def _table(self) -> np.ndarray:
        """Real and imaginary parts of `mean_response`, by speed and beta ``(speeds * betas, bands * 6)``."""
        beta = np.linspace(0.0, 2.0 * np.pi, _BETAS + 1)
        response = np.stack([self.mean_response(beta, speed) for speed in _speeds(self.ship)])
        parts = np.moveaxis(np.concatenate([response.real, response.imag], -1), 1, 2)
        return parts.reshape(_SPEEDS * (_BETAS + 1), -1)


_SPEEDS, _BETAS = 21, 120


def _speeds(ship: CorvetteParameters) -> np.ndarray:
    """Speeds [m/s] at which responses are tabled."""
    return ship.speed * np.linspace(0.25, 1.25, _SPEEDS)
