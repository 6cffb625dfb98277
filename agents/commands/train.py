"""Train an agent on an environment: ``vessel-gym train SigmaCorvette-v0 --estimator kf-umv-ui``."""

import shutil
from pathlib import Path
from typing import Any

from agents.commands.console import asked, progress

CHOOSING = 100
"""Tuning seeds on which the best of several trainings is chosen."""


OPTIONS = {
    "out": "policy to write; results/ and the algorithm's name if not given",
    "algorithm": "ppo, a2c, trpo, sac, td3, tqc, crossq or ddpg",
    "memory": "none, frames (the last observations) or lstm (a recurrent network)",
    "seed": "number of the training run",
    "steps": "environment steps; n_timesteps of the settings if not given",
    "runs": "training runs from --seed on, of which the best on tuning seeds is saved",
    "hyperparameters": "TOML file with a table for each environment, or [default], of settings that"
    " replace the tuned ones, with the names of rl_zoo3",
    "set_": "settings over all these, e.g. learning_rate=1e-3",
    "resume": "go on with an interrupted training",
    "force": "replace what is there",
}


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    out: Path | None = None,
    algorithm: str = "ppo",
    memory: str = "none",
    seed: int = 0,
    steps: int | None = None,
    runs: int = 1,
    hyperparameters: Path | None = None,
    set_: dict[str, Any] = {},  # noqa: B006  (never changed)
    resume: bool = False,
    force: bool = False,
    **options: Any,
) -> None:
    """Train PPO, with tuned settings, or another algorithm of stable-baselines3.

    The policy is an .npz file, with the model of stable-baselines3 beside it as a .zip. A folder of
    the same name gets progress.csv, TensorBoard's events, evaluations on tuning seeds, the best
    policy and checkpoints. After Ctrl-C, or the death of the process, the same command with
    --resume goes on from the last of them.
    """
    from agents.policies.checkpoint import npz_path
    from agents.studies.worlds import environment_id
    from agents.training.algorithms import read_settings
    from agents.tuning.tuned import load_tuned

    algorithm = algorithm.lower()
    out = npz_path(out or Path("results") / algorithm)
    with asked():
        if out.exists() and not (resume or force):
            raise ValueError(f"{out} exists: give --force to replace it, or another --out")
        env_id = environment_id(env_id)
        if "tuned" in options:
            options = load_tuned(options.pop("tuned")).options_for(env_id, options)
        settings = read_settings(hyperparameters, env_id)[1] if hyperparameters else {}
        _tell_settings(algorithm, env_id)
        given = {"settings": settings | set_, "steps": steps, "algorithm": algorithm}
        given |= {"memory": memory, "env_options": options, "resume": resume, "force": force}
        if runs == 1:
            _once(env_id, env_id, out, seed, given)
        else:
            _best(env_id, out, range(seed, seed + runs), given)
    print(f"wrote {out}, and for stable-baselines3 {out.with_suffix('.zip')}")
    if runs == 1:
        _tell_best(out.with_suffix(""))


def _tell_settings(algorithm: str, env_id: str) -> None:
    """Print whose settings train an environment that has none of its own."""
    from agents.training.algorithms import tuned_settings

    if (table := tuned_settings(algorithm, env_id)[0]) != env_id:
        of = "the defaults, not tuned" if table == "default" else f"those of {table}"
        print(f"settings: {of} ({algorithm}.toml)", flush=True)


def _tell_best(folder: Path) -> None:
    """Print which of the evaluations of a training the best policy is of."""
    from agents.commands.plot import evaluations

    steps, returns = evaluations(folder / "evaluations.npz")
    print(
        f"the best of {len(returns)} evaluations, mean return {returns.max():.3f} after"
        f" {steps[returns.argmax()]} steps: {folder / 'best_model.npz'}"
    )


def _once(title: str, env_id: str, path: Path, run: int, given: dict[str, Any]) -> None:
    """Train once, with progress."""
    from agents.training.algorithms import train

    with progress(title) as show:

        def report(done: int, total: int, reward: float) -> None:
            show(done, total, "" if reward != reward else f"mean return in evaluation {reward:.3f}")

        train(env_id, path, seed=run, progress=report, folder=path.with_suffix(""), **given)


def _best(env_id: str, out: Path, runs: range, given: dict[str, Any]) -> None:
    """Train several times, no run twice, and save the policy that scores best on tuning seeds."""
    from agents import rollout
    from agents.files import replacing
    from agents.seeds import tuning_seeds

    scores, seeds = {}, tuning_seeds(CHOOSING)
    for run in runs:
        path = out.with_suffix("") / f"run-{run}.npz"
        if not (given["resume"] and path.exists()):
            started = path.with_suffix("").exists()
            title = f"{env_id}, run {run}"
            _once(title, env_id, path, run, given | {"resume": given["resume"] and started})
        flight = rollout(path, env_id, seeds, given["env_options"], record=False)
        scores[path] = float(flight.score.mean())
        print(f"run {run}: mean score {scores[path]:.3f} over {CHOOSING} tuning seeds", flush=True)
    best = max(scores, key=lambda path: scores[path])
    for suffix in (".zip", ".npz"):
        with replacing(out.with_suffix(suffix)) as temporary:
            shutil.copyfile(best.with_suffix(suffix), temporary)
