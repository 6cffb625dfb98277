"""Callbacks of a training: progress, evaluation, and checkpoints from which it can go on."""

from collections.abc import Callable
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback, CheckpointCallback, EvalCallback
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.utils import safe_mean

from agents.policies.checkpoint import write
from agents.seeds import tuning_seeds

EVALUATIONS, EPISODES, CHECKPOINTS = 10, 20, 20
"""Evaluations of a training, episodes of each, and checkpoints."""


class Progress(BaseCallback):
    """Progress by calls with (steps so far, steps in all, mean return).

    The return is that of the last evaluation, or without one of the last training episodes.
    """

    def __init__(
        self, report: Callable[[int, int, float], None], evaluation: EvalCallback | None
    ) -> None:
        super().__init__()
        self._report, self._evaluation = report, evaluation

    def _on_training_start(self) -> None:
        model: Any = self.model  # learns in whole rollouts
        on_policy = isinstance(model, OnPolicyAlgorithm)
        rollout = model.n_envs * (model.n_steps if on_policy else model.train_freq.frequency)
        left = self.locals["total_timesteps"] - self.num_timesteps
        self._total = self.num_timesteps - (-left // rollout) * rollout

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self._evaluation:
            reward = self._evaluation.last_mean_reward
        else:
            reward = safe_mean([each["r"] for each in self.model.ep_info_buffer or ()])
        self._report(self.num_timesteps, self._total, reward if reward > -np.inf else np.nan)

    _on_training_end = _on_rollout_start


class Checkpoints(CheckpointCallback):
    """stable-baselines3's checkpoints, `CHECKPOINTS` in a training, of which the last two stay.

    Args:
        folder: Place of the files.
        steps: Steps of the batch in the training.
    """

    def __init__(self, folder: Path, steps: int) -> None:
        super().__init__(max(steps // CHECKPOINTS, 1), str(folder), save_replay_buffer=True)

    def _on_step(self) -> bool:
        super()._on_step()
        if self.n_calls % self.save_freq == 0:
            for steps in checkpoints(Path(self.save_path))[:-2]:
                remove_checkpoints(Path(self.save_path), str(steps))
        return True


def checkpoints(folder: Path) -> list[int]:
    """Steps of the checkpoints in a folder, from the first to the last."""
    return sorted(int(path.stem.split("_")[2]) for path in folder.glob("rl_model_*_steps.zip"))


def remove_checkpoints(folder: Path, steps: str = "*") -> None:
    """Remove the checkpoints of so many steps, or all, with their replay buffers."""
    for path in folder.glob(f"rl_model*_{steps}_steps.*"):
        path.unlink()


class Evaluation(EvalCallback):
    """stable-baselines3's evaluation on the same tuning seeds each time.

    The best policy is stored without pickle, too.

    Evaluation draws no random number of the learner, so a training learns the same with this
    callback or without.

    Args:
        env: `EPISODES` environments.
        folder: Place of the files; those of an interrupted training are continued.
        steps: Steps of the batch in the training.
        described: Description of the training.
    """

    def __init__(self, env: Any, folder: Path, steps: int, described: dict[str, Any]) -> None:
        super().__init__(
            env,
            n_eval_episodes=EPISODES,
            eval_freq=max(steps // EVALUATIONS, 1),
            log_path=str(folder),
            best_model_save_path=str(folder),
            verbose=0,
        )
        self._best, self._described = folder / "best_model.npz", described
        with suppress(Exception), np.load(folder / "evaluations.npz") as kept:
            self.best_mean_reward = float(kept["results"].mean(axis=1).max())
            self.evaluations_timesteps = list(kept["timesteps"])
            self.evaluations_results = list(kept["results"])
            self.evaluations_length = list(kept["ep_lengths"])
            self.evaluations_successes = list(kept["successes"])

    def _on_step(self) -> bool:
        before = self.best_mean_reward
        self.eval_env.seed(tuning_seeds(1)[0])
        goes_on = super()._on_step()
        if self.best_mean_reward > before:
            steps = {"trained_steps": self.num_timesteps}
            write(self._best, self.model, self._described | steps)
        return goes_on


def curves(folder: Path, steps: int) -> Logger:
    """A logger to TensorBoard and ``progress.csv``; after some steps ``progress_<steps>.csv``."""
    kinds = ["csv", *(["tensorboard"] if find_spec("tensorboard") else [])]
    place = str(folder), f"_{steps}" if steps else ""
    return Logger(place[0], [make_output_format(kind, *place) for kind in kinds])
