"""Run the source papers' experiments beside their tables: ``vessel-gym reproduce all``."""

import json
from pathlib import Path
from typing import Any

from agents.commands.console import asked, job_progress

OPTIONS = {
    "papers": "all, or some of corvette, segorogeni, itsunusa, robust and puna",
    "out": "folder for the pages, the tables as CSV and summary.json, from which studies.tables"
    " writes docs",
}


def main(
    papers: tuple[str, ...],
    /,
    out: Path = Path("results/reproduction"),
    processes: int = 2,
) -> int:
    """Write a page for each source paper: its numbers beside ours, its claims, our guesses.

    Prints a row for each experiment. Finished papers are kept in jobs/ of the output folder: after
    an interruption, run the same command again. Every number follows from fixed seeds, computation
    times excepted.

    Returns:
        The exit status: 1 if an experiment failed.
    """
    from agents.files import check_folder
    from agents.jobs import run
    from vessel_gym.checks import one_of
    from vessel_gym.extras import require

    require("joblib", "jinja2", "markdown_it", "matplotlib", "pandas")  # before the experiments
    from agents.papers import PAPERS, job

    with asked():
        for name in papers:
            one_of("paper", name, ("all", *PAPERS))
    check_folder(out)
    jobs = {name: job(name) for name in (PAPERS if "all" in papers else dict.fromkeys(papers))}
    with job_progress("reproducing", processes) as progress:
        outcome = run(jobs.values(), out, processes, progress=progress)
    made = {name: outcome.values[of.key] for name, of in jobs.items() if of.key in outcome.values}
    _report(made, out)
    print(*outcome.failures.values(), sep="\n", end="")
    return int(bool(outcome.failures))


def _report(made: dict[str, Any], out: Path) -> None:
    """Write the pages, tables and summary of finished papers, and print a row an experiment."""
    from agents.files import write_text
    from agents.papers.measures import Row, summary_table
    from agents.papers.pages import write_paper

    for name, values in made.items():
        print(f"Page: {write_paper(name, values, out)}")
    rows = [Row(*row) for values in made.values() for row in values["rows"]]
    print(f"\n{summary_table(rows)}")
    summary = {
        name: values
        | {"figures": {f"Figure {f['number']}": f["caption"] for f in values["figures"]}}
        for name, values in made.items()
    }
    text = json.dumps(summary, ensure_ascii=False, indent=1)
    write_text(out / "summary.json", f"{text}\n")
