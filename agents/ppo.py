"""PPO through stable-baselines3 on the batched environments."""

import json
import tomllib
import zipfile
from collections.abc import Callable
from importlib import metadata
from importlib.resources import files
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import vessel_gym
from agents.files import replacing
from agents.seeds import training_seed
from agents.source import source_digest
from estimators.factory import unknown

MEMORIES = ("none", "frames", "lstm")
"""What an agent may remember: nothing, its last observations, or what a recurrent network makes of all of them."""

_DESCRIPTION = "vessel_gym.json"  # inside a checkpoint
_OF_THE_TRAINING = [
    "start_time", "ep_info_buffer", "ep_success_buffer", "_last_obs", "_last_original_obs", "_last_episode_starts",
    "_last_lstm_states",
]  # fmt: skip
"""What stable-baselines3 would store, and nobody needs who flies the policy."""


def hyperparameters(env_id: str, memory: str = "none") -> dict[str, Any]:
    """The tuned settings of an environment, from ``agents/ppo.toml``: its own, and over them those of the memory.

    Raises:
        ValueError: if it has none, or the memory is of no known kind.
    """
    if memory not in MEMORIES:
        raise ValueError(unknown("memory", memory, MEMORIES))
    table = tomllib.loads(files("agents").joinpath("ppo.toml").read_text())
    if env_id not in table:
        raise ValueError(f"no PPO settings for {env_id!r} in agents/ppo.toml: choose from {', '.join(table)}")
    own = table[env_id]
    if memory != "none" and memory not in own:
        having = [name for name, settings in table.items() if memory in settings]
        raise ValueError(
            f"no settings with memory {memory!r} for {env_id!r} in agents/ppo.toml: choose from {', '.join(having)}"
        )
    return {key: value for key, value in own.items() if not isinstance(value, dict)} | own.get(memory, {})


def describe(
    env_id: str, env_options: dict[str, Any] | None, seed: int, steps: int | None, memory: str = "none"
) -> dict[str, Any]:
    """Everything that decides what `train` gives, as plain data: equal descriptions, equal checkpoints.

    Args:
        env_id: As `train`; so are the other arguments.
        env_options: See `train`.
        seed: See `train`.
        steps: See `train`.
        memory: See `train`.

    Returns:
        The arguments, the tuned settings, the versions of the libraries that compute, and a digest of the
        environments' and estimators' source code.

    Raises:
        ValueError: for an environment or memory without settings, or a budget below one rollout.
    """
    settings = hyperparameters(env_id, memory)
    steps = settings["steps"] if steps is None else steps
    if steps < settings["num_envs"]:
        raise ValueError(f"steps must be at least the {settings['num_envs']} environments of a batch, got {steps}")
    described = {
        "env_id": env_id,
        "env_options": env_options or {},
        "seed": seed,
        "steps": steps,
        "memory": memory,
        "hyperparameters": settings,
        "versions": {"vessel-gym": vessel_gym.__version__}
        | {name: metadata.version(name) for name in ("numpy", "torch", "stable-baselines3", "sb3-contrib")},
        "source": source_digest(__name__),
    }
    return json.loads(json.dumps(described, default=_named))


def _named(own: Any) -> str:
    """An estimator of the user's own, as plain data."""
    return f"{own.__module__}:{own.__qualname__}"


def description(path: Path) -> dict[str, Any] | None:
    """What `train` wrote of itself into a checkpoint; None if there is no such checkpoint."""
    try:
        with zipfile.ZipFile(path) as archive:
            return json.loads(archive.read(_DESCRIPTION))
    except (OSError, zipfile.BadZipFile, KeyError, ValueError):
        return None


def train(
    env_id: str,
    path: Path,
    env_options: dict[str, Any] | None = None,
    seed: int = 0,
    steps: int | None = None,
    progress: Callable[[int, int, float], None] | None = None,
    memory: str = "none",
) -> Path:
    """Train PPO on an environment and save the checkpoint.

    The checkpoint is written whole or not at all.

    Args:
        env_id: A registered environment with settings in ``agents/ppo.toml``.
        path: Where the checkpoint goes (``.zip``); folders are made.
        env_options: Passed to `gymnasium.make_vec`.
        seed: Number of the training run; the environments' seeds follow by `agents.seeds`.
        steps: Environment steps in all; None: the tuned budget.
        progress: Called with (steps so far, steps in all, mean score of late episodes).
        memory: ``"none"``: the agent acts on the newest observation alone; ``"frames"``: on its last ones, side by
            side, zeros before the first; ``"lstm"``: through a recurrent network (``RecurrentPPO``).

    Returns:
        The path of the checkpoint.

    Raises:
        ValueError: for an environment or memory without settings, or a budget below one rollout.
        OSError: if the checkpoint cannot be written.
    """
    described = describe(env_id, env_options, seed, steps, memory)
    path = Path(path)
    path = path if path.suffix == ".zip" else path.with_name(f"{path.name}.zip")
    with replacing(path) as temporary:
        described |= _learn(described, temporary, progress)
        _settle(temporary, described)
    return path


def _settle(path: Path, described: dict[str, Any]) -> None:
    """Add the description to a checkpoint, and take out what differs between two equal trainings.

    stable-baselines3 stores times, and for people what objects look like, with their addresses in memory.
    """
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    data = json.loads(files["data"])
    for value in data.values():
        if isinstance(value, dict) and ":serialized:" in value:
            for key in value.keys() - {":type:", ":serialized:"}:
                del value[key]
    files["data"] = json.dumps(data, sort_keys=True).encode()
    files[_DESCRIPTION] = json.dumps(described, indent=1).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name in sorted(files):
            archive.writestr(zipfile.ZipInfo(name), files[name])  # dated 1980


def _learn(described: dict[str, Any], path: Path, progress: Callable[[int, int, float], None] | None) -> dict[str, Any]:
    """Train what `describe` described and save the policy; returns how many steps it took: whole rollouts."""
    import torch
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.utils import LinearSchedule
    from stable_baselines3.common.vec_env import VecEnv, VecFrameStack

    from agents.vec_env import StableBaselinesVecEnv

    torch.set_num_threads(1)  # small networks: a second thread costs more than it brings
    settings, budget, seed, memory = (described[key] for key in ("hyperparameters", "steps", "seed", "memory"))
    num_envs = settings["num_envs"]
    vector = gym.make_vec(described["env_id"], num_envs=num_envs, **described["env_options"])
    perfect = vector.unwrapped.core.task.perfect  # type: ignore[attr-defined]
    env: VecEnv = StableBaselinesVecEnv(vector)
    if memory == "frames":
        env = VecFrameStack(env, settings["frames"])
    env.seed(training_seed(seed))
    network: dict[str, Any] = {
        "log_std_init": settings["log_std_init"],
        "net_arch": settings["net_arch"],
        "activation_fn": torch.nn.Tanh,
    }
    policy: Any = "MlpPolicy"
    if memory == "lstm":
        from agents.lstm_policy import LstmPolicy

        policy = LstmPolicy
        network["lstm_hidden_size"] = settings["lstm_hidden_size"]

    class Report(BaseCallback):
        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:
            if progress is not None:
                late = [info["r"] for info in self.model.ep_info_buffer or ()]
                mean = float(np.mean(late)) / perfect if late else float("nan")
                progress(self.num_timesteps, budget, mean)

    model = _algorithm(memory)(
        policy,
        env,
        n_steps=settings["n_steps"],
        batch_size=settings["batch_size"],
        n_epochs=settings["n_epochs"],
        gamma=settings["gamma"],
        gae_lambda=settings["gae_lambda"],
        clip_range=settings["clip_range"],
        ent_coef=settings["ent_coef"],
        learning_rate=LinearSchedule(settings["learning_rate"], settings["learning_rate_final"], 1.0),
        policy_kwargs=network,
        stats_window_size=2 * num_envs,
        seed=seed,
        device="cpu",
    )
    # PPO reseeds the environments with its own seed: put the training range back.
    env.seed(training_seed(seed))
    try:
        model.learn(budget, callback=Report())
        model.observation_space.seed(seed)  # stable-baselines3 samples it, from the machine's entropy, and stores that
        model.save(path, exclude=_OF_THE_TRAINING)
    finally:
        env.close()
    return {"trained_steps": model.num_timesteps}


def _algorithm(memory: str) -> Any:
    """The class that trains and loads agents with this memory."""
    if memory == "lstm":
        from sb3_contrib import RecurrentPPO

        return RecurrentPPO
    from stable_baselines3 import PPO

    return PPO


class PPOAgent:
    """A trained PPO policy, flown without exploration noise; it keeps a memory for each environment of the batch.

    Args:
        path: A checkpoint of `train`.
        env: The environment that it will fly, to check the observation.

    Raises:
        ValueError: if the file is no checkpoint, or was trained on another observation.
    """

    def __init__(self, path: Path, env: Any) -> None:
        import torch

        torch.set_num_threads(1)
        described = description(Path(path)) or {}
        memory = described.get("memory", "none")
        try:
            self._policy = _algorithm(memory).load(path, device="cpu").policy
        except (zipfile.BadZipFile, AssertionError, KeyError, ValueError) as error:
            raise ValueError(f"{path} is not a PPO checkpoint ({error})") from None
        self._frames = described["hyperparameters"]["frames"] if memory == "frames" else 1
        self._size = env.core.observation_size
        # Two kinds of observation may have the same length: ask what it was trained on, not how long that is.
        trained = described.get("env_options", {}).get("observe", "mean")
        if trained != env.core.observe_mode or self._policy.observation_space.shape != (self._frames * self._size,):
            raise ValueError(
                f"{path} was trained on observe={trained!r}, this environment gives {env.core.observe_mode!r}"
            )

    def reset(self, num_envs: int) -> None:
        """Forget everything: the frames before the first are zeros, and so is the recurrent state."""
        self._seen = np.zeros((num_envs, self._frames * self._size), np.float32)
        self._state = None

    def act(self, observations: np.ndarray) -> np.ndarray:
        """The policy's mean action."""
        self._seen = np.concatenate([self._seen[:, self._size :], observations], axis=1)  # the newest frame last
        actions, self._state = self._policy.predict(self._seen, self._state, deterministic=True)
        return actions
