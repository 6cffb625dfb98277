"""Disturbances: waves, gusts, turbulence, currents and winds, and faults of actuators.

All are made from white noise. A disturbance has a state z of its own and acts on a vehicle through
components of its exogenous input. Your own disturbance is a subclass of `Disturbance`:
docs/own-disturbance.md.
"""

import math
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from estimators.checks import integer, number
from estimators.discretisation import van_loan
from estimators.engine import along, compiled, sincos
from vessel_gym.checks import check_names, check_numbers, instance
from vessel_gym.processes import (
    Process,
    block_diagonal,
    integrated,
    interpolated,
    linear,
    root_of,
)
from vessel_gym.waves import GRAVITY, WaveBands, WaveField


@compiled
class Disturbance:
    """Base class of disturbances that act on a vehicle over a step.

    The state moves as ``z+ = transition z + root n``. Over a step the vehicle receives ``effect(z,
    state)`` and, for the increments in ``white_increments``, the product ``white n'``. n and n' are
    standard normal.

    Attributes:
        names: Components of z.
        forces: Components of the vehicle's exogenous input (see `vessel_gym.system.Vehicle`) that
            `effect` returns, in order.
        process: Process of z; its ``start_cov`` is the covariance of z at the start.
        white_increments: Increments of the vehicle that are white noise.
        white: Root ``(len(white_increments), m)`` of the covariance of ``white_increments``.
        assumed_as: Default way in which filters model the disturbance, see
            `vessel_gym.filter_models.build.ASSUMED`.
        inputs: Components of the unknown input d, where filters assume one: names from ``forces``
            or ``white_increments``, or ``"change of NAME"`` for the change of a component of
            ``names`` in a step. None: all names in ``forces``
            and ``white_increments`` that are increments of the vehicle.
        input_sd: Standard deviations of d that filters assume where no measurement shows d. None:
            derived from `process` and ``white``.
        scale: An agent that observes standard deviations receives those of z divided by these
            numbers. None: divided by the standard deviations at the start.
        averaged: Names from ``forces`` that are means over the coming step, which no sensor may
            read.
        dt: Time step [s] for which the disturbance was made; None: any.
        believed: Disturbance that filters assume unless the user names another; None: this one.
        modelled: Where a filter assumes this disturbance, ``modelled`` takes its place. None: no
            replacement.
        uniforms: Number of uniform random numbers that `draw` receives in an episode.
    """

    names: tuple[str, ...] = ()
    forces: tuple[str, ...] = ()
    process: Process = Process.joined()
    white_increments: tuple[str, ...] = ()
    white: np.ndarray = np.zeros((0, 0))
    assumed_as: str = "states"
    inputs: tuple[str, ...] | None = None
    input_sd: tuple[float, ...] | None = None
    scale: tuple[float, ...] | None = None
    averaged: tuple[str, ...] = ()
    dt: float | None = None
    believed: "Disturbance | None" = None
    modelled: "Disturbance | None" = None
    uniforms: int = 0

    def met(self, z: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """State z ``(..., k)`` after the vehicle moved from ``before`` to ``after``; default: z."""
        return z

    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Constants ``(..., e)`` of an episode, from ``uniforms (..., u)`` in [0, 1]."""
        return uniforms

    def effect_at(
        self, drawn: np.ndarray, time: np.ndarray, z: np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Effect at ``time (...)`` [s] of an episode with constants; default: `effect`.

        The argument ``drawn (..., e)`` has the constants.
        """
        return self.effect(z, state)

    @linear
    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Effect ``(..., len(forces))`` of z on a vehicle in a state; default: z.

        An override may be any function of both arguments. If it is linear in z at every state, the
        decorator `vessel_gym.processes.linear` makes it faster.

        Args:
            z: ``(..., k)`` state of the disturbance.
            state: ``(..., n)`` state of the vehicle.
        """
        return z


@compiled
@dataclass(frozen=True)
class Sea(Disturbance):
    """Yaw rates by waves and gusts, and a current, that act on a ship.

    The wave yaw rate follows the second-order linear wave model ``s / (s^2 + 2 lambda w0 s +
    w0^2)`` with a damping for a JONSWAP peak (Fossen 2011, sec. 8.2.6). Gust and current are
    first-order Gauss-Markov processes. The state is (wave yaw angle, wave yaw rate, gust yaw rate,
    current north, current east), stationary from the first step.
    """

    wave: float  # yaw rate RMS, rad/s
    peak: float  # wave peak frequency met by the ship, rad/s
    gust: float  # yaw rate RMS, rad/s
    current: float  # speed RMS, m/s
    damping: float = 0.1  # lambda of a JONSWAP peak; 0.26 fits Pierson-Moskowitz
    gust_time: float = 15.0  # s
    current_time: float = 1000.0  # s
    dt: float = 0.5  # s

    def __post_init__(self) -> None:
        check_numbers(
            self,
            not_negative="wave gust current",
            positive="peak damping gust_time current_time dt",
        )

    names = ("wave yaw", "wave yaw rate", "gust yaw rate", "current north", "current east")
    forces = ("yaw increment", "current north", "current east")
    assumed_as = "unknown-input"

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Waves, gust and current."""
        wave = np.array([[0.0, 1.0], [-(self.peak**2), -2.0 * self.damping * self.peak]])
        intensity = np.diag([0.0, 4.0 * self.damping * self.peak * self.wave**2])
        transition, noise = van_loan(wave, np.eye(2), intensity, self.dt)
        waves = Process(transition, root_of(noise), self.wave**2 * np.diag([self.peak**-2, 1.0]))
        gust = Process.wandering((self.gust,), self.gust_time, self.dt)
        each = self.current / np.sqrt(2.0)  # component, which carries half the power
        return Process.joined(
            waves, gust, Process.wandering((each, each), self.current_time, self.dt)
        )

    @linear
    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Yaw increment d [rad] in the coming step, current north and east [m/s]: ``(..., 3)``."""
        increment = self.dt * (z[..., 1] + z[..., 2])
        return np.concatenate([increment[..., None], z[..., 3:]], -1)


@compiled
@dataclass(frozen=True)
class Water(Disturbance):
    """Turbulence and a wandering current that act on a submerged vehicle.

    Turbulence is white noise on the accelerations of the vehicle through the water. Each step adds
    an increment to the velocities, with a variance in proportion to the step's length. The current
    is a first-order Gauss-Markov process. A filter that assumes this disturbance has an exact model
    of it.
    """

    turbulence: float  # standard deviation of what a second adds to a velocity, m/s per sqrt(s)
    spin: float  # standard deviation of what a second adds to a rate, rad/s per sqrt(s)
    current: float  # RMS speed, m/s
    velocities: tuple[str, ...] = ("u", "v", "w")  # with increments
    rates: tuple[str, ...] = ("p", "q", "r")
    names: tuple[str, ...] = ("current north", "current east")
    current_time: float = 200.0  # s
    dt: float = 0.1  # s

    def __post_init__(self) -> None:
        check_numbers(self, not_negative="turbulence spin current", positive="current_time dt")
        for name in ("velocities", "rates", "names"):
            check_names(f"{name} of Water", getattr(self, name))
        increments = tuple(f"{name} increment" for name in (*self.velocities, *self.rates))
        vars(self).update(
            forces=self.names, white_increments=increments, scale=(0.1,) * len(self.names)
        )  # 0.1 m/s

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Process of the current [m/s]; its components share the power equally."""
        sd = self.current / np.sqrt(len(self.names))
        return Process.wandering((sd,) * len(self.names), self.current_time, self.dt)

    @cached_property
    def white(self) -> np.ndarray:  # type: ignore[override]
        """Root of the covariance of the increments in a step [m/s, rad/s]."""
        in_a_second = np.repeat(
            [self.turbulence, self.spin], [len(self.velocities), len(self.rates)]
        )
        return np.sqrt(self.dt) * np.diag(in_a_second)


@compiled
@dataclass(frozen=True)
class SurfaceWater(Disturbance):
    """Water near the surface, with waves that carry a submerged vehicle to and fro.

    The waves are a `WaveField` that runs to the north and is carried by the current. Their
    horizontal orbital velocity decays with depth as ``exp(-k z)`` (Airy) and is added to the
    current. The vertical orbital velocity is left out.
    """

    height: float  # significant wave height, m
    period: float  # peak period of the spectrum, s
    beside: Water
    north: int  # index of the vehicle's north position in its state
    down: int  # index of its depth
    depth: float = 2.0  # m, depth of the origin

    uniforms = WaveField.uniforms

    def __post_init__(self) -> None:
        check_numbers(self, not_negative="height depth", positive="period")
        instance("beside of SurfaceWater", self.beside, Water)
        for name in ("north", "down"):
            integer(f"{name} of SurfaceWater", getattr(self, name), 0)
        self._name(("water north",), (1.0,))

    def _name(self, own: tuple[str, ...], scale: tuple[float, ...]) -> None:
        """Set names and scales: those of the other water, then ``own``."""
        water = self.beside
        vars(self).update(
            names=(*water.names, *own), forces=water.forces, scale=(*(water.scale or ()), *scale),
            dt=water.dt, white_increments=water.white_increments, white=water.white,
        )  # fmt: skip

    @cached_property
    def waves(self) -> WaveField:
        """The wave field alone."""
        return WaveField(self.height, self.period)

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Current, and distance [m] by which it has carried the water to the north."""
        return integrated(self.beside.process, (0,), self.beside.dt)

    @cached_property
    def modelled(self) -> "BandedSurfaceWater":  # type: ignore[override]
        """Filters' model of this water, with frequency bands of waves in place of the field."""
        return BandedSurfaceWater(*(getattr(self, each.name) for each in fields(SurfaceWater)))

    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Frequencies and phases of an episode's waves."""
        return self.waves.draw(uniforms)

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Current [m/s] without waves."""
        return self.beside.effect(z[..., : self.beside.process.size], state)

    def effect_at(
        self, drawn: np.ndarray, time: np.ndarray, z: np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Current [m/s], with the orbital velocity of an episode's waves in its first component."""
        depth = np.maximum(self.depth + state[..., self.down], 0.0)
        place = state[..., self.north] - z[..., self.beside.process.size]

        def orbital(w: np.ndarray, phase: np.ndarray) -> list[np.ndarray]:
            return [w * np.exp((-1.0 / GRAVITY) * w * w * depth) * sincos(phase)[1]]

        (each,) = along(orbital, *self.waves.phases(drawn, time, place))
        ahead = each.sum(-1)
        return self._carried(self.waves.amplitude * ahead, z, state)

    def _carried(self, ahead: np.ndarray, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        flow = self.beside.effect(z[..., : self.beside.process.size], state)
        return np.concatenate([(flow[..., 0] + ahead)[..., None], flow[..., 1:]], -1)


@compiled
@dataclass(frozen=True)
class BandedSurfaceWater(SurfaceWater):
    """A filter's model of `SurfaceWater`: frequency bands of waves, not carried by the current."""

    uniforms = 0
    modelled = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        self._name(WaveBands.names, (1.0,) * len(WaveBands.names))

    @cached_property
    def bands(self) -> WaveBands:
        """The frequency bands of the waves alone."""
        return WaveBands(self.height, self.period)

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Current, then the frequency bands of the waves."""
        return Process.joined(self.beside.process, self.bands.process(self.beside.dt))

    @cached_property
    def speeds(self) -> np.ndarray:
        """Standard deviations ``(101, 3)`` of the bands' speeds [m/s] at 0, 1, 2, ... m depth."""
        depths = np.arange(101.0)
        decay = [np.exp(-np.outer(w**2 / GRAVITY, depths)) * w[:, None] for w in self.bands.within]
        return np.sqrt(
            np.stack([self.bands.power(band, each) for band, each in enumerate(decay)], -1)
        )

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Current [m/s], with the waves' velocity in its first component."""
        k, deepest = self.beside.process.size, len(self.speeds) - 1.0
        depth = np.minimum(np.maximum(self.depth + state[..., self.down], 0.0), deepest)
        parts, ahead = self.bands.at(z[..., k:], state[..., self.north]), np.zeros_like(depth)
        speeds = interpolated(self.speeds, depth)
        for band, (real, _) in enumerate(parts):
            ahead = ahead + speeds[..., band] * real
        return self._carried(ahead, z, state)


@compiled
@dataclass(frozen=True)
class Air(Disturbance):
    """Wandering wind, Dryden gusts and turbulence that act on an aircraft.

    Gusts have the low-altitude Dryden spectra (MIL-F-8785C) at a constant airspeed. The vertical
    gust has the second-order form. North and east gusts have the first-order, longitudinal form, so
    that a turn does not change the spectrum. The states are the mean wind north and east, the gusts
    north and east, and two states of the vertical gust [m/s]. Turbulence shorter than a step is
    white noise that adds increments to velocities and bank, with variances in proportion to the
    step's length. A filter that assumes this disturbance has an exact model of it.
    """

    wind: float  # RMS speed of the mean wind, which is horizontal, m/s
    gust: float  # standard deviation of each horizontal gust component, m/s
    vertical_gust: float  # standard deviation of the vertical gust, m/s
    # Standard deviations of what a second of turbulence adds to each velocity, m/s per sqrt(s), and
    # to the bank, rad per sqrt(s); the values in 0.1 s are assumed.
    increment: float = 0.05 / math.sqrt(0.1)
    roll: float = 0.005 / math.sqrt(0.1)
    wind_time: float = 200.0  # correlation time of the mean wind, s; assumed
    length: float = 200.0  # length scale of horizontal gusts, m; Beard & McLain (2012), Table 4.1
    vertical_length: float = 50.0  # length scale of vertical gusts, m; the same table
    airspeed: float = 20.0  # m/s
    dt: float = 0.1  # s

    def __post_init__(self) -> None:
        check_numbers(
            self, not_negative="wind gust vertical_gust increment roll",
            positive="wind_time length vertical_length airspeed dt",
        )  # fmt: skip

    names = (
        "mean wind north", "mean wind east", "gust north", "gust east", "gust down 1",
        "gust down 2",
    )  # fmt: skip
    forces = ("wind north", "wind east", "wind down")
    white_increments = ("north increment", "east increment", "climb increment", "phi increment")
    scale = (1.0, 1.0, 0.5, 0.5, 0.5, 0.5)

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Mean wind and gusts."""
        time, vertical_time = self.length / self.airspeed, self.vertical_length / self.airspeed
        # (1 + sqrt(3) T s) / (1 + T s)^2 of white noise, scaled so that both states have a quarter
        # of the variance
        vertical = np.array([[0.0, 1.0], [-1.0, -2.0]]) / vertical_time
        level = 2.0 * self.gust**2 / time
        A = block_diagonal(-np.eye(2) / time, vertical)
        gusts = Process.stationary(
            A, np.diag([level, level, 0.0, self.vertical_gust**2 / vertical_time]), self.dt
        )
        mean = self.wind / np.sqrt(2.0)
        return Process.joined(Process.wandering((mean, mean), self.wind_time, self.dt), gusts)

    @cached_property
    def white(self) -> np.ndarray:  # type: ignore[override]
        """Root of the covariance of a step's increments of velocities [m/s] and bank [rad]."""
        return np.sqrt(self.dt) * np.diag(
            [self.increment, self.increment, self.increment, self.roll]
        )

    @linear
    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Wind north, east and down [m/s]."""
        mean_north, mean_east, north, east, down, rising = np.moveaxis(z, -1, 0)
        return np.stack([mean_north + north, mean_east + east, rising * np.sqrt(3.0) + down], -1)


@compiled
@dataclass(frozen=True)
class Fault(Disturbance):
    """Fault of an actuator, whose true position differs from the measured one.

    A fault comes with another disturbance, ``beside``. Over a step the difference is ``bias - loss
    * angle + amplitude sin(2 pi t / period + phase)`` plus a random walk, with the angle at the
    step's beginning and a random phase. Filters know which actuator has the fault and estimate its
    size as their unknown input d. The other disturbance is bit for bit the one of an episode
    without the fault.

    Raises:
        ValueError: for a number out of range, or a second fault of the actuator.
    """

    actuator: str  # name in the vehicle's ``faults``, without "fault"
    bias: float = 0.0  # rad, or N of a thrust
    loss: float = 0.0  # share of the actuator's effect that is lost
    amplitude: float = 0.0  # of an oscillation, rad or N
    period: float = 2.0  # of the oscillation, s
    start: float = 0.0  # standard deviation of the random walk at the start, rad or N
    walk: float = 0.0  # standard deviation of what a second adds to the walk
    size: float = float(
        np.deg2rad(5.0)
    )  # rad or N, standard deviation that filters assume where no measurement shows the fault
    beside: Disturbance = field(default_factory=Disturbance)
    dt: float = 0.1  # s

    assumed_as = "unknown-input"

    def __post_init__(self) -> None:
        instance("actuator of a fault", self.actuator, str)
        instance("beside of a fault", self.beside, Disturbance)
        check_numbers(
            "a fault", vars(self), positive="dt size", share="loss", finite="bias amplitude"
        )
        check_numbers("a fault", vars(self), not_negative="start walk")
        number(
            "period of a fault",
            self.period,
            low=2.0 * self.dt,
            what=f"above two steps of {self.dt:g} s",
        )
        other, loss = self.beside, (f"{self.actuator} loss",) if self.loss else ()
        own = (f"{self.actuator} {name}" for _, names, _ in self._own for name in names)
        fault = f"{self.actuator} fault"
        if fault in other.forces:
            raise ValueError(f"a fault has another fault of the {self.actuator} beside it")
        vars(self).update(
            names=(*other.names, *own), forces=(*other.forces, fault, *loss),
            inputs=(*(other.inputs or ()), fault),
            input_sd=(*(other.input_sd or ()), self.size), white_increments=other.white_increments,
            white=other.white, uniforms=other.uniforms, averaged=other.averaged,
        )  # fmt: skip

    @property
    def _own(self) -> list[tuple[Process, tuple[str, ...], tuple[float, ...]]]:
        """Process, names and sizes of the fault's own states: the walk and the oscillation."""
        turn = 2.0 * np.pi * self.dt / self.period
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        own: list[tuple[Process, tuple[str, ...], tuple[float, ...]]] = []
        if self.start or self.walk:
            own.append(
                (Process.walk((self.start,), (self.walk,), self.dt), ("offset",), (self.size,))
            )
        if self.amplitude:
            own.append(
                (
                    Process(rotation, np.zeros((2, 2)), np.eye(2)),
                    ("swing", "swing back"),
                    (1.0, 1.0),
                )
            )
        return own

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Process of the other disturbance, then of the fault."""
        parts = self.beside.process, *(process for process, _, _ in self._own)
        process = Process.joined(*parts)
        vars(process)["start_root"] = block_diagonal(
            *(part.start_root for part in parts)
        )  # each part begins as it does alone
        return process

    @property
    def modelled(self) -> "Fault | None":  # type: ignore[override]
        """This fault, with the other disturbance replaced by its ``modelled`` one."""
        other = self.beside.modelled
        return None if other is None else replace(self, beside=other)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        """Scales of the other disturbance, then of the fault; 1 for the oscillation."""
        there = self.beside.scale or tuple(np.sqrt(np.diag(self.beside.process.start_cov)))
        return *there, *(size for _, _, sizes in self._own for size in sizes)

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Effect of the other disturbance, then the fault: additions to actuators, lost shares."""
        return self._with_fault(self.beside.effect(z[..., : self.beside.process.size], state), z)

    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Constants of the other disturbance."""
        return self.beside.draw(uniforms)

    def effect_at(
        self, drawn: np.ndarray, time: np.ndarray, z: np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """As `effect`, at a time of an episode."""
        return self._with_fault(
            self.beside.effect_at(drawn, time, z[..., : self.beside.process.size], state), z
        )

    def _with_fault(self, others: np.ndarray, z: np.ndarray) -> np.ndarray:
        k = self.beside.process.size
        offset = np.zeros(z.shape[:-1]) + self.bias
        if self.start or self.walk:
            offset = offset + z[..., k]
        if self.amplitude:
            offset = offset + self.amplitude * z[..., -2] / np.maximum(
                np.hypot(z[..., -2], z[..., -1]), 1e-12
            )
        lost = [np.full(z.shape[:-1], self.loss)] if self.loss else []
        return np.concatenate([others, np.stack([offset, *lost], -1)], -1)
