"""The PUNA, a small fixed-wing unmanned aircraft: a point mass that turns coordinated, in a wind.

Frames: x north, y east, altitude h up; positive bank turns to starboard. Wind components are north, east, down, where
it blows to.

In the literature the state holds airspeed and the angles of the velocity through the air. Here it holds the velocity
over ground: a gust then changes nothing but the wind, so that white noise on the wind is all that a filter has to be
told, and there is no pole at the vertical.

Sources: the paper on Dubins paths and the ensemble Kalman filter for a PUNA ("Pesawat Udara Nir Awak", in Indonesian)
for the task and the controls (thrust and angle of attack); its own equations are those of
`vessel_gym.vehicles.planar_puna`. Beard & McLain (2012), ch. 9, for the point mass and the bank.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
from scipy.optimize import brentq

from estimators import NonlinearModel
from estimators.checks import shown
from vessel_gym.compiled import gufunc, inlined, sincos
from vessel_gym.disturbances import Air
from vessel_gym.sensors import Instrument, nominal_sd
from vessel_gym.vehicles.integration import RATES, STEP, STEPS, Numbers, advanced, blank, rate, step, steps
from vessel_gym.vehicles.point_mass import COEFFICIENTS, UNCERTAIN, I, PointMass, forces

TRUTH = (
    "x", "y", "h", "north", "east", "climb", "phi", "mean wind north", "mean wind east", "gust north", "gust east",
    "gust down 1", "gust down 2", "bias x", "bias y", "bias h",
)  # fmt: skip
"""Truth state: position and altitude [m], velocity over ground [m/s], bank [rad], mean wind [m/s], the gusts' state
[m/s] (down: the first plus sqrt(3) times the second), bias of the GNSS [m]."""

HARDEST = 200.0  # m/s2: no wing bears more lift. At 20 m/s the aircraft reaches 50; it bounds how fast a step may turn


@dataclass(frozen=True)
class PunaParameters(PointMass):
    """The aircraft with its actuators and their limits."""

    thrust_limit: float = 16.0  # N, half the weight, assumed: climbs at 20 deg at 20 m/s
    thrust_lag: float = 0.5  # s, assumed
    alpha_low: float = np.deg2rad(-4.0)  # rad, assumed: pushes over at -1 g at 20 m/s
    alpha_high: float = np.deg2rad(12.0)  # rad, assumed: clear of the stall
    alpha_rate: float = 0.5  # rad/s, assumed: the short-period motion that a point mass leaves out
    bank_limit: float = np.deg2rad(35.0)  # rad, see below
    cruise_speed: float = 20.0  # m/s, printed
    # 100 m of radius at 20 m/s take 22.2 deg, with 3.8 m/s of tail wind 30 deg: the rest is for gusts and corrections.

    @cached_property
    def cruise(self) -> np.ndarray:
        """Thrust, angle of attack and bank ``(3,)`` of level flight at the cruising speed, at sea level."""
        steady = trim(self.cruise_speed, self)
        return np.array([steady.thrust, steady.alpha, 0.0])

    def commands(self, action: np.ndarray) -> np.ndarray:
        """Thrust, angle of attack and bank ``(..., 3)`` that actions ask for: limits at -1 and 1, cruising at 0."""
        below, above = self._reach
        return self.cruise + action * np.where(action < 0.0, below, above)

    def actions(self, commands: np.ndarray) -> np.ndarray:
        """The actions ``(..., 3)`` that ask for thrust, angle of attack and bank."""
        below, above = self._reach
        change = commands - self.cruise
        return change / np.where(change < 0.0, below, above)

    @cached_property
    def _reach(self) -> tuple[np.ndarray, np.ndarray]:
        """From cruising to the lower limits and to the upper ones."""
        low = np.array([0.0, self.alpha_low, -self.bank_limit])
        return self.cruise - low, np.array([self.thrust_limit, self.alpha_high, self.bank_limit]) - self.cruise


@dataclass(frozen=True)
class Trim:
    """Steady level flight."""

    alpha: float  # rad
    thrust: float  # N


def trim(speed: float, body: PunaParameters, altitude: float = 0.0, bank: float = 0.0) -> Trim:
    """Angle of attack and thrust for level flight, in a coordinated turn if banked.

    Args:
        speed: Airspeed [m/s].
        body: The aircraft.
        altitude: Of the flight [m].
        bank: Angle [rad].

    Raises:
        ValueError: if the aircraft cannot fly level like this within its limits of angle and thrust.
    """
    pressure = 0.5 * float(np.polyval(body.density, altitude)) * speed**2 * body.area

    def thrust(alpha: float) -> float:
        return float(pressure * np.polyval(body.drag, alpha) / np.cos(alpha))

    def excess(alpha: float) -> float:
        across = pressure * np.polyval(body.lift, alpha) + thrust(alpha) * np.sin(alpha)
        return float(across * np.cos(bank) - body.mass * body.gravity)

    if excess(body.alpha_low) > 0.0 or excess(body.alpha_high) < 0.0:
        raise ValueError(
            f"no level flight at {speed:g} m/s: lift and weight balance at no angle of attack within limits"
        )
    alpha = float(brentq(excess, body.alpha_low, body.alpha_high, xtol=1e-14))
    if thrust(alpha) > body.thrust_limit:
        raise ValueError(f"no level flight at {speed:g} m/s: it takes {thrust(alpha):.1f} N of thrust")
    return Trim(alpha, thrust(alpha))


# --- compiled equations -----------------------------------------------------------------------------


@inlined
def _rates(s: Numbers, control: Numbers, wind: Numbers, c: np.ndarray) -> Numbers:
    """Of position and altitude, velocity over ground and bank, in a ``wind`` north, east and down."""
    thrust, alpha, command = control
    north, east, up, phi = s[3] - wind[0], s[4] - wind[1], s[5] + wind[2], s[6]
    level = np.sqrt(north * north + east * east)
    V = np.sqrt(level * level + up * up)
    lift, drag = forces(s[2], V, alpha, c)
    (sin_alpha, cos_alpha), (sin_phi, cos_phi) = sincos(alpha), sincos(phi)
    force = c[I.thrust] * thrust
    along = (force * cos_alpha - drag) / c[I.mass]
    across = min(max((lift + force * sin_alpha) / c[I.mass], -HARDEST), HARDEST)
    # Where nothing flies, straight up or down or at rest, directions are those of a hair beside.
    V = max(V, 1e-3)
    level = max(level, 1e-3)
    above, aside = across * cos_phi / V, across * sin_phi / level
    ahead = along / V - above * up / level
    return (
        s[3], s[4], s[5],
        ahead * north - aside * east, ahead * east + aside * north,
        along * up / V + above * level - c[I.gravity],
        c[I.bank_rate] * (command - phi),
    )  # fmt: skip


_BLANK = blank(7, 3, 3)


@gufunc(*RATES)
def puna_rates(state: np.ndarray, control: np.ndarray, wind: np.ndarray, c: np.ndarray, out: np.ndarray) -> None:
    """Time derivative of the aircraft's own state ``(7,)``; control is (thrust, angle of attack, commanded bank)."""
    rate(_rates, _BLANK, state, control, wind, c, out)


@gufunc(*STEP)
def puna_step(
    state: np.ndarray, control: np.ndarray, wind: np.ndarray, c: np.ndarray, dt: float, substeps: int, out: np.ndarray
) -> None:
    """The aircraft's own state ``(7,)`` after ``dt``; control ``(6,)``: actuators before and after."""
    step(_rates, _BLANK, state, control, wind, c, dt, substeps, out)


@gufunc(*STEPS)
def puna_steps(
    states: np.ndarray, control: np.ndarray, winds: np.ndarray, c: np.ndarray, dt: float, substeps: int, out: np.ndarray
) -> None:
    """`puna_step` of many states ``(N, 7)`` under one control: the same numbers, several times as fast."""
    steps(_rates, _BLANK, states, control, winds, c, dt, substeps, out)


@inlined
def _wind(s: np.ndarray) -> tuple[float, float, float]:
    """Mean wind and gusts of the truth state: north, east, down."""
    return s[7] + s[9], s[8] + s[10], s[11] + np.sqrt(3.0) * s[12]


@gufunc("void(float64[:], float64[:], float64[:], float64[:], float64[:])", "(n),(d),(w)->(w),(n)")
def _air(state: np.ndarray, decay: np.ndarray, template: np.ndarray, wind: np.ndarray, after: np.ndarray) -> None:
    """The wind that the truth state ``(16,)`` tells of, and what of that state is not the aircraft's after a step."""
    wind[0], wind[1], wind[2] = _wind(state)
    after[7], after[8] = decay[0] * state[7], decay[0] * state[8]
    after[9], after[10] = decay[1] * state[9], decay[1] * state[10]
    after[11] = decay[2] * state[11] + decay[3] * state[12]
    after[12] = decay[4] * state[11] + decay[5] * state[12]
    after[13], after[14], after[15] = state[13], state[14], state[15]


def ground_step(
    truth: np.ndarray, control: np.ndarray, c: np.ndarray, decay: np.ndarray, dt: float, substeps: int
) -> np.ndarray:
    """`puna_step` on truth states ``(..., 16)``; at the end the wind decays by ``decay (6,)``, see `Air.decay`."""
    wind, moved = _air(truth, decay, np.empty(3))
    advanced(puna_step, puna_steps, truth[..., :7], control, wind, c, dt, substeps, out=moved[..., :7])
    return moved


@gufunc("void(float64[:], float64[:], float64[:])", "(n),(p)->(p)")
def puna_readings(state: np.ndarray, template: np.ndarray, out: np.ndarray) -> None:
    """What instruments without noise read ``(9,)``, in their order; ``template (9,)`` only tells how many they are."""
    wind = _wind(state)
    north, east, up = state[3] - wind[0], state[4] - wind[1], state[5] + wind[2]
    out[0], out[1], out[2] = state[0] + state[13], state[1] + state[14], state[2] + state[15]
    out[3], out[4], out[5] = np.hypot(state[3], state[4]), np.arctan2(state[4], state[3]), state[5]
    out[6], out[7], out[8] = state[2], np.hypot(np.hypot(north, east), up), state[6]


def airspeed(truth: np.ndarray) -> np.ndarray:
    """Airspeed [m/s] of truth states ``(..., 16)``, ``(...)``: what a pitot tube without noise reads."""
    return puna_readings(truth, np.empty(9))[..., 7]


# --- the vehicle as an environment uses it ----------------------------------------------------------


class Gusts(Protocol):
    """What a filter's model needs to know of the air and of the GNSS."""

    @property
    def decay(self) -> np.ndarray:
        """How the wind decays in a step, ``(6,)``: mean, level gusts, and the vertical ones' matrix row by row."""

    @property
    def noise_cov(self) -> np.ndarray:
        """Covariance ``(13, 13)`` of what enters the state in a step, from the velocities on."""


@dataclass(frozen=True)
class Puna:
    """The aircraft in batches, as an environment uses it.

    Over a step the wind is constant; the forcing changes it at the end. Figures of the instruments are from public
    models of small aircraft (Beard & McLain 2012, ch. 7): the GNSS has white noise and a bias that wanders.
    """

    body: PunaParameters = PunaParameters()
    dt: float = 0.1  # s
    substeps: int = 1  # one RK4 step is converged to 3 cm and 2e-4 rad in 30 s of full reversals

    truth_names: ClassVar = TRUTH
    parameter_names: ClassVar = COEFFICIENTS
    action_names: ClassVar = ("thrust", "angle of attack", "bank")
    instruments: ClassVar = (
        Instrument(
            "GNSS", ("x", "y", "h", "ground speed", "course over ground", "climb"), (1.0, 1.0, 1.5, 0.05, 0.03, 0.1),
            period=10,
        ),
        Instrument("barometer", ("pressure altitude",), (0.5,)),
        Instrument("pitot tube", ("airspeed",), (0.5,)),
        Instrument("attitude", ("bank",), (0.02,)),  # assumed
    )  # fmt: skip
    unknown_inputs: ClassVar = 13
    """What enters the state in a step, from the velocities on."""
    normals: ClassVar = len(UNCERTAIN)
    """Normal numbers that `parameters` needs."""
    state_angles: ClassVar = (6,)
    measurement_angles: ClassVar = (4, 8)

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """Coefficients ``(B, k)`` of the truth: the filter's, with a relative spread on the uncertain ones."""
        return self.body.vector(1.0 + mismatch * np.clip(normals, -2.0, 2.0))

    @cached_property
    def localisation(self) -> np.ndarray:
        """``(16, 9)``: which reading may correct which state of an ensemble.

        Ten times a second barometer, pitot tube and attitude tell of altitude, wind and bank, and only by chance
        correlations of the position in plan, whose variance would shrink between two fixes of the GNSS.
        """
        level = ("x", "y", "north", "east", "bias x", "bias y")
        course = ("x", "y", "north", "east", "phi", "mean wind north", "mean wind east", "gust north", "gust east")
        vertical = ("h", "climb", "bias h")
        down = (*vertical, "gust down 1", "gust down 2")
        wind = ("north", "east", "mean wind north", "mean wind east", "gust north", "gust east")
        corrected = (level, level, vertical, course, course, down, down, wind, ("phi",))
        return np.array([[float(name in names) for names in corrected] for name in TRUTH])

    @cached_property
    def wind_decay(self) -> np.ndarray:
        """How the wind decays in a step ``(6,)``, as `Air.decay`."""
        return Air(0.0, 1.0, 1.0, airspeed=self.body.cruise_speed, dt=self.dt).decay

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Truth ``(B, 16)`` and actuators ``(B, 3)`` from the state: trimmed for the cruising speed."""
        return np.array(x, float), np.tile(self.body.cruise, (len(x), 1))

    def filter_state(self, truth: np.ndarray, n: int = len(TRUTH)) -> np.ndarray:
        """The part of the truth that filters estimate: its first ``n`` components."""
        return truth[..., :n]

    def actuate(self, actuators: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Actuators ``(B, 3)`` after a step of ``action`` in [-1, 1].

        At 0 the aircraft cruises level, at -1 and 1 every actuator is at a limit. Thrust follows with its lag, angle of
        attack at its rate, commanded bank at once: the bank itself lags.
        """
        body, after = self.body, self.body.commands(action)
        thrust = after[..., 0]
        after[..., 0] = thrust + (actuators[..., 0] - thrust) * np.exp(-self.dt / body.thrust_lag)
        turn = body.alpha_rate * self.dt
        after[..., 1] = np.clip(after[..., 1], actuators[..., 1] - turn, actuators[..., 1] + turn)
        return after

    def step(
        self, truth: np.ndarray, before: np.ndarray, after: np.ndarray, forcing: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """The truth one step later, with actuators moving from ``before`` to ``after`` and ``forcing (B, 13)``."""
        control = np.concatenate([before, after], -1)
        moved = ground_step(truth, control, parameters, self.wind_decay, self.dt, self.substeps)
        moved[..., 3:] += forcing
        return moved

    def readings(self, truth: np.ndarray, forcing: np.ndarray) -> np.ndarray:
        """What perfect instruments read ``(B, 9)``; the forcing acts later and is not seen."""
        return puna_readings(truth, np.empty(9))

    def from_readings(
        self, readings: np.ndarray, previous: np.ndarray, interval: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """State ``(..., 16)`` and unknown input ``(..., 13)`` from the readings alone, gusts and bias as zero.

        Altitude is the barometer's. What airspeed and ground speed differ by is taken for a wind along the course.

        Args:
            readings: ``(..., 9)``.
            previous: the readings before, not needed.
            interval: seconds between the two, not needed.
        """
        x = np.zeros(readings.shape[:-1] + (len(TRUTH),))
        x[..., [0, 1, 2, 5, 6]] = readings[..., [0, 1, 6, 5, 8]]
        speed, course = readings[..., 3], readings[..., 4]
        x[..., 3], x[..., 4] = speed * np.cos(course), speed * np.sin(course)
        airspeed, climb = np.clip(readings[..., 7], 0.0, 1e3), np.clip(readings[..., 5], -1e3, 1e3)
        level = np.sqrt(np.maximum(airspeed**2 - climb**2, 0.0))
        x[..., 7], x[..., 8] = (speed - level) * np.cos(course), (speed - level) * np.sin(course)
        return x, np.zeros(readings.shape[:-1] + (self.unknown_inputs,))

    def model(self, kind: str, noise: float, air: Gusts) -> NonlinearModel:
        """The filters' model: the vehicle's own equations, and what the air does as process noise.

        The known input is ``u = (actuators before, actuators after)``.

        Args:
            kind: ``"nonlinear"``; there is no other.
            noise: standard deviation of the readings relative to nominal.
            air: how the gusts decay, and what drives them.

        Raises:
            ValueError: for another kind.
        """
        if kind != "nonlinear":
            raise ValueError(f"unknown filter model {shown(kind)}: this vehicle has the nonlinear one only")
        if not np.allclose(air.decay, self.wind_decay):
            raise ValueError(
                "the vehicle's wind decays otherwise than that of the air: give both the same times and lengths"
            )
        c = self.body.vector()

        def transition(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            assert u is not None
            return ground_step(x, u, c, self.wind_decay, self.dt, self.substeps)

        def measurement(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            return puna_readings(x, np.empty(9))

        Q = np.zeros((len(TRUTH), len(TRUTH)))
        Q[3:, 3:] = air.noise_cov
        return NonlinearModel(
            transition,
            measurement,
            Q,
            np.diag((noise * nominal_sd(self.instruments)) ** 2),
            state_angles=self.state_angles,
            measurement_angles=self.measurement_angles,
        )
