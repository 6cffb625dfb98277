"""Run a study file and write its report: ``python -m scripts.ablate studies/quick.toml``."""

import re
import sys
from pathlib import Path
from typing import Annotated

import tyro

from scripts.console import asked, command, in_range, job_progress

STUDIES = {path.stem: path for path in sorted(Path(__file__).parents[1].glob("studies/*.toml"))}
"""Those that come with vessel-gym, by their names."""


def main(
    study: Annotated[Path, tyro.conf.Positional],
    out: Path | None = None,
    processes: int = 2,
    scheduler: str | None = None,
    shard: str | None = None,
    confirm: bool = False,
) -> int:
    """Run what a study file asks for, as far as it has not been run, and write its report.

    Results are kept in the output folder, each in a file of its own. After an interruption, run the same command
    again: it goes on with what is missing. Several machines may share the folder.

    Args:
        study: The study file (TOML; docs/studies.md says what it holds), or the name of one that comes with vessel-gym,
            e.g. quick.
        out: Folder for results and report; results/ and the name of the study file if not given.
        processes: Processes on this machine.
        scheduler: Address of a Dask scheduler whose workers compute instead, e.g. tcp://10.0.0.1:8786.
        shard: i/n: compute only the i-th of n parts, for job arrays; the report is made when all are done.
        confirm: Open the fresh seeds, once in each folder: fly the study on them, too, and report which claims hold.

    Returns:
        The exit status: 1 if something failed or is missing.
    """
    import json
    import shutil

    from rich.console import Console

    from agents.files import check_folder, replacing
    from agents.jobs import check_scheduler, run
    from agents.studies.answer import answer
    from agents.studies.confirmation import is_open, open_seeds, opening
    from agents.studies.examples import examples
    from agents.studies.plan import plan
    from agents.studies.records import FEW_SEEDS
    from agents.studies.report import write_report
    from agents.studies.results import Results
    from agents.studies.study import read_study
    from estimators.factory import unknown
    from vessel_gym.extras import require

    require("matplotlib", "jinja2", "joblib")  # before the flights, not after them
    if scheduler is not None:
        require("dask", "distributed")
    out = Path("results") / study.stem if out is None else out
    with asked():
        part = _shard(shard)
        study = STUDIES.get(str(study), study)
        if not study.suffix and not study.exists():
            raise ValueError(f"{unknown('study', str(study), STUDIES)} (your own: a file, e.g. mine.toml)")
        in_range("--processes", processes, 1)
        if scheduler is not None:
            check_scheduler(scheduler)
        sys.path.append(str(study.resolve().parent))  # an own estimator may lie beside the study
        question = read_study(study)
        planned = plan(question)
    check_folder(out)
    with asked():
        if confirm:
            open_seeds(question, out)
        fresh = plan(question.fresh) if is_open(question, out) else None
    console = Console(markup=False, highlight=False, soft_wrap=True)
    console.print(question.title)
    if question.learned and question.training_seeds < FEW_SEEDS:
        console.print(
            f"warning: {question.training_seeds} training seeds say little about learning; use {FEW_SEEDS} or more"
        )
    with replacing(out / "study.json") as path:
        path.write_text(json.dumps(question.resolved(), indent=1), encoding="utf-8")
    if study.resolve() != (out / "study.toml").resolve():
        with replacing(out / "study.toml") as path:
            shutil.copyfile(study, path)
    jobs = [*planned.jobs, *examples(planned).values(), *(fresh.jobs if fresh else ())]
    with job_progress(study.stem) as progress:
        outcome = run(jobs, out, processes, scheduler, part, progress)
    if fresh is None and opening(out):
        outcome.notes.append(f"the fresh seeds of {out} were opened for another version of this study: not reported")
    for note in outcome.notes:
        console.print(note)
    missing = sum(job.key not in outcome.values for job in jobs)
    if part is not None and missing:
        console.print(f"Part {shard} is done, {missing} of {len(jobs)} results are still missing: no report yet.")
        return int(bool(outcome.failures))
    results = Results.of(planned, outcome, out)
    again = Results.of(fresh, outcome, out) if fresh else None
    report = write_report(results, out, again)
    console.print("", " ".join(answer(results, again)), "", sep="\n")
    if missing:
        console.print(f"{missing} of {len(jobs)} results are missing; the report says why.")
    console.print(f"Report: {report}")
    return int(missing > 0)


def _shard(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
    if not found or not 1 <= int(found[1]) <= int(found[2]):
        raise ValueError(f"--shard is i/n with 1 <= i <= n, e.g. 1/4, got {text!r}")
    return int(found[1]), int(found[2])


if __name__ == "__main__":
    sys.exit(command(main))
