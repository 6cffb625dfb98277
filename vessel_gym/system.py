"""What an environment is made of: a vehicle, a task, disturbances and a default estimator, as data."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from estimators import Belief, Gaussian, LinearModel, NonlinearModel
from vessel_gym.sensors import Instrument


class Vehicle(Protocol):
    """A vehicle in batches ``(B, ...)``: actuators, truth, exact readings and models for filters.

    The equations may be compiled or plain NumPy: anything that broadcasts over leading axes.
    """

    @property
    def dt(self) -> float:
        """Time step [s]."""

    @property
    def truth_names(self) -> tuple[str, ...]:
        """Components of the true state."""

    @property
    def action_names(self) -> tuple[str, ...]:
        """Components of the action."""

    @property
    def instruments(self) -> tuple[Instrument, ...]:
        """Sensors, in the order of the readings."""

    @property
    def unknown_inputs(self) -> int:
        """q: the first components of the forcing, which are the unknown input d that filters may estimate."""

    @property
    def normals(self) -> int:
        """How many normal numbers `parameters` needs."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Components of the parameters."""

    def parameters(self, mismatch: float, normals: np.ndarray) -> np.ndarray:
        """The truth's parameters ``(B, k)``, spread around the filter's."""

    def start(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """True state and actuators ``(B, a)`` from the state that the task's prior describes."""

    def filter_state(self, truth: np.ndarray, n: int) -> np.ndarray:
        """The first ``n`` components that filters estimate, out of the truth."""

    def actuate(self, actuators: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Actuators one step later, within limits and rates."""

    def step(
        self,
        truth: np.ndarray,
        before: np.ndarray,
        after: np.ndarray,
        forcing: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:
        """The truth one step later, with actuators moving from ``before`` to ``after``."""

    def readings(self, truth: np.ndarray, forcing: np.ndarray) -> np.ndarray:
        """What perfect sensors would read ``(B, p)``."""

    def model(self, kind: str, noise: float, disturbance: Any) -> LinearModel | NonlinearModel:
        """A filter's model of this vehicle, with sensors ``noise`` times nominal, in a disturbance."""

    def from_readings(
        self, readings: np.ndarray, previous: np.ndarray, interval: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """State and unknown input from the readings alone, differenced where no sensor gives a rate.

        Args:
            readings: ``(..., p)`` the last reading of every channel.
            previous: ``(..., p)`` the one before.
            interval: ``(..., p)`` seconds between the two.
        """


def estimated_names(vehicle: Vehicle, n: int | None = None) -> tuple[str, ...]:
    """Which components of the truth a vehicle's filters estimate, by name, in their order; empty if they mix them.

    Args:
        vehicle: Whose.
        n: How many are estimated; None: as many as may be.
    """
    names = vehicle.truth_names
    marks = np.arange(len(names), dtype=float)
    # What picks components does so from any truth: it shows which by their numbers, and from other numbers the same.
    picked, again = (vehicle.filter_state(x, len(names) if n is None else n) for x in (marks, marks**2 + 0.5))
    chosen = picked.astype(int)
    if not (np.isin(picked, marks).all() and (again == chosen**2 + 0.5).all()):
        return ()
    return tuple(names[i] for i in chosen)


class Disturbance(Protocol):
    """A stochastic process with one state ``(B, size)`` an environment."""

    @property
    def size(self) -> int:
        """Size of the state, and normal numbers a step."""

    def start(self, normals: np.ndarray) -> np.ndarray:
        """A stationary state."""

    def advance(self, state: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """The state one step later."""

    def forcing(self, state: np.ndarray) -> np.ndarray:
        """What acts on the vehicle over the coming step, and no filter is told: the unknown input d first."""


class Task(Protocol):
    """What is asked. ``observe`` has no parameter through which truth could come; ``score`` alone reads it."""

    @property
    def horizon(self) -> int:
        """Steps of a full episode."""

    @property
    def perfect(self) -> float:
        """Sum of the rewards of a perfect episode: what the score is relative to."""

    @property
    def ends(self) -> tuple[str, ...]:
        """Why an episode may end, by number; number 0 is that it goes on."""

    @property
    def success(self) -> str:
        """Which of ``ends`` means success; empty where success is to go on to the time limit."""

    @property
    def states(self) -> int:
        """Size of the prior."""

    @property
    def uniforms(self) -> int:
        """How many uniform numbers `course` needs."""

    @property
    def BOUND(self) -> float:
        """Observations are clipped to +- this."""

    def course(self, uniforms: np.ndarray, options: dict[str, Any]) -> np.ndarray:
        """What is drawn at reset, ``(B, k)``."""

    def prior(self, course: np.ndarray, disturbance: Any) -> Gaussian:
        """Where the truth starts, and all that the estimator knows of it: mean ``(B, n)``, covariance ``(n, n)``."""

    def reference(self, course: np.ndarray, step: np.ndarray, state: np.ndarray) -> np.ndarray:
        """What is commanded at a step, the vehicle being (or believed to be) in a state ``(B, n)``."""

    def known_input(self, before: np.ndarray, after: np.ndarray, course: np.ndarray, step: np.ndarray) -> np.ndarray:
        """What filters are told over a step."""

    def sizes(self) -> dict[str, int]:
        """Length of an observation for each mode of ``observe``."""

    def observe(self, belief: Belief, reference: np.ndarray, actuators: np.ndarray) -> np.ndarray:
        """The observation from estimates."""

    def observe_std(self, belief: Belief) -> np.ndarray:
        """What mode ``"mean+std"`` appends."""

    def observe_readings(
        self,
        readings: np.ndarray,
        available: np.ndarray,
        course: np.ndarray,
        step: np.ndarray,
        actuators: np.ndarray,
    ) -> np.ndarray:
        """The observation of mode ``"measurement"``: nothing that an estimator believes."""

    def begin(self, truth: np.ndarray, course: np.ndarray) -> np.ndarray:
        """What `score` remembers, ``(B, k)``, at the start of an episode."""

    def score(
        self, truth: np.ndarray, reference: np.ndarray, actuators: np.ndarray, action: np.ndarray, tally: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Reward in [0, 1], the number in ``ends`` of why the episode ends (0: it goes on), and the next tally."""


@dataclass(frozen=True)
class System:
    """One environment as data.

    Attributes:
        name: The environment's id.
        vehicle: What moves.
        task: What is asked of it.
        disturbances: By name: ``"calm"``, ``"moderate"``, ``"rough"``.
        estimator: The default estimator.
        filter_model: The vehicle's model that filters use, unless ``filter_models`` says otherwise.
        tuning: Options of a filter by name, given the disturbance.
        filter_models: Models of particular filters.
    """

    name: str
    vehicle: Vehicle
    task: Task
    disturbances: Mapping[str, Disturbance]
    estimator: str
    filter_model: str
    tuning: Callable[[str, Any], dict[str, Any]]
    filter_models: Mapping[str, str] = field(default_factory=dict)
