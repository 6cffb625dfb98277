"""Run a study file and write its report: ``vessel-gym ablate quick``."""

import shlex
import sys
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from agents.commands.console import asked, job_progress, print_answer, print_table


def _shipped() -> dict[str, Path]:
    """Study files that come with vessel-gym by name: the checkout's, or the wheel's data files."""
    found = list(Path(__file__).parents[2].glob("studies/*.toml"))
    if not found:
        with suppress(metadata.PackageNotFoundError):
            files = metadata.files("vessel-gym") or ()
            found = [
                Path(str(file.locate()))
                for file in files
                if file.match("vessel-gym/studies/*.toml")
            ]
    return {path.stem: path for path in sorted(found)}


STUDIES = _shipped()


OPTIONS = {
    "study": "study file (TOML), or the name of one that comes with vessel-gym:"
    f" {', '.join(STUDIES)}",
    "out": "folder for results and report; results/ and the study's name if not given",
    "scheduler": "Dask scheduler whose workers compute instead, e.g. tcp://10.0.0.1:8786",
}


def main(
    study: Path,
    /,
    out: Path | None = None,
    processes: int = 2,
    scheduler: str | None = None,
) -> int:
    """Run what a study file asks for, as far as it has not been run, and write its report.

    Results are kept in the output folder, each in a file of its own. After an interruption, run the
    same command again: it goes on with what is missing. Run it on several machines with a folder
    that all of them see, and they share the work.

    Returns:
        The exit status: 1 if something failed or is missing.
    """
    from agents.files import check_folder, write_text
    from agents.jobs import run
    from agents.studies.examples import examples
    from agents.studies.plan import plan
    from agents.studies.report import write_report
    from agents.studies.results import Results
    from agents.studies.study import read_study
    from vessel_gym.extras import require

    out = out or Path("results") / study.stem
    with asked():
        path, cluster = _file(study), ("dask", "distributed") if scheduler else ()
        require("matplotlib", "jinja2", "joblib", "pyarrow", *cluster)
        planned = plan(read_study(path))
        check_folder(out)
    print(planned.study.title)
    write_text(out / "study.toml", path.read_text(encoding="utf-8"))

    def compute(title: str, jobs: list[Any]) -> Any:
        with job_progress(title, processes) as progress:
            return run(jobs, out, processes, scheduler, progress)

    results = Results.of(planned, compute(study.stem, planned.jobs))
    episodes = examples(results)
    played = compute("example episodes", list(episodes.values()))
    pages = {e: played.values[job.key] for e, job in episodes.items() if job.key in played.values}
    command = shlex.join(["vessel-gym", "ablate", str(study), "--out", str(out)])
    _print(results, write_report(results, out, pages, command))
    # Jobs that fail alike say it once: what differs is the name before the traceback.
    texts = (results.outcome.failures | played.failures).values()
    failures = {text.partition("Traceback")[2] or text: text for text in texts}
    print(*failures.values(), sep="\n", end="")
    return int(bool(failures))


def _print(results: Any, report: Path) -> None:
    """Print the answer, a table of at most five rows, the code and the place of the report."""
    from agents.studies.answer import answer
    from agents.studies.ranking import rankings
    from agents.studies.tables import BEST, code, effects_table, summary

    print_answer(answer(results))
    title, table = "How much each factor moves the score", effects_table(results)[:BEST]
    if len(table) < 2 and (found := rankings(results)):
        head, ranking = next(iter(found.items()))
        title, table = f"The best estimators, {head}", summary(ranking)
    if len(table):
        print_table(title, [table.index.name, *table.columns], table.itertuples())
    print(*code(results), f"Report: {report}", sep="\n")


def _file(study: Path) -> Path:
    """The file of a study by its path or name; modules of the user's own lie beside it or here."""
    from estimators.factory import unknown

    path = STUDIES.get(str(study), study)
    if not path.suffix and not path.exists():
        raise ValueError(
            f"{unknown('study', str(path), STUDIES)} (your own: a file, e.g. mine.toml)"
        )
    sys.path += [str(path.resolve().parent), str(Path.cwd())]
    return path
