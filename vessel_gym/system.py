"""What an environment is made of: a vehicle, a task, disturbances and a default estimator, as data."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from estimators import Belief, Gaussian, LinearModel, NonlinearModel


class Vehicle(Protocol):
    """A vehicle in batches ``(B, ...)``: actuators, truth, exact readings and models for filters."""

    dt: float
    truth_names: tuple[str, ...]
    action_names: tuple[str, ...]
    reading_names: tuple[str, ...]
    reading_sd: np.ndarray
    normals: int

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray: ...
    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...
    def filter_state(self, truth: np.ndarray, n: int) -> np.ndarray: ...
    def actuate(self, actuators: np.ndarray, action: np.ndarray) -> np.ndarray: ...
    def step(
        self,
        truth: np.ndarray,
        before: np.ndarray,
        after: np.ndarray,
        unknown_input: np.ndarray,
        current: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray: ...
    def readings(self, truth: np.ndarray, unknown_input: np.ndarray) -> np.ndarray: ...
    def model(self, kind: str, noise: float) -> LinearModel | NonlinearModel: ...
    def from_readings(
        self, readings: np.ndarray, previous: np.ndarray, elapsed: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]: ...


class Disturbance(Protocol):
    """A stochastic process, one state ``(B, size)`` an environment."""

    size: int

    def start(self, normals: np.ndarray) -> np.ndarray: ...
    def advance(self, state: np.ndarray, normals: np.ndarray) -> np.ndarray: ...
    def unknown_input(self, state: np.ndarray) -> np.ndarray: ...
    def current_velocity(self, state: np.ndarray) -> np.ndarray: ...


class Task(Protocol):
    """What is asked. ``observe`` has no parameter through which truth could come; ``score`` alone reads it."""

    horizon: int
    states: int
    uniforms: int
    BOUND: float

    def course(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray: ...
    def prior(self, course: np.ndarray) -> Gaussian: ...
    def reference(self, course: np.ndarray, step: np.ndarray) -> np.ndarray: ...
    def known_input(self, before: np.ndarray, after: np.ndarray, reference: np.ndarray) -> np.ndarray: ...
    def sizes(self) -> dict[str, int]: ...
    def observe(self, belief: Belief, reference: np.ndarray, actuators: np.ndarray) -> np.ndarray: ...
    def observe_std(self, belief: Belief) -> np.ndarray: ...
    def observe_readings(
        self, readings: np.ndarray, available: np.ndarray, reference: np.ndarray, actuators: np.ndarray
    ) -> np.ndarray: ...
    def score(
        self, truth: np.ndarray, reference: np.ndarray, action: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]: ...


@dataclass(frozen=True)
class System:
    """One environment as data."""

    vehicle: Vehicle
    task: Task
    disturbances: Mapping[str, Disturbance]
    estimator: str
    """The default estimator."""
    filter_model: str
    """The vehicle's model that filters use, unless `filter_models` says otherwise."""
    tuning: Callable[[str, Any], dict[str, Any]]
    """Options of a filter by name, given the disturbance."""
    filter_models: Mapping[str, str] = field(default_factory=dict)
