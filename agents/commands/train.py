"""Train an agent on an environment: ``vessel-gym train SigmaCorvette-v0 --estimator kf-umv-ui``."""

import shutil
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from agents.commands.console import asked, in_range, training_progress
from agents.commands.world import World, assigned

CHOOSING = 100
"""Tuning seeds on which the best of several trainings is chosen."""


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    out: Path | None = None,
    algorithm: str = "ppo",
    estimator: str | None = None,
    world: tyro.conf.OmitArgPrefixes[World] = World(),  # noqa: B008  (frozen)
    memory: str = "none",
    seed: int = 0,
    steps: int | None = None,
    runs: int = 1,
    hyperparameters: Path | None = None,
    settings: Annotated[tuple[str, ...], tyro.conf.arg(name="set")] = (),
    resume: bool = False,
) -> None:
    """Train PPO, with tuned settings, or another algorithm of stable-baselines3, and save the checkpoint.

    A folder beside the checkpoint, of the same name without .zip, gets progress.csv, TensorBoard's
    events, the latest and best policy on tuning seeds, and stable-baselines3's checkpoints. After
    Ctrl-C, or the death of the process, the same command with --resume goes on from the last of
    them.

    Args:
        env_id: Registered environment.
        out: Checkpoint to write; results/ and the name of the algorithm if not given.
        algorithm: ppo, recurrentppo (ppo with --memory lstm), a2c, trpo, sac, td3, tqc, crossq or
            ddpg.
        estimator: What the agent sees the world through; the environment's default if not given.
        world: Options of the environment.
        memory: What the agent remembers: none, frames (its last observations) or lstm (a recurrent
            network).
        seed: Number of the training run.
        steps: Environment steps; the tuned budget if not given.
        runs: Training runs, numbered from --seed on; of several the one that scores best on tuning
            seeds is saved.
        hyperparameters: TOML file of settings that replace the tuned ones.
        settings: Settings over all these, as name=value, e.g. learning_rate=1e-3 net_arch=[64,64].
        resume: Go on with an interrupted training.
    """
    from agents.files import check_file
    from agents.policies.checkpoint import zip_path
    from agents.training.algorithms import ALGORITHMS
    from estimators.factory import unknown
    from vessel_gym.toml_file import TomlFile

    named = algorithm.lower()
    out = zip_path(out or Path("results") / named)
    with asked():
        if named not in (known := (*ALGORITHMS, "recurrentppo")):
            raise ValueError(unknown("algorithm", algorithm, known))
        if out.exists() and not resume:
            raise ValueError(
                f"{out} is there already: remove it and its folder, or give another --out"
            )
        in_range("--runs", runs, 1)
        algorithm, memory = ("ppo", "lstm") if named == "recurrentppo" else (named, memory)
        changed = (TomlFile(hyperparameters).data if hyperparameters else {}) | assigned(
            "--set", settings
        )
        given = {"steps": steps, "memory": memory, "settings": changed, "algorithm": algorithm}
        env_id, options = _checked(env_id, world.options(estimator), seed, given)
    check_file(out)
    with asked():
        if runs == 1:
            _once(seed, env_id, out, options, resume, given)
        else:
            _best(range(seed, seed + runs), env_id, out, options, resume, given)
    print(f"checkpoint: {out}")


def _checked(
    env_id: str, options: dict[str, Any], seed: int, given: dict[str, Any]
) -> tuple[str, dict[str, Any]]:
    """The id and the options of the environment, once everything is known to fit together."""
    import gymnasium as gym

    from agents.studies.worlds import environment_id
    from agents.training.algorithms import describe

    env_id = environment_id(env_id)
    gym.make_vec(env_id, num_envs=1, **options).close()
    in_range("--seed", seed, 0)
    if given["steps"] is not None:
        in_range("--steps", given["steps"], 1)
    described = describe(env_id, options, seed, **given)
    idle = described["hyperparameters"].get("learning_starts", 0)
    if described["steps"] <= idle:
        advice = f"give more --steps, or --set learning_starts={described['steps'] // 10}"
        print(f"learning starts after {idle} steps: {advice}", file=sys.stderr)
    return env_id, options


def _once(
    run: int, env_id: str, path: Path, options: dict[str, Any], resume: bool, given: dict[str, Any]
) -> None:
    """Train once, with progress."""
    from agents.training.algorithms import train

    with training_progress(f"{env_id}, run {run}") as progress:
        train(
            env_id,
            path,
            options,
            run,
            folder=path.with_suffix(""),
            resume=resume,
            progress=progress,
            **given,
        )


def _best(
    runs: range,
    env_id: str,
    out: Path,
    options: dict[str, Any],
    resume: bool,
    given: dict[str, Any],
) -> None:
    """Train several times, no run twice, and save the checkpoint that scores best on tuning seeds."""
    from agents import rollout
    from agents.files import replacing
    from agents.seeds import tuning_seeds

    scores, seeds = {}, tuning_seeds(CHOOSING)
    for run in runs:
        folder = out.with_suffix("") / f"run-{run}"
        path = folder.with_suffix(".zip")
        if not (resume and path.exists()):
            _once(run, env_id, path, options, resume and folder.exists(), given)
        scores[path] = float(rollout(path, env_id, seeds, options, record=False).score.mean())
        print(f"run {run}: mean score {scores[path]:.3f} over {CHOOSING} tuning seeds", flush=True)
    with replacing(out) as temporary:
        shutil.copyfile(max(scores, key=lambda path: scores[path]), temporary)
