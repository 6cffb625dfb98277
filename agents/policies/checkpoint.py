"""Checkpoints that hold numbers and words only: opening one runs nothing that its writer has put in.

stable-baselines3 pickles what describes an agent, and whoever unpickles a file runs what it says. A
checkpoint of ours is a zip of a JSON file, which says what network to build, and of plain arrays,
its weights. Nothing is built that is larger than these arrays. Beside them stand the entries that
stable-baselines3 itself loads; nothing here reads them.
"""

import json
import zipfile
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.files import replacing
from agents.policies.network import POLICIES, Dense, built, torch_policy
from agents.policies.stable import entries
from estimators.checks import as_array, as_number, integer
from vessel_gym.extras import require
from vessel_gym.wrappers import EstimatedObservation

_DESCRIPTION = "vessel_gym.json"
_OF_THE_TRAINING = ("optimizer_class", "optimizer_kwargs")
_MOST_COMPRESSION, _SAME_VEHICLE = 10, 0.25
"""Ratio by which entries may be compressed, and by which parameters of a vehicle may differ: the largest mismatch."""


@dataclass(frozen=True)
class Policy:
    """A trained network and what it was fed with.

    Attributes:
        network: The network, a ``BasePolicy`` of stable-baselines3 or a `Dense`.
        frames: How many observations it sees side by side.
        observe: The kind of observation; None for a foreign checkpoint.
        statistics: Of observations, for those that were normalised: ``mean`` and ``var``, of one or
            of all frames.
        clip: Bound of normalised observations.
        epsilon: Added to their variance.
        environment: The environment of the training; "" for a foreign checkpoint.
        vehicle: Its vehicle, see `vehicle_of`; empty for a foreign checkpoint.
    """

    network: Any
    frames: int = 1
    observe: str | None = None
    statistics: dict[str, np.ndarray] = field(default_factory=dict)
    clip: float = np.inf
    epsilon: float = 0.0
    environment: str = ""
    vehicle: dict[str, Any] = field(default_factory=dict)

    @property
    def normalizes(self) -> int:
        """Size of its statistics: 0, one frame or all frames."""
        return len(self.statistics["mean"]) if self.statistics else 0

    def normalized(self, observations: np.ndarray) -> np.ndarray:
        """Observations normalised by these statistics, as by `VecNormalize`."""
        deviation = (observations - self.statistics["mean"]) / np.sqrt(
            self.statistics["var"] + self.epsilon
        )
        return np.clip(deviation, -self.clip, self.clip).astype(np.float32)


def save_agent(model: Any, path: str | Path) -> Path:
    """Save an agent that stable-baselines3 trained, for `agents.load_agent`: without pickle, and with all it needs.

    The statistics of a ``VecNormalize`` and the frames of a ``VecFrameStack`` go with it; it flies
    on them, frozen. stable-baselines3 loads the file, too, as one of ``model.save``, without these
    statistics.

    Args:
        model: A PPO, A2C, SAC, TD3, DDPG, RecurrentPPO, TQC, CrossQ, TRPO or ARS with its
            environment (``model.set_env`` gives it one).
        path: Where the checkpoint goes (``.zip``); folders are made.

    Returns:
        The path of the checkpoint.

    Raises:
        ValueError: if the model or its environment holds what cannot be stored in numbers and
            words.
        TypeError: for what is no model of stable-baselines3.
        OSError: if the checkpoint cannot be written.
        ModuleNotFoundError: without torch or stable-baselines3.
    """
    require("torch", "stable_baselines3", "sb3_contrib")
    from stable_baselines3.common.base_class import BaseAlgorithm

    if not isinstance(model, BaseAlgorithm):
        raise TypeError(f"save_agent saves what stable-baselines3 trained, got {model!r}")
    with replacing(zip_path(path)) as temporary:
        write(temporary, model, {})
    return zip_path(path)


def zip_path(path: str | Path) -> Path:
    """The path with the suffix of a checkpoint."""
    path = Path(path)
    return path if path.suffix == ".zip" else path.with_name(f"{path.name}.zip")


def description(path: str | Path) -> dict[str, Any] | None:
    """The description that `agents.training.algorithms.train` wrote into a checkpoint; None without one."""
    try:
        with zipfile.ZipFile(path) as archive:
            return _described(archive)
    except Exception:  # a file of somebody else may break anything that reads it
        return None


def write(path: Path, model: Any, described: dict[str, Any]) -> None:
    """Write a checkpoint, as `save_agent`, and plain data with it; equal models and descriptions give equal bytes."""
    spoken, statistics = _environment(model)
    arrays = {
        f"weights/{name}": tensor.numpy(force=True)
        for name, tensor in model.policy.state_dict().items()
    }
    arrays |= {f"statistics/{name}": value for name, value in statistics.items()}
    policy = {
        "class": _class_name(model.policy_class),
        "network": _in_words(model),
        "actions": _size(model.action_space),
        **spoken,
    }
    text = json.dumps(described | {"policy": policy}, indent=1)
    with zipfile.ZipFile(path, "w") as archive:  # of files dated 1980
        archive.writestr(zipfile.ZipInfo(_DESCRIPTION), text)
        for name in sorted(arrays):
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w") as file:
                np.lib.format.write_array(file, np.asarray(arrays[name]), allow_pickle=False)
        for name, content in entries(model).items():
            archive.writestr(zipfile.ZipInfo(name), content)


def _class_name(policy: type) -> str:
    if POLICIES.get(policy.__name__) != policy.__module__:
        raise ValueError(
            f"cannot store a {policy.__module__}.{policy.__qualname__}, only {', '.join(POLICIES)}:"
            " use model.save, and load_agent with trust=True"
        )
    return policy.__name__


def _in_words(model: Any) -> dict[str, Any]:
    """The arguments of a policy as JSON values; the activation by its name in `torch.nn`."""
    import torch

    network: dict[str, Any] = {
        key: v for key, v in model.policy_kwargs.items() if key not in _OF_THE_TRAINING
    }
    if model.use_sde:
        network["use_sde"] = True
    for key, value in network.items():
        if key == "activation_fn" and value in vars(torch.nn).values():
            network[key] = value.__name__
        try:
            json.dumps(network[key])
        except TypeError:
            raise ValueError(
                f"cannot store policy_kwargs[{key!r}], {value!r}, in words: "
                "use model.save, and load_agent with trust=True"
            ) from None
    return network


def _environment(model: Any) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Wrappers between an environment's observations and the network, as plain data and arrays."""
    from stable_baselines3.common.vec_env import (
        VecCheckNan,
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
    spoken: dict[str, Any] = {"frames": 1}
    statistics: dict[str, np.ndarray] = {}
    while isinstance(env, VecEnvWrapper):
        if isinstance(env, VecNormalize) and env.norm_obs and not statistics:
            found: Any = env.obs_rms
            statistics = {"mean": found.mean, "var": found.var}
            spoken |= {"clip": float(env.clip_obs), "epsilon": float(env.epsilon)}
        elif isinstance(env, VecFrameStack) and spoken["frames"] == 1:
            spoken["frames"] = _size(env.observation_space) // _size(env.venv.observation_space)
        elif not isinstance(env, VecMonitor | VecCheckNan) and not (
            isinstance(env, VecNormalize) and not env.norm_obs
        ):
            raise ValueError(f"cannot store what {type(env).__name__} does to observations")
        env = env.venv
    core = getattr(env.get_attr("unwrapped", 0)[0], "core", None)
    for inner in (*getattr(env, "envs", ())[:1], *([env.env] if hasattr(env, "env") else ())):
        _refuse_wrappers(inner)
    if core is None:
        for space in (env.observation_space, env.action_space):
            if not isinstance(space, gym.spaces.Box) or len(space.shape) != 1:
                raise ValueError(
                    "only agents whose observations and actions are vectors of numbers are stored,"
                    f" not {space}"
                )
        spec = env.get_attr("spec", 0)[0]
        named: dict[str, Any] = {
            "environment": spec.id if spec else "",
            "vehicle": {},
            "observe": None,
        }
        return (
            spoken | named | {"observations": spoken["frames"] * _size(env.observation_space)},
            statistics,
        )
    known = {
        "environment": core.system.name,
        "vehicle": vehicle_of(core.vehicle),
        "observe": core.observe_mode,
    }
    return spoken | known | {"observations": spoken["frames"] * core.observation_size}, statistics


def vehicle_of(vehicle: Any) -> dict[str, Any]:
    """Fingerprint of a vehicle: names of its components, time step and nominal parameters."""
    numbers = vehicle.dt, *np.ravel(vehicle.parameters(0.0, np.zeros((1, vehicle.normals))))
    names = {"states": list(vehicle.state_names), "actions": list(vehicle.action_names)}
    return names | {"numbers": [float(f"{each:.6g}") for each in numbers]}


def same_vehicle(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Equal names, and numbers that differ by no more than a mismatch may."""
    names, numbers = (
        ("states", "actions"),
        [as_array("numbers", each.get("numbers")) for each in (one, other)],
    )
    if (
        any(one.get(name) != other.get(name) for name in names)
        or numbers[0].shape != numbers[1].shape
    ):
        return False
    return np.allclose(numbers[0], numbers[1], rtol=_SAME_VEHICLE, atol=0.0)


def _size(space: Any) -> int:
    """Length of the vectors of a space."""
    return int(space.shape[0])


def _refuse_wrappers(env: Any) -> None:
    """Gymnasium's wrappers of observations and actions would be lost: an agent is loaded without them."""
    kinds = (
        gym.ObservationWrapper, gym.ActionWrapper, gym.vector.VectorObservationWrapper, gym.vector.VectorActionWrapper,
    )  # fmt: skip
    while isinstance(env, gym.Wrapper | gym.vector.VectorWrapper) and not isinstance(
        env, EstimatedObservation
    ):
        if isinstance(env, kinds):
            raise ValueError(
                f"cannot store what {type(env).__name__} does to observations or actions"
            )
        env = env.env


def packaged(env_id: str) -> Path:
    """The checkpoint that comes with the package for an environment: PPO, trained on its default estimates.

    Raises:
        ValueError: if there is none.
    """
    folder = Path(__file__).with_name("trained")
    known = sorted(path.stem for path in folder.glob("*.zip"))
    if env_id not in known:
        raise ValueError(
            f"no trained agent comes with the package for {env_id!r}, only for {', '.join(known)}:"
            " train one with vessel-gym train, and give the path of its checkpoint"
        )
    return folder / f"{env_id}.zip"


def load(path: Path, trust: bool, dense: bool = False) -> Policy:
    """The policy in a checkpoint, our own or one of stable-baselines3.

    Args:
        path: The file.
        trust: Whether a file that is not ours may run what it says.
        dense: Compute it in NumPy, as a `Dense`: without torch.

    Raises:
        ValueError: if it is no checkpoint, or not ours and not trusted.
        ModuleNotFoundError: without torch or stable-baselines3.
    """
    with _one_sentence(path), zipfile.ZipFile(path) as archive:
        described, names = _described(archive), set(archive.namelist())
    if described is None and "data" not in names:
        raise ValueError(f"{path} is not a checkpoint of an agent")
    ours = described is not None and "policy" in described
    if not ours and not trust:
        raise ValueError(
            f"{path} was not saved by agents.save_agent or vessel-gym train of this version, and to"
            " load it is to run whatever code it holds: if you trust whoever made it, say"
            " trust=True (--trust on a command line)"
        )
    if not dense:
        require("torch", "stable_baselines3", "sb3_contrib")
    with _one_sentence(path):
        if described and ours:
            return _ours(path, described, Dense if dense else torch_policy)
        return _foreign(path)


@contextmanager
def _one_sentence(path: Path) -> Iterator[None]:
    """Whatever a damaged or doctored file makes fail ends in one sentence."""
    try:
        yield
    except _Unfit as error:
        raise ValueError(f"{path} {error}") from None
    except Exception as error:
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise ValueError(
            f"{path} is not a checkpoint of an agent, or is damaged ({reason})"
        ) from None


class _Unfit(Exception):
    """A checkpoint that is whole, but cannot be flown."""


def _described(archive: zipfile.ZipFile) -> dict[str, Any] | None:
    size = sum(entry.file_size for entry in archive.infolist())
    if size > _MOST_COMPRESSION * Path(str(archive.filename)).stat().st_size:
        raise ValueError(f"its entries hold {size} bytes")
    if _DESCRIPTION not in archive.namelist():
        return None
    described = json.loads(archive.read(_DESCRIPTION))
    if not isinstance(described, dict):
        raise ValueError(f"{_DESCRIPTION} is no table")
    return described


def _ours(path: Path, described: dict[str, Any], build: Callable[..., Any]) -> Policy:
    """Build the network that the words tell of, and fill in the numbers."""
    settings = described["policy"]
    arrays: dict[str, dict[str, np.ndarray]] = {"weights": {}, "statistics": {}}
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            folder, _, rest = name.partition("/")
            if folder in arrays:
                arrays[folder][rest.removesuffix(".npy")] = _array(archive, name)
    _check_sizes(settings, arrays["weights"].values())
    frames, statistics = integer("frames", settings["frames"], 1), arrays["statistics"]
    environment, vehicle = settings["environment"], dict(settings["vehicle"])
    built = build(settings, arrays["weights"])
    seen = built.observation_space
    if not statistics:
        return Policy(built, frames, settings["observe"], environment=environment, vehicle=vehicle)
    mean, var = statistics["mean"], statistics["var"]
    if (
        mean.shape not in (seen.shape, (seen.shape[0] // frames,))
        or var.shape != mean.shape
        or (var < 0).any()
    ):
        raise ValueError("its statistics are of something else")
    clip, epsilon = as_number(settings["clip"]), as_number(settings["epsilon"])
    if not (clip > 0.0 and 0.0 <= epsilon < np.inf and (var + epsilon > 0.0).all()):
        raise ValueError("its clip and epsilon do not go with its statistics")
    return Policy(
        built, frames, settings["observe"], statistics, clip, epsilon, environment, vehicle
    )


def _array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """An array of a checkpoint, as long as its entry."""
    with archive.open(name) as file:
        if np.lib.format.read_magic(file) != (1, 0):
            raise ValueError(f"{name} is no array of version 1.0")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
        if dtype.kind != "f" and (dtype.kind, shape) != (
            "i",
            (),
        ):  # a batch normalisation counts its steps
            raise ValueError(f"{name} holds {dtype}, not real numbers")
        array = np.frombuffer(file.read(), dtype).reshape(shape, order="F" if fortran else "C")
    if not (np.abs(array) <= np.finfo(np.float32).max).all():
        raise ValueError(f"{name} is not finite in single precision")
    return array.copy()


def _check_sizes(settings: dict[str, Any], weights: Collection[np.ndarray]) -> None:
    """Refuse a description with more layers than arrays, or with a size that no array has."""
    largest = max((*(max(array.shape, default=1) for array in weights), len(weights)))

    def check(value: Any) -> None:
        sizes = (
            value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        )
        if len(sizes) > largest or (isinstance(value, int) and value > largest):
            raise ValueError("it describes a larger network than its weights are of")
        for each in sizes:
            check(each)

    check({key: value for key, value in settings.items() if key != "vehicle"})


def _foreign(path: Path) -> Policy:
    """Unpickle what stable-baselines3 saved, of whatever algorithm."""
    from stable_baselines3.common.save_util import load_from_zip_file

    data, weights, _ = load_from_zip_file(path, device="cpu")
    if not data or "policy_class" not in data or "policy" not in weights:
        raise ValueError("it holds no policy")
    # Only VecNormalize has original observations to keep, but algorithms with a replay buffer keep
    # them always.
    if data.get("_last_original_obs") is not None and "replay_buffer_class" not in data:
        raise _Unfit(
            "was trained under VecNormalize, whose statistics stable-baselines3 leaves out: load it"
            " there with its VecNormalize, model.set_env(...), and save it by"
            " agents.save_agent(model, path)"
        )
    network = {key: value for key, value in data["policy_kwargs"].items() if key != "device"}
    if data.get("use_sde"):
        network["use_sde"] = True
    spaces = data["observation_space"], data["action_space"]
    return Policy(built(data["policy_class"], *spaces, network, weights["policy"]))
