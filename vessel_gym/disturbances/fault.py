"""Faults of actuators."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from estimators.checks import number
from estimators.engine import compiled
from vessel_gym.checks import check_numbers, instance
from vessel_gym.disturbances.disturbance import Disturbance
from vessel_gym.processes import Process, block_diagonal


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
    # rad or N, standard deviation that filters assume where no measurement shows the fault
    size: float = float(np.deg2rad(5.0))
    beside: Disturbance = field(default_factory=Disturbance)
    dt: float = 0.1  # s

    assumed_as = "unknown-input"

    def __post_init__(self) -> None:
        instance("actuator of a fault", self.actuator, str)
        instance("beside of a fault", self.beside, Disturbance)
        check_numbers(
            "a fault", vars(self), positive="dt size", share="loss", finite="bias amplitude",
            not_negative="start walk",
        )  # fmt: skip
        two_steps = f"above two steps of {self.dt:g} s"
        number("period of a fault", self.period, low=2.0 * self.dt, what=two_steps)
        other, loss = self.beside, (f"{self.actuator} loss",) if self.loss else ()
        own = (f"{self.actuator} {name}" for _, sizes in self._own for name in sizes)
        fault = f"{self.actuator} fault"
        if fault in other.forces:
            raise ValueError(f"a fault has another fault of the {self.actuator} beside it")
        vars(self).update(
            names=(*other.names, *own), forces=(*other.forces, fault, *loss),
            inputs=(*(other.inputs or ()), fault),
            input_sd=(*(other.input_sd or ()), self.size), white_increments=other.white_increments,
            white=other.white, uniforms=other.uniforms, averaged=other.averaged,
        )  # fmt: skip

    @cached_property
    def _own(self) -> list[tuple[Process, dict[str, float]]]:
        """Processes of the walk and of the oscillation, with sizes of their states by name."""
        own = []
        if self.start or self.walk:
            walk = Process.walk((self.start,), (self.walk,), self.dt)
            own.append((walk, {"offset": self.size}))
        if self.amplitude:
            turn = 2.0 * np.pi * self.dt / self.period
            rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
            swing = Process(rotation, np.zeros((2, 2)), np.eye(2))
            own.append((swing, {"swing": 1.0, "swing back": 1.0}))
        return own

    @cached_property
    def process(self) -> Process:  # type: ignore[override]
        """Process of the other disturbance, then of the fault."""
        parts = self.beside.process, *(process for process, _ in self._own)
        process = Process.joined(*parts)
        # each part begins as it does alone
        vars(process)["start_root"] = block_diagonal(*(part.start_root for part in parts))
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
        return *there, *(size for _, sizes in self._own for size in sizes.values())

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
            size = np.maximum(np.hypot(z[..., -2], z[..., -1]), 1e-12)
            offset = offset + self.amplitude * z[..., -2] / size
        lost = [np.full(z.shape[:-1], self.loss)] if self.loss else []
        return np.concatenate([others, np.stack([offset, *lost], -1)], -1)
