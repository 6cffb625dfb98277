"""Train PPO on an environment: ``vessel-gym train SigmaCorvette-v0 --estimator kf-umv-ui``."""

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from agents.commands.console import asked, in_range, training_progress

CHOOSING = 100
"""Tuning seeds on which the best of several trainings is chosen."""


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    out: Path = Path("results/ppo.zip"),
    estimator: str | None = None,
    sensors: str = "nominal",
    disturbance: str = "moderate",
    mismatch: float = 0.0,
    observe: str = "mean",
    memory: str = "none",
    critic: str | None = None,
    seed: int = 0,
    steps: int | None = None,
    runs: int = 1,
) -> None:
    """Train PPO with the tuned settings of ``agents/training/ppo.toml`` and save the checkpoint.

    Args:
        env_id: Registered environment.
        out: Checkpoint to write.
        estimator: What the agent sees the world through; the environment's default if not given.
        sensors: clean, nominal, degraded, budget or denied.
        disturbance: calm, moderate or rough.
        mismatch: Relative spread of the truth's parameters.
        observe: mean, mean+std or measurement.
        memory: What the agent remembers: none, frames (its last observations) or lstm (a recurrent network).
        critic: truth, so that the critic alone is told the truth while it learns (docs/critic.md).
        seed: Number of the training run.
        steps: Environment steps; the tuned budget if not given.
        runs: Training runs, numbered from --seed on; of several the one that scores best on tuning seeds is saved.
    """
    import gymnasium as gym

    from agents.files import check_file
    from agents.studies.worlds import environment_id
    from agents.training.ppo import describe, train
    from vessel_gym.checks import one_of

    world = {"sensors": sensors, "disturbance": disturbance, "mismatch": mismatch}
    options: dict[str, Any] = {"estimator": estimator, **world, "observe": observe}
    with asked():
        env_id = environment_id(env_id)
        one_of("--observe", observe, ("mean", "mean+std", "measurement"))
        gym.make_vec(env_id, num_envs=1, **options).close()
        in_range("--seed", seed, 0)
        in_range("--runs", runs, 1)
        if steps is not None:
            in_range("--steps", steps, 1)
        describe(env_id, options, seed, steps, memory, critic)
    check_file(out)
    with training_progress(f"PPO on {env_id}") as progress:
        settings: dict[str, Any] = {"steps": steps, "progress": progress, "memory": memory, "critic": critic}
        if runs == 1:
            path = train(env_id, out, options, seed, **settings)
        else:
            path = _best(range(seed, seed + runs), env_id, out, options, settings)
    print(f"checkpoint: {path}")


def _best(runs: range, env_id: str, out: Path, options: dict[str, Any], settings: dict[str, Any]) -> Path:
    """Train several times, and save the checkpoint that scores best on tuning seeds."""
    from agents import rollout
    from agents.files import replacing
    from agents.policies.checkpoint import zip_path
    from agents.seeds import tuning_seeds
    from agents.training.ppo import train

    scores, seeds = {}, tuning_seeds(CHOOSING)
    with TemporaryDirectory() as folder:
        for run in runs:
            path = train(env_id, Path(folder) / f"{run}.zip", options, run, **settings)
            scores[path] = float(rollout(path, env_id, seeds, options, record=False).score.mean())
            print(f"run {run}: mean score {scores[path]:.3f} over {CHOOSING} tuning seeds", flush=True)
        with replacing(zip_path(out)) as temporary:
            shutil.copyfile(max(scores, key=lambda path: scores[path]), temporary)
    return zip_path(out)
