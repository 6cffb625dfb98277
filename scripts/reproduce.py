"""Run the source papers' experiments and set their tables beside ours: ``python -m scripts.reproduce all``."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from scripts.console import asked, cell_progress, command, in_range

Name = Literal["all", "corvette", "segorogeni", "itsunusa", "robust", "puna"]


def main(
    papers: Annotated[tuple[Name, ...], tyro.conf.Positional],
    out: Path = Path("results/reproduction"),
    jobs: int = 2,
) -> int:
    """Write a page for each paper: its table beside ours, its figures, what we had to assume, its misprints.

    Finished work is kept in cells/ of the output folder: after an interruption, run the same command again. Every
    number follows from fixed seeds, computation times excepted.

    Args:
        papers: Which papers; all: every one.
        out: Folder for the pages and the tables as CSV.
        jobs: Processes that compute.

    Returns:
        The exit status: 1 if an experiment failed.
    """
    from rich.console import Console

    from agents.cells import run
    from agents.files import check_folder
    from agents.page import write
    from agents.reproduction import PAPERS, cells, page
    from vessel_gym.extras import require

    require("matplotlib", "jinja2", "joblib")  # before the experiments, not after them
    with asked():
        if not papers:
            raise ValueError(f"name the papers to reproduce: all, or some of {', '.join(PAPERS)}")
        in_range("--jobs", jobs, 1)
    check_folder(out)
    names = PAPERS if "all" in papers else tuple(dict.fromkeys(papers))
    groups = {name: cells(name) for name in names}
    with cell_progress("reproducing") as progress:
        outcome = run([cell for group in groups.values() for cell in group.values()], out, jobs, progress=progress)
    console = Console(markup=False, highlight=False, soft_wrap=True)
    for note in outcome.notes:
        console.print(note)
    status = 0
    for name, group in groups.items():
        failed = {what: outcome.failures[cell.key] for what, cell in group.items() if cell.key in outcome.failures}
        if failed:
            status = 1
            what, text = next(iter(failed.items()))
            console.print(
                f"{name}: {len(failed)} of {len(group)} cells failed, so there is no page. First, {what}:\n{text}"
            )
            continue
        made = page(name, {what: outcome.values[cell.key] for what, cell in group.items()})
        console.print(f"\n{made.title}\n{' '.join(made.answer)}")
        for table in made.tables:
            if table.name:
                file = out / "tables" / f"{name}-{table.name}.csv"
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(table.csv(), encoding="utf-8")
        console.print(f"Page: {write(made, out / f'{name}.html')}")
    return status


if __name__ == "__main__":
    sys.exit(command(main))
