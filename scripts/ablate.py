"""What does an estimator cost? Train, fly every estimator on the same seeds, write a report."""

import sys
from pathlib import Path

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from agents.ablation import Study, prepare, run
from agents.report import answer, write_report


def ablate(
    out: Path = Path("results/ablation"),
    env_id: str = "SigmaCorvette-v0",
    episodes: int = 100,
    training_seeds: int = 3,
    steps: int | None = None,
    jobs: int = 2,
) -> int:
    """Compare estimators by what agents achieve on them.

    Trains PPO, flies autopilot and PPO on every estimator over the same seeds, and writes
    checkpoints/, episodes.csv and report.html. Checkpoints that fit are used again.

    Args:
        out: Folder for the results.
        env_id: The environment.
        episodes: Evaluation seeds for each agent, estimator and sea.
        training_seeds: PPO training runs.
        steps: Environment steps of a training run; None: the tuned budget.
        jobs: Training runs at a time.

    Returns:
        The exit status: 2 if the study cannot be run or its results cannot be written.
    """
    try:
        study = Study(env_id, episodes, training_seeds, steps, jobs)
        prepare(study, out)
    except (ValueError, OSError) as error:
        print(f"ablate: {error}", file=sys.stderr)
        return 2
    console = Console()
    columns = (
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[score]}"), TimeElapsedColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console) as bars:
        tasks: dict[str, TaskID] = {}

        def progress(what: str, done: int, total: int, score: float | None) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total, score="")
            bars.update(tasks[what], completed=done, score="" if score is None else f"score {score:.3f}")

        results = run(study, out, progress)
    report = write_report(results, out)
    console.print("", " ".join(answer(results)), "", sep="\n", highlight=False, markup=False)
    console.print(f"Report: {report}", highlight=False, markup=False, soft_wrap=True)
    return 0


if __name__ == "__main__":
    sys.exit(tyro.cli(ablate))
