"""A linear model of an environment, from random steps."""

from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np

from estimators import LinearModel
from estimators.checks import as_array, integer, numbers, short_repr
from vessel_gym import checks
from vessel_gym.wrappers.simulation import square
from vessel_gym.wrappers.watch import observed_state, plain_action


def identify(
    env: gym.Env,
    state: Callable[[gym.Env, Any], Any] | None,
    C: np.ndarray,
    R: np.ndarray | float,
    steps: int = 2000,
    seed: int = 0,
) -> tuple[LinearModel, Callable[[Any], np.ndarray]]:
    """The linear model that fits random steps best: ``x+ = A x + B [a, 1] + w``.

    Q is the covariance of what it leaves: a model that is far from linear tells its filter so.

    Args:
        env: The environment; it is stepped, and reset.
        state: Its state ``(n,)``, a function of (env, observation); None: the observation itself.
        C: ``(p, n)`` what is read.
        R: ``(p, p)`` how well, or a number for that number times identity.
        steps: How many steps.
        seed: Of the actions and of the first reset.

    Returns:
        The model, and the known input as a function of the action, for `EstimatedObservation`.

    Raises:
        ValueError: if there are too few steps to tell the numbers, or sizes do not fit.
    """
    checks.function("state", state, "(env, observation)")
    look, known_input = state or observed_state, partial(_with_one, plain_action(env.action_space))
    integer("steps", steps, 1)
    env.action_space.seed(seed)
    seen, _ = env.reset(seed=seed)
    x = _state(look(env, seen))
    least = 10 * (len(x) + len(known_input(env.action_space.sample())))
    if steps < least:
        raise ValueError(f"{steps} steps are too few for {least // 10} numbers a state: take {least} at least")
    before, inputs, after = _random_steps(env, x, lambda seen: _state(look(env, seen)), known_input, steps)
    Z, n = np.concatenate([before, inputs], 1), x.shape[-1]
    W, *_ = np.linalg.lstsq(Z, after, rcond=None)
    left = after - Z @ W
    C = as_array("C", C)
    Q = left.T @ left / (steps - Z.shape[1])
    return LinearModel(W[:n].T, C, Q, square("R", R, len(C)), B=W[n:].T), known_input


def _random_steps(
    env: gym.Env, x: np.ndarray, look: Callable[[Any], np.ndarray], known_input: Callable[[Any], np.ndarray], steps: int
) -> tuple[np.ndarray, ...]:
    """States ``(steps, n)`` before random steps, known inputs of these, and states after them."""
    taken: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    ends = 0
    while len(taken) < steps:
        action = env.action_space.sample()
        seen, _, terminated, truncated, _ = env.step(action)
        following = look(seen)
        if terminated or truncated:  # how episodes end is not how they go on
            ends += 1
            if ends > steps:
                raise ValueError(
                    f"{ends} episodes have ended within {ends + len(taken)} steps: too short to learn from"
                )
            seen, _ = env.reset()
            following = look(seen)
        else:
            taken.append((x, known_input(action), following))
        x = following
    return tuple(np.array(each) for each in zip(*taken, strict=True))


def _with_one(plain: Callable[[Any], Any], action: Any) -> np.ndarray:
    """An action as numbers, and 1 behind."""
    a = np.asarray(plain(action), float)
    return np.concatenate([a, np.ones((*a.shape[:-1], 1))], -1)


def _state(given: Any) -> np.ndarray:
    x = numbers(given)
    if x is None or x.ndim != 1 or not np.isfinite(x).all():
        raise ValueError(f"state must give a row of finite numbers, got {short_repr(given)}")
    return x
