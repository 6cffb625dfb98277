"""Disturbances by sea and air: waves, gusts, turbulence, currents and winds, all made from white noise.

And what a vehicle does to itself: faults of its actuators.

A disturbance has a state of its own, z, and acts on a vehicle through the parts of its exogenous
input. Yours is a subclass of `Disturbance`: docs/own-disturbance.md.
"""

import math
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from estimators.checks import integer, number
from estimators.engine import along, sincos
from vessel_gym.checks import check_names, check_numbers, instance
from vessel_gym.processes import Process, integrated, interpolated, linear
from vessel_gym.verified import Verified
from vessel_gym.waves import GRAVITY, WaveBands, WaveField


class Disturbance(Verified, verified=True):
    """Disturbance of a vehicle over a step, which no sensor reads as such.

    Its state moves as ``z+ = transition z + root n``; over a step it gives the vehicle ``effect(z,
    state)`` and, besides, white increments ``white n'``, with standard normals n and n'.

    Attributes:
        names: The components of z.
        forces: The parts of a vehicle's exogenous input (its increments and flows, see
            `vessel_gym.system.Vehicle`) that `effect` gives, in order.
        process: How z moves; its ``start_cov`` is what is known of z at the start.
        white_increments: The increments that are white noise,
        white: and a root ``(len(white_increments), m)`` of their covariance.
        assumed_as: How filters assume it unless ``estimator_options={"assume": ...}`` says
            otherwise, see `vessel_gym.filter_models.build.ASSUMED`.
        inputs: What the unknown input d is, where filters assume one: names of what it ``forces``
            or ``white_increments``, or ``"change of NAME"`` for what a step adds to one of its
            ``names``; None: its increments.
        input_sd: Standard deviations that filters take d to have where no measurement shows it;
            None: what follows from `process` and ``white``.
        scale: Sizes of z that count as 1 in an observation of standard deviations; None: those at
            the start.
        averaged: What of its ``forces`` is a mean over the coming step, which no sensor may read.
        dt: The step [s] that it was made for; None: any.
        believed: What filters take it for unless another is named; None: what it is.
        modelled: What filters that assume it have in its place; None: what it is.
        uniforms: Uniform random numbers that an episode draws, of which `draw` makes constants.
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
        """The state z ``(..., k)`` as a vehicle meets it that has moved from one state ``(..., n)`` to another: z."""
        return z

    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Constants of an episode ``(..., e)``, of ``uniforms (..., u)`` from 0 to 1."""
        return uniforms

    def effect_at(
        self, drawn: np.ndarray, time: np.ndarray, z: np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Effect at a ``time (...)`` [s] of an episode that has drawn ``(..., e)``, without which it is `effect`."""
        return self.effect(z, state)

    @linear
    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Effect of z on a vehicle in a state, ``(..., len(forces))``: z itself.

        Yours may be any function of both; faster if it is declared to be
        `vessel_gym.processes.linear` in z, wherever the vehicle is.

        Args:
            z: ``(..., k)``.
            state: ``(..., n)`` of the vehicle: where it is, where it heads and how fast.
        """
        return z


@dataclass(frozen=True)
class Sea(Disturbance, verified=True):
    """Disturbance of a ship's heading and track: wave and gust yaw rate, and a current.

    The wave yaw rate follows the second-order linear wave model ``s / (s^2 + 2 lambda w0 s +
    w0^2)`` with the damping that fits a JONSWAP peak (Fossen 2011, sec. 8.2.6); gust and current
    are first-order Gauss-Markov processes. Their state is (wave yaw angle, wave yaw rate, gust yaw
    rate, current north, current east), stationary from the first step.
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
        A = block_diag(
            wave, -1.0 / self.gust_time, -1.0 / self.current_time, -1.0 / self.current_time
        )
        drift = (
            2.0 * self.current**2 / (2.0 * self.current_time)
        )  # each component carries half the power
        W = np.diag([0.0, 4.0 * self.damping * self.peak * self.wave**2, 2.0 * self.gust**2 / self.gust_time, drift,
                     drift])  # fmt: skip
        return Process.stationary(A, W, self.dt)

    @linear
    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """The yaw increment d [rad] over the coming step, and the current north and east [m/s]: ``(..., 3)``."""
        increment = self.dt * (z[..., 1] + z[..., 2])
        return np.concatenate([increment[..., None], z[..., 3:]], -1)


@dataclass(frozen=True)
class Water(Disturbance, verified=True):
    """Disturbance of a submerged vehicle by water: turbulence, and a current that wanders.

    Turbulence is white noise on every acceleration of the vehicle through the water: each step adds
    an increment to its velocities, with a variance in proportion to the step's length. The current
    is a first-order Gauss-Markov process. A filter that assumes all of it knows all that there is
    to know.
    """

    turbulence: float  # standard deviation of what a second adds to a velocity, m/s per sqrt(s)
    spin: float  # of what a second adds to a rate, rad/s per sqrt(s)
    current: float  # RMS speed, m/s
    velocities: tuple[str, ...] = ("u", "v", "w")  # that get increments,
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
        """The current [m/s], whose components share its power."""
        sd = self.current / np.sqrt(len(self.names))
        return Process.wandering((sd,) * len(self.names), self.current_time, self.dt)

    @cached_property
    def white(self) -> np.ndarray:  # type: ignore[override]
        """Increments of a step [m/s, rad/s]."""
        in_a_second = np.repeat(
            [self.turbulence, self.spin], [len(self.velocities), len(self.rates)]
        )
        return np.sqrt(self.dt) * np.diag(in_a_second)


@dataclass(frozen=True)
class SurfaceWater(Disturbance, verified=True):
    """Water near the surface: beside what else it does, waves carry a submerged vehicle to and fro.

    The horizontal orbital velocity of a `WaveField` that runs to the north, and that the current
    carries, dies away with the depth as ``exp(-k z)`` (Airy), and is that of a current; the
    vertical one is left out.
    """

    height: float  # significant, m
    period: float  # of the spectrum's peak, s
    beside: Water
    north: int  # which component of the vehicle's state is its place north,
    down: int  # and which its depth
    depth: float = 2.0  # m, of the place 0

    uniforms = WaveField.uniforms

    def __post_init__(self) -> None:
        check_numbers(self, not_negative="height depth", positive="period")
        instance("beside of SurfaceWater", self.beside, Water)
        for name in ("north", "down"):
            integer(f"{name} of SurfaceWater", getattr(self, name), 0)
        self._name(("water north",), (1.0,))

    def _name(self, own: tuple[str, ...], scale: tuple[float, ...]) -> None:
        """Name what is of the other water, and its own components of the state."""
        water = self.beside
        vars(self).update(
            names=(*water.names, *own), forces=water.forces, scale=(*(water.scale or ()), *scale), dt=water.dt,
            white_increments=water.white_increments, white=water.white,
        )  # fmt: skip

    @cached_property
    def waves(self) -> WaveField:
        """The waves alone."""
        return WaveField(self.height, self.period)

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """The current, and how far it has carried the water north."""
        return integrated(self.beside.process, (0,), self.beside.dt)

    @cached_property
    def modelled(self) -> "BandedSurfaceWater":  # type: ignore[override]
        """The water in which filters that assume it have bands in place of the field."""
        return BandedSurfaceWater(*(getattr(self, each.name) for each in fields(SurfaceWater)))

    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Frequencies and phases of the waves of an episode."""
        return self.waves.draw(uniforms)

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """The current [m/s], where there are no waves."""
        return self.beside.effect(z[..., : self.beside.process.size], state)

    def effect_at(
        self, drawn: np.ndarray, time: np.ndarray, z: np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """The current with what the waves of an episode add to its first component [m/s]."""
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


@dataclass(frozen=True)
class BandedSurfaceWater(SurfaceWater, verified=True):
    """A filter's model of `SurfaceWater`: its waves are `WaveBands`, at rest over ground."""

    uniforms = 0
    modelled = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        self._name(WaveBands.names, (1.0,) * len(WaveBands.names))

    @cached_property
    def bands(self) -> WaveBands:
        """The waves alone."""
        return WaveBands(self.height, self.period)

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """The current, then the waves."""
        return Process.joined(self.beside.process, self.bands.process(self.beside.dt))

    @cached_property
    def speeds(self) -> np.ndarray:
        """Standard deviations of the velocity in each band [m/s] at depths of 0, 1, 2 ... metres, ``(101, 3)``."""
        depths = np.arange(101.0)
        decay = [np.exp(-np.outer(w**2 / GRAVITY, depths)) * w[:, None] for w in self.bands.within]
        return np.sqrt(
            np.stack([self.bands.power(band, each) for band, each in enumerate(decay)], -1)
        )

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """The current with what waves add to its first component [m/s]."""
        k, deepest = self.beside.process.size, len(self.speeds) - 1.0
        depth = np.minimum(np.maximum(self.depth + state[..., self.down], 0.0), deepest)
        parts, ahead = self.bands.at(z[..., k:], state[..., self.north]), np.zeros_like(depth)
        speeds = interpolated(self.speeds, depth)
        for band, (real, _) in enumerate(parts):
            ahead = ahead + speeds[..., band] * real
        return self._carried(ahead, z, state)


@dataclass(frozen=True)
class Air(Disturbance, verified=True):
    """Disturbance of an aircraft by air: a wind that wanders, Dryden gusts on top of it, and turbulence that shakes it.

    Low-altitude Dryden spectra (MIL-F-8785C) as met at a constant airspeed: the vertical gust has
    the second-order form; north and east have the first-order, longitudinal one, so that a turn
    does not change the spectrum. The state is the mean wind north and east and that of the gusts
    (north, east, two of the vertical) [m/s]. Turbulence that is shorter than a step is white noise:
    it adds increments to velocities and bank, with variances in proportion to the step's length. A
    filter that assumes all of it knows all that there is to know.
    """

    wind: float  # RMS speed of the mean wind, which is level, m/s
    gust: float  # standard deviation of a level gust component, m/s
    vertical_gust: float  # of the vertical one, m/s
    # Standard deviations of what a second of turbulence adds to each velocity, m/s per sqrt(s), and
    # to the bank, rad per sqrt(s): those in 0.1 s are assumed.
    increment: float = 0.05 / math.sqrt(0.1)
    roll: float = 0.005 / math.sqrt(0.1)
    wind_time: float = 200.0  # s, in which the mean wind changes; assumed
    length: float = 200.0  # m, of level gusts; Beard & McLain (2012), Table 4.1
    vertical_length: float = 50.0  # m, of vertical ones; there too
    airspeed: float = 20.0  # m/s
    dt: float = 0.1  # s

    def __post_init__(self) -> None:
        check_numbers(
            self, not_negative="wind gust vertical_gust increment roll",
            positive="wind_time length vertical_length airspeed dt",
        )  # fmt: skip

    names = (
        "mean wind north", "mean wind east", "gust north", "gust east", "gust down 1", "gust down 2",
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
        A = block_diag(-1.0 / time, -1.0 / time, vertical)
        gusts = Process.stationary(
            A, np.diag([level, level, 0.0, self.vertical_gust**2 / vertical_time]), self.dt
        )
        mean = self.wind / np.sqrt(2.0)
        return Process.joined(Process.wandering((mean, mean), self.wind_time, self.dt), gusts)

    @cached_property
    def white(self) -> np.ndarray:  # type: ignore[override]
        """Increments of a step on velocities [m/s] and bank [rad]."""
        return np.sqrt(self.dt) * np.diag(
            [self.increment, self.increment, self.increment, self.roll]
        )

    @linear
    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """The wind north, east and down [m/s]."""
        mean_north, mean_east, north, east, down, rising = np.moveaxis(z, -1, 0)
        return np.stack([mean_north + north, mean_east + east, rising * np.sqrt(3.0) + down], -1)


@dataclass(frozen=True)
class Fault(Disturbance, verified=True):
    """A fault of an actuator beside whatever else acts: the actuator is not where it is measured to be.

    Over a step it is off by ``bias - loss * angle + amplitude sin(2 pi t / period + phase)`` and by
    a random walk: the angle is that at the step's beginning, the phase is random. Filters know
    where the fault is, and not how large: it is their unknown input d. What else acts is the same
    to the last bit as without the fault.

    Raises:
        ValueError: for a number out of range.
    """

    actuator: str  # as the vehicle calls it
    bias: float = 0.0  # rad, or N of a thrust
    loss: float = 0.0  # share of its effect that is lost
    amplitude: float = 0.0  # of an oscillation, rad or N
    period: float = 2.0  # s
    start: float = 0.0  # standard deviation of the walk at first, rad or N
    walk: float = 0.0  # of what a second adds to it
    size: float = float(
        np.deg2rad(5.0)
    )  # rad or N, that filters take it to have where no measurement shows it
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
        vars(self).update(
            names=(*other.names, *(f"{self.actuator} {name}" for _, own, _ in self._own for name in own)),
            forces=(*other.forces, f"{self.actuator} fault", *loss),
            inputs=(*(other.inputs or ()), f"{self.actuator} fault"), input_sd=(*(other.input_sd or ()), self.size),
            white_increments=other.white_increments, white=other.white, uniforms=other.uniforms,
            averaged=other.averaged,
        )  # fmt: skip

    @property
    def _own(self) -> list[tuple[Process, tuple[str, ...], tuple[float, ...]]]:
        """Parts of its state behind that of what else acts, a walk and a swing: process, names and sizes of each."""
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
        """Of what else acts, then its own."""
        parts = self.beside.process, *(process for process, _, _ in self._own)
        process = Process.joined(*parts)
        vars(process)["start_root"] = block_diag(
            *(part.start_root for part in parts)
        )  # each begins as it does alone
        return process

    @property
    def modelled(self) -> "Fault | None":  # type: ignore[override]
        """The fault beside what filters have in place of the other disturbance."""
        other = self.beside.modelled
        return None if other is None else replace(self, beside=other)

    @property
    def scale(self) -> tuple[float, ...]:  # type: ignore[override]
        """Of what else acts; that of the fault; 1 of what swings."""
        there = self.beside.scale or tuple(np.sqrt(np.diag(self.beside.process.start_cov)))
        return *there, *(size for _, _, sizes in self._own for size in sizes)

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Effect of the other disturbance, the fault without its loss, and the share that is lost."""
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
