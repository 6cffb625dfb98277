"""The vector face: a native `gymnasium.vector.VectorEnv` on the batched core."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from estimators.factory import shown
from vessel_gym.checks import no_others
from vessel_gym.core import Core, whole
from vessel_gym.envs.spaces import action_space, observation_space
from vessel_gym.estimation import EstimatorChoice
from vessel_gym.system import System


class VesselVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many environments in one batch; environment i of a batch seeded s is the single one seeded s + i.

    Autoreset is ``SAME_STEP``: the observation of a finished environment is its next episode's
    first, and ``info["final_obs"]`` and ``info["final_info"]`` hold the ended episode's.

    Args:
        num_envs: Number of environments.
        max_episode_steps: Steps after which an episode is truncated; None: never. `gymnasium.make_vec`
            passes the registered value.
        estimator: As `VesselEnv`; so are the other arguments.
        estimator_options: See `VesselEnv`.
        sensors: See `VesselEnv`.
        disturbance: See `VesselEnv`.
        mismatch: See `VesselEnv`.
        observe: See `VesselEnv`.

    Raises:
        ValueError: as `VesselEnv`, and for a ``num_envs`` that is not a positive whole number.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}
    system: ClassVar[System]

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        estimator: EstimatorChoice | None = None,
        estimator_options: dict[str, Any] | None = None,
        sensors: str = "nominal",
        disturbance: str = "moderate",
        mismatch: float = 0.0,
        observe: str = "mean",
        **others: Any,
    ) -> None:
        no_others(self.system.name, type(self), others)
        if max_episode_steps is not None and not (whole(max_episode_steps) and max_episode_steps >= 1):
            raise ValueError(f"max_episode_steps must be a whole number of at least 1, got {shown(max_episode_steps)}")
        self.core = Core(self.system, num_envs, estimator, estimator_options, sensors, disturbance, mismatch, observe)
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.single_observation_space = observation_space(self.core)
        self.single_action_space = action_space(self.core)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    @property
    def truth(self) -> np.ndarray:
        """A copy of the true states ``(num_envs, n)``, for scoring only."""
        return self.core.scored_truth()

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode in every environment; ``seed`` is a number or one for each."""
        self.core.start(seed, options)
        return self.core.observe(), self._masked(self.core.info())

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance every environment by one step and restart those that ended."""
        core = self.core
        reward, terminated = core.step(actions)
        truncated = np.zeros(self.num_envs, bool)
        if self.max_episode_steps is not None:
            truncated = core.steps >= self.max_episode_steps
        observation, info = core.observe(), core.info()
        done = terminated | truncated
        if not done.any():
            return observation, reward, terminated, truncated, self._masked(info)
        rows = np.flatnonzero(done)
        final_observations = np.full(self.num_envs, None, dtype=object)
        for row in rows:
            final_observations[row] = observation[row]
        final_info = self._masked({key: _only(done, value) for key, value in info.items()}, done)
        core.episodes[rows] += 1
        core.reset(rows)
        infos = self._masked(core.info())
        infos |= {"final_obs": final_observations, "_final_obs": done.copy()}
        infos |= {"final_info": final_info, "_final_info": done.copy()}
        return core.observe(), reward, terminated, truncated, infos

    def _masked(self, info: dict[str, np.ndarray], rows: np.ndarray | None = None) -> dict[str, Any]:
        """Gymnasium's form of a batch's info: every array with a ``_key`` mask of the rows that have it."""
        mask = np.ones(self.num_envs, bool) if rows is None else rows
        masked: dict[str, Any] = dict(info)
        for key in info:
            masked[f"_{key}"] = mask.copy()
        return masked


def _only(rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The values of some rows; of the others what Gymnasium puts where nothing is, 0 or None."""
    nothing = np.full((), None) if values.dtype == object else np.zeros((), values.dtype)
    return np.where(rows_like(rows, values), values, nothing)


def rows_like(rows: np.ndarray, array: np.ndarray) -> np.ndarray:
    """The mask with as many axes as the array."""
    return rows.reshape(rows.shape + (1,) * (array.ndim - 1))
