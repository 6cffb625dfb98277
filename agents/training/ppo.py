"""PPO through stable-baselines3 on the batched environments."""

import json
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import partial
from importlib import metadata
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
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.extras import require

MEMORIES = ("none", "frames", "lstm")
"""Memories of an agent: none, its last observations, or a recurrent network over all of them."""

CRITICS = (None, "truth")
"""Inputs of a critic in training beside the agent's observation: nothing, or the truth."""

_OF_PPO = ("n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "ent_coef")
"""Settings that PPO takes as they are."""

OTHERS = "others"
"""The settings of environments that have none of their own."""


def hyperparameters(env_id: str, memory: str = "none", changed: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The settings of an environment, from ``agents/training/ppo.toml``: its own, and over them those of the memory.

    They are tuned for the package's environments; another one of a `vessel_gym.system.System` has those of `OTHERS`.

    Args:
        env_id: A registered environment.
        memory: One of `MEMORIES`.
        changed: Settings by name, each a number where the tuned one is.

    Raises:
        ValueError: if it has none, the memory is of no known kind, or a changed setting is none.
    """
    if memory not in MEMORIES:
        raise ValueError(unknown("memory", memory, MEMORIES))
    table = tomllib.loads(files("agents.training").joinpath("ppo.toml").read_text())
    others = table.pop(OTHERS, None)
    if env_id not in table and not (others and _has_system(env_id)):
        raise ValueError(f"no PPO settings for {env_id!r} in agents/training/ppo.toml: choose from {', '.join(table)}")
    own = table.get(env_id, others)
    if memory != "none" and memory not in own:
        having = [name for name, settings in table.items() if memory in settings]
        raise ValueError(
            f"no settings with memory {memory!r} for {env_id!r} in agents/training/ppo.toml: "
            f"choose from {', '.join(having)}"
        )
    tuned = {key: value for key, value in own.items() if not isinstance(value, dict)} | own.get(memory, {})
    for name, value in (changed or {}).items():
        if name not in tuned or name == "steps":
            raise ValueError(unknown("setting", name, [each for each in tuned if each != "steps"]))
        if not _such_as(tuned[name], value):
            raise ValueError(f"the setting {name} must be such as {tuned[name]!r}, got {short_repr(value)}")
    return tuned | dict(changed or {})


def _such_as(tuned: Any, value: Any) -> bool:
    """Return whether a setting is as the tuned one: a list of sizes, a count, or a finite number, of no other sign."""
    if isinstance(tuned, list):
        return isinstance(value, list) and len(value) > 0 and all(_such_as(1, each) for each in value)
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
    critic: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Everything that decides what `train` gives, as plain data: equal descriptions, equal checkpoints.

    Its arguments are those of `train`.

    Returns:
        The arguments, the tuned settings, the versions of the libraries that compute, and a digest of the
        environments' and estimators' source code.

    Raises:
        ValueError: for an environment or memory without settings, an unknown critic, or a budget below one rollout.
        TypeError: for options that no plain data can tell.
        ModuleNotFoundError: without torch or stable-baselines3.
    """
    require("torch", "stable_baselines3", "sb3_contrib")
    if critic not in CRITICS:
        raise ValueError(f"critic must be 'truth', or None for one that is told nothing more, got {short_repr(critic)}")
    settings = hyperparameters(env_id, memory, settings)
    steps = settings["steps"] if steps is None else integer("steps", steps, 1)
    if steps < settings["num_envs"]:
        raise ValueError(f"steps must be at least the {settings['num_envs']} environments of a batch, got {steps}")
    described = {
        "env_id": env_id,
        "env_options": env_options or {},
        "seed": seed,
        "steps": steps,
        "memory": memory,
        "critic": critic,
        "hyperparameters": settings,
        "versions": {"vessel-gym": vessel_gym.__version__}
        | {name: metadata.version(name) for name in ("numpy", "torch", "stable-baselines3", "sb3-contrib")},
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
        return {"kind": _plain(type(own))} | {each.name: getattr(own, each.name) for each in fields(own)}
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
    critic: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Path:
    """Train PPO on an environment and save the checkpoint.

    The checkpoint is written whole or not at all.

    Args:
        env_id: A registered environment; `hyperparameters` says with which settings.
        path: Where the checkpoint goes (``.zip``); folders are made.
        env_options: Passed to `gymnasium.make_vec`.
        seed: Number of the training run; the environments' seeds follow by `agents.seeds`.
        steps: Environment steps in all; None: the tuned budget.
        progress: Called with (steps so far, steps in all, mean score of late episodes).
        memory: ``"none"``: the agent acts on the newest observation alone; ``"frames"``: on its last ones, side by
            side, zeros before the first; ``"lstm"``: through a recurrent network (``RecurrentPPO``).
        critic: ``"truth"``: the critic alone has the truth for an input, see `agents.training.critic`; the policy acts
            on its observations as any other. None: it sees what the agent sees.
        settings: Hyperparameters by name over those of `hyperparameters`.

    Returns:
        The path of the checkpoint.

    Raises:
        ValueError: for an environment or memory without settings, an unknown critic, or a budget below one rollout.
        TypeError: for options that a checkpoint cannot hold as plain data.
        OSError: if the checkpoint cannot be written.
        ModuleNotFoundError: without torch or stable-baselines3.
    """
    described = describe(env_id, env_options, seed, steps, memory, critic, settings)
    with replacing(zip_path(path)) as temporary, one_thread():
        _learn(described, env_options, temporary, progress)
    return zip_path(path)


def _learn(
    described: dict[str, Any],
    env_options: dict[str, Any] | None,
    path: Path,
    progress: Callable[[int, int, float], None] | None,
) -> None:
    """Train what `describe` described and save the policy, with the steps that it took: whole rollouts."""
    from stable_baselines3.common.callbacks import BaseCallback

    budget = described["steps"]

    class Report(BaseCallback):
        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:
            if progress is not None:
                late = [info["r"] for info in self.model.ep_info_buffer or ()]
                perfect = self.training_env.get_attr("unwrapped", 0)[0].core.task.perfect
                mean = float(np.mean(late)) / perfect if late else float("nan")
                progress(self.num_timesteps, budget, mean)

    with learner(described, env_options) as model:
        model.learn(budget, callback=Report())
        write(path, model, described | {"trained_steps": model.num_timesteps})


@contextmanager
def learner(described: dict[str, Any], env_options: dict[str, Any] | None = None) -> Iterator[Any]:
    """The model of stable-baselines3 that learns what `describe` described, with its environment while it does.

    Args:
        described: What `describe` gave.
        env_options: Those that were described, where they hold more than plain data.
    """
    import torch
    from stable_baselines3.common.utils import LinearSchedule

    settings, seed, memory = (described[key] for key in ("hyperparameters", "seed", "memory"))
    num_envs = settings["num_envs"]
    env = batch(described, num_envs, env_options)
    env.seed(training_seed(seed))
    network: dict[str, Any] = {
        "log_std_init": settings["log_std_init"],
        "net_arch": settings["net_arch"],
        "activation_fn": torch.nn.Tanh,
    }
    policy: Any = "MlpPolicy"
    if memory == "lstm":
        from agents.policies.lstm import LstmPolicy

        policy = LstmPolicy
        network["lstm_hidden_size"] = settings["lstm_hidden_size"]
    if described["critic"] == "truth":
        from agents.training.critic import TruthLstmPolicy, TruthPolicy

        policy = TruthLstmPolicy if memory == "lstm" else TruthPolicy
        network |= {"seen": env.seen, "truth": env.truth, "frames": settings.get("frames", 1)}
    model = _algorithm(memory)(
        policy,
        env,
        **{name: settings[name] for name in _OF_PPO},
        learning_rate=LinearSchedule(settings["learning_rate"], settings["learning_rate_final"], 1.0),
        policy_kwargs=network,
        stats_window_size=2 * num_envs,
        seed=seed,
        device="cpu",
    )
    # PPO reseeds the environments with its own seed: put the training range back.
    env.seed(training_seed(seed))
    try:
        yield model
    finally:
        env.close()


def batch(described: dict[str, Any], num_envs: int, env_options: dict[str, Any] | None = None) -> Any:
    """The environments, as the learner of what `describe` described sees them; ``env_options`` as for `learner`."""
    from stable_baselines3.common.vec_env import VecFrameStack

    from agents.training.vec_env import StableBaselinesVecEnv

    options = env_options or described["env_options"]
    if (
        options.get("observe") == "measurement"
        and options.get("termination") != "belief"
        and described["critic"] is None
    ):
        options = options | {"estimator": "measurement", "estimator_options": {}}  # nobody sees what a filter believes
    vector: Any = gym.make_vec(described["env_id"], num_envs=num_envs, **options)
    if described["critic"] == "truth":
        from agents.training.critic import TruthVecEnv

        env: StableBaselinesVecEnv = TruthVecEnv(vector)
    else:
        env = StableBaselinesVecEnv(vector)
    return VecFrameStack(env, described["hyperparameters"]["frames"]) if described["memory"] == "frames" else env


def _algorithm(memory: str) -> Any:
    """The class that trains agents with this memory."""
    if memory == "lstm":
        from sb3_contrib import RecurrentPPO

        return RecurrentPPO
    from stable_baselines3 import PPO

    return PPO
