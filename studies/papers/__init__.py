"""The experiments of the source papers, reproduced with this package.

A folder a paper: ``settings.toml`` (what the paper prints, what it leaves open), ``experiment.py``
(what is computed), ``page.py`` (its tables) and ``page.md`` (the explanation, with a line ``<!--
table: NAME -->`` for each table). ``python -m scripts.reproduce all`` runs them.
"""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.jobs import Job
from estimators.factory import unknown

if TYPE_CHECKING:  # experiments run without what makes pages
    from studies.papers.measures import Report

PAPERS = ("corvette", "segorogeni", "itsunusa", "robust", "puna")
"""The papers, each a folder of this package."""


@cache
def settings(name: str) -> dict[str, Any]:
    """The settings file of a paper.

    Raises:
        ValueError: if there is no such paper.
    """
    if name not in PAPERS:
        raise ValueError(unknown("paper", name, ("all", *PAPERS)))
    return tomllib.loads(read(name, "settings.toml"))


def read(name: str, file: str) -> str:
    """The text of a file in the folder of a paper."""
    return (Path(__file__).parent / name / file).read_text(encoding="utf-8")


def opening(name: str) -> str:
    """The paragraph of the explanation that says what holds, below title and source."""
    return " ".join(read(name, "page.md").split("\n\n")[2].split())


def jobs(name: str) -> dict[str, Job]:
    """Everything to compute for a paper, by name."""
    values = settings(name)
    return import_module(f"studies.papers.{name}.experiment").jobs(values)


def report(name: str, results: Mapping[str, Mapping[str, Any]]) -> "Report":
    """Tables and measures of a paper, from the values of every one of its jobs."""
    values = settings(name)
    return import_module(f"studies.papers.{name}.page").report(values, results)
