"""Hold the ensemble and particle filters against published scores: ``python -m studies.lorenz``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from agents.commands.console import asked, command, in_range, progress_bar

if TYPE_CHECKING:
    from rich.table import Table

TOLERANCE = 1.05
"""The lower end of our interval may be this many times the published value."""


def main(runs: int = 20, cycles: int = 1000, seed: int = 0) -> None:
    """Run ensemble and particle filters on Lorenz-63 and Lorenz-96 and print their scores beside the published ones.

    Filters that are the same transform share a row and are run once, under the first name. "Within" says whether the
    lower end of the interval is at most 1.05 times the published value; "reported", that the mean varies too much for
    that to mean anything (the median shows what a run that keeps to the truth is worth).

    Args:
        runs: Independent runs of each setting; the interval is Student's over them.
        cycles: Analyses that are scored in each run, after the burn-in.
        seed: Of everything random.
    """
    import numpy as np
    from rich.console import Console
    from rich.markup import escape

    from agents.statistics import mean_interval
    from studies.lorenz.benchmarks import BENCHMARKS, analysis_rmse

    with asked():
        in_range("runs", runs, 2)  # one run has no interval
        in_range("cycles", cycles, 1)
        in_range("seed", seed, 0)
    sources = list(dict.fromkeys(row.source for row in BENCHMARKS))
    tables: dict[str, Table] = {}
    with progress_bar("analyses", sum(row.setting.burn_in + cycles for row in BENCHMARKS)) as advance:
        for row in BENCHMARKS:
            scores = analysis_rmse(row, row.filters[0], runs, cycles, seed, advance)
            interval = mean_interval(scores)
            assert interval is not None, "two runs have an interval"
            within = "yes" if interval.low <= TOLERANCE * row.published else "no"
            table = tables.setdefault(row.setting.name, _table(row.setting.name))
            table.add_row(
                ", ".join(row.filters), str(row.members), row.described,
                f"{interval.mean:.3f} ± {interval.half:.3f}", f"{np.median(scores):.3f}",
                escape(f"{row.published:g} [{sources.index(row.source) + 1}]"),
                "reported" if row.reported_only else within,
            )  # fmt: skip
    console = Console(markup=False, highlight=False)
    console.width = max(console.width, 120)  # no figure is cut off
    console.print(f"Analysis RMSE, mean and 95 % interval over {runs} runs of {cycles} analyses")
    for table in tables.values():
        console.print(table)
    for number, source in enumerate(sources, 1):
        console.print(f"[{number}] {source}")


def _table(title: str) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, box=SIMPLE_HEAD)
    table.add_column("filter", no_wrap=True)
    table.add_column("N", justify="right", no_wrap=True)
    table.add_column("options", no_wrap=True)
    for heading in ("ours", "median", "published", "within"):
        table.add_column(heading, justify="right", no_wrap=True)
    return table


if __name__ == "__main__":
    command(main)
