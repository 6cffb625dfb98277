"""The experiments of the source papers, run with this package's own estimators and vehicles.

``settings`` holds what each paper prints, as data. Beside it stands one module a paper, which says what to compute, and
in ``pages`` another one, which makes a page of the results.
"""

from collections.abc import Mapping
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from agents.cells import Cell
from estimators.factory import unknown
from vessel_gym.extras import require

if TYPE_CHECKING:  # experiments need nothing that shows results
    from agents.page import Page

PAPERS = ("corvette", "segorogeni", "itsunusa", "robust", "puna")
"""The papers, each a module of this package and one of its pages."""


def cells(name: str) -> dict[str, Cell]:
    """Everything to compute for a paper, by name.

    Raises:
        ValueError: if there is no such paper.
    """
    return _module(__name__, name).cells()


def page(name: str, results: Mapping[str, Mapping[str, Any]]) -> "Page":
    """The page of a paper, from the values of every one of its cells under the same names.

    Raises:
        ValueError: if there is no such paper.
    """
    require("matplotlib")
    return _module(f"{__name__}.pages", name).page(results)


def _module(package: str, paper: str) -> ModuleType:
    if paper not in PAPERS:
        raise ValueError(unknown("paper", paper, ("all", *PAPERS)))
    return import_module(f"{package}.{paper}")
