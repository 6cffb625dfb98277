"""State of a training: all that learning changes, so that an interrupted one goes on to the same bits.

Its file is a pickle of arrays and numbers that is read without running anything: the reader makes NumPy arrays and
records of state of this package, and refuses every other name.
"""

import io
import pickle
import random
from collections import deque
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.save_util import recursive_getattr, recursive_setattr

from agents.files import replacing

_NUMBERS = (
    "num_timesteps", "_n_updates", "_episode_num", "_current_progress_remaining", "_last_obs", "_last_original_obs",
    "_last_episode_starts",
)  # fmt: skip
"""Attributes of a learner that learning changes, beside its networks, buffers and recurrent state."""
_LISTS = ("ep_info_buffer", "ep_success_buffer")
_FIXED = ("owner", "name", "rows")
"""Attributes of a `vessel_gym.loop.Loop` that no step changes."""
_PARTS = ("_faults", "_transit")
"""Parts of a loop whose arrays change: faulty and late sensors."""
_CALLABLE = {
    ("numpy", "dtype"), ("numpy", "ndarray"), ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"), ("estimators.belief", "_restored_read_only"),
}  # fmt: skip
"""Functions and classes that a state may name, beside the dataclasses of this package."""


def save_state(path: Path, model: Any, more: dict[str, Any]) -> None:
    """Write the state of a learner between two rollouts, whole or not at all.

    Args:
        path: The file.
        model: A learner of stable-baselines3 on a `StableBaselinesVecEnv`, perhaps with stacked frames.
        more: Plain data to keep with it.

    Raises:
        OSError: if it cannot be written.
    """
    with replacing(path) as temporary, temporary.open("wb") as file:
        state = {"more": more, "learner": _learner(model), "environment": _environment(model.env)}
        pickle.dump(state, file, protocol=4)  # whose arrays name no other function


def load_state(path: Path) -> dict[str, Any]:
    """Read what `save_state` wrote; nothing in the file is run.

    Raises:
        ValueError: if it is no such file.
        OSError: if it cannot be read.
    """
    try:
        state = _Reader(io.BytesIO(path.read_bytes())).load()
        if set(state) != {"more", "learner", "environment"}:
            raise ValueError("it lacks a part")
    except OSError:
        raise
    except Exception as error:  # a damaged pickle may break anything
        raise ValueError(f"{path} is no state of a training, or is damaged ({error})") from None
    return dict(state)


def restore(model: Any, state: dict[str, Any]) -> None:
    """Put a learner and its environments into a state that `load_state` read."""
    learner = state["learner"]
    model.set_parameters(_tensors(learner["parameters"]), device="cpu")
    for name, value in learner["variables"].items():
        recursive_getattr(model, name).data.copy_(torch.from_numpy(value))
    for name, value in learner["numbers"].items():
        setattr(model, name, value)
    for name, values in learner["lists"].items():
        setattr(model, name, deque(values, maxlen=model._stats_window_size))
    if learner["lstm"] is not None:
        recursive_setattr(model, "_last_lstm_states", type(model._last_lstm_states)(*_tensors(learner["lstm"])))
    if learner["replay"] is not None:
        _fill(model.replay_buffer, learner["replay"])
    model.env.reset()
    _put_environment(model.env, state["environment"])
    generators = learner["generators"]
    random.setstate(generators["random"])
    np.random.set_state(generators["numpy"])  # noqa: NPY002  (stable-baselines3 draws from it)
    torch.set_rng_state(torch.from_numpy(generators["torch"]))
    model.action_space.np_random.bit_generator.state = generators["actions"]


class _Reader(pickle.Unpickler):
    """Reader of arrays and of this package's records: a file can call nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        """The dataclass of a record, or what an array is made with."""
        known = (module, name) in _CALLABLE
        if known or module.partition(".")[0] in ("estimators", "vessel_gym"):
            found = getattr(import_module(module), name)
            if known or (isinstance(found, type) and is_dataclass(found)):
                return found
        raise ValueError(f"it names {module}.{name}")


def _learner(model: Any) -> dict[str, Any]:
    """The state of a learner as arrays and plain data."""
    names = model._get_torch_save_params()[1]
    replay, lstm = getattr(model, "replay_buffer", None), getattr(model, "_last_lstm_states", None)
    return {
        "parameters": _arrays(model.get_parameters()),
        "variables": {name: recursive_getattr(model, name).numpy(force=True) for name in names},
        "numbers": {name: getattr(model, name) for name in _NUMBERS if hasattr(model, name)},
        "lists": {name: list(getattr(model, name) or ()) for name in _LISTS},
        "lstm": None if lstm is None else _arrays(tuple(lstm)),
        "replay": None if replay is None else _filled(replay),
        "generators": {
            "random": random.getstate(),
            "numpy": np.random.get_state(),  # noqa: NPY002
            "torch": torch.get_rng_state().numpy(),
            "actions": model.action_space.np_random.bit_generator.state,
        },
    }


def _filled(buffer: Any) -> dict[str, Any]:
    """The part of a replay buffer that holds transitions."""
    rows = buffer.buffer_size if buffer.full else buffer.pos
    arrays = {name: value[:rows].copy() for name, value in vars(buffer).items() if isinstance(value, np.ndarray)}
    return {"pos": buffer.pos, "full": buffer.full, "arrays": arrays}


def _fill(buffer: Any, filled: dict[str, Any]) -> None:
    buffer.pos, buffer.full = filled["pos"], filled["full"]
    for name, value in filled["arrays"].items():
        getattr(buffer, name)[: len(value)] = value


def _environment(env: Any) -> dict[str, Any]:
    """The state of a batch and of what stands between it and the learner."""
    stacked = None
    if hasattr(env, "stacked_obs"):
        stacked, env = env.stacked_obs.stacked_obs, env.venv
    batch = env.env.unwrapped
    core = batch.core
    loops = [_changing(loop) for loop in (core.loop, core.raw) if loop is not None]
    return {
        "stacked": stacked, "returns": env._returns, "lengths": env._lengths, "ended": batch._ended,
        "seeds": core.seeds, "episodes": core.episodes, "now": core.now, "loops": loops,
    }  # fmt: skip


def _put_environment(env: Any, state: dict[str, Any]) -> None:
    if state["stacked"] is not None:
        env.stacked_obs.stacked_obs[...], env = state["stacked"], env.venv
    env._returns, env._lengths = state["returns"], state["lengths"]
    batch = env.env.unwrapped
    batch._ended, core = state["ended"], batch.core
    core.seeds, core.episodes, core.now = state["seeds"], state["episodes"], state["now"]
    for loop, values in zip((core.loop, core.raw), state["loops"], strict=False):
        for name, part in ((name, getattr(loop, name)) for name in _PARTS):
            own = values.pop(name)
            if part is not None:
                vars(part).update(own)
        vars(loop).update(values)


def _changing(loop: Any) -> dict[str, Any]:
    """Changing parts of sensors and estimator: arrays, a belief, and the arrays of late and faulty sensors."""
    values = {name: value for name, value in vars(loop).items() if name not in _FIXED}
    for name in _PARTS:
        values[name] = {k: v for k, v in vars(values[name] or _Reader).items() if isinstance(v, np.ndarray)}
    return values


def _arrays(value: Any) -> Any:
    """A tree with arrays in place of tensors."""
    if isinstance(value, torch.Tensor):
        return value.numpy(force=True).copy()
    if isinstance(value, dict):
        return {key: _arrays(each) for key, each in value.items()}
    return type(value)(_arrays(each) for each in value) if isinstance(value, list | tuple) else value


def _tensors(value: Any) -> Any:
    """A tree with tensors in place of arrays."""
    if isinstance(value, np.ndarray):
        return torch.from_numpy(value.copy())
    if isinstance(value, dict):
        return {key: _tensors(each) for key, each in value.items()}
    return type(value)(_tensors(each) for each in value) if isinstance(value, list | tuple) else value
