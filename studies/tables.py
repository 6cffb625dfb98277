"""Tables of docs/, computed and written into their pages: ``python -m studies.tables``."""

import json
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from shutil import copyfile, copytree
from typing import Any

import pandas as pd
from scipy.stats import gmean

from agents.commands.console import command, progress
from agents.page import markdown_table
from agents.papers.measures import Row
from agents.papers.pages import file_name
from agents.refusal import Refusal
from studies.markdown import ROOT, put


def papers() -> str:
    """Measures and figures of the papers as ``vessel-gym reproduce`` stored them."""
    kept, made = ROOT / "docs/papers.json", ROOT / "results/reproduction"
    if made.exists():
        copyfile(made / "summary.json", kept)
        copytree(made / "figures", ROOT / "docs/images/papers", dirs_exist_ok=True)
    return papers_page(json.loads(kept.read_text(encoding="utf-8")))


def papers_page(summary: Mapping[str, Any]) -> str:
    """A line for each way of a paper, and the figures."""
    lines, rows = [], [row for each in summary.values() for row in each["rows"]]
    for paper, of in pd.DataFrame(rows, columns=Row._fields).groupby("paper", sort=False):
        total: Any = of.sum()
        scored, factors = of.numbers - of.incomparable, of.factor.replace(0.0, 1.0)
        factor = f"{gmean(factors, weights=scored):.1f}" if scored.any() else "–"
        numbers = total.agree, total.better, total.worse, total.near, factor
        lines.append([str(paper), *map(str, numbers)])
    head = "Errors", "agree", "better", "worse", "within 25 %", "typical factor"
    figures = (_figures(name, each["figures"]) for name, each in summary.items())
    return "\n\n".join((markdown_table(head, lines, 1), *figures))


def _figures(name: str, captions: Mapping[str, str]) -> str:
    """The figures of a paper, which show their captions, in one paragraph."""
    figures = (
        f"![{caption}](images/papers/{file_name(name, title)})"
        for title, caption in captions.items()
    )
    return "\n".join((f"### {name.title()}: figures\n", *figures))


def _made(module: str, function: str, *arguments: str) -> str:
    """A text by a function of a module of this package."""
    return getattr(import_module(f"studies.{module}"), function)(*arguments)


BLOCKS: dict[str, tuple[Path, str, Callable[[], str]]] = {
    mark.partition(": ")[2]: (
        ROOT / page,
        mark,
        partial(_made, *function.split("."), *filter(None, arguments.split(";"))),
    )
    for page, mark, function, arguments in pd.read_csv(
        ROOT / "docs/tables.csv", keep_default_na=False
    ).itertuples(index=False)
}
"""Page and mark of each table and sentence, and the function that writes it."""


OPTIONS = {"names": "which; all if not given"}


def main(names: tuple[str, ...] = (), /) -> None:
    """Write tables of docs/ anew: dives, flights, faults and others are flown, in an hour.

    Tables of studies are taken from results/ablation, where `make ablation` leaves them, and from
    results/suites, quick, latency, tuned, tuned_each and likelihood, where `vessel-gym ablate` with
    each name does.
    """
    names = names or tuple(BLOCKS)
    for name in names:
        if name not in BLOCKS:
            raise Refusal(f"there is no table {name!r}: known are {', '.join(BLOCKS)}")
    with progress("tables") as show:
        for done, name in enumerate(names, 1):
            page, mark, made = BLOCKS[name]
            put(page, mark, made())
            show(done, len(names))


if __name__ == "__main__":
    command(main)
