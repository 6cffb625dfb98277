"""An estimator in the loop of any Gymnasium environment."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from estimators import Gaussian, Model
from estimators.checks import numbers
from vessel_gym import checks
from vessel_gym.estimation import EstimatorChoice
from vessel_gym.foreign import copied
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import Sensor
from vessel_gym.wrappers.simulation import sampled_prior
from vessel_gym.wrappers.watch import Watch, observed_state, time_step

_ALL = np.ones(1, bool)


class EstimatedObservation(gym.Wrapper, RecordConstructorArgs):
    """An environment whose agent sees what a filter believes.

    The environment goes on as it is, and so do its rewards and ends, which are about the truth.
    Sensors read its state, with noise. A filter gets these measurements and the actions, and
    nothing else. The observation is made of its belief. So an agent that was trained on the truth
    flies unchanged, and one that is trained here learns to live with an estimate.

    ::

        env = EstimatedObservation(
            gym.make("Pendulum-v1"), model, prior=Gaussian([0, 0], np.diag([3.3, 0.33])),
            state=lambda env, obs: env.unwrapped.state,
            observation=lambda x: [np.cos(x[..., 0]), np.sin(x[..., 0]), x[..., 1]], estimator="ukf",
        )

    ``info`` has, besides the environment's own and in place of its keys of these names, ``truth``
    and ``estimate`` ``(n,)``, ``covariance`` ``(n, n)``, ``measurement`` and ``available``
    ``(p,)``, ``healthy``; ``sensor_faults`` where sensors may fail.

    Args:
        env: Any environment whose observations are numbers, or dictionaries of such.
        model: What the filter knows of it: a `LinearModel` or `NonlinearModel` of one step, of your
            own or from `simulator`. R says how well its measurements are read.
        prior: What is known of the state at the start; None: how copies of the environment begin.
        state: The true state ``(n,)``, a function of (env, observation); None: the observation
            itself. Nobody but the sensors, the oracle and ``info`` gets it.
        observation: The observation as a function of the state ``(n,)``: an array, or a dictionary;
            None: the state.
        passes: Keys of a dictionary, or components of an array, that pass to the agent as they are:
            goals, say. What is not named here comes from the estimate.
        known_input: Known input of the filter, a function of the action; None: the action as
            numbers, within the bounds of its space.
        estimator: Name of a filter, "truth", "dead-reckoning", or a function of the model that
            returns a filter.
        estimator_options: Its options; ``late``: what is done with measurements that come late,
            "fused" (where they belong), "as new" or "discarded".
        sensors: "clean", "nominal" or "degraded", or a list of `Sensor` objects that read ``(state,
            known input)``, whose noise then takes the place of the model's R. Their rates and
            delays are in Hz and s where the environment has a time step ``dt``, as MuJoCo's have;
            elsewhere a step is the unit of time.
        observe: "mean"; "mean+std": with the deviations of the states behind, or as ``std`` in a
            dictionary; or "measurement": the measurements, the mask of those that arrived, and what
            passes.
        sensor_faults: What goes wrong with the sensors, and when, in the same unit of time:
            `SensorFault` objects.

    Raises:
        TypeError: for what is no model, prior or estimator, or observations that are images.
        ValueError: for names that there are not, or sizes that do not fit.
    """

    def __init__(
        self,
        env: gym.Env,
        model: Model,
        prior: Gaussian | None = None,
        state: Callable[[gym.Env, Any], Any] | None = None,
        observation: Callable[[np.ndarray], Any] | None = None,
        passes: Sequence[Any] = (),
        known_input: Callable[[Any], Any] | None = None,
        estimator: EstimatorChoice = "ekf",
        estimator_options: dict[str, Any] | None = None,
        sensors: str | Sequence[Sensor] = "nominal",
        observe: str = "mean",
        sensor_faults: Sequence[SensorFault] = (),
    ) -> None:
        RecordConstructorArgs.__init__(
            self, _disable_deepcopy=True, model=model, prior=prior, state=state, observation=observation, passes=passes,
            known_input=known_input, estimator=estimator, estimator_options=estimator_options, sensors=sensors,
            observe=observe, sensor_faults=sensor_faults,
        )  # fmt: skip
        gym.Wrapper.__init__(self, env)
        within = env
        while isinstance(within, gym.Wrapper):
            if isinstance(within, gym.wrappers.Autoreset):
                raise ValueError(
                    "Autoreset within hides how episodes end: put it around EstimatedObservation"
                )
            within = within.env
        checks.function("state", state, "(env, observation)")
        checks.function("observation", observation, "the state")
        self._state = state or observed_state
        if prior is None and isinstance(model, Model):
            prior = sampled_prior(env, self._state, model.state_angles)
            if len(prior.mean) != model.n:
                given = "state= gives" if state else "the observation has"
                raise ValueError(
                    f"the model has {model.n} states, and {given} {len(prior.mean)} numbers: give"
                    " state=, a function of (env, observation) that returns the states of the"
                    " model, in its order"
                )
        self.watch = Watch(
            env.observation_space, env.action_space, 1, time_step(env), model, prior,
            None if observation is None else partial(_of_row, observation), passes, known_input, estimator,
            estimator_options, sensors, observe, sensor_faults,
        )  # fmt: skip
        self.observation_space = self.watch.space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; a seed is that of the sensors and of the filter, too."""
        seen, info = self.env.reset(seed=seed, options=options)
        self.watch.seed(_ALL, [seed])
        self.watch.begin(_ALL, self._truth(seen))
        return self._observed(seen), info | self._info()

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step of the environment, of which the agent sees an estimate."""
        seen, reward, terminated, truncated, info = self.env.step(action)
        self.watch.go_on(self._truth(seen), action, ~_ALL)
        return self._observed(seen), reward, terminated, truncated, info | self._info()

    @property
    def compute_reward(self) -> Callable[..., Any]:
        """``compute_reward(achieved, desired, info)`` of an environment with goals.

        Other environments have no such method.

        It knows no truth: of an achieved goal that is an estimate it tells what reaching it would
        pay.
        """
        own: Callable[..., Any] = self.env.get_wrapper_attr("compute_reward")
        return own

    def _truth(self, seen: Any) -> np.ndarray:
        return np.asarray(self._state(self.env, copied(seen)))[
            None
        ]  # which is copied where it is checked

    def _observed(self, seen: Any) -> Any:
        watch = self.watch
        if isinstance(seen, dict):
            observed = watch.observe(
                {key: [value] for key, value in seen.items()}
            )  # of any kind, where it passes
        else:
            observed = watch.observe(np.asarray(seen)[None])
        return (
            {key: value[0] for key, value in observed.items()}
            if isinstance(observed, dict)
            else observed[0]
        )

    def _info(self) -> dict[str, Any]:
        """Of one row; SyncVectorEnv stacks a bool, and no array of one."""
        one = {name: values[0] for name, values in self.watch.info().items()}
        return one | {"healthy": bool(one["healthy"])}


def _of_row(observation: Callable[[np.ndarray], Any], x: np.ndarray) -> Any:
    """The observation of a batch of one."""
    return _row(observation(x[0]))


def _row(value: Any) -> Any:
    """Value of a function of one state, as that of a batch of one."""
    if isinstance(value, dict):
        return {key: _row(part) for key, part in value.items()}
    array = numbers(value)
    return value if array is None else array[None]
