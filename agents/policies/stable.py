"""Entries of stable-baselines3's own file format, so that ``PPO.load(path)`` reads a checkpoint of this package.

`load_agent` reads none of them: they hold pickles.
"""

import base64
import io
import json
import pickle
from contextlib import suppress
from typing import Any

import cloudpickle
from gymnasium.spaces import Box

_OF_THE_RUN = {
    "start_time", "tensorboard_log", "ep_info_buffer", "ep_success_buffer", "_last_obs", "_last_original_obs",
    "_last_episode_starts", "_last_lstm_states", "_num_timesteps_at_start", "weights", "described", "elapsed",
}  # fmt: skip
"""Attributes of a single run, ARS's copy of its network, and what the checkpoint's own description says."""


def entries(model: Any) -> dict[str, bytes]:
    """Settings, networks and optimisers as ``model.save`` writes them; equal trainings give equal bytes."""
    import stable_baselines3
    from stable_baselines3.common.save_util import recursive_getattr

    states, variables = model._get_torch_save_params()
    left_out = _OF_THE_RUN.union(
        model._excluded_save_params(), (name.split(".")[0] for name in states + variables)
    )
    data: dict[str, Any] = {}
    for name, value in vars(model).items():
        with suppress(
            pickle.PicklingError
        ):  # an attribute of the user's, beside those of the algorithm
            if name not in left_out:
                data[name] = _entry(value)
    tensors = model.get_parameters()
    tensors["pytorch_variables"] = {name: recursive_getattr(model, name) for name in variables}
    return {
        "data": json.dumps(data, indent=1).encode(),
        **{f"{name}.pth": _torch_file(value) for name, value in tensors.items()},
        "_stable_baselines3_version": stable_baselines3.__version__.encode(),
    }


def _entry(value: Any) -> Any:
    """A setting as JSON, or as a pickle in JSON.

    stable-baselines3 adds the printed form of what it pickles, which holds memory addresses.

    Raises:
        pickle.PicklingError: for what is neither.
    """
    if isinstance(value, Box):
        value = Box(
            value.low, value.high, dtype=value.dtype
        )  # without the random state of the training
    try:
        json.dumps(value)
        return value
    except (TypeError, ValueError):
        pass
    try:
        pickled = cloudpickle.dumps(value)
    except TypeError as error:
        raise pickle.PicklingError(str(error)) from None
    return {":type:": str(type(value)), ":serialized:": base64.b64encode(pickled).decode()}


def _torch_file(value: Any) -> bytes:
    import torch

    buffer = io.BytesIO()
    torch.save(value, buffer)
    return buffer.getvalue()
