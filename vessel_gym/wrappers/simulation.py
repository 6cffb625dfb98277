"""A simulator as a filter's model: copies of an environment, set to a state and stepped."""

from collections.abc import Callable
from copy import deepcopy
from importlib import import_module
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box

from estimators import Gaussian, NonlinearModel
from estimators.angles import difference
from estimators.checks import short_repr

_Get = Callable[[gym.Env], np.ndarray]
_Put = Callable[[gym.Env, np.ndarray], None]
_TRIES = 8
"""Number of states and actions on which a simulator is tried."""


def simulator(
    env: gym.Env,
    measurement: Callable[[np.ndarray, np.ndarray | None], np.ndarray],
    Q: np.ndarray | float,
    R: np.ndarray | float,
    get: _Get | None = None,
    put: _Put | None = None,
    **angles: Any,
) -> NonlinearModel:
    """Make a filter's model that uses an environment as simulator.

    A copy of the environment is set to each state and stepped. This works for environments of
    MuJoCo and of classic control; in MuJoCo all states are stepped in one native call. The known
    input is the action. If a simulator stores its state in float32, differences of close points are
    rounding errors: use `ukf`.

    Args:
        env: An environment that can be made again from its spec; `simulator` does not change it.
        measurement: Measurement function ``h(x, u)``, which broadcasts.
        Q: Covariance ``(n, n)`` of process noise, or a number that multiplies the identity.
        R: Covariance ``(p, p)`` of measurement noise, or a number that multiplies the identity.
        get: Function that returns the state ``(n,)`` of an environment; None: MuJoCo's positions
            and velocities, classic control's ``state``.
        put: Function that sets the state ``(n,)`` of an environment; None: the counterpart of
            ``get``.
        **angles: ``state_angles`` and ``measurement_angles`` of `NonlinearModel`.

    Raises:
        TypeError: for an environment that cannot be copied, or whose state cannot be set.
        ValueError: if ``get`` does not return the state that ``put`` has set, or if two steps from
            one state differ, because the simulator draws random numbers or has further states.
    """
    if not isinstance(env, gym.Env):
        raise TypeError(f"a simulator is made of a Gymnasium environment, got {short_repr(env)}")
    copy = made_again(env)
    copy.reset(seed=0)
    base: Any = copy.unwrapped
    get, put = _access(base, get, put)
    steps: Any = _Simulator(copy, get, put)
    x, u = _tried(copy, steps)
    if get is _mujoco_state:
        rollout = _Rollout(base.model, base.frame_skip)
        # if so, the actions are MuJoCo's controls
        if np.allclose(rollout(x, u), steps(x, u), rtol=1e-6, atol=1e-8):
            steps = rollout
    p = np.shape(measurement(x, u))[-1]
    return NonlinearModel(steps, measurement, _square(Q, x.shape[-1]), _square(R, p), **angles)


def _access(base: Any, get: _Get | None, put: _Put | None) -> tuple[_Get, _Put]:
    """Functions that get and set an environment's state: the given ones, or those of its kind."""
    if (get is None) != (put is None):
        raise TypeError("give both get and put, or neither")
    if get is not None and put is not None:
        return get, put
    if hasattr(base, "set_state") and hasattr(base, "data") and hasattr(base, "model"):
        return _mujoco_state, _set_mujoco
    if hasattr(base, "state"):
        return _classic_state, _set_classic
    raise TypeError(
        f"nobody knows how to set the state of {base.spec.id}: give get and put, or a model of"
        " your own"
    )


def _square(value: np.ndarray | float, size: int) -> np.ndarray:
    """A covariance from a matrix, or from a number that multiplies the identity."""
    array = np.asarray(value, float)
    return array * np.eye(size) if array.ndim == 0 else array


def _tried(env: gym.Env, steps: "_Simulator") -> tuple[np.ndarray, np.ndarray]:
    """States and actions on which the simulator was tried and repeated its steps."""
    space = deepcopy(env.action_space)  # copies may share the environment's own
    space.seed(0)
    x, u = [], []
    for seed in range(_TRIES):
        env.reset(seed=seed)
        x.append(np.array(steps.get(env), float))
        u.append(np.asarray(space.sample(), float).reshape(-1))
        steps.put(env, x[0])
        if not np.allclose(steps.get(env), x[0], rtol=1e-12, atol=1e-12):
            raise ValueError(
                "a state that put sets is not the one that get finds: they must be of the same"
                " numbers"
            )
    states, actions = np.array(x), np.array(u)
    first, second = steps(states, actions), steps(states[::-1], actions[::-1])[::-1]
    if not np.allclose(first, second, rtol=1e-6, atol=1e-9):
        raise ValueError(
            "two steps from one state end in different ones: the simulator draws random numbers, or"
            " get does not give all of its state, so it is no model"
        )
    return states, actions


def _points(
    x: np.ndarray, u: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[int, ...]]:
    """Rows of states and actions, mask of finite rows, and shape of the states."""
    assert u is not None
    shape = np.broadcast_shapes(x.shape[:-1], u.shape[:-1])
    states = np.broadcast_to(x, shape + x.shape[-1:]).reshape(-1, x.shape[-1])
    actions = np.broadcast_to(u, shape + u.shape[-1:]).reshape(len(states), -1)
    finite = np.isfinite(states).all(1) & np.isfinite(actions).all(1)
    return states, actions, finite, shape + x.shape[-1:]


class _Simulator:
    """``f(x, u)``: a copy of the environment is set to each point and stepped."""

    def __init__(self, env: gym.Env, get: _Get, put: _Put) -> None:
        self.env, self.get, self.put = env, get, put
        self._float = isinstance(env.action_space, Box)

    def __call__(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        states, actions, finite, shape = _points(x, u)
        after = np.full(states.shape, np.nan)
        for i in np.flatnonzero(finite):
            self.put(self.env, states[i])
            self.env.step(self._action(actions[i]))
            after[i] = self.get(self.env)
        return after.reshape(shape)

    def _action(self, u: np.ndarray) -> Any:
        space: Any = self.env.action_space
        if self._float:
            return np.clip(u.reshape(space.shape), space.low, space.high).astype(space.dtype)
        whole = np.rint(u).astype(int)
        return int(whole[0]) if space.shape == () else whole.reshape(space.shape)


class _Rollout:
    """Steps of MuJoCo, all points in one native call."""

    def __init__(self, model: Any, substeps: int) -> None:
        mujoco = import_module("mujoco")  # comes with MuJoCo's environments, not with an extra
        Rollout = import_module("mujoco.rollout").Rollout
        self._model, self._substeps = model, substeps
        self._rollout, self._data = Rollout(nthread=1), [mujoco.MjData(model)]
        self._size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy has its own buffers."""
        return type(self), (self._model, self._substeps)

    def __call__(self, x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        states, actions, finite, shape = _points(x, u)
        n = states.shape[1]
        whole = np.zeros((len(states), self._size))  # the first column is the time
        whole[:, 1 : 1 + n] = np.nan_to_num(states)
        controls = np.ascontiguousarray(
            np.repeat(np.nan_to_num(actions[:, None]), self._substeps, 1)
        )
        after, _ = self._rollout.rollout(
            self._model, self._data, whole, controls, nstep=self._substeps
        )
        return np.where(finite[:, None], after[:, -1, 1 : 1 + n], np.nan).reshape(shape)


def _mujoco_state(env: gym.Env) -> np.ndarray:
    data = env.unwrapped.data  # type: ignore[attr-defined]
    return np.concatenate([data.qpos, data.qvel])


def _set_mujoco(env: gym.Env, x: np.ndarray) -> None:
    base: Any = env.unwrapped
    base.data.qacc_warmstart[:] = 0.0  # the solver's initial guess, left by the last point
    base.set_state(x[: base.model.nq], x[base.model.nq :])


def _classic_state(env: gym.Env) -> np.ndarray:
    return np.array(env.unwrapped.state, float)  # type: ignore[attr-defined]


def _set_classic(env: gym.Env, x: np.ndarray) -> None:
    base: Any = env.unwrapped
    base.state = np.array(x)
    if hasattr(base, "steps_beyond_terminated"):  # a state may lie beyond an episode's end
        base.steps_beyond_terminated = None


def made_again(env: gym.Env) -> gym.Env:
    """Another environment of the same spec, without rendering."""
    if env.spec is None:
        raise TypeError(
            f"a copy is made of an environment's spec, and this one has no spec: {short_repr(env)}"
        )
    spec: Any = deepcopy(env.spec)
    spec.kwargs.pop("render_mode", None)
    return gym.make(spec)


def sampled_prior(
    env: gym.Env, state: Callable[[gym.Env, Any], Any], angles: tuple[int, ...], resets: int = 256
) -> Gaussian:
    """Prior of an environment: mean and covariance of the initial states of a copy.

    The mean of an angle is the direction of the mean of unit vectors.

    Raises:
        ValueError: if the environment cannot be copied.
    """
    try:
        copy = made_again(env)
    except Exception as error:
        wanted = "give prior=, what is known of the state at the start"
        raise ValueError(
            f"{wanted}: this environment cannot be made again ({short_repr(str(error))})"
        ) from error
    starts = []
    for seed in range(resets):
        seen, _ = copy.reset(seed=seed)
        starts.append(np.asarray(state(copy, seen), float))
    copy.close()
    x = np.array(starts)
    mean, turning = x.mean(0), list(angles)
    mean[turning] = np.arctan2(np.sin(x[:, turning]).mean(0), np.cos(x[:, turning]).mean(0))
    return Gaussian(mean, np.cov(difference(x, mean, angles).T).reshape(x.shape[1], x.shape[1]))
