"""Agents of rl_zoo3: its folders become checkpoints of this package, and it trains with this package's settings."""

import json
import tomllib
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any

import gymnasium as gym

from agents.files import replacing
from agents.policies.checkpoint import write, zip_path
from agents.training.algorithms import ALGORITHMS, OTHERS
from estimators.factory import unknown
from vessel_gym.extras import require

_ALGORITHMS = ALGORITHMS | {"ppo_lstm": "sb3_contrib:RecurrentPPO"}
"""Algorithms by their names in rl_zoo3."""

_SCHEDULES = "learning_rate", "clip_range", "clip_range_vf"
_UNUSED: dict[str, Any] = {
    "lr_schedule": None,
    "buffer_size": 1,
    "replay_buffer_class": None,
    "replay_buffer_kwargs": {},
}
"""Parts of a model that only its training needs: a buffer would take memory, and schedules need rl_zoo3."""


def _hyperparameters() -> dict[str, dict[str, Any]]:
    table = tomllib.loads(files("agents.training").joinpath("ppo.toml").read_text())
    table["default"] = table.pop(OTHERS)
    same = "n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "ent_coef"
    return {
        name: {key: tuned[key] for key in same}
        | {
            "policy": "MlpPolicy",
            "n_envs": tuned["num_envs"],
            "n_timesteps": tuned["steps"],
            "learning_rate": f"lin_{tuned['learning_rate']}",  # to zero: rl_zoo3 has no other end
            "policy_kwargs": {"log_std_init": tuned["log_std_init"], "net_arch": tuned["net_arch"]},
        }
        | ({"normalize": {"norm_obs": False, "norm_reward": True}} if "reward_scale" in tuned else {})
        for name, tuned in table.items()
    }


hyperparams = _hyperparameters()
"""Settings of ``agents/training/ppo.toml`` as rl_zoo3 reads them: ``--algo ppo --conf-file agents.training.zoo``."""


def convert(folder: str | Path, path: str | Path, best: bool = False, trust: bool = False) -> Path:
    """Convert an agent that rl_zoo3 trained into a checkpoint without pickle, as `agents.save_agent` writes it.

    The statistics of ``VecNormalize`` and the frames of ``frame_stack`` go with it.

    Args:
        folder: The folder of a training, such as ``logs/ppo/SigmaCorvette-v0_1``.
        path: Where the checkpoint goes (``.zip``); folders are made.
        best: Take ``best_model.zip``, the best of the evaluations in training, instead of the last model. rl_zoo3
            keeps the last statistics of ``VecNormalize`` only, and so does the checkpoint.
        trust: The folder holds pickles: reading it runs whatever code its maker has put in.

    Returns:
        The path of the checkpoint.

    Raises:
        ValueError: if the folder is not trusted, is none of rl_zoo3's or damaged, or holds what a checkpoint cannot.
        OSError: if a file cannot be read, or the checkpoint cannot be written.
        ModuleNotFoundError: without torch, stable-baselines3 or PyYAML.
    """
    folder = Path(folder)
    settings = sorted(folder.glob("*/args.yml"))
    if len(settings) != 1 or not (inner := settings[0].parent).joinpath("config.yml").is_file():
        raise ValueError(f"{folder} is no folder of a training of rl_zoo3, such as logs/ppo/SigmaCorvette-v0_1")
    source = folder / ("best_model.zip" if best else f"{inner.name}.zip")
    if not source.is_file():
        raise ValueError(
            f"{source} does not exist: rl_zoo3 writes it {'after an evaluation' if best else 'at the end'}"
        )
    if not trust:
        raise ValueError(
            f"{folder} holds pickles, and to read it is to run whatever code they hold: if you trust whoever made it, "
            "say trust=True (--trust on a command line)"
        )
    require("torch", "stable_baselines3", "sb3_contrib", "yaml")
    try:
        model, described = _loaded(inner, source)
        with replacing(zip_path(path)) as temporary:
            write(temporary, model, described)
    except OSError:
        raise
    except Exception as error:  # what somebody else wrote may break anything that reads it
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise ValueError(f"{folder} cannot be converted: {reason}") from error
    return zip_path(path)


def _loaded(inner: Path, source: Path) -> tuple[Any, dict[str, Any]]:
    """The model with its environment, and what rl_zoo3 notes about its training."""
    from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecFrameStack, VecNormalize

    config, arguments = _read(inner / "config.yml"), _read(inner / "args.yml")
    algorithm, env_id = arguments["algo"], arguments["env"]
    if algorithm not in _ALGORITHMS:
        raise ValueError(unknown("algorithm", algorithm, _ALGORITHMS))
    for wrapper in ("env_wrapper", "vec_env_wrapper"):
        if config.get(wrapper):
            raise ValueError(
                f"cannot store the {wrapper} {config[wrapper]} of {inner / 'config.yml'}: train without it, or fly the "
                "model by rl_zoo3"
            )
    for package in arguments.get("gym_packages") or ():
        import_module(package)
    options = arguments.get("env_kwargs") or config.get("env_kwargs") or {}
    env: VecEnv = DummyVecEnv([lambda: gym.make(env_id, **options)])
    if config.get("normalize"):
        env = VecNormalize.load(str(inner / "vecnormalize.pkl"), env)
    if config.get("frame_stack"):
        env = VecFrameStack(env, config["frame_stack"])
    module, _, name = _ALGORITHMS[algorithm].partition(":")
    # A schedule, such as lin_0.002, is replaced by its first value.
    first = {key: float(str(config[key]).rpartition("_")[2]) for key in _SCHEDULES if config.get(key) is not None}
    model = getattr(import_module(module), name).load(source, env, device="cpu", custom_objects=_UNUSED | first)
    described = {"env_id": env_id, "env_options": options, "algorithm": algorithm, "hyperparameters": config}
    return model, json.loads(json.dumps(described, default=str))


def _read(path: Path) -> dict[str, Any]:
    """The table in a YAML file of rl_zoo3, which holds Python's ordered dictionaries."""
    import yaml

    return dict(yaml.load(path.read_text(), yaml.UnsafeLoader))
