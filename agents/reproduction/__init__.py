"""The experiments of the source papers, run with this package's own estimators and vehicles.

``settings`` holds what each paper prints, as data. Beside it stands one module a paper, which says what to compute
(``cells()``) and makes a page of the results (``page(results)``).
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any, Protocol, cast

from agents.cells import Cell
from agents.page import Page

PAPERS = ("corvette", "segorogeni", "itsunusa", "robust", "puna")
"""The papers, each a module of this package."""


class Paper(Protocol):
    """What a paper's module offers."""

    def cells(self) -> dict[str, Cell]:
        """Everything to compute, by name."""
        ...

    def page(self, results: Mapping[str, Mapping[str, Any]]) -> Page:
        """The page, from the values of every cell under the same names."""
        ...


def paper(name: str) -> Paper:
    """The module of a paper.

    Raises:
        ValueError: if there is no such paper.
    """
    if name not in PAPERS:
        raise ValueError(f"unknown paper {name!r}: choose from all, {', '.join(PAPERS)}")
    return cast(Paper, import_module(f"agents.reproduction.{name}"))
