"""Tune estimator and controller: ``vessel-gym tune SigmaCorvette-v0 --estimator ekf``."""

from itertools import product
from pathlib import Path
from typing import Any

from agents.commands.console import asked, print_table, progress
from agents.refusal import Refusal

OPTIONS = {
    "estimator": "estimator that is tuned; the environment's default if not given",
    "sensors": "one or more sensor suites",
    "disturbance": "one or more disturbances; the mean score over all combinations is tuned",
    "tune_": "parameters to tune, such as estimator.R or agent.heading; all if not given",
    "by": "score, or likelihood: Q and R are then tuned alone, for likely measurements",
    "evaluations": "largest number of candidates",
    "episodes": "tuning seeds of a candidate in each condition",
    "seed": "number of the tuning, which has its own tuning seeds and its own start",
    "fresh": "other seeds, on which tuned and delivered parameters are compared, two or more",
    "out": "file to write (.toml)",
    "resume": "go on with an interrupted tuning",
    "force": "replace what is there",
}


def main(
    env_id: str = "SigmaCorvette-v0",
    /,
    estimator: str = "default",
    agent: str = "autopilot",
    sensors: tuple[str, ...] = ("nominal",),
    disturbance: tuple[str, ...] = ("moderate",),
    tune_: tuple[str, ...] = (),
    by: str = "score",
    evaluations: int = 100,
    episodes: int = 40,
    seed: int = 0,
    fresh: int = 100,
    processes: int = 1,
    out: Path = Path("tuned.toml"),
    resume: bool = False,
    force: bool = False,
    **options: Any,
) -> None:
    """Tune an estimator and a controller together, in closed loop, for the highest score.

    Writes a file of parameters that watch, evaluate and train take with --tuned. Every
    evaluation is appended to a journal beside it. After Ctrl-C the best so far is written; after
    the death of the process the same command with --resume goes on.
    """
    from agents.tuning.arm import Arm
    from agents.tuning.tune import tune

    journal = _journal(out, resume or force)
    chosen = {} if estimator == "default" else {"estimator": estimator}
    conditions = [{"sensors": s, "disturbance": d} for s, d in product(sensors, disturbance)]
    with asked(), progress("candidates") as show:
        arm = Arm(env_id, agent, options | chosen, tuple(conditions), tune_, by)
        if arm.parameters and force and not resume:
            journal.unlink(missing_ok=True)

        def report(done: int, best: float) -> None:
            show(done, evaluations, f"best {by} {best:.4f}")

        tuned = tune(arm, evaluations, episodes, seed, fresh, journal, processes, report)
    tuned.write(out)
    _print(tuned, out)


def _journal(out: Path, used: bool) -> Path:
    """The journal beside the file that is written; both may only be there if they are used."""
    from agents.files import check_file
    from vessel_gym.checks import one_of

    with asked():
        one_of("kind of file", out.suffix.lower(), (".toml",))
    check_file(out)
    journal = out.with_suffix(".jsonl")
    if not used and (out.exists() or journal.exists()):
        raise Refusal(
            f"{out if out.exists() else journal} is there already: give --resume to go on,"
            " --force to replace it, or another --out"
        )
    return journal


def _print(tuned: Any, out: Path) -> None:
    """Print what was tuned, what it gained on fresh seeds, and a line to copy."""
    from agents.page import text
    from agents.statistics import Interval

    found, arm, rows = tuned.found, tuned.arm, []
    for name, parameter in arm.parameters.items():
        gain = Interval(*found["gain_of"][name])
        note = "no effect" if max(-gain.low, gain.high) < 0.002 else ""
        note = "at its bound" if name in found["at_bound"] else note
        values = [f"{value:.3g}" for value in (parameter.value, tuned.values[name])]
        rows.append([name, *values, text(gain, 3, True), note])
    title = f"{arm.env_id}, {arm.estimator}, {arm.agent}: gain of each parameter on fresh seeds"
    print_table(title, ["parameter", "delivered", "tuned", "gain", ""], rows)
    print(
        f"Score on fresh seeds: {found['fresh_delivered']:.3f} as delivered,"
        f" {found['fresh_tuned']:.3f} tuned, difference {text(Interval(*found['gain']), 3, True)};"
        f" NEES of the position {found['position_nees']:.2f};"
        f" {len(found['best_so_far'])} candidates in {found['cpu_seconds']:.0f} CPU s.\n"
        f"Use it: vessel-gym evaluate {arm.env_id} --tuned {out}"
    )
