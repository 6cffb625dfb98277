"""Run the source papers' experiments beside their tables: ``python -m scripts.reproduce all``."""

import csv
import json
import sys
from pathlib import Path
from typing import Any

from agents.commands.console import asked, command, in_range, job_progress

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
    """Write a page for each paper: its numbers beside ours, what was probably done, its claims; in a checkout.

    Prints a row for each experiment. Finished work is kept in jobs/ of the output folder: after an
    interruption, run the same command again. Every number follows from fixed seeds, computation
    times excepted.

    Returns:
        The exit status: 1 if an experiment failed.
    """
    from rich.console import Console

    from agents.files import check_folder
    from agents.jobs import run
    from vessel_gym.checks import one_of
    from vessel_gym.extras import require

    require("joblib")  # before the experiments, not after them
    from studies.papers import PAPERS, jobs, opening, report
    from studies.papers.measures import Row, summary_table

    with asked():
        in_range("--processes", processes, 1)
        for name in papers:
            one_of("paper", name, ("all", *PAPERS))
    check_folder(out)
    names = PAPERS if "all" in papers else tuple(dict.fromkeys(papers))
    groups = {name: jobs(name) for name in names}
    with job_progress("reproducing") as progress:
        outcome = run(
            [job for group in groups.values() for job in group.values()],
            out,
            processes,
            progress=progress,
        )
    console = Console(markup=False, highlight=False, soft_wrap=True)
    status, summary, rows = 0, {}, list[Row]()
    for name, group in groups.items():
        failed = {
            what: outcome.failures[job.key]
            for what, job in group.items()
            if job.key in outcome.failures
        }
        if failed:
            status, (what, text) = 1, next(iter(failed.items()))
            said = (
                f"{name}: {len(failed)} of {len(group)} jobs failed, so there is no page. First,"
                f" {what}:\n{text}"
            )
            console.print(said)
            continue
        made = report(name, {what: outcome.values[job.key] for what, job in group.items()})
        console.print(f"Page: {_write(name, made, out)}")
        summary[name] = {"opening": opening(name), "rows": made.rows}
        rows += made.rows
    console.print(f"\n{summary_table(rows)}")
    (out / "summary.json").write_text(
        json.dumps(summary, ensure_ascii=False, indent=1) + "\n", encoding="utf-8"
    )
    return status


def _write(name: str, made: Any, out: Path) -> Path:
    """Write the explanation of a paper with its tables, and these as CSV; returns the page."""
    from studies.papers import read

    (out / "tables").mkdir(parents=True, exist_ok=True)
    for table, rows in made.tables.items():
        with (out / "tables" / f"{name}-{table}.csv").open(
            "w", encoding="utf-8", newline=""
        ) as file:
            csv.writer(file, lineterminator="\n").writerows(rows)
    page = out / f"{name}.md"
    page.write_text(made.page(read(name, "page.md")), encoding="utf-8")
    return page


if __name__ == "__main__":
    sys.exit(command(main))
