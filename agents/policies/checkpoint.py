"""Policies as ``.npz`` files of plain arrays: loaded without pickle, computed without torch."""

import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.files import replacing
from agents.policies.network import Network, exported
from vessel_gym.extras import require
from vessel_gym.wrappers import EstimatedObservation

_SAME_VEHICLE = 0.25
"""Ratio by which parameters of a vehicle may differ: the largest mismatch."""
_CHANGES = (
    gym.ObservationWrapper,
    gym.ActionWrapper,
    gym.vector.VectorObservationWrapper,
    gym.vector.VectorActionWrapper,
)
"""Wrappers that a stored policy would lack."""


@dataclass(frozen=True)
class Policy:
    """Observations and actions of a policy, and its purpose.

    Attributes:
        observations: Shape of the network's observations.
        actions: Shape of the actions.
        layers: See `Network`.
        squash: See `Network`.
        frames: Number of observations side by side.
        observe: Kind of the observation; None if the environment has only one.
        environment: Environment of the training; "" if unknown.
        vehicle: Its vehicle, see `vehicle_of`; empty if unknown.
        mean: Subtracted from observations that are normalised; empty for others.
        variance: Observations are divided by its root.
        clip: Bound of normalised observations.
    """

    observations: list[int]
    actions: list[int]
    layers: list[str]
    squash: bool
    frames: int = 1
    observe: str | None = None
    environment: str = ""
    vehicle: dict[str, Any] = field(default_factory=dict)
    mean: list[float] = field(default_factory=list)
    variance: list[float] = field(default_factory=list)
    clip: float = np.inf


def save_agent(model: Any, path: str | Path) -> Path:
    """Save the policy of a model of stable-baselines3 for `agents.load_agent`.

    The policy is loaded without pickle and computed without torch. The statistics of a
    ``VecNormalize`` around the model's environment, and the number of frames of a ``VecFrameStack``
    around that, are saved with the policy.

    Args:
        model: A model of an algorithm for continuous actions, with its environment
            (``model.set_env`` gives it one).
        path: Place of the policy (``.npz``); folders are made.

    Returns:
        The path of the policy.

    Raises:
        ValueError: if the model or its environment holds what cannot be stored in arrays.
        TypeError: if ``model`` is no model of stable-baselines3.
        OSError: if the policy cannot be written.
        ModuleNotFoundError: without torch or stable-baselines3.
    """
    require("torch", "stable_baselines3", "sb3_contrib")
    from stable_baselines3.common.base_class import BaseAlgorithm

    if not isinstance(model, BaseAlgorithm):
        raise TypeError(f"save_agent saves what stable-baselines3 trained, got {model!r}")
    return write(npz_path(path), model, {})


def write(path: Path, model: Any, described: dict[str, Any]) -> Path:
    """Write a policy with a description; equal models and descriptions give equal bytes."""
    network = exported(model.policy)
    shapes = [list(space.shape) for space in (model.observation_space, model.action_space)]
    policy = Policy(shapes[0], shapes[1], network.layers, network.squash, **_environment(model))
    text = np.array(json.dumps(described | {"policy": asdict(policy)}))
    arrays: Any = {"description": text, **network.arrays}
    with replacing(path) as temporary:
        np.savez(temporary, **arrays)
    return path


def _environment(model: Any) -> dict[str, Any]:
    """Fields of a `Policy` that the environment of a model decides."""
    from stable_baselines3.common.vec_env import (
        VecEnvWrapper,
        VecFrameStack,
        VecMonitor,
        VecNormalize,
    )

    env = model.get_env()
    if env is None:
        raise ValueError(
            "the model has no environment to tell what it observes: give it one with model.set_env"
        )
    known: dict[str, Any] = {}
    while isinstance(env, VecEnvWrapper):
        if isinstance(env, VecFrameStack) and not known:
            known["frames"] = env.stacked_obs.n_stack
        elif isinstance(env, VecNormalize) and env.norm_obs and "mean" not in known:
            found: Any = env.obs_rms
            variance = (found.var + env.epsilon).tolist()
            known |= {"mean": found.mean.tolist(), "variance": variance, "clip": env.clip_obs}
        elif not isinstance(env, VecMonitor) and getattr(env, "norm_obs", True):
            raise ValueError(f"cannot store what {type(env).__name__} does to observations")
        env = env.venv
    inner: Any = getattr(env, "envs", [getattr(env, "env", None)])[0]
    unwrapped = env.get_attr("unwrapped", 0)[0]
    while isinstance(inner, gym.Wrapper | gym.vector.VectorWrapper):
        if isinstance(inner, _CHANGES) and not isinstance(inner, EstimatedObservation):
            raise ValueError(
                f"cannot store what {type(inner).__name__} does to observations or actions"
            )
        inner = inner.env
    if core := getattr(unwrapped, "core", None):
        config = core.config
        known |= {"observe": config.options.observe, "vehicle": vehicle_of(config.system.vehicle)}
        return known | {"environment": config.system.name}
    return known | {"environment": unwrapped.spec.id if unwrapped.spec else ""}


def vehicle_of(vehicle: Any) -> dict[str, Any]:
    """Fingerprint of a vehicle: names of its components, time step and nominal parameters."""
    numbers = vehicle.dt, *np.ravel(vehicle.parameters(0.0, np.zeros((1, vehicle.normals))))
    names = {"states": list(vehicle.state_names), "actions": list(vehicle.action_names)}
    return names | {"numbers": [float(f"{each:.6g}") for each in numbers]}


def same_vehicle(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Equal names, and numbers that differ by no more than a mismatch may."""
    names = [each | {"numbers": len(each.get("numbers", ()))} for each in (one, other)]
    return names[0] == names[1] and np.allclose(
        one["numbers"], other["numbers"], rtol=_SAME_VEHICLE, atol=0.0
    )


def description(path: str | Path) -> dict[str, Any]:
    """The description that a training wrote into a policy."""
    with np.load(policy_path(path)) as file:
        return json.loads(str(file["description"]))


def npz_path(path: str | Path) -> Path:
    """A path with the suffix of a policy, in the place of ``.zip``."""
    path = Path(path)
    return path.with_name(f"{path.name.removesuffix('.zip').removesuffix('.npz')}.npz")


def policy_path(path: str | Path) -> Path:
    """Path of a policy: of ``<name>.zip`` the file ``<name>.npz`` beside it, if there is one."""
    zipped = os.fspath(path).endswith(".zip")
    return npz_path(path) if zipped and os.path.isfile(npz_path(path)) else Path(path)


def packaged(env_id: str) -> Path:
    """The policy that comes with the package for an environment: PPO on its default estimates.

    Raises:
        ValueError: if there is none.
    """
    folder = Path(__file__).with_name("trained")
    known = sorted(path.stem for path in folder.glob("*.npz"))
    if env_id not in known:
        raise ValueError(
            f"no trained agent comes with the package for {env_id!r}, only for {', '.join(known)}:"
            " train one with vessel-gym train, and give the path of its checkpoint"
        )
    return folder / f"{env_id}.npz"


def load(path: Path, space: Any) -> tuple[Policy, Network]:
    """A policy of `save_agent`, and its network.

    Args:
        path: Its file.
        space: The environment's actions.

    Raises:
        ValueError: if it is none.
    """
    try:
        with path.open("rb") as stream, np.load(stream) as file:
            arrays = dict(file) if "description" in file else {}
        if arrays:
            policy = Policy(**json.loads(str(arrays.pop("description")))["policy"])
            network = Network(policy.layers, arrays, policy.squash, space)
            if not np.isfinite(network(np.zeros((1, *policy.observations), np.float32))[0]).all():
                raise ValueError("its actions are not finite")
            return policy, network
    except Exception as error:  # whatever a damaged or doctored file makes fail
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise ValueError(
            f"{path} is not a checkpoint of an agent, or is damaged ({reason})"
        ) from None
    raise ValueError(
        f"{path} was not saved by agents.save_agent or vessel-gym train of this version: load it by"
        " stable-baselines3, and save the model by agents.save_agent(model, path)"
    )
