"""What does an estimator cost? Agents fly the same seeds on the estimates of each."""

import csv
import io
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from agents.files import replacing
from agents.metrics import consistency
from agents.ppo import describe, description, train
from agents.rollouts import Rollout, rollout
from agents.seeds import evaluation_seeds
from agents.statistics import Interval, mean_interval, paired_difference
from agents.turning_scores import METRICS, scores
from vessel_gym.system import System
from vessel_gym.tasks.turning_circle import TurningCircle

TOLD = "kf told d"
"""The fair rival of an unknown-input filter: the Kalman filter that knows the variance of d."""
AUTOPILOT, PPO = "autopilot", "PPO"
AGENTS = (AUTOPILOT, PPO)

Progress = Callable[[str, int, int, float | None], None]
"""Called with what is being done, how much of it is done, how much there is, and a score or None."""


@dataclass(frozen=True)
class Study:
    """What is compared; the defaults are the small study, some minutes on two cores.

    Attributes:
        env_id: The environment.
        episodes: Evaluation seeds, the same for every agent and estimator.
        training_seeds: PPO training runs.
        steps: Environment steps of a training run; None: the tuned budget.
        jobs: Training runs at a time.
        estimators: What the agents fly on; ``truth`` is the reference.
        seas: Disturbances, the hardest last.
        trained_on: The estimator that PPO learns on.
        trained_in: The sea that PPO learns in.

    Raises:
        ValueError: for numbers that make no study.
    """

    env_id: str = "SigmaCorvette-v0"
    episodes: int = 100
    training_seeds: int = 3
    steps: int | None = None
    jobs: int = 2
    estimators: tuple[str, ...] = ("truth", "kf-umv-ui", "kf", TOLD, "measurement", "dead-reckoning")
    seas: tuple[str, ...] = ("moderate", "rough")
    trained_on: str = "kf-umv-ui"
    trained_in: str = "moderate"

    def __post_init__(self) -> None:
        for name, least in (("episodes", 2), ("training_seeds", 1), ("jobs", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be at least {least}, got {getattr(self, name)}")
        missing = {"truth", self.trained_on} - set(self.estimators)
        if missing:
            raise ValueError(f"the estimators must include {' and '.join(sorted(missing))}")
        if self.trained_in not in self.seas:
            raise ValueError(f"the seas must include {self.trained_in}, in which PPO is trained")
        evaluation_seeds(self.episodes)

    @property
    def seeds(self) -> list[int]:
        """The evaluation seeds."""
        return evaluation_seeds(self.episodes)

    def system(self) -> System:
        """The environment's system.

        Raises:
            ValueError: if there is no such environment, or its task is not one that has scores.
        """
        try:
            env: Any = gym.make_vec(self.env_id, num_envs=1).unwrapped
        except gym.error.Error as error:
            raise ValueError(str(error)) from None
        system = getattr(env, "system", None)
        if system is None or not isinstance(system.task, TurningCircle):
            raise ValueError(f"this study is of turning circles, which {self.env_id} is not")
        return system

    def env_options(self, estimator: str, sea: str, system: System) -> dict[str, Any]:
        """The environment's options for one of the study's estimators in one of its seas."""
        if estimator != TOLD:
            return {"estimator": estimator, "disturbance": sea}
        variance = float(system.disturbances[sea].unknown_input_var)  # type: ignore[attr-defined]
        return {"estimator": "kf", "estimator_options": {"input_cov": variance}, "disturbance": sea}


class Cell(NamedTuple):
    """One agent in one sea on one estimator."""

    sea: str
    agent: str
    estimator: str


@dataclass(frozen=True, eq=False)
class Results:
    """Everything that was flown.

    Attributes:
        study: What was asked.
        system: The environment's system.
        figures: `agents.scores.scores` for each run of a cell: one for the autopilot, one a training seed for PPO.
        in_band: `agents.scores.consistency` of each cell, its mean over runs; None without a covariance.
        examples: History ``(T + 1, ...)`` of the autopilot's first seed in the last sea, by estimator.
        trained: What the checkpoints say of themselves, by training seed.
    """

    study: Study
    system: System
    figures: dict[Cell, list[dict[str, np.ndarray]]]
    in_band: dict[Cell, float | None]
    examples: dict[str, dict[str, np.ndarray]]
    trained: list[dict[str, Any]]

    def values(self, cell: Cell, key: str, run: int | None = None) -> np.ndarray:
        """A metric at every seed ``(N,)``: of one run, or the mean over runs."""
        runs = [figures[key] for figures in self.figures[cell]]
        return np.mean(runs, axis=0) if run is None else runs[run]

    def mean(self, cell: Cell, key: str) -> Interval | None:
        """The mean of a metric over the seeds."""
        return mean_interval(self.values(cell, key))

    def difference(self, cell: Cell, other: Cell, key: str, other_key: str | None = None) -> Interval | None:
        """The mean over seeds of a metric in a cell minus the same, or another, metric in another cell."""
        return paired_difference(self.values(cell, key), self.values(other, other_key or key))


def prepare(study: Study, out: Path) -> System:
    """Find out what would go wrong, before any work is done; make the output folder.

    Returns:
        The environment's system.

    Raises:
        ValueError: for a study that cannot be run: an unknown environment, estimator or sea, a budget
            below one rollout, a task that has no scores.
        OSError: if the output cannot be written, saying why.
    """
    system = study.system()
    for estimator, sea in product(study.estimators, study.seas):
        if sea not in system.disturbances:
            raise ValueError(f"unknown sea {sea!r}: choose from {', '.join(system.disturbances)}")
        gym.make_vec(study.env_id, num_envs=1, **study.env_options(estimator, sea, system)).close()
    describe(study.env_id, {}, 0, study.steps)
    for path in (out, *out.parents):
        if path.exists() and not path.is_dir():
            raise NotADirectoryError(f"cannot write to {out}: {path} is a file, not a folder")
    for path in (out / "episodes.csv", out / "report.html"):
        if path.is_dir():
            raise IsADirectoryError(f"cannot write {path}: it is a folder")
    try:
        (out / "checkpoints").mkdir(parents=True, exist_ok=True)
        for folder in (out, out / "checkpoints"):
            tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise type(error)(f"cannot write to {out}: {error.strerror}") from None
    return system


def run(study: Study, out: Path, progress: Progress | None = None) -> Results:
    """Train, fly, and write ``checkpoints/`` and ``episodes.csv`` to a folder.

    Checkpoints that are there and say that they are what would be trained are used again.

    Args:
        study: What is compared.
        out: The folder.
        progress: See `Progress`; it may be called from another thread.

    Raises:
        ValueError: as `prepare`.
        OSError: as `prepare`.
    """
    system = prepare(study, out)
    progress = progress or (lambda what, done, total, score: None)
    checkpoints = train_agents(study, out / "checkpoints", system, progress)
    cells = [Cell(*cell) for cell in product(study.seas, AGENTS, study.estimators)]
    total = sum(len(checkpoints) if cell.agent == PPO else 1 for cell in cells)
    figures: dict[Cell, list[dict[str, np.ndarray]]] = {cell: [] for cell in cells}
    in_band: dict[Cell, float | None] = {}
    examples: dict[str, dict[str, np.ndarray]] = {}
    done = 0
    for cell in cells:
        shares = []
        for agent in map(str, checkpoints) if cell.agent == PPO else (AUTOPILOT,):
            progress("flying", done, total, None)
            flown = rollout(agent, study.env_id, study.seeds, study.env_options(cell.estimator, cell.sea, system))
            figures[cell].append(scores(flown))
            shares.append(consistency(flown))
            done += 1
            if cell.agent == AUTOPILOT and cell.sea == study.seas[-1]:
                examples[cell.estimator] = _first_episode(flown)
        in_band[cell] = None if shares[0] is None else float(np.mean([s for s in shares if s is not None]))
    progress("flying", done, total, None)
    trained = [description(path) or {} for path in checkpoints]
    results = Results(study, system, figures, in_band, examples, trained)
    with replacing(out / "episodes.csv") as path:
        path.write_text(episodes_csv(results), encoding="utf-8")
    return results


def train_agents(study: Study, folder: Path, system: System, progress: Progress) -> list[Path]:
    """A checkpoint for each training seed, trained in parallel processes unless it is there already."""
    from joblib import Parallel, delayed

    options = study.env_options(study.trained_on, study.trained_in, system)
    paths = [folder / f"ppo-{seed}.zip" for seed in range(study.training_seeds)]
    missing = []
    for seed, path in enumerate(paths):
        found, wanted = description(path), describe(study.env_id, options, seed, study.steps)
        there = found is not None and found.items() >= wanted.items()
        progress(f"PPO {seed}", wanted["steps"] if there else 0, wanted["steps"], None)
        if not there:
            missing.append(seed)
    with tempfile.TemporaryDirectory() as notes:
        files = {seed: Path(notes, str(seed)) for seed in missing}
        stop = threading.Event()
        watcher = threading.Thread(target=_watch, args=(files, progress, stop), daemon=True)
        watcher.start()
        try:
            Parallel(n_jobs=min(study.jobs, max(len(missing), 1)))(
                delayed(_train)(study, options, seed, paths[seed], files[seed]) for seed in missing
            )
        finally:
            stop.set()
            watcher.join()
    return paths


def episodes_csv(results: Results) -> str:
    """One row an episode: where, who, on what, the seed and every metric; empty where there is no value."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["sea", "agent", "training_seed", "estimator", "seed", *(m.key for m in METRICS)])
    for cell, runs in results.figures.items():
        for number, figures in enumerate(runs):
            training_seed = number if cell.agent == PPO else ""
            for i, seed in enumerate(results.study.seeds):
                values = (figures[m.key][i] for m in METRICS)
                shown = [f"{value:.6g}" if np.isfinite(value) else "" for value in values]
                writer.writerow([cell.sea, cell.agent, training_seed, cell.estimator, seed, *shown])
    return text.getvalue()


def _train(study: Study, options: dict[str, Any], seed: int, path: Path, note: Path) -> None:
    """Train in whatever process this is, and leave notes of the progress in a file."""

    def progress(done: int, total: int, score: float) -> None:
        note.write_text(f"{done} {total} {score}")

    train(study.env_id, path, options, seed, study.steps, progress)


def _watch(notes: dict[int, Path], progress: Progress, stop: threading.Event) -> None:
    """Pass on what the training processes note, until told to stop."""
    last = False
    while not last:
        last = stop.wait(0.5)
        for seed, note in notes.items():
            words = note.read_text().split() if note.exists() else []
            if len(words) == 3:
                score = float(words[2])
                progress(f"PPO {seed}", min(int(words[0]), int(words[1])), int(words[1]), score if score >= 0 else None)


def _first_episode(flown: Rollout) -> dict[str, np.ndarray]:
    """The history of a rollout's first episode, from its start to its end."""
    return {key: values[: flown.length[0] + 1, 0] for key, values in flown.history.items()}
