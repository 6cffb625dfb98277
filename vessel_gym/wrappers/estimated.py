"""An estimator in the loop of any Gymnasium environment."""

from collections.abc import Callable
from copy import deepcopy
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from estimators import Gaussian, Model
from estimators.angles import difference
from vessel_gym import checks
from vessel_gym.wrappers.watch import Watch, observed_state, time_step

_STARTS = 256
"""Number of initial states from which a prior is estimated."""


class EstimatedObservation(gym.Wrapper, RecordConstructorArgs):
    """Wrapper of an environment whose agent observes a filter's estimate.

    The environment itself does not change: its rewards and ends follow from the truth. Sensors
    measure its state, with noise. A filter receives these measurements and the actions, and nothing
    else. The observation is a function of the estimate. So an agent that was trained on the truth
    runs unchanged, and an agent can be trained on estimates.

    ::

        env = EstimatedObservation(
            gym.make("Pendulum-v1"), model, estimator="ukf",
            prior=Gaussian([0, 0], np.diag([3.3, 0.33])),
            state=lambda env, obs: env.unwrapped.state,
            observation=lambda x: [np.cos(x[..., 0]), np.sin(x[..., 0]), x[..., 1]],
        )

    ``info`` has the environment's keys and ``truth`` and ``estimate`` ``(n,)``, ``covariance``
    ``(n, n)``, ``measurement`` and ``available`` ``(p,)``, ``healthy`` and, with faults,
    ``sensor_faults``. These replace keys of the environment with the same names.

    Args:
        env: Any environment whose observations are numbers, or dictionaries of numbers.
        model: The filter's model of one step: a `LinearModel` or `NonlinearModel`. Its R is the
            covariance of measurement noise.
        prior: Prior of the state. None: mean and covariance of initial states of copies of the
            environment.
        state: Function of (env, observation) that returns the true state ``(n,)``; None: the
            observation is the state. Only the sensors, the estimator "truth" and ``info`` receive
            the true state.
        observation: Function of the state ``(n,)`` that returns an observation, an array or a
            dictionary; None: the state.
        **options: Options by name:

            - ``passes`` (none by default): keys of a dictionary, or components of an array, that
              pass to the agent unchanged, such as goals. All others come from the estimate.
            - ``known_input``: function of the action that returns the filter's known input. The
              default is the action as numbers, clipped to its space.
            - ``estimator`` (``"ekf"``): name of a filter, ``"truth"``, ``"dead-reckoning"``, or a
              function of the model that returns a filter.
            - ``estimator_options``: options of the filter; ``late`` is the use of late
              measurements, ``"fused"`` (at the time when they were taken), ``"as new"`` or
              ``"discarded"``.
            - ``sensors`` (``"nominal"``): also ``"clean"`` or ``"degraded"``, or a list of `Sensor`
              objects that read ``(state, known input)``. Their noise replaces the model's R. Rates
              and delays are in Hz and s if the environment has a time step ``dt``, as MuJoCo's
              have; otherwise a step is the unit of time.
            - ``observe`` (``"mean"``): ``"mean+std"`` also has the standard deviations of the
              states, appended, or as ``std`` in a dictionary. ``"measurement"`` is measurements,
              mask of those that arrived, and ``passes``.
            - ``sensor_faults``: `SensorFault` objects. Their times are in s if the environment has
              a time step ``dt``, otherwise in steps.

    Raises:
        TypeError: for an object that is no model, prior or estimator, or observations that are
            images.
        ValueError: for unknown names, or inconsistent sizes.
    """

    def __init__(
        self,
        env: gym.Env,
        model: Model,
        prior: Gaussian | None = None,
        state: Callable[[gym.Env, Any], Any] | None = None,
        observation: Callable[[np.ndarray], Any] | None = None,
        **options: Any,
    ) -> None:
        RecordConstructorArgs.__init__(
            self, _disable_deepcopy=True, model=model, prior=prior, state=state,
            observation=observation, **options,
        )  # fmt: skip
        gym.Wrapper.__init__(self, env)
        _refuse_autoreset(env)
        checks.function("state", state, "(env, observation)")
        checks.function("observation", observation, "the state")
        self._state = state or observed_state
        if prior is None and isinstance(model, Model):
            prior = _sampled_prior(env, self._state, model)
        of_row = None if observation is None else partial(_of_row, observation)
        self.watch = Watch(
            env.observation_space, env.action_space, 1, time_step(env), model, prior, of_row,
            **options,
        )  # fmt: skip
        self.observation_space = self.watch.space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; a seed also seeds the sensors and the filter."""
        seen, info = self.env.reset(seed=seed, options=options)
        self.watch.begin(np.zeros(1, int), self._state(self.env, seen), seed)
        return self._observed(seen), info | self._info()

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, and observe the estimate."""
        seen, reward, terminated, truncated, info = self.env.step(action)
        self.watch.step(self._state(self.env, seen), action, np.zeros(1, bool))
        return self._observed(seen), reward, terminated, truncated, info | self._info()

    @property
    def compute_reward(self) -> Callable[..., Any]:
        """``compute_reward(achieved, desired, info)`` of an environment with goals.

        Other environments have no such method. The method does not use the truth: it computes the
        reward from the achieved goal that it is given, which may be an estimate.
        """
        own: Callable[..., Any] = self.env.get_wrapper_attr("compute_reward")
        return own

    def _observed(self, seen: Any) -> Any:
        if isinstance(seen, dict):  # values of any kind may pass
            observed = self.watch.observe({key: [value] for key, value in seen.items()})
            return {key: value[0] for key, value in observed.items()}
        return self.watch.observe(np.asarray(seen)[None])[0]

    def _info(self) -> dict[str, Any]:
        """Info of one row, with a bool, because SyncVectorEnv cannot stack an array of one."""
        one = {name: values[0] for name, values in self.watch.info().items()}
        return one | {"healthy": bool(one["healthy"])}


def _refuse_autoreset(env: gym.Env) -> None:
    while isinstance(env, gym.Wrapper):
        if isinstance(env, gym.wrappers.Autoreset):
            raise ValueError(
                "Autoreset within hides how episodes end: put it around EstimatedObservation"
            )
        env = env.env


def _of_row(observation: Callable[[np.ndarray], Any], x: np.ndarray) -> Any:
    """Observation of a batch ``(1, n)`` by a function of one state."""
    return observation(x[0])


def _sampled_prior(env: gym.Env, state: Callable[[gym.Env, Any], Any], model: Model) -> Gaussian:
    """Mean and covariance of a model's states at the starts of a copy of an environment.

    The mean of an angle is the direction of the mean unit vector.

    Raises:
        ValueError: if the environment cannot be copied, or has another number of states.
    """
    try:
        spec: Any = deepcopy(env.spec)
        spec.kwargs.pop("render_mode", None)
        copy = gym.make(spec)
    except Exception as error:
        raise ValueError(
            "give prior=, what is known of the state at the start: this environment cannot be made"
            " again from its spec"
        ) from error
    x = np.array([state(copy, copy.reset(seed=seed)[0]) for seed in range(_STARTS)], float)
    copy.close()
    if x.shape[1:] != (model.n,):
        raise ValueError(
            f"the model has {model.n} states, and the environment shows {x.shape[1:]}: give state=,"
            " a function of (env, observation) that returns the states of the model, in its order"
        )
    mean, turning = x.mean(0), list(model.state_angles)
    mean[turning] = np.arctan2(np.sin(x[:, turning]).mean(0), np.cos(x[:, turning]).mean(0))
    cov = np.cov(difference(x, mean, model.state_angles).T)
    return Gaussian(mean, np.atleast_2d(cov))
