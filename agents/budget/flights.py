"""Flights of suites: jobs, whose results are kept, so that an interrupted search loses nothing."""

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import agents.jobs
from agents.agent import load_agent
from agents.budget.search import TRUTH, Request
from agents.budget.suites import Suite, sensors_of
from agents.jobs import Job
from agents.named import named_object
from agents.rollouts import rollout
from agents.seeds import evaluation_seeds
from agents.studies.records import ORACLE
from agents.studies.worlds import digests, environment_id, import_own, registered, system_of

PART = 256
"""The most episodes of a job, so that a long flight is shared by several processes."""


@dataclass(frozen=True)
class World:
    """Environment, agent, estimator and disturbance of a search.

    Attributes:
        environment: As `agents.studies.worlds.environment_id` takes it.
        estimator: Its name, or ``"module:object"``; None: the environment's default.
        agent: As `agents.load_agent` takes it.
        disturbance: Its name.
    """

    environment: str
    estimator: str | None = None
    agent: str = "autopilot"
    disturbance: str = "moderate"

    def check(self) -> None:
        """Refuse what the environment does not take.

        Raises:
            ValueError: naming the mistake.
        """
        with closing(self.made(None)) as env:
            load_agent(self.agent, env)

    def options(self, estimator: str | None) -> dict[str, Any]:
        """Options of the environment."""
        chosen = (
            named_object(estimator) if estimator is not None and ":" in estimator else estimator
        )
        return {"estimator": chosen, "disturbance": self.disturbance}

    def made(self, sensors: Any) -> Any:
        """A batch of one, on sensors of one's own if there are some."""
        extra = {} if sensors is None else {"sensors": sensors}
        return gym.make_vec(
            environment_id(self.environment), num_envs=1, **self.options(self.estimator), **extra
        )

    @property
    def own(self) -> dict[str, str]:
        """Digests of the user's own modules, by name, and of the agent's file, by its path."""
        modules = digests(self.environment, self.estimator or "")
        path = Path(self.agent)
        if path.is_file():
            return modules | {self.agent: sha256(path.read_bytes()).hexdigest()}
        return modules | digests(self.agent) | registered(self.environment, self.agent)


@dataclass
class Flights:
    """Flies suites by jobs, as `agents.budget.search` asks for them.

    Attributes:
        world: The rest of what is flown.
        suites: By their numbers.
        folder: Keeps the results.
        processes: Processes on this machine.
        first_seed: Number of the first evaluation seed, from which requests count.
        refusals: Reason for each suite that the environment refuses.
    """

    world: World
    suites: Sequence[Suite]
    folder: Path
    processes: int = 1
    first_seed: int = 0
    refusals: dict[int, str] = field(default_factory=dict)

    def __call__(self, requests: Sequence[Request]) -> list[np.ndarray | None]:
        """Scores of each request, see `agents.budget.search.Fly`.

        Raises:
            RuntimeError: if a flight failed.
            OSError: if the results cannot be written.
        """
        parts = {request: list(self._jobs(request)) for request in requests}
        outcome = agents.jobs.run(
            (job for jobs in parts.values() for job in jobs), self.folder, self.processes
        )
        for failure in outcome.failures.values():
            raise RuntimeError(f"a flight failed:\n{failure}")
        return [
            self._scores(request, [outcome.values[job.key] for job in jobs])
            for request, jobs in parts.items()
        ]

    def _jobs(self, request: Request) -> Iterator[Job]:
        truth = request.suite == TRUTH
        end = request.first + request.episodes
        for first in range(request.first, end, PART):
            arguments = asdict(replace(self.world, estimator=ORACLE) if truth else self.world) | {
                "names": None if truth else self.suites[request.suite].names,
                "first_seed": self.first_seed + first,
                "episodes": min(PART, end - first),
                "own": self.world.own,
            }
            label = "truth" if truth else str(self.suites[request.suite])
            yield Job("agents.budget.flights:fly", arguments, label)

    def _scores(self, request: Request, values: list[dict[str, Any]]) -> np.ndarray | None:
        for value in values:
            if "refused" in value:
                self.refusals[request.suite] = value["refused"]
                return None
        return np.concatenate([value["score"] for value in values])


def fly(
    environment: str,
    estimator: str | None,
    agent: str,
    disturbance: str,
    names: dict[str, list[Any]] | None,
    first_seed: int,
    episodes: int,
    own: dict[str, str],
) -> dict[str, Any]:
    """Fly a suite, and score its episodes on the truth.

    Args:
        environment: As in `World`, as are estimator, agent and disturbance.
        estimator: None: the environment's default.
        agent: Flies.
        disturbance: Its name.
        names: Grade and rate by sensor; None: the nominal sensors.
        first_seed: See `agents.seeds.evaluation_seeds`.
        episodes: Number of seeds.
        own: See `World.own`.

    Returns:
        ``score (N,)``; or ``refused``, why the environment cannot fly the estimator on these
        sensors.
    """
    import_own({name: digest for name, digest in own.items() if name != agent})
    world = World(environment, estimator, agent, disturbance)
    sensors = None if names is None else sensors_of(system_of(environment), names)
    try:
        world.made(sensors).close()
    except (ValueError, TypeError) as error:
        return {"refused": str(error)}
    options = world.options(estimator) | ({} if sensors is None else {"sensors": sensors})
    seeds = evaluation_seeds(episodes, first_seed)
    return {
        "score": rollout(agent, environment_id(environment), seeds, options, record=False).score
    }
