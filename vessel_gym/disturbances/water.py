"""Water around a submerged vehicle: currents, turbulence, and waves above it."""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from estimators.engine import compiled, sincos
from vessel_gym.checks import check_names, check_numbers, instance
from vessel_gym.disturbances.disturbance import Disturbance
from vessel_gym.disturbances.spectrum import WaveSpectrum
from vessel_gym.disturbances.waves import InWaves, WaveBands
from vessel_gym.processes import Process, integrated, interpolated
from vessel_gym.vehicles.vehicle import GRAVITY


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
class SurfaceWater(InWaves):
    """Water near the surface, with waves that carry a submerged vehicle to and fro.

    The waves are a `WaveField` of a `WaveSpectrum`, which the current carries. Their horizontal
    orbital velocity decays with depth as ``exp(-k z)`` (Airy) and is added to the current; a
    vehicle in the vertical plane meets its north component. The vertical velocity is left out.
    """

    spectrum: WaveSpectrum
    beside: Water
    place: tuple[int, ...]  # indices of the vehicle's position north and east, or north alone
    down: int  # index of its depth
    depth: float = 2.0  # m, depth of the origin

    def __post_init__(self) -> None:
        instance("spectrum of SurfaceWater", self.spectrum, WaveSpectrum)
        instance("beside of SurfaceWater", self.beside, Water)
        check_numbers(self, not_negative="depth")
        if len(self.place) != len(self.beside.names):
            raise ValueError(
                f"place of SurfaceWater needs one index for each of {self.beside.names}"
            )
        self._name(("water north", "water east")[: len(self.place)])

    def _name(self, own: tuple[str, ...]) -> None:
        """Set names and scales: those of the other water, then ``own`` with the scale 1."""
        water = self.beside
        vars(self).update(
            names=(*water.names, *own), forces=water.forces, dt=water.dt,
            scale=(*(water.scale or ()), *(1.0,) * len(own)),
            white_increments=water.white_increments, white=water.white,
        )  # fmt: skip

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Current, and distances [m] by which it has carried the water north and east."""
        return integrated(self.beside.process, range(len(self.place)), self.beside.dt)

    @cached_property
    def modelled(self) -> "BandedSurfaceWater":  # type: ignore[override]
        """Filters' model of this water, with frequency bands of waves in place of the field."""
        return BandedSurfaceWater(*(getattr(self, each.name) for each in fields(SurfaceWater)))

    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Constants of an episode's waves, see `WaveField.draw`."""
        return self.waves.draw(uniforms)

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Current [m/s] without waves."""
        return z[..., : len(self.place)]

    def effect_at(
        self, drawn: np.ndarray, time: np.ndarray, z: np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Current [m/s], with the orbital velocity of an episode's waves."""
        depth, count = np.maximum(self.depth + state[..., self.down], 0.0), len(self.place)
        places = [state[..., own] - z[..., count + i] for i, own in enumerate(self.place)]

        def orbital(w: Any, kx: Any, ky: Any, phase: Any) -> list[Any]:
            size = GRAVITY / w * np.exp((-1.0 / GRAVITY) * w * w * depth) * sincos(phase)[1]
            return [size * kx, size * ky][:count]

        north, east = (*places, 0.0)[:2]
        velocity = self.waves.superposition(orbital, drawn, time, north, east)
        return z[..., :count] + np.stack(velocity, -1)


@compiled
@dataclass(frozen=True)
class BandedSurfaceWater(SurfaceWater):
    """A filter's model of `SurfaceWater`: frequency bands of waves, not carried by the current."""

    uniforms = 0
    modelled = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        self._name(WaveBands.names)

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Current, then the waves."""
        return Process.joined(self.beside.process, self.bands.process(self.beside.dt))

    @cached_property
    def speeds(self) -> np.ndarray:
        """Velocities [m/s] north and east of a unit of each wave at 0, 1, 2, ... m depth.

        The shape is ``(101, 4 * 2)``, or ``(101, 4)`` for a vehicle in the vertical plane.
        """
        depths = np.arange(101.0)

        def of_waves(w: np.ndarray, direction: np.ndarray) -> np.ndarray:
            way = np.stack([np.cos(direction), np.sin(direction)], -1)[..., : len(self.place)]
            decay = w[:, None] * np.exp(-np.outer(w**2 / GRAVITY, depths))
            return decay[..., None] * way[:, None, :]

        loadings = self.bands.loadings(of_waves).real
        return np.moveaxis(loadings, 0, 1).reshape(len(depths), -1)

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Current [m/s], with the waves' velocity."""
        count, deepest = len(self.place), len(self.speeds) - 1.0
        depth = np.minimum(np.maximum(self.depth + state[..., self.down], 0.0), deepest)
        north, east = (*(state[..., own] for own in self.place), np.zeros_like(depth))[:2]
        parts, speeds = self.bands.at(z[..., count:], north, east), interpolated(self.speeds, depth)
        flow = z[..., :count]
        for wave, (real, _) in enumerate(parts):
            flow = flow + speeds[..., wave * count : (wave + 1) * count] * real[..., None]
        return flow
