"""Train an agent on an environment: ``vessel-gym train SigmaCorvette-v0 --estimator kf-umv-ui``."""

import shutil
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from agents.commands.console import asked, in_range, training_progress

CHOOSING = 100
"""Tuning seeds on which the best of several trainings is chosen."""


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    out: Path | None = None,
    algorithm: str = "ppo",
    estimator: str | None = None,
    estimator_options: tuple[str, ...] = (),
    sensors: str = "nominal",
    disturbance: str = "moderate",
    mismatch: float = 0.0,
    observe: str = "mean",
    guidance: bool = True,
    termination: str | None = None,
    memory: str = "none",
    critic: str | None = None,
    seed: int = 0,
    steps: int | None = None,
    runs: int = 1,
    hyperparameters: Path | None = None,
    settings: Annotated[tuple[str, ...], tyro.conf.arg(name="set")] = (),
    resume: bool = False,
) -> None:
    """Train PPO, with tuned settings, or another algorithm of stable-baselines3, and save the checkpoint.

    A folder beside the checkpoint, of the same name without .zip, gets progress.csv, TensorBoard's events, and the
    latest and best policy on tuning seeds. Ctrl-C, or the death of the process, leaves a state there: the same command
    with --resume goes on, and learns the same weights as if it had never stopped.

    Args:
        env_id: Registered environment.
        out: Checkpoint to write; results/ and the name of the algorithm if not given.
        algorithm: ppo, recurrentppo (ppo with --memory lstm), a2c, trpo, sac, td3, tqc, crossq or ddpg.
        estimator: What the agent sees the world through; the environment's default if not given.
        estimator_options: Options of the estimator, as name=value, e.g. members=50.
        sensors: clean, nominal, degraded, budget or denied.
        disturbance: calm, moderate or rough.
        mismatch: Relative spread of the truth's parameters.
        observe: mean, mean+std or measurement.
        guidance: Observe the mission relative to the reference; without it the state alone.
        termination: Who ends a mission: task, belief or agent; the environment's default if not given.
        memory: What the agent remembers: none, frames (its last observations) or lstm (a recurrent network).
        critic: truth, so that the critic alone is told the truth while it learns (docs/critic.md).
        seed: Number of the training run.
        steps: Environment steps; the tuned budget if not given.
        runs: Training runs, numbered from --seed on; of several the one that scores best on tuning seeds is saved.
        hyperparameters: TOML file of settings that replace the tuned ones.
        settings: Settings over all these, as name=value, e.g. learning_rate=1e-3 net_arch=[64,64].
        resume: Go on with an interrupted training.
    """
    import gymnasium as gym

    from agents.files import check_file
    from agents.policies.checkpoint import zip_path
    from agents.studies.worlds import environment_id
    from agents.training.ppo import describe, train
    from vessel_gym.checks import one_of

    if algorithm == "recurrentppo":
        algorithm, memory = "ppo", "lstm"
    options: dict[str, Any] = {"estimator": estimator, "sensors": sensors, "disturbance": disturbance}
    options |= {"mismatch": mismatch, "observe": observe}
    options |= {} if guidance else {"guidance": False}
    options |= {} if termination is None else {"termination": termination}
    with asked():
        if estimator_options:
            options["estimator_options"] = _assigned("--estimator-options", estimator_options)
        changed = _of_file(hyperparameters) | _assigned("--set", settings)
        env_id = environment_id(env_id)
        one_of("--observe", observe, ("mean", "mean+std", "measurement"))
        gym.make_vec(env_id, num_envs=1, **options).close()
        in_range("--seed", seed, 0)
        in_range("--runs", runs, 1)
        if steps is not None:
            in_range("--steps", steps, 1)
        describe(env_id, options, seed, steps, memory, critic, changed, algorithm)
    out = out or Path("results") / f"{algorithm}.zip"
    check_file(out)
    path = zip_path(out)
    with training_progress(f"{algorithm} on {env_id}") as progress, asked():
        given: dict[str, Any] = {"steps": steps, "progress": progress, "memory": memory, "critic": critic}
        given |= {"settings": changed, "algorithm": algorithm}
        try:
            if runs == 1:
                train(env_id, path, options, seed, folder=path.with_suffix(""), resume=resume, **given)
            else:
                _best(range(seed, seed + runs), env_id, path, options, resume, given)
        except KeyboardInterrupt as stop:
            raise KeyboardInterrupt(f"{stop}; the same command with --resume goes on" if str(stop) else "") from None
    print(f"checkpoint: {path}")


def _assigned(option: str, words: Sequence[str]) -> dict[str, Any]:
    """Values by name, of words as name=value; a value is TOML, or else a text.

    Raises:
        ValueError: for a word of another form.
    """
    values = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not (name and equals and text):
            raise ValueError(f"{option} takes words as name=value, got {word!r}")
        try:
            values[name] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[name] = text
    return values


def _of_file(path: Path | None) -> dict[str, Any]:
    """Settings of a TOML file; none without one.

    Raises:
        ValueError: if it is no TOML.
        OSError: if it cannot be read.
    """
    try:
        return {} if path is None else tomllib.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is no TOML file of settings: {error}") from None


def _best(runs: range, env_id: str, out: Path, options: dict[str, Any], resume: bool, given: dict[str, Any]) -> None:
    """Train several times, and save the checkpoint that scores best on tuning seeds; none is trained twice."""
    from agents import rollout
    from agents.files import replacing
    from agents.seeds import tuning_seeds
    from agents.training.callbacks import STATE
    from agents.training.ppo import train

    scores, seeds = {}, tuning_seeds(CHOOSING)
    for run in runs:
        folder = out.with_suffix("") / f"run-{run}"
        path = folder.with_suffix(".zip")
        if not (resume and path.exists()):
            interrupted = resume and (folder / STATE).exists()
            train(env_id, path, options, run, folder=folder, resume=interrupted, **given)
        scores[path] = float(rollout(path, env_id, seeds, options, record=False).score.mean())
        print(f"run {run}: mean score {scores[path]:.3f} over {CHOOSING} tuning seeds", flush=True)
    with replacing(out) as temporary:
        shutil.copyfile(max(scores, key=lambda path: scores[path]), temporary)
