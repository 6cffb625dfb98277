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
    """Write a page for each paper, in a checkout: its numbers beside ours, its claims, our guesses.

    Prints a row for each experiment. Finished papers are kept in jobs/ of the output folder: after
    an interruption, run the same command again. Every number follows from fixed seeds, computation
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
    from studies.papers import PAPERS, job
    from studies.papers.measures import Row, summary_table

    with asked():
        in_range("--processes", processes, 1)
        for name in papers:
            one_of("paper", name, ("all", *PAPERS))
    check_folder(out)
    jobs = {name: job(name) for name in (PAPERS if "all" in papers else dict.fromkeys(papers))}
    with job_progress("reproducing") as progress:
        outcome = run(jobs.values(), out, processes, progress=progress)
    console = Console(markup=False, highlight=False, soft_wrap=True)
    summary, rows = {}, list[Row]()
    for name, of in jobs.items():
        if of.key in outcome.failures:
            console.print(f"{name}: failed, so there is no page:\n{outcome.failures[of.key]}")
            continue
        made = outcome.values[of.key]
        console.print(f"Page: {_write(name, made['tables'], out)}")
        summary[name] = made["rows"]
        rows += [Row(*row) for row in made["rows"]]
    console.print(f"\n{summary_table(rows)}")
    (out / "summary.json").write_text(
        json.dumps(summary, ensure_ascii=False, indent=1) + "\n", encoding="utf-8"
    )
    return int(len(summary) < len(jobs))


def _write(name: str, tables: dict[str, Any], out: Path) -> Path:
    """Write the explanation of a paper with its tables, and these as CSV; returns the page."""
    from studies.papers import read
    from studies.papers.measures import page

    (out / "tables").mkdir(parents=True, exist_ok=True)
    for table, rows in tables.items():
        with (out / "tables" / f"{name}-{table}.csv").open(
            "w", encoding="utf-8", newline=""
        ) as file:
            csv.writer(file, lineterminator="\n").writerows(rows)
    path = out / f"{name}.md"
    path.write_text(page(read(name, "page.md"), tables), encoding="utf-8")
    return path


if __name__ == "__main__":
    sys.exit(command(main))
