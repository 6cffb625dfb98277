"""The experiments of the source papers, reproduced with this package.

A folder a paper: ``settings.toml`` (what the paper prints, what it leaves open), ``experiment.py``
(what is computed, and its tables) and ``page.md`` (the explanation, with a line ``<!-- table: NAME
-->`` for each table). ``vessel-gym reproduce all`` runs them.
"""

import tomllib
from pathlib import Path
from typing import Any

from agents.jobs import Job

PAPERS = ("corvette", "segorogeni", "itsunusa", "robust", "puna")
"""The papers, each a folder of this package."""


def settings(name: str) -> dict[str, Any]:
    """The settings file of a paper."""
    return tomllib.loads(read(name, "settings.toml"))


def read(name: str, file: str) -> str:
    """The text of a file in the folder of a paper."""
    return (Path(__file__).parent / name / file).read_text(encoding="utf-8")


def job(name: str) -> Job:
    """The report of a paper as a job: see `agents.papers.measures`."""
    return Job(f"agents.papers.{name}.experiment:report", {"settings": settings(name)})
