"""An estimator in the loop of many environments: one batched filter for all of them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from estimators import Gaussian, Model
from vessel_gym import checks
from vessel_gym.wrappers.watch import Watch, observed_state, time_step


class EstimatedObservation(VectorWrapper):
    """Wrapper of a vector environment whose agents observe the estimates of one batched filter.

    Environment i of a batch with seed s has the random numbers of the single wrapper with seed s +
    i, so that episodes are equal. Native batches, `SyncVectorEnv` and `AsyncVectorEnv` can be
    wrapped.

    Args:
        env: A vector environment with autoreset in the next step, or without autoreset.
        model: As for the single wrapper.
        prior: Prior of the state ``(n,)``.
        state: Function of (env, observations) that returns the true states ``(B, n)``; None: the
            observations are the states. Environments must be rows, which cannot be checked if B is
            n: Gymnasium's native CartPole, for example, keeps them in columns.
        observation: Function of the states ``(B, n)`` that returns observations, one row for each;
            None: the states. Rows cannot be checked if B is the size of an observation.
        **options: As for the single wrapper: ``passes``, ``known_input`` (a function of the
            actions, ``(B, m)``), ``estimator``, ``estimator_options``, ``sensors``, ``observe`` and
            ``sensor_faults``.

    Raises:
        TypeError: as for the single wrapper.
        ValueError: as for the single wrapper, and for an environment that resets in the same step,
            which hides the ends of episodes.
    """

    def __init__(
        self,
        env: VectorEnv,
        model: Model,
        prior: Gaussian,
        state: Callable[[VectorEnv, Any], Any] | None = None,
        observation: Callable[[np.ndarray], Any] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(env)
        mode = AutoresetMode(env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        if mode not in (AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED):
            raise ValueError(
                "an environment that resets in the same step hides the state in which an episode"
                " ended: make it with autoreset_mode=AutoresetMode.NEXT_STEP or DISABLED"
            )
        self._restarts = mode is AutoresetMode.NEXT_STEP
        checks.function("state", state, "(env, observations)")
        self._state = state or observed_state
        self.watch = Watch(
            env.single_observation_space, env.single_action_space, env.num_envs, time_step(env),
            model, prior, observation, **options,
        )  # fmt: skip
        self.single_observation_space = self.watch.space
        self.observation_space = batch_space(self.watch.space, env.num_envs)
        self._over = np.zeros(env.num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes, in all environments or in those of ``options["reset_mask"]``."""
        mask = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, bool)), bool)
        seen, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self.watch.begin(np.flatnonzero(mask), self._state(self.env, seen), seed)
        self._over &= ~mask
        return self.watch.observe(seen), info | self._info(mask)

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step all environments; those whose episode has ended begin the next."""
        seen, reward, terminated, truncated, info = self.env.step(actions)
        self.watch.step(self._state(self.env, seen), actions, self._over)
        self._over = (terminated | truncated) & self._restarts
        every = np.ones(self.num_envs, bool)
        return self.watch.observe(seen), reward, terminated, truncated, info | self._info(every)

    def _info(self, rows: np.ndarray) -> dict[str, Any]:
        happened = self.watch.info()
        return happened | {f"_{name}": rows.copy() for name in happened}
