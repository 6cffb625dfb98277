"""Training by the algorithms of stable-baselines3 and sb3-contrib, on the batched environments."""

import inspect
import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import partial
from importlib import import_module, metadata
from importlib.resources import files
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import vessel_gym
from agents.files import replacing
from agents.named import vector_class
from agents.policies.checkpoint import write, zip_path
from agents.policies.network import one_thread
from agents.seeds import training_seed
from agents.source import source_digest
from estimators.checks import as_number, integer, short_repr
from estimators.factory import unknown
from vessel_gym.checks import is_integer
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.extras import require

MEMORIES = ("none", "frames", "lstm")
"""Memories of an agent: none, its last observations, or a recurrent network over all of them."""

ALGORITHMS = {
    "ppo": "stable_baselines3:PPO",
    "a2c": "stable_baselines3:A2C",
    "crossq": "sb3_contrib:CrossQ",
    "ddpg": "stable_baselines3:DDPG",
    "sac": "stable_baselines3:SAC",
    "td3": "stable_baselines3:TD3",
    "tqc": "sb3_contrib:TQC",
    "trpo": "sb3_contrib:TRPO",
}
"""Algorithms for continuous actions by name; RecurrentPPO is ``ppo`` with the memory ``lstm``."""

_OF_NETWORK = ("log_std_init", "net_arch", "lstm_hidden_size")
"""Settings of the network."""
_OF_TRAINING = (
    "num_envs",
    "steps",
    "frames",
    "learning_rate_final",
    "action_noise",
    "reward_scale",
)
"""Settings that no algorithm takes as they are."""
_GIVEN = (
    "policy", "env", "learning_rate", "policy_kwargs", "seed", "device", "verbose", "tensorboard_log",
    "rollout_buffer_class", "rollout_buffer_kwargs", "replay_buffer_class", "replay_buffer_kwargs",
)  # fmt: skip
"""Arguments of algorithms that are no settings, or are settings by another way."""
_SHARES = ("gamma", "gae_lambda", "tau", "line_search_shrinking_factor")
_POSITIVE = (
    "clip_range",
    "learning_rate",
    "max_grad_norm",
    "reward_scale",
    "rms_prop_eps",
    "target_kl",
    "tau",
)
_LEAST = {
    "learning_starts": 0,
    "top_quantiles_to_drop_per_net": 0,
    "gradient_steps": -1,
    "sde_sample_freq": -1,
}
"""Settings of at most 1, above 0, and the least value of whole numbers where it is not 1."""


def hyperparameters(
    env_id: str,
    memory: str = "none",
    changed: Mapping[str, Any] | None = None,
    algorithm: str = "ppo",
) -> dict[str, Any]:
    """The settings of a training: of PPO those of ``ppo.toml``, tuned by environment, and over them the memory's.

    Another environment of a `vessel_gym.system.System` has those of ``others``; another algorithm
    has its own of ``algorithms.toml``, which are not tuned.

    Args:
        env_id: A registered environment.
        memory: One of `MEMORIES`.
        changed: Settings by name: of these, or any argument of the algorithm that is a number, text
            or switch.
        algorithm: One of `ALGORITHMS`.

    Raises:
        ValueError: if it has none, the memory or algorithm is of no known kind, or a changed
            setting is none.
    """
    if memory not in MEMORIES:
        raise ValueError(unknown("memory", memory, MEMORIES))
    if algorithm not in ALGORITHMS:
        raise ValueError(unknown("algorithm", algorithm, ALGORITHMS))
    if algorithm == "ppo":
        tuned = _of_ppo(env_id, memory)
    elif memory == "none" and _has_system(env_id):
        tuned = _table("algorithms")[algorithm]
    else:
        raise ValueError(
            f"{algorithm} trains agents without a memory, in environments of vessel_gym"
        )
    for name, value in (changed or {}).items():
        known = _arguments(algorithm) | {each: tuned[each] for each in tuned if each != "steps"}
        if name not in known:
            raise ValueError(unknown("setting", name, known))
        if wanted := _wanted(name, known[name], value):
            raise ValueError(f"the setting {name} must be {wanted}, got {short_repr(value)}")
    return tuned | dict(changed or {})


def _table(name: str) -> dict[str, Any]:
    return tomllib.loads(files("agents.training").joinpath(f"{name}.toml").read_text())


def _of_ppo(env_id: str, memory: str) -> dict[str, Any]:
    """The tuned settings of PPO."""
    table = _table("ppo")
    others = table.pop("others")
    if not _has_system(env_id):
        raise ValueError(
            f"no PPO settings for {env_id!r} in agents/training/ppo.toml: choose from"
            f" {', '.join(table)}"
        )
    own = table.get(env_id, others)
    return {key: value for key, value in own.items() if not isinstance(value, dict)} | own.get(
        memory, {}
    )


def _arguments(algorithm: str) -> dict[str, Any]:
    """Arguments of an algorithm that may be set, with their defaults."""
    arguments = inspect.signature(_algorithm(algorithm, "none")).parameters.values()
    return {
        each.name: each.default
        for each in arguments
        if each.name[0] != "_" and each.name not in _GIVEN
    }


def _wanted(name: str, known: Any, value: Any) -> str:
    """What a setting must be, if the value is something else; the known value is the tuned one or the default."""
    number = as_number(value)
    if (known is None or name in _POSITIVE) and not 0.0 < number < np.inf:
        return "a number above 0"
    if name in _SHARES and not 0.0 <= number <= 1.0:
        return "between 0 and 1"
    if name in _LEAST:
        whole = is_integer(value) and _LEAST[name] <= value < 2**31
        return "" if whole else f"a whole number of at least {_LEAST[name]}"
    if known == "auto":
        pattern, least = (
            ("auto", -np.inf) if name == "target_entropy" else (r"auto(_\d*\.?\d+)?", 0.0)
        )
        automatic = isinstance(value, str) and re.fullmatch(pattern, value)
        return (
            "" if automatic or (np.isfinite(number) and number >= least) else "'auto' or a number"
        )
    return "" if known is None or _such_as(known, value) else f"such as {known!r}"


def _such_as(tuned: Any, value: Any) -> bool:
    """Return whether a setting is as the tuned one: a list of sizes, a count, or a finite number, of no other sign."""
    if isinstance(tuned, list) and isinstance(value, dict):  # layers by network, as net_arch may be
        return len(value) > 0 and all(_such_as(tuned, each) for each in value.values())
    if isinstance(tuned, list):
        return (
            isinstance(value, list) and len(value) > 0 and all(_such_as(1, each) for each in value)
        )
    if isinstance(tuned, bool):
        return isinstance(value, bool)
    if isinstance(tuned, int):
        return isinstance(value, int) and not isinstance(value, bool) and 1 <= value < 2**31
    return bool(np.isfinite(as_number(value))) and (tuned < 0.0 or value >= 0.0)


def _has_system(env_id: str) -> bool:
    return env_id in gym.registry and issubclass(vector_class(env_id), VesselVectorEnv)


def describe(
    env_id: str,
    env_options: dict[str, Any] | None,
    seed: int,
    steps: int | None,
    memory: str = "none",
    settings: Mapping[str, Any] | None = None,
    algorithm: str = "ppo",
) -> dict[str, Any]:
    """Everything that decides what `train` gives, as plain data: equal descriptions, equal checkpoints.

    Its arguments are those of `train`.

    Returns:
        The arguments, the tuned settings, the versions of the libraries that compute, and a digest
        of the environments' and estimators' source code.

    Raises:
        ValueError: for an environment or memory without settings, or a budget below one rollout.
        TypeError: for options that no plain data can tell.
        ModuleNotFoundError: without torch or stable-baselines3.
    """
    require("torch", "stable_baselines3", "sb3_contrib")
    settings = hyperparameters(env_id, memory, settings, algorithm)
    steps = settings["steps"] if steps is None else integer("steps", steps, 1)
    if steps < settings["num_envs"]:
        raise ValueError(
            f"steps must be at least the {settings['num_envs']} environments of a batch, got"
            f" {steps}"
        )
    described = {
        "env_id": env_id,
        "env_options": env_options or {},
        "seed": seed,
        "steps": steps,
        "algorithm": algorithm,
        "memory": memory,
        "hyperparameters": settings,
        "versions": (
            {"vessel-gym": vessel_gym.__version__}
            | {
                name: metadata.version(name)
                for name in ("numpy", "torch", "stable-baselines3", "sb3-contrib")
            }
        ),
        "source": source_digest(__name__),
    }
    return json.loads(json.dumps(described, default=_plain))


def _plain(own: Any) -> Any:
    """An option of an environment that is neither number nor name, as plain data.

    Raises:
        TypeError: for what has no name to be known by.
    """
    if isinstance(own, np.ndarray | np.generic):
        return own.tolist()
    if isinstance(own, Enum):
        return own.value
    if isinstance(own, partial):
        return [own.func, *own.args, own.keywords]
    if is_dataclass(own) and not isinstance(own, type):
        return {"kind": _plain(type(own))} | {
            each.name: getattr(own, each.name) for each in fields(own)
        }
    if hasattr(own, "__qualname__"):
        return f"{own.__module__}:{own.__qualname__}"
    if " at 0x" in repr(own):
        what = f"a checkpoint cannot say what {short_repr(own)} in env_options is"
        raise TypeError(f"{what}: give numbers, names, functions or dataclasses")
    return repr(own)


def train(
    env_id: str,
    path: Path,
    env_options: dict[str, Any] | None = None,
    seed: int = 0,
    steps: int | None = None,
    progress: Callable[[int, int, float], None] | None = None,
    memory: str = "none",
    settings: Mapping[str, Any] | None = None,
    algorithm: str = "ppo",
    folder: Path | None = None,
    resume: bool = False,
) -> Path:
    """Train an agent on an environment and save the checkpoint.

    The checkpoint is written whole or not at all.

    Args:
        env_id: A registered environment; `hyperparameters` says with which settings.
        path: Where the checkpoint goes (``.zip``); folders are made.
        env_options: Passed to `gymnasium.make_vec`.
        seed: Number of the training run; the environments' seeds follow by `agents.seeds`.
        steps: Environment steps in all; None: the tuned budget.
        progress: Called with (steps so far, steps of all rollouts, score of the last evaluation),
            which is NaN without a folder.
        memory: ``"none"``: the agent acts on the newest observation alone; ``"frames"``: on its
            last ones, side by side, zeros before the first; ``"lstm"``: through a recurrent network
            (``RecurrentPPO``).
        settings: Hyperparameters by name over those of `hyperparameters`.
        algorithm: One of `ALGORITHMS`.
        folder: Where learning curves, the latest and the best policy, and the checkpoints of
            stable-baselines3 go, see `agents.training.callbacks`; None: nowhere. It must hold no
            earlier training.
        resume: Go on from the last checkpoint of stable-baselines3 in the folder, in new episodes;
            begin anew where the training broke off before the first. A checkpoint holds pickles, as
            all of stable-baselines3's.

    Returns:
        The path of the checkpoint.

    Raises:
        ValueError: for an environment, memory or algorithm without settings, a budget below one
            rollout, a checkpoint of another training or a damaged one, or a training in the folder
            that is not to be resumed.
        TypeError: for options that a checkpoint cannot hold as plain data.
        OSError: if the checkpoint cannot be written, or there is no training to resume.
        ModuleNotFoundError: without torch or stable-baselines3.
        KeyboardInterrupt: after Ctrl-C; the text names the last checkpoint in the folder.
    """
    described = describe(env_id, env_options, seed, steps, memory, settings, algorithm)
    kept = None if folder is None else _kept(folder, described, resume, zip_path(path).exists())
    with replacing(zip_path(path)) as temporary, one_thread():
        _learn(described, env_options, temporary, progress, folder, kept)
    return zip_path(path)


def _kept(folder: Path, described: dict[str, Any], resume: bool, finished: bool) -> Path | None:
    """The checkpoint with which a training goes on; None for a new one."""
    from stable_baselines3.common.save_util import load_from_zip_file

    from agents.training.callbacks import CURVES, last_checkpoint

    path = last_checkpoint(folder)
    if path is None:
        if resume and (finished or not folder.exists()):
            raise FileNotFoundError(
                f"there is no interrupted training to go on with: no checkpoint in {folder}"
            )
        if not resume and (folder / CURVES).exists():
            raise ValueError(
                f"{folder} keeps an earlier training: remove it, or train into another place"
            )
        return None
    if not resume:
        raise ValueError(
            f"{path} keeps an interrupted training: go on with resume, or remove {folder}"
        )
    try:
        data, *_ = load_from_zip_file(path, device="cpu")
        before = dict((data or {})["described"])
    except Exception:  # a damaged pickle may break anything
        raise _damaged(path) from None
    changed = [key for key, value in described.items() if before.get(key) != value]
    if changed:
        raise ValueError(f"{path} is of another training: it differs in {', '.join(changed)}")
    return path


def _damaged(path: Path) -> ValueError:
    return ValueError(f"{path} is damaged: remove it, and --resume goes on from the one before it")


def _learn(
    described: dict[str, Any],
    env_options: dict[str, Any] | None,
    path: Path,
    progress: Callable[[int, int, float], None] | None,
    folder: Path | None,
    kept: Path | None,
) -> None:
    """Train what `describe` described and save the policy, with the steps that it took: whole rollouts."""
    from agents.training.callbacks import (
        Checkpoints,
        Evaluation,
        Report,
        curves,
        last_checkpoint,
        remove_checkpoints,
    )

    budget = described["steps"]
    with _learner(described, env_options, kept) as model:
        if folder is None:
            model.learn(budget, callback=Report(budget, progress))
        else:
            folder.mkdir(parents=True, exist_ok=True)
            checkpoints = Checkpoints(folder, budget // described["hyperparameters"]["num_envs"])
            evaluation = Evaluation(folder, described, env_options)
            callbacks = [checkpoints, evaluation, Report(budget, progress, evaluation)]
            with closing(curves(folder, model.num_timesteps)) as logger:
                model.set_logger(logger)
                try:
                    model.learn(
                        budget - model.num_timesteps,
                        callback=callbacks,
                        reset_num_timesteps=kept is None,
                    )
                except KeyboardInterrupt:
                    last = last_checkpoint(folder)
                    said = f"the last checkpoint is {last}; the same command with --resume goes on"
                    raise KeyboardInterrupt(said if last else "") from None
        write(path, model, described | {"trained_steps": model.num_timesteps})
    if folder is not None:
        remove_checkpoints(folder)


@contextmanager
def _learner(
    described: dict[str, Any], env_options: dict[str, Any] | None, kept: Path | None
) -> Iterator[Any]:
    """The model of stable-baselines3 that learns what `describe` described, with its environment while it does.

    Args:
        described: What `describe` gave.
        env_options: Those that were described, where they hold more than plain data.
        kept: A checkpoint with which it goes on; None: a new model.
    """
    import torch
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.utils import LinearSchedule

    from agents.training.callbacks import replay_path

    settings, seed, memory = (described[key] for key in ("hyperparameters", "seed", "memory"))
    rate, env = settings["learning_rate"], batch(described, settings["num_envs"], env_options)
    network: dict[str, Any] = {name: settings[name] for name in _OF_NETWORK if name in settings}
    own = {
        name: value
        for name, value in settings.items()
        if name not in (*_OF_NETWORK, *_OF_TRAINING, *_GIVEN)
    }
    policy: Any = "MlpPolicy"
    if described["algorithm"] == "ppo":
        network["activation_fn"] = torch.nn.Tanh
    if memory == "lstm":
        from agents.policies.lstm import LstmPolicy

        policy = LstmPolicy
    if "action_noise" in settings:
        size = env.action_space.shape[0]
        own["action_noise"] = NormalActionNoise(
            np.zeros(size), np.full(size, settings["action_noise"])
        )
    kind = _algorithm(described["algorithm"], memory)
    if kept is None:
        own |= {"policy_kwargs": network, "seed": seed, "device": "cpu"}
        own["learning_rate"] = LinearSchedule(rate, settings.get("learning_rate_final", rate), 1.0)
        try:
            model = kind(policy, env, **own)
        except AssertionError as error:  # of settings that do not go together
            raise ValueError(str(error)) from None
        model.described, model.elapsed = described, 0  # which its checkpoints keep
    else:
        model = kind.load(kept, env, device="cpu")
        if hasattr(model, "load_replay_buffer"):
            try:
                with replay_path(kept).open("rb") as file:
                    model.load_replay_buffer(file)
            except Exception:  # a damaged pickle may break anything
                raise _damaged(kept) from None
        model.set_random_seed(
            int(np.random.SeedSequence((seed, model.num_timesteps)).generate_state(1)[0])
        )
    # PPO reseeds the environments with its own seed: put the training range back, beyond all runs'
    # when it goes on.
    env.seed(training_seed(seed) + 2**49 * model.num_timesteps)
    try:
        yield model
    finally:
        env.close()


def batch(
    described: dict[str, Any], num_envs: int, env_options: dict[str, Any] | None = None
) -> Any:
    """The environments, as the learner of what `describe` described sees them; ``env_options`` as described."""
    from stable_baselines3.common.vec_env import VecFrameStack

    from agents.training.vec_env import StableBaselinesVecEnv

    options = env_options or described["env_options"]
    if options.get("observe") == "measurement" and options.get("termination") != "belief":
        options = options | {
            "estimator": "measurement",
            "estimator_options": {},
        }  # nobody sees what a filter believes
    vector: Any = gym.make_vec(described["env_id"], num_envs=num_envs, **options)
    env = StableBaselinesVecEnv(vector, described["hyperparameters"].get("reward_scale", 1.0))
    return (
        VecFrameStack(env, described["hyperparameters"]["frames"])
        if described["memory"] == "frames"
        else env
    )


def _algorithm(name: str, memory: str) -> Any:
    """The class that trains agents with this memory."""
    module, _, kind = (
        "sb3_contrib:RecurrentPPO" if memory == "lstm" else ALGORITHMS[name]
    ).partition(":")
    return getattr(import_module(module), kind)
