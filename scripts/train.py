"""Train PPO on an environment: ``python -m scripts.train SigmaCorvette-v0 --estimator kf-umv-ui``."""

from pathlib import Path
from typing import Any

from scripts.console import asked, command, in_range, training_progress


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
) -> None:
    """Train PPO with the tuned settings of ``agents/ppo.toml`` and save the checkpoint.

    Args:
        env_id: Registered environment.
        out: Checkpoint to write.
        estimator: What the agent sees the world through; the environment's default if not given.
        sensors: clean, nominal or degraded.
        disturbance: calm, moderate or rough.
        mismatch: Relative spread of the truth's parameters.
        observe: mean, mean+std or measurement.
        memory: What the agent remembers: none, frames (its last observations) or lstm (a recurrent network).
        critic: truth, so that the critic alone is told the truth while it learns (docs/critic.md).
        seed: Number of the training run.
        steps: Environment steps; the tuned budget if not given.
    """
    import gymnasium as gym

    from agents.files import check_file
    from agents.ppo import describe, train
    from agents.studies.worlds import environment_id
    from vessel_gym.checks import one_of

    options: dict[str, Any] = {
        "estimator": estimator,
        "sensors": sensors,
        "disturbance": disturbance,
        "mismatch": mismatch,
        "observe": observe,
    }
    with asked():
        env_id = environment_id(env_id)
        one_of("--observe", observe, ("mean", "mean+std", "measurement"))
        gym.make_vec(env_id, num_envs=1, **options).close()
        in_range("--seed", seed, 0)
        if steps is not None:
            in_range("--steps", steps, 1)
        describe(env_id, options, seed, steps, memory, critic)
    check_file(out)
    with training_progress(f"PPO on {env_id}") as progress:
        path = train(env_id, out, options, seed, steps, progress, memory, critic)
    print(f"checkpoint: {path}")


if __name__ == "__main__":
    command(main)
