"""Checkpoints that hold numbers and words only: opening one runs nothing that its writer has put in.

stable-baselines3 pickles what describes an agent, and whoever unpickles a file runs what it says. A checkpoint of ours
is a zip of a JSON file, which says what network to build, and of plain arrays, its weights. Nothing is built that is
larger than these arrays.
"""

import json
import zipfile
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.files import replacing
from agents.named import vector_class
from estimators.checks import as_array, as_number, whole
from vessel_gym.extras import require

_DESCRIPTION = "vessel_gym.json"
_POLICIES = {
    "ActorCriticPolicy": "stable_baselines3.common.policies",
    "SACPolicy": "stable_baselines3.sac.policies",
    "TD3Policy": "stable_baselines3.td3.policies",
    "RecurrentActorCriticPolicy": "sb3_contrib.common.recurrent.policies",
    "LstmPolicy": "agents.policies.lstm",
    "TruthPolicy": "agents.training.critic",
    "TruthLstmPolicy": "agents.training.critic",
}
"""The networks that a checkpoint may ask for, and where they are."""
_OF_THE_TRAINING = ("optimizer_class", "optimizer_kwargs")
_MOST_COMPRESSION, _SAME_VEHICLE = 10, 0.25
"""Ratio by which entries may be compressed, and by which parameters of a vehicle may differ: the largest mismatch."""


@dataclass(frozen=True)
class Policy:
    """A trained network and what it was fed with.

    Attributes:
        network: The network, a ``BasePolicy`` of stable-baselines3 or a `Dense`.
        frames: How many observations it sees side by side.
        observe: The kind of observation; None if nobody wrote it down.
        statistics: Of observations, for those that were normalised: ``mean`` and ``var``, of one or of all frames.
        clip: Bound of normalised observations.
        epsilon: Added to their variance.
        environment: The environment of the training; "" if nobody wrote it down.
        vehicle: Its vehicle, see `_vehicle`; empty if nobody wrote it down.
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
        deviation = (observations - self.statistics["mean"]) / np.sqrt(self.statistics["var"] + self.epsilon)
        return np.clip(deviation, -self.clip, self.clip).astype(np.float32)


def save_agent(model: Any, path: str | Path) -> Path:
    """Save an agent that stable-baselines3 trained, for `agents.load_agent`: without pickle, and with all it needs.

    The statistics of a ``VecNormalize`` and the frames of a ``VecFrameStack`` go with it; it flies on them, frozen.

    Args:
        model: A PPO, A2C, SAC, TD3, DDPG or RecurrentPPO with its environment (``model.set_env`` gives it one).
        path: Where the checkpoint goes (``.zip``); folders are made.

    Returns:
        The path of the checkpoint.

    Raises:
        ValueError: if the model or its environment holds what cannot be stored in numbers and words.
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
    """The description that `agents.training.ppo.train` wrote into a checkpoint; None without one."""
    try:
        with zipfile.ZipFile(path) as archive:
            return _described(archive)
    except Exception:  # a file of somebody else may break anything that reads it
        return None


def write(path: Path, model: Any, described: dict[str, Any]) -> None:
    """Write a checkpoint, as `save_agent`, and plain data with it; equal models and descriptions give equal bytes."""
    spoken, statistics = _environment(model)
    arrays = {f"weights/{name}": tensor.numpy(force=True) for name, tensor in model.policy.state_dict().items()}
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


def _class_name(policy: type) -> str:
    if _POLICIES.get(policy.__name__) != policy.__module__:
        raise ValueError(
            f"cannot store a {policy.__module__}.{policy.__qualname__}, only {', '.join(_POLICIES)}: "
            "use model.save, and load_agent with trust=True"
        )
    return policy.__name__


def _in_words(model: Any) -> dict[str, Any]:
    """The arguments of a policy as JSON values; the activation by its name in `torch.nn`."""
    import torch

    network: dict[str, Any] = {key: v for key, v in model.policy_kwargs.items() if key not in _OF_THE_TRAINING}
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
    from stable_baselines3.common.vec_env import VecCheckNan, VecEnvWrapper, VecFrameStack, VecMonitor, VecNormalize

    env = model.get_env()
    if env is None:
        raise ValueError("the model has no environment to tell what it observes: give it one with model.set_env")
    spoken: dict[str, Any] = {"frames": 1}
    statistics: dict[str, np.ndarray] = {}
    while isinstance(env, VecEnvWrapper):
        if isinstance(env, VecNormalize) and env.norm_obs and not statistics:
            found: Any = env.obs_rms
            statistics = {"mean": found.mean, "var": found.var}
            spoken |= {"clip": float(env.clip_obs), "epsilon": float(env.epsilon)}
        elif isinstance(env, VecFrameStack) and spoken["frames"] == 1:
            spoken["frames"] = _size(env.observation_space) // _size(env.venv.observation_space)
        elif not isinstance(env, VecMonitor | VecCheckNan) and not (isinstance(env, VecNormalize) and not env.norm_obs):
            raise ValueError(f"cannot store what {type(env).__name__} does to observations")
        env = env.venv
    core = getattr(env.get_attr("unwrapped", 0)[0], "core", None)
    if core is None:
        raise ValueError("an agent is stored for the environments of vessel_gym: this one was trained in another")
    for inner in (*getattr(env, "envs", ())[:1], *([env.env] if hasattr(env, "env") else ())):
        _refuse_wrappers(inner)
    # What a critic alone was told while it learned is no part of what the agent sees.
    seen = spoken["frames"] * core.observation_size
    if statistics and _size(model.observation_space) != seen:
        raise ValueError("cannot store a VecNormalize that counts what the critic alone is told: leave it out")
    known = {"environment": core.system.name, "vehicle": _vehicle(core.vehicle)}
    return spoken | known | {"observations": seen, "observe": core.observe_mode}, statistics


def _vehicle(vehicle: Any) -> dict[str, Any]:
    """Names and numbers by which a vehicle is known again: its time step and nominal parameters."""
    numbers = vehicle.dt, *np.ravel(vehicle.parameters(0.0, np.zeros((1, vehicle.normals))))
    names = {"states": list(vehicle.state_names), "actions": list(vehicle.action_names)}
    return names | {"numbers": [float(f"{each:.6g}") for each in numbers]}


def _same_vehicle(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Equal names, and numbers that differ by no more than a mismatch may."""
    names, numbers = ("states", "actions"), [as_array("numbers", each.get("numbers")) for each in (one, other)]
    if any(one.get(name) != other.get(name) for name in names) or numbers[0].shape != numbers[1].shape:
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
    while isinstance(env, gym.Wrapper | gym.vector.VectorWrapper):
        if isinstance(env, kinds):
            raise ValueError(f"cannot store what {type(env).__name__} does to observations or actions")
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
            f"no trained agent comes with the package for {env_id!r}, only for {', '.join(known)}: train one with "
            "scripts.train, and give the path of its checkpoint"
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
    with _reading(path), zipfile.ZipFile(path) as archive:
        described, names = _described(archive), set(archive.namelist())
    if described is None and "data" not in names:
        raise ValueError(f"{path} is not a checkpoint of an agent")
    ours = described is not None and "policy" in described
    if not ours and not trust:
        raise ValueError(
            f"{path} was not saved by agents.save_agent or scripts.train of this version, and to load it is to run "
            "whatever code it holds: if you trust whoever made it, say trust=True (--trust on a command line)"
        )
    if not dense:
        require("torch", "stable_baselines3", "sb3_contrib")
    with _reading(path):
        if described and ours:
            return _ours(path, described, Dense if dense else _in_torch)
        return _foreign(path, described or {})


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Whatever a damaged or doctored file makes fail ends in one sentence."""
    try:
        yield
    except _Unfit as error:
        raise ValueError(f"{path} {error}") from None
    except Exception as error:
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise ValueError(f"{path} is not a checkpoint of an agent, or is damaged ({reason})") from None


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


class Dense:
    """The actor of a plain policy in NumPy: dense layers of tanh, as torch computes them but for rounding.

    It is made of what a checkpoint says of its policy, and of its arrays by name.

    Raises:
        ValueError: if it is another network.
    """

    def __init__(self, told: dict[str, Any], weights: dict[str, np.ndarray]) -> None:
        if (told["class"], told["network"]["activation_fn"]) != ("ActorCriticPolicy", "Tanh"):
            raise ValueError("it is no network of dense layers of tanh")
        widths = told["network"]["net_arch"]
        widths = widths["pi"] if isinstance(widths, dict) else widths
        names = (*(f"mlp_extractor.policy_net.{2 * i}" for i in range(len(widths))), "action_net")
        self._layers = [(weights[f"{name}.weight"], weights[f"{name}.bias"]) for name in names]
        self.observation_space, self.action_space = _spaces(told)
        sizes = [told["observations"], *widths, told["actions"]]
        for name, (weight, bias), before, after in zip(names, self._layers, sizes[:-1], sizes[1:], strict=True):
            if (weight.shape, bias.shape) != ((after, before), (after,)):
                raise ValueError(f"{name} is no layer of {before} to {after} numbers")

    def predict(
        self, observations: np.ndarray, state: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, Any]:
        """The mean actions, within the bounds; the state is nobody's."""
        *hidden, (last, bias) = self._layers
        for weight, shift in hidden:
            observations = np.tanh(observations @ weight.T + shift)
        return np.clip(observations @ last.T + bias, -1.0, 1.0), state


def _spaces(told: dict[str, Any]) -> tuple[Any, Any]:
    """Spaces of observations and of actions."""
    from gymnasium.spaces import Box

    seen = Box(-np.inf, np.inf, (told["observations"],), np.float32)
    return seen, Box(-1.0, 1.0, (told["actions"],), np.float32)


def _in_torch(told: dict[str, Any], arrays: dict[str, np.ndarray]) -> Any:
    """The network that the words tell of, with its weights."""
    from importlib import import_module

    import torch

    network = dict(told["network"])
    if "activation_fn" in network:
        kind = getattr(torch.nn, network["activation_fn"])
        if not (isinstance(kind, type) and issubclass(kind, torch.nn.Module)):
            raise ValueError(f"{network['activation_fn']!r} is no activation")
        network["activation_fn"] = kind
    policy = getattr(import_module(_POLICIES[told["class"]]), told["class"])
    weights = {name: torch.from_numpy(array) for name, array in arrays.items()}
    with _bounded(sum(array.size for array in arrays.values())):
        return _built(policy, *_spaces(told), network, weights)


def _bounded(size: int) -> Any:
    """A context in which torch makes no more parameters than ``size`` numbers, those of the file."""
    from torch import Tensor, empty
    from torch.overrides import TorchFunctionMode

    class Bounded(TorchFunctionMode):
        left = 2 * size  # `TruthPolicy` makes a critic twice

        def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
            made = func(*args, **(kwargs or {}))
            numbers = made.numel() if isinstance(made, Tensor) else 0
            self.left -= numbers if func is empty else 0
            if self.left < 0 or numbers > size:
                raise ValueError("it describes a larger network than its weights are of")
            return made

    return Bounded()


def _ours(path: Path, described: dict[str, Any], build: Callable[..., Any]) -> Policy:
    """Build the network that the words tell of, and fill in the numbers."""
    told = described["policy"]
    arrays: dict[str, dict[str, np.ndarray]] = {"weights": {}, "statistics": {}}
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            folder, _, rest = name.partition("/")
            if folder in arrays:
                arrays[folder][rest.removesuffix(".npy")] = _array(archive, name)
    _check_sizes(told, arrays["weights"].values())
    frames, statistics = whole("frames", told["frames"], 1), arrays["statistics"]
    environment = told.get("environment", described.get("env_id", ""))
    vehicle = dict(told.get("vehicle") or _registered_vehicle(described))
    built = build(told, arrays["weights"])
    seen = built.observation_space
    if not statistics:
        return Policy(built, frames, told["observe"], environment=environment, vehicle=vehicle)
    mean, var = statistics["mean"], statistics["var"]
    if mean.shape not in (seen.shape, (seen.shape[0] // frames,)) or var.shape != mean.shape or (var < 0).any():
        raise ValueError("its statistics are of something else")
    clip, epsilon = as_number(told["clip"]), as_number(told["epsilon"])
    if not (clip > 0.0 and 0.0 <= epsilon < np.inf and (var + epsilon > 0.0).all()):
        raise ValueError("its clip and epsilon do not go with its statistics")
    return Policy(built, frames, told["observe"], statistics, clip, epsilon, environment, vehicle)


def _array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """An array of a checkpoint, as long as its entry."""
    with archive.open(name) as file:
        if np.lib.format.read_magic(file) != (1, 0):
            raise ValueError(f"{name} is no array of version 1.0")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
        if dtype.kind != "f":
            raise ValueError(f"{name} holds {dtype}, not real numbers")
        array = np.frombuffer(file.read(), dtype).reshape(shape, order="F" if fortran else "C")
    if not (np.abs(array) <= np.finfo(np.float32).max).all():
        raise ValueError(f"{name} is not finite in single precision")
    return array.copy()


def _check_sizes(told: dict[str, Any], weights: Collection[np.ndarray]) -> None:
    """Refuse a description with more layers than arrays, or with a size that no array has."""
    largest = max((*(max(array.shape, default=1) for array in weights), len(weights)))

    def check(value: Any) -> None:
        sizes = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        if len(sizes) > largest or (isinstance(value, int) and value > largest):
            raise ValueError("it describes a larger network than its weights are of")
        for each in sizes:
            check(each)

    check({key: value for key, value in told.items() if key != "vehicle"})


def _registered_vehicle(described: Mapping[str, Any]) -> dict[str, Any]:
    """The vehicle of the environment that a training names; empty for a vehicle file, or one that is not known."""
    env_id = described.get("env_id", "")
    system = getattr(vector_class(env_id), "system", None) if env_id in gym.registry else None
    return {} if system is None or "vessel" in described.get("env_options", {}) else _vehicle(system.vehicle)


def _foreign(path: Path, described: dict[str, Any]) -> Policy:
    """Unpickle what stable-baselines3 saved, of whatever algorithm."""
    from stable_baselines3.common.save_util import load_from_zip_file

    data, weights, _ = load_from_zip_file(path, device="cpu")
    if not data or "policy_class" not in data or "policy" not in weights:
        raise ValueError("it holds no policy")
    # Only VecNormalize has original observations to keep, but algorithms with a replay buffer keep them always.
    if data.get("_last_original_obs") is not None and "replay_buffer_class" not in data:
        raise _Unfit(
            "was trained under VecNormalize, whose statistics stable-baselines3 leaves out: load it there with its "
            "VecNormalize, model.set_env(...), and save it by agents.save_agent(model, path)"
        )
    network = {key: value for key, value in data["policy_kwargs"].items() if key != "device"}
    if data.get("use_sde"):
        network["use_sde"] = True
    built = _built(data["policy_class"], data["observation_space"], data["action_space"], network, weights["policy"])
    remembered = described.get("memory") == "frames"  # as version 0.1 wrote it down
    observe = described.get("env_options", {}).get("observe", "mean") if described else None
    return Policy(built, described["hyperparameters"]["frames"] if remembered else 1, observe)


def _built(policy: type, seen: Any, done: Any, network: dict[str, Any], weights: Any) -> Any:
    """A policy with its weights, ready to fly."""
    import torch

    with torch.random.fork_rng(devices=[]):  # its first weights are drawn, and thrown away
        built = policy(seen, done, lambda _: 0.0, **network)
    built.load_state_dict(weights)
    built.set_training_mode(False)
    return built


class TrainedAgent:
    """A trained policy, flown without exploration noise; it keeps a memory for each environment of the batch.

    Args:
        path: A checkpoint.
        env: The environment that it will fly, to check the observation.
        trust: See `agents.load_agent`.
        dense: See `load`.

    Raises:
        ValueError: if the file is no checkpoint that may be loaded, or was trained on another observation, other
            actions or another vehicle.
        ModuleNotFoundError: without torch or stable-baselines3, where it needs them.
    """

    def __init__(self, path: Path, env: Any, trust: bool = False, dense: bool = False) -> None:
        self._policy = load(path, trust, dense)
        network, frames, self._size = self._policy.network, self._policy.frames, env.core.observation_size
        # Two kinds of observation may have the same length: ask what it was trained on, not only how long that is.
        trained, given = self._policy.observe, env.core.observe_mode
        if trained is not None and trained != given:
            raise ValueError(f"{path} was trained on observe={trained!r}, this environment gives {given!r}")
        seen, done = network.observation_space.shape, network.action_space.shape
        if (seen, done) != ((frames * self._size,), (env.core.action_size,)):
            raise ValueError(
                f"{path} was trained in another environment: on observations of shape {seen} and actions of shape "
                f"{done}, not {(frames * self._size,)} and {(env.core.action_size,)}"
            )
        if (known := self._policy.vehicle) and not _same_vehicle(known, _vehicle(env.core.vehicle)):
            raise ValueError(
                f"{path} was trained on another vehicle, that of {self._policy.environment}: fly it there, or train an "
                f"agent in {env.core.system.name}"
            )
        self.reset(1)

    def reset(self, num_envs: int) -> None:
        """Forget everything: the frames before the first are zeros, and so is the recurrent state."""
        self._seen = np.zeros((num_envs, self._policy.frames * self._size), np.float32)
        self._state = None

    def act(self, observations: np.ndarray) -> np.ndarray:
        """The policy's mean action.

        Raises:
            ValueError: for another number of rows than `reset` was told, or other observations.
        """
        wanted = len(self._seen), self._size
        if np.shape(observations) != wanted:
            raise ValueError(
                f"observations must have shape {wanted}, as many rows as reset(num_envs) was told, got "
                f"{np.shape(observations)}"
            )
        scale, size = self._policy.normalized, self._policy.normalizes
        frame = scale(observations) if size == self._size else observations
        self._seen = np.concatenate([self._seen[:, self._size :], frame], axis=1)  # the newest frame last
        seen = scale(self._seen) if size not in (0, self._size) else self._seen
        network = self._policy.network
        with nullcontext() if isinstance(network, Dense) else one_thread():
            actions, self._state = network.predict(seen, self._state, deterministic=True)
        return actions


@contextmanager
def one_thread() -> Iterator[None]:
    """For small networks a second thread costs more than it brings; the user's own get theirs back."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
