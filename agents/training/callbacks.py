"""Callbacks of a training: progress, curves, evaluation, and checkpoints from which an interrupted one goes on."""

import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from agents.files import replacing
from agents.policies.checkpoint import write
from agents.rollouts import rollout
from agents.seeds import tuning_seeds
from vessel_gym.extras import require

require("stable_baselines3")

from stable_baselines3.common import logger as sb3_logger  # noqa: E402
from stable_baselines3.common.callbacks import BaseCallback, CheckpointCallback  # noqa: E402

EVALUATIONS, EPISODES = 10, 20
"""Evaluations of a training, and episodes of each, on tuning seeds."""
CHECKPOINTS = 20
"""Checkpoints of stable-baselines3 in a training."""
CURVES, LATEST, BEST = "progress.csv", "latest.zip", "best.zip"
"""Files of a training's folder; TensorBoard's events and stable-baselines3's checkpoints lie beside them."""
_CHECKPOINT = "checkpoint"


class Report(BaseCallback):
    """Progress by calls with (steps so far, steps of all rollouts, score of the last evaluation or NaN)."""

    model: Any

    def __init__(
        self,
        budget: int,
        progress: Callable[[int, int, float], None] | None,
        evaluation: Any = None,
    ) -> None:
        super().__init__()
        self._budget, self._progress, self._evaluation = budget, progress, evaluation

    def _on_training_start(self) -> None:
        model = self.model
        rollout = model.n_envs * (
            model.train_freq.frequency if hasattr(model, "train_freq") else model.n_steps
        )
        self._total = (
            self.num_timesteps + -(-(self._budget - self.num_timesteps) // rollout) * rollout
        )

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self._progress is not None:
            self._progress(
                self.num_timesteps, self._total, getattr(self._evaluation, "score", np.nan)
            )

    _on_training_end = _on_rollout_start


class Checkpoints(CheckpointCallback):
    """stable-baselines3's checkpoints, `CHECKPOINTS` of them in a training, of which the last two stay.

    Args:
        folder: Where the files go.
        steps: Steps of the batch in the training.
    """

    model: Any

    def __init__(self, folder: Path, steps: int) -> None:
        super().__init__(
            max(steps // CHECKPOINTS, 1), str(folder), _CHECKPOINT, save_replay_buffer=True
        )

    def _on_training_start(self) -> None:
        self.model.start_time -= self.model.elapsed
        self.model._num_timesteps_at_start = 0  # as many steps as took this time

    def _on_step(self) -> bool:
        self.model.elapsed = time.time_ns() - self.model.start_time
        go_on = super()._on_step()
        if (
            self.n_calls % self.save_freq == 0
        ):  # it has just saved one: no look at the folder at other steps
            remove_checkpoints(Path(self.save_path), 2)
        return go_on


def _checkpoints(folder: Path) -> list[Path]:
    """Checkpoints of stable-baselines3 in a folder, from the first to the last."""
    return sorted(
        folder.glob(f"{_CHECKPOINT}_*_steps.zip"), key=lambda path: int(path.stem.split("_")[1])
    )


def last_checkpoint(folder: Path) -> Path | None:
    """The last checkpoint of stable-baselines3 in a folder, if there is one."""
    return next(reversed(_checkpoints(folder)), None)


def replay_path(checkpoint: Path) -> Path:
    """The file of the replay buffer that goes with a checkpoint of stable-baselines3."""
    name = checkpoint.stem.replace(_CHECKPOINT, f"{_CHECKPOINT}_replay_buffer")
    return checkpoint.with_name(f"{name}.pkl")


def remove_checkpoints(folder: Path, kept: int = 0) -> None:
    """Remove the checkpoints of stable-baselines3 from a folder, but for the last ones."""
    paths = _checkpoints(folder)
    for path in paths[: len(paths) - kept]:
        replay_path(path).unlink(missing_ok=True)
        path.unlink()


class Evaluation(BaseCallback):
    """The latest and the best policy of a training, and what they score.

    Evaluation draws no random number of the learner, so a training learns the same with this
    callback or without.

    Args:
        folder: Where the files go.
        described: What `agents.training.algorithms.describe` gave.
        env_options: Passed to the environment of evaluations.
    """

    def __init__(
        self, folder: Path, described: dict[str, Any], env_options: dict[str, Any] | None
    ) -> None:
        super().__init__()
        self._folder, self._described, self._options = folder, described, env_options
        self._best, self._done, self.score = -np.inf, -1, np.nan

    def _on_training_start(self) -> None:
        if self.num_timesteps:  # of the training that goes on
            self._done = self.num_timesteps * EVALUATIONS // self._described["steps"]
            with suppress(ValueError):  # damaged, or there is none
                self._best = self._score(self._folder / BEST)

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps * EVALUATIONS >= (self._done + 1) * self._described["steps"]:
            self._evaluate()

    def _on_training_end(self) -> None:
        self._evaluate()

    def _evaluate(self) -> None:
        """Score the latest policy on tuning seeds in a row of its own, and keep it if it is the best so far."""
        latest, described = self._folder / LATEST, self._described
        write(latest, self.model, described | {"trained_steps": self.num_timesteps})
        self.score = self._score(latest)
        self.logger.record("eval/score", self.score)
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(self.num_timesteps)
        self._done = self.num_timesteps * EVALUATIONS // described["steps"]
        if self.score > self._best:
            self._best = self.score
            with replacing(self._folder / BEST) as temporary:
                shutil.copyfile(latest, temporary)

    def _score(self, path: Path) -> float:
        env_id, seeds = self._described["env_id"], tuning_seeds(EPISODES)
        return float(rollout(path, env_id, seeds, self._options, record=False).score.mean())


def curves(folder: Path, steps: int) -> sb3_logger.Logger:
    """A logger to ``progress.csv`` and, where tensorboard is installed, to its events.

    Args:
        folder: Where the files go.
        steps: Of a training that goes on; rows of later steps are dropped, since they are computed
            again.
    """
    path = folder / CURVES
    earlier = path.read_text(encoding="utf-8").splitlines() if steps and path.exists() else []
    outputs: list[sb3_logger.KVWriter] = [sb3_logger.CSVOutputFormat(str(path))]
    if earlier:
        _go_on(outputs[0], earlier, steps)
    if find_spec("tensorboard") is not None:
        outputs.append(sb3_logger.TensorBoardOutputFormat(str(folder)))
    return sb3_logger.Logger(str(folder), outputs)


def _go_on(output: Any, earlier: list[str], steps: int) -> None:
    """Write the rows of an interrupted training again, up to a number of steps."""
    output.keys = earlier[0].split(",")
    column = output.keys.index("time/total_timesteps")
    rows = [row for row in earlier[1:] if int(row.split(",")[column]) <= steps]
    output.file.write("\n".join([earlier[0], *rows, ""]))
    output.file.flush()
