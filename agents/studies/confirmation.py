"""The claims of a study, tested once on fresh evaluation seeds."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from math import comb
from pathlib import Path
from typing import Any

from agents.files import replacing
from agents.statistics import EQUIVALENT, UNDECIDED, Interval, paired_difference, verdict
from agents.studies import shares
from agents.studies.records import Study
from agents.studies.results import Results
from agents.studies.shares import Difference

CONFIRMED, OPEN, FAILED = "confirmed", "not confirmed", "contradicted"
"""Outcomes of a claim on fresh seeds: the same verdict, none, another one."""


@dataclass(frozen=True)
class Claim:
    """A difference as the first pass found it, and on the fresh seeds (None if not flown there), with both verdicts."""

    first: Difference
    fresh: Interval | float | None
    verdicts: tuple[str, str]

    @property
    def outcome(self) -> str:
        """One of the outcomes; empty where the first pass claimed nothing."""
        if self.verdicts[0] == UNDECIDED:
            return ""
        return CONFIRMED if self.verdicts[0] == self.verdicts[1] else OPEN if self.verdicts[1] == UNDECIDED else FAILED

    def __str__(self) -> str:
        word = "to" if self.verdicts[0] == EQUIVALENT else "than"
        return f"{self.first.one} {self.verdicts[0]} {word} {self.first.other} ({self.first.column})"


@dataclass(frozen=True)
class Confirmed:
    """The claims of a study on fresh seeds, their number, and the share kept there on the best of the first pass.

    The best is empty if none stands for all environments.
    """

    episodes: int
    best: str
    kept: Interval | float | None
    claims: list[Claim]


def confirmed(results: Results, fresh: Results) -> Confirmed:
    """Compare the differences of a study with those on fresh seeds."""
    margin = results.plan.study.margin
    columns = shares.columns(shares.ruled(results), bool(shares.common(results)))
    best = {column: next(iter(shares.rankable(results, where))) for column, where in columns.items()}
    again = {each[:3]: each.value for each in _differences(fresh, columns, best, chosen=True)}
    claims = []
    for first in _differences(results, columns, best, chosen=False):
        value = again.get(first[:3])
        claims.append(Claim(first, value, (verdict(first.value, margin), verdict(value, margin))))
    column = next(iter(columns)) if len(columns) == 1 or shares.ALL in columns else ""
    share = shares.kept(fresh, columns[column], fresh.classical, best[column]) if column else None
    return Confirmed(fresh.plan.study.episodes, best.get(column, ""), share, claims)


def _differences(
    results: Results, columns: Mapping[str, Sequence[str]], best: Mapping[str, str], chosen: bool
) -> Iterator[Difference]:
    """Every estimator against the best, and learned agents against the classical one and each other.

    Where the best was chosen on other seeds, the 95 % hold for all comparisons with it at once, else for all pairs.
    """
    for column, where in columns.items():
        ranked = shares.rankable(results, where)
        others = [name for name in ranked if name != best[column]]
        pairs = len(others) if chosen else comb(len(ranked), 2)
        for name in others if best[column] in ranked else ():
            found = paired_difference(ranked[name], ranked[best[column]], comparisons=pairs)
            yield Difference(column, name, best[column], found)
    yield from shares.learned_differences(results)


def open_seeds(study: Study, out: Path) -> None:
    """Record in a results folder that the fresh seeds of a study are opened.

    Raises:
        ValueError: if they, or others, were opened there for another version of the study.
    """
    opened = opening(out)
    if opened and not is_open(study, out):
        raise ValueError(
            f"the fresh seeds of {out} were opened on {opened['opened']} for another version of this study: they are "
            "opened once, so take another folder, and a first_seed in confirm that nobody has opened"
        )
    if not opened:
        record = {"opened": f"{datetime.now(UTC):%Y-%m-%d}", "study": study.resolved()}
        with replacing(out / "confirmation.json") as temporary:
            temporary.write_text(json.dumps(record, indent=1), encoding="utf-8")


def is_open(study: Study, out: Path) -> bool:
    """Return whether the fresh seeds were opened in a folder, for this very study but for its title."""
    opened = opening(out)
    return bool(opened) and opened["study"] | {"title": ""} == json.loads(json.dumps(study.resolved() | {"title": ""}))


def opening(out: Path) -> dict[str, Any]:
    """The record of the fresh seeds that were opened in a folder; empty if none were.

    Raises:
        ValueError: if it is damaged.
    """
    path = out / "confirmation.json"
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        return {"opened": str(record["opened"]), "study": dict(record["study"])}
    except FileNotFoundError:
        return {}
    except (ValueError, KeyError, TypeError):
        raise ValueError(f"{path} is damaged, so which seeds were opened is not known: take another folder") from None
