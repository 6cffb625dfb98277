"""An estimator in the loop of many environments at once: one batched filter for all of them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

from estimators import Gaussian, Model
from estimators.checks import short_repr
from vessel_gym import checks
from vessel_gym.foreign import copied
from vessel_gym.wrappers.watch import Watch, observed_state, time_step


class EstimatedObservation(VectorWrapper):
    """A vector environment whose agents see what one batched filter believes.

    Environment i, seeded with s, has the sensors' and the filter's numbers of the single one seeded
    with s + i: the same seeds give the same flights. Native batches and Gymnasium's Sync and Async
    ones are wrapped alike.

    Args:
        env: A vector environment that resets at the next step, or not by itself.
        model: As for the single one.
        prior: What is known of the state at the start, ``(n,)``.
        state: The true states ``(B, n)``, a function of (env, observations); None: the
            observations. Environments are rows, which nobody can check where B is n: Gymnasium's
            native CartPole, for one, keeps them in columns.
        observation: The observations as a function of the states ``(B, n)``, a row each; None: the
            states.
        **options: As for the single one: ``passes``, ``known_input`` (a function of the actions,
            ``(B, m)``), ``estimator``, ``estimator_options``, ``sensors``, ``observe`` and
            ``sensor_faults``.

    Raises:
        TypeError: as for the single one.
        ValueError: as for the single one; or for an environment that resets in the
            same step, which hides how episodes end.
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
            env.single_observation_space, env.single_action_space, env.num_envs, time_step(env), model, prior,
            observation, **options,
        )  # fmt: skip
        self.single_observation_space = self.watch.space
        self.observation_space = batch_space(self.watch.space, env.num_envs)
        self._over = np.zeros(env.num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes, in all environments or in those of ``options["reset_mask"]``."""
        mask = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, bool)), bool)
        if seed is None:
            seeds: list[Any] = [None] * self.num_envs
        elif isinstance(seed, int | np.integer):
            seed = int(seed)
            seeds = [seed + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(
                f"seed must be one number, or one for each of {self.num_envs}, got"
                f" {short_repr(seed)}"
            )
        seen, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self.watch.seed(mask, seeds)
        self.watch.begin(mask, self._truth(seen))
        self._over &= ~mask
        return self.watch.observe(seen), info | self._info(mask)

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """A step of all environments; those whose episode was over begin the next."""
        seen, reward, terminated, truncated, info = self.env.step(actions)
        self.watch.go_on(self._truth(seen), actions, self._over)
        self._over = (terminated | truncated) & self._restarts
        every = np.ones(self.num_envs, bool)
        return self.watch.observe(seen), reward, terminated, truncated, info | self._info(every)

    def _truth(self, seen: Any) -> np.ndarray:
        return np.array(self._state(self.env, copied(seen)), float)

    def _info(self, rows: np.ndarray) -> dict[str, Any]:
        happened = self.watch.info()
        return happened | {f"_{name}": rows.copy() for name in happened}
