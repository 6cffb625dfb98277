"""Training by the algorithms of stable-baselines3 and sb3-contrib, on the batched environments."""

import inspect
import json
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import vessel_gym
from agents.files import check_file, replacing, write_text
from agents.named import vector_class
from agents.policies.checkpoint import npz_path, write
from agents.seeds import training_seed
from agents.source import source_digest
from estimators.checks import as_number, integer, short_repr
from vessel_gym.checks import is_integer, one_of
from vessel_gym.extras import require
from vessel_gym.toml_file import TomlFile

MEMORIES = ("none", "frames", "lstm")
"""Memories of an agent, which are none, its last observations, or a recurrent network."""

_CLASSES = ("PPO", "A2C", "CrossQ", "DDPG", "SAC", "TD3", "TQC", "TRPO")
ALGORITHMS = {name.lower(): name for name in _CLASSES}
"""Algorithms for continuous actions by name; RecurrentPPO is ``ppo`` with the memory ``lstm``."""

_OF_TRAINING = {
    "n_envs": 1,
    "n_timesteps": 1,
    "frame_stack": 1,
    "reward_scale": 1.0,
    "noise_type": "normal",
    "noise_std": 0.1,
}
"""Hyperparameters that are no arguments of an algorithm."""
_CONFIG = "config.json"
"""Description of the training in a folder."""
_GIVEN = ("env", "seed", "device", "action_noise")
"""Arguments of algorithms that are no hyperparameters."""
_SCHEDULES, _LINEAR = ("learning_rate", "clip_range"), r"lin(_\d+\.?\d*(e-?\d+)?){1,2}"
"""Hyperparameters that may be ``"lin_<first>"``, which falls to 0, or ``"lin_<first>_<last>"``."""


def hyperparameters(
    env_id: str,
    memory: str = "none",
    changed: Mapping[str, Any] | None = None,
    algorithm: str = "ppo",
) -> dict[str, Any]:
    """Hyperparameters with the names of rl_zoo3, from ``<algorithm>.toml``; those of PPO are tuned.

    Args:
        env_id: A registered environment of a `vessel_gym.system.System`.
        memory: One of `MEMORIES`.
        changed: New values by name of the hyperparameter; ``policy_kwargs`` are merged.
        algorithm: One of `ALGORITHMS`.

    Raises:
        ValueError: for an unknown memory or algorithm, a memory with an algorithm other than PPO,
            or a changed hyperparameter with an unknown name or a value of another type.
    """
    one_of("memory", memory, MEMORIES)
    _, tuned = tuned_settings(algorithm, env_id)
    if algorithm != "ppo" and memory != "none":
        raise ValueError(f"{algorithm} trains agents without a memory")
    tuned = _merged(tuned, tuned.get(memory, {}))
    tuned = {key: value for key, value in tuned.items() if key not in MEMORIES}
    parameters = inspect.signature(_algorithm(algorithm, "none")).parameters
    known = {name: each.default for name, each in parameters.items() if name not in _GIVEN}
    known |= _OF_TRAINING | tuned
    for name, value in (changed or {}).items():
        one_of("setting", name, known)
        if not _is_such(name, known[name], value):
            raise ValueError(
                f"the setting {name} must be such as {known[name]!r}, got {short_repr(value)}"
            )
    return _merged(tuned, changed or {})


def tuned_settings(algorithm: str, env_id: str) -> tuple[str, dict[str, Any]]:
    """The package's settings of an algorithm, as `read_settings` returns them."""
    one_of("algorithm", algorithm, ALGORITHMS)
    return read_settings(Path(__file__).with_name(f"{algorithm}.toml"), env_id)


def read_settings(path: Path, env_id: str) -> tuple[str, dict[str, Any]]:
    """Name of an environment's table in a TOML file, and the settings in that table.

    The first of these tables that the file has: the environment's own; the table of another
    environment, whose task's class is the nearest base class of this environment's task;
    ``default``.

    Raises:
        ValueError: if the file has none of these tables, or is not TOML.
        OSError: if the file cannot be read.
    """
    tables: Any = TomlFile(path).data
    name = env_id
    if env_id not in tables:
        of = {_task(each): each for each in tables if each in gym.registry}
        name = next((of[base] for base in _task(env_id).__mro__[:-1] if base in of), "default")
    if not isinstance(found := tables.get(name), dict):
        raise ValueError(f"{path} has neither a table [{env_id!r}] nor [default]")
    return name, found


def _task(env_id: str) -> type:
    """Class of the task of an environment; ``object`` where it has none."""
    system: Any = getattr(vector_class(env_id), "system", None)
    return type(system.task) if system else object


def _merged(settings: Mapping[str, Any], changed: Mapping[str, Any]) -> dict[str, Any]:
    """Changed settings over others; those of the network one by one."""
    network = settings["policy_kwargs"] | changed.get("policy_kwargs", {})
    return {**settings, **changed, "policy_kwargs": network}


def _is_such(name: str, known: Any, value: Any) -> bool:
    """Is a value of the kind of the known one: a switch, list, table, count, number or text?"""
    if name in _SCHEDULES and isinstance(value, str):
        return re.fullmatch(_LINEAR, value) is not None
    if isinstance(known, dict) and isinstance(value, dict):
        return all(_is_such(key, of, value.get(key, of)) for key, of in known.items())
    if isinstance(known, bool | list | dict):
        return isinstance(value, type(known))
    if isinstance(known, int):
        return is_integer(value)
    text = isinstance(value, str) and not isinstance(known, float)
    return text or bool(np.isfinite(as_number(value)))


def describe(
    env_id: str,
    env_options: dict[str, Any] | None,
    seed: int,
    steps: int | None,
    memory: str = "none",
    settings: Mapping[str, Any] | None = None,
    algorithm: str = "ppo",
) -> dict[str, Any]:
    """Description of a training: everything on which the result of `train` depends, as plain data.

    The arguments are those of `train`.

    Returns:
        The arguments, the hyperparameters, the versions of the libraries that compute, and a digest
        of the environments' and estimators' source code.

    Raises:
        ValueError: for an environment or memory without settings, or a budget below one rollout.
        ModuleNotFoundError: without torch or stable-baselines3.
    """
    require("torch", "stable_baselines3", "sb3_contrib")
    settings = hyperparameters(env_id, memory, settings, algorithm)
    num_envs = integer("n_envs", settings["n_envs"], 1)
    libraries = ("numpy", "torch", "stable-baselines3", "sb3-contrib")
    versions = {name: metadata.version(name) for name in libraries}
    described = {
        "env_id": env_id,
        "env_options": env_options or {},
        "seed": seed,
        "steps": integer("steps", settings["n_timesteps"] if steps is None else steps, num_envs),
        "algorithm": algorithm,
        "memory": memory,
        "hyperparameters": settings,
        "versions": {"vessel-gym": vessel_gym.__version__, **versions},
        "source": source_digest(__name__),
    }
    return json.loads(json.dumps(described, default=repr))


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
    force: bool = False,
) -> Path:
    """Train an agent on an environment and save the policy.

    The policy is written whole or not at all.

    Args:
        env_id: A registered environment; `hyperparameters` returns its settings.
        path: Place of the policy (``.npz``); folders are made.
        env_options: Passed to `gymnasium.make_vec`.
        seed: Number of the training run; the environments' seeds follow by `agents.seeds`.
        steps: Environment steps in all; None: ``n_timesteps``.
        progress: Function of (steps so far, steps in all, mean return). The mean return is that of
            the last evaluation; without a folder, that of the last training episodes; NaN before
            the first. An algorithm ends after whole rollouts, so the steps in all may exceed
            ``steps``.
        memory: ``"none"``: the agent acts on the newest observation alone. ``"frames"``: it acts on
            its last observations, side by side, with zeros before the first. ``"lstm"``: it has a
            recurrent network (``RecurrentPPO``).
        settings: New values of hyperparameters by name, in place of those of `hyperparameters`.
        algorithm: One of `ALGORITHMS`.
        folder: Place of learning curves, evaluations, the best policy and checkpoints. With a
            folder, the model of stable-baselines3 is also saved, beside the policy (``.zip``).
            None: no such files.
        resume: Go on from the last checkpoint in the folder, in new episodes. If the interrupted
            training has no checkpoint yet, begin it anew. A checkpoint holds pickles, as all of
            stable-baselines3's.
        force: Replace an earlier training in the folder.

    Returns:
        The path of the policy.

    Raises:
        ValueError: for an environment, memory or algorithm without settings, a budget below one
            rollout, settings that the algorithm refuses, or another training in the folder.
        OSError: if a file cannot be written, or the folder has no interrupted training to resume.
        ModuleNotFoundError: without torch or stable-baselines3.
    """
    described = describe(env_id, env_options, seed, steps, memory, settings, algorithm)
    path, num_envs = npz_path(path), described["hyperparameters"]["n_envs"]
    with _one_thread(), closing(batch(described, num_envs, env_options)) as env:
        check_file(path)
        if folder is not None:
            _prepare(folder, path, described, resume, force)
        model = _restored(described, env, folder) or _new(described, env)
        env.seed(training_seed(seed) + 2**49 * model.num_timesteps)
        _learn(model, described, env_options, folder, progress)
        if folder is not None:
            with replacing(path.with_suffix(".zip")) as temporary:
                model.save(temporary)
        write(path, model, described | {"trained_steps": model.num_timesteps})
    if folder is not None:
        from agents.training.callbacks import remove_checkpoints

        remove_checkpoints(folder)
    return path


def _prepare(
    folder: Path, path: Path, described: dict[str, Any], resume: bool, force: bool
) -> None:
    """Refuse a folder of another training, or remove it."""
    config = folder / _CONFIG
    if resume:
        if path.exists() or not config.exists():
            raise FileNotFoundError(f"there is no interrupted training to go on with in {folder}")
        before = json.loads(config.read_text(encoding="utf-8"))
        changed = [key for key, value in described.items() if before.get(key) != value]
        if changed:
            raise ValueError(f"{folder} is of another training: it differs in {', '.join(changed)}")
    elif force:
        path.unlink(missing_ok=True)
        if config.exists():
            shutil.rmtree(folder)
    elif config.exists():
        raise ValueError(
            f"{folder} keeps a training: go on with --resume if it was interrupted, replace it with"
            " --force, or train into another place"
        )


def _restored(described: dict[str, Any], env: Any, folder: Path | None) -> Any:
    """The model of the last whole checkpoint in the folder; None without one."""
    from agents.training.callbacks import checkpoints

    kind = _algorithm(described["algorithm"], described["memory"])
    for steps in reversed(checkpoints(folder) if folder else []):
        with suppress(Exception):  # a file that was being written when the process was killed
            model = kind.load(f"{folder}/rl_model_{steps}_steps.zip", env, device="cpu")
            if hasattr(model, "load_replay_buffer"):
                # opened here, because the library leaves a damaged file open
                with open(f"{folder}/rl_model_replay_buffer_{steps}_steps.pkl", "rb") as file:
                    model.load_replay_buffer(file)
            seeds = np.random.SeedSequence((described["seed"], steps))
            model.set_random_seed(int(seeds.generate_state(1)[0]))
            return model
    return None


def _new(described: dict[str, Any], env: Any) -> Any:
    """An untrained model."""
    from stable_baselines3.common.noise import NormalActionNoise
    from stable_baselines3.common.utils import LinearSchedule

    settings = described["hyperparameters"]
    arguments = {name: value for name, value in settings.items() if name not in _OF_TRAINING}
    arguments["policy_kwargs"] = dict(settings["policy_kwargs"])  # A2C adds its optimiser
    if described["memory"] == "lstm":
        arguments["policy"] = "MlpLstmPolicy"
    for name in _SCHEDULES:
        if isinstance(text := settings.get(name), str):
            first, last, *_ = *map(float, text.split("_")[1:]), 0.0
            arguments[name] = LinearSchedule(first, last, 1.0)
    if "noise_std" in settings:
        zero = np.zeros(env.action_space.shape[0])
        arguments["action_noise"] = NormalActionNoise(zero, zero + settings["noise_std"])
    kind = _algorithm(described["algorithm"], described["memory"])
    try:
        return kind(env=env, seed=described["seed"], device="cpu", **arguments)
    except (AssertionError, TypeError) as error:  # of settings that do not go together
        raise ValueError(str(error)) from None


def _learn(
    model: Any,
    described: dict[str, Any],
    env_options: dict[str, Any] | None,
    folder: Path | None,
    progress: Callable[[int, int, float], None] | None,
) -> None:
    """Learn up to the steps of `describe`; with a folder, with evaluations and checkpoints."""
    from agents.training.callbacks import EPISODES, Checkpoints, Evaluation, Progress, curves

    budget, evaluation, callbacks = described["steps"], None, []
    with ExitStack() as stack:
        if folder is not None:
            write_text(folder / _CONFIG, json.dumps(described, indent=1))
            calls = budget // described["hyperparameters"]["n_envs"]
            env = stack.enter_context(closing(batch(described, EPISODES, env_options)))
            evaluation = Evaluation(env, folder, calls, described)
            callbacks = [Checkpoints(folder, calls), evaluation]
            model.set_logger(stack.enter_context(closing(curves(folder, model.num_timesteps))))
        if progress is not None:
            callbacks.append(Progress(progress, evaluation))
        model.learn(budget - model.num_timesteps, callback=callbacks, reset_num_timesteps=False)


def batch(
    described: dict[str, Any], num_envs: int, env_options: dict[str, Any] | None = None
) -> Any:
    """Environments of the learner, from the result of `describe`.

    ``env_options`` replace the environment's options in that result; None: take those.
    """
    from stable_baselines3.common.vec_env import VecFrameStack

    from agents.training.vec_env import StableBaselinesVecEnv

    options, settings = env_options or described["env_options"], described["hyperparameters"]
    if options.get("observe") == "measurement" and options.get("termination") != "belief":
        # nobody sees what a filter believes
        options = options | {"estimator": "measurement", "estimator_options": {}}
    vector: Any = gym.make_vec(described["env_id"], num_envs=num_envs, **options)
    env = StableBaselinesVecEnv(vector, settings.get("reward_scale", 1.0))
    return VecFrameStack(env, settings["frame_stack"]) if "frame_stack" in settings else env


def _algorithm(name: str, memory: str) -> Any:
    """The class that trains agents with this memory."""
    import sb3_contrib
    import stable_baselines3

    kind = "RecurrentPPO" if memory == "lstm" else ALGORITHMS[name]
    return getattr(sb3_contrib, kind, None) or getattr(stable_baselines3, kind)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Context with one thread of torch: for small networks a second one does not pay."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
