"""PPO through stable-baselines3 on the batched environments."""

import hashlib
import json
import time
import tomllib
import zipfile
from collections.abc import Callable
from importlib import metadata
from importlib.resources import files
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import estimators
import vessel_gym
from agents.files import replacing
from agents.seeds import training_seed

_DESCRIPTION = "vessel_gym.json"  # inside a checkpoint


def hyperparameters(env_id: str) -> dict[str, Any]:
    """The tuned settings of an environment, from ``agents/ppo.toml``.

    Raises:
        ValueError: if it has none.
    """
    table = tomllib.loads(files("agents").joinpath("ppo.toml").read_text())
    if env_id not in table:
        raise ValueError(f"no PPO settings for {env_id!r} in agents/ppo.toml: choose from {', '.join(table)}")
    return table[env_id]


def describe(env_id: str, env_options: dict[str, Any] | None, seed: int, steps: int | None) -> dict[str, Any]:
    """Everything that decides what `train` gives, as plain data: equal descriptions, equal checkpoints.

    Args:
        env_id: As `train`; so are the other arguments.
        env_options: See `train`.
        seed: See `train`.
        steps: See `train`.

    Returns:
        The arguments, the tuned settings, the versions of the libraries that compute, and a digest of the
        environments' and estimators' source code.

    Raises:
        ValueError: for an environment without settings or a budget below one rollout.
    """
    settings = hyperparameters(env_id)
    steps = settings["steps"] if steps is None else steps
    if steps < settings["num_envs"]:
        raise ValueError(f"steps must be at least the {settings['num_envs']} environments of a batch, got {steps}")
    described = {
        "env_id": env_id,
        "env_options": env_options or {},
        "seed": seed,
        "steps": steps,
        "hyperparameters": settings,
        "versions": {"vessel-gym": vessel_gym.__version__}
        | {name: metadata.version(name) for name in ("numpy", "torch", "stable-baselines3")},
        "source": _source_digest(),
    }
    return json.loads(json.dumps(described))


def description(path: Path) -> dict[str, Any] | None:
    """What `train` wrote of itself into a checkpoint; None if there is no such checkpoint."""
    try:
        with zipfile.ZipFile(path) as archive:
            return json.loads(archive.read(_DESCRIPTION))
    except (OSError, zipfile.BadZipFile, KeyError, ValueError):
        return None


def _source_digest() -> str:
    """SHA-256 of the code that an agent learns from: the training's own, and all but pictures of the environments'."""
    digest = hashlib.sha256()
    here = Path(__file__).parent
    for source in (here / "ppo.py", here / "vec_env.py", here / "seeds.py"):
        digest.update(source.read_bytes())
    for package in (estimators, vessel_gym):
        root = Path(package.__file__ or "").parent
        for source in sorted(root.rglob("*.py")):
            name = source.relative_to(root)
            if name.parts[0] != "rendering":
                digest.update(name.as_posix().encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()


def train(
    env_id: str,
    path: Path,
    env_options: dict[str, Any] | None = None,
    seed: int = 0,
    steps: int | None = None,
    progress: Callable[[int, int, float], None] | None = None,
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

    Returns:
        The path of the checkpoint.

    Raises:
        ValueError: for an environment without settings or a budget below one rollout.
        OSError: if the checkpoint cannot be written.
    """
    described = describe(env_id, env_options, seed, steps)
    path = Path(path)
    path = path if path.suffix == ".zip" else path.with_name(f"{path.name}.zip")
    with replacing(path) as temporary:
        described |= _learn(described, temporary, progress)
        with zipfile.ZipFile(temporary, "a") as archive:
            archive.writestr(_DESCRIPTION, json.dumps(described, indent=1))
    return path


def _learn(described: dict[str, Any], path: Path, progress: Callable[[int, int, float], None] | None) -> dict[str, Any]:
    """Train what `describe` described and save the policy; returns how many steps and seconds it took."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

    from agents.vec_env import StableBaselinesVecEnv

    torch.set_num_threads(1)  # small networks: a second thread costs more than it brings
    settings, budget, seed = described["hyperparameters"], described["steps"], described["seed"]
    num_envs = settings["num_envs"]
    vector = gym.make_vec(described["env_id"], num_envs=num_envs, **described["env_options"])
    perfect = vector.unwrapped.core.task.perfect  # type: ignore[attr-defined]
    env = StableBaselinesVecEnv(vector)
    env.seed(training_seed(seed))
    final = settings["learning_rate_final"]
    initial = settings["learning_rate"]

    class Report(BaseCallback):
        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:
            if progress is not None:
                late = [info["r"] for info in self.model.ep_info_buffer or ()]
                mean = float(np.mean(late)) / perfect if late else float("nan")
                progress(self.num_timesteps, budget, mean)

    model = PPO(
        "MlpPolicy",
        env,
        n_steps=settings["n_steps"],
        batch_size=settings["batch_size"],
        n_epochs=settings["n_epochs"],
        gamma=settings["gamma"],
        gae_lambda=settings["gae_lambda"],
        clip_range=settings["clip_range"],
        ent_coef=settings["ent_coef"],
        learning_rate=lambda remaining: final + (initial - final) * remaining,
        policy_kwargs={
            "log_std_init": settings["log_std_init"],
            "net_arch": settings["net_arch"],
            "activation_fn": torch.nn.Tanh,
        },
        stats_window_size=2 * num_envs,
        seed=seed,
        device="cpu",
    )
    # PPO reseeds the environments with its own seed: put the training range back.
    env.seed(training_seed(seed))
    begin = time.perf_counter()
    try:
        model.learn(budget, callback=Report())
        seconds = time.perf_counter() - begin
        model.save(path)
    finally:
        env.close()
    return {"trained_steps": model.num_timesteps, "trained_seconds": seconds}  # whole rollouts


class PPOAgent:
    """A trained PPO policy, flown without exploration noise.

    Args:
        path: A checkpoint of `train`.
        env: The environment that it will fly, to check the observation.

    Raises:
        ValueError: if the file is no checkpoint, or was trained on another observation.
    """

    def __init__(self, path: Path, env: Any) -> None:
        import torch
        from stable_baselines3 import PPO

        torch.set_num_threads(1)
        try:
            self._policy = PPO.load(path, device="cpu").policy
        except (zipfile.BadZipFile, AssertionError, KeyError, ValueError) as error:
            raise ValueError(f"{path} is not a PPO checkpoint ({error})") from None
        # Two kinds of observation may have the same length: ask what it was trained on, not how long that is.
        trained = (description(Path(path)) or {}).get("env_options", {}).get("observe", "mean")
        if trained != env.core.observe_mode or self._policy.observation_space.shape != (env.core.observation_size,):
            raise ValueError(
                f"{path} was trained on observe={trained!r}, this environment gives {env.core.observe_mode!r}"
            )

    def reset(self, num_envs: int) -> None:
        """Nothing to forget: the policy has no memory."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        """The policy's mean action."""
        return self._policy.predict(observations, deterministic=True)[0]
