"""Callbacks of a training: progress, curves, evaluation, and a state from which an interrupted one goes on."""

import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from agents.policies.checkpoint import write
from agents.rollouts import rollout
from agents.seeds import tuning_seeds
from vessel_gym.extras import require

require("stable_baselines3")

from stable_baselines3.common import logger as sb3_logger  # noqa: E402
from stable_baselines3.common.callbacks import BaseCallback  # noqa: E402

from agents.training.state import save_state  # noqa: E402

EVALUATIONS, EPISODES = 10, 20
"""Evaluations of a training, and episodes of each, on tuning seeds."""
PAUSE = 60.0
"""Seconds between two states that are kept."""
CURVES, STATE, LATEST, BEST = "progress.csv", "state.pkl", "latest.zip", "best.zip"
"""Files of a training's folder; TensorBoard's events lie beside them."""


class Interrupted(KeyboardInterrupt):
    """A training that the user has interrupted; the text says how far it got and how it goes on."""


class Report(BaseCallback):
    """Progress by calls with (steps so far, steps in all, mean score of late episodes)."""

    def __init__(self, budget: int, progress: Callable[[int, int, float], None] | None) -> None:
        super().__init__()
        self._budget, self._progress = budget, progress

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        if self._progress is not None:
            late = [info["r"] for info in self.model.ep_info_buffer or ()]
            perfect = self.training_env.get_attr("unwrapped", 0)[0].core.task.perfect
            mean = float(np.mean(late)) / perfect if late else float("nan")
            self._progress(self.num_timesteps, self._budget, mean)


class Checkpoints(BaseCallback):
    """The folder of a training: its state, its latest and its best policy, and what these score.

    Evaluation draws no random number of the learner, so a training learns the same with this callback or without.

    Args:
        folder: Where the files go.
        described: What `agents.training.algorithms.describe` gave.
        env_options: Passed to the environment of evaluations.
        kept: What the state of an interrupted training holds beside the learner; None: a new training.

    Raises:
        Interrupted: between two rollouts, after Ctrl-C; the state is kept.
    """

    def __init__(
        self, folder: Path, described: dict[str, Any], env_options: dict[str, Any] | None, kept: Any = None
    ) -> None:
        super().__init__()
        self._folder, self._described, self._options = folder, described, env_options
        self._best: float = kept["best"] if kept else -np.inf
        self._done: int = kept["evaluations"] if kept else 0
        self._saved = time.monotonic() if kept else -np.inf  # a new training keeps its state at once
        self.interrupted = False

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.num_timesteps * EVALUATIONS >= (self._done + 1) * self._described["steps"]:
            self._evaluate()
        if self.interrupted or time.monotonic() >= self._saved + PAUSE:
            self._keep()
        if self.interrupted:
            share = self.num_timesteps / self._described["steps"]
            raise Interrupted(f"{share:.0%} of the steps are kept in {self._folder / STATE}")

    def _on_training_end(self) -> None:
        self._evaluate()
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(self.num_timesteps)

    def _keep(self) -> None:
        more = {"described": self._described, "best": self._best, "evaluations": self._done}
        save_state(self._folder / STATE, self.model, more)
        self._saved = time.monotonic()

    def _evaluate(self) -> None:
        """Score the latest policy on tuning seeds, and keep it if it is the best so far."""
        latest, described = self._folder / LATEST, self._described
        write(latest, self.model, described | {"trained_steps": self.num_timesteps})
        flown = rollout(latest, described["env_id"], tuning_seeds(EPISODES), self._options, record=False)
        score = float(flown.score.mean())
        self.logger.record("eval/score", score)
        self._done = self.num_timesteps * EVALUATIONS // described["steps"]
        if score > self._best:
            self._best = score
            shutil.copyfile(latest, self._folder / BEST)


@contextmanager
def interruptible(checkpoints: Checkpoints) -> Iterator[None]:
    """Around learning: a first Ctrl-C waits for the end of a rollout, a second one does not.

    Only the main thread of a process can listen.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def note(*_: Any) -> None:
        checkpoints.interrupted = True
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def curves(folder: Path, steps: int) -> sb3_logger.Logger:
    """A logger to ``progress.csv`` and, where tensorboard is installed, to its events.

    Args:
        folder: Where the files go.
        steps: Of a training that goes on; rows of later steps are dropped, since they are computed again.
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
