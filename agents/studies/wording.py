"""Numbers, names and notes as a report writes them."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeVar

from agents import page
from agents.metrics import Metric
from agents.page import Block, Entry, Table, entry, many, number, words
from agents.statistics import Interval
from agents.studies.records import FEW_SEEDS, FLOOR, ORACLE
from agents.studies.results import Results

K = TypeVar("K")
V = TypeVar("V")


def paragraphs(name: str, results: Results, **values: Any) -> list[str]:
    """The paragraphs of a note in ``templates/study-notes.md`` about results of a study, with these values."""
    study = results.plan.study
    values |= {
        "study": study,
        "who": results.who,
        "first": results.conditions[0],
        "meanings": meanings,
        "many": many,
    }
    values |= {
        "oracle": ORACLE,
        "floor": FLOOR,
        "few": FEW_SEEDS,
        "runs": many(study.training_seeds, "training run"),
    }
    return page.paragraphs(
        "study-notes.md", name, conditions=many(len(study.conditions), "condition"), **values
    )


def note(name: str, results: Results, **values: Any) -> str:
    """A note of one paragraph, as `paragraphs`."""
    (text,) = paragraphs(name, results, **values)
    return text


def amount(value: Interval | float | None, signed: bool = False) -> str:
    """A share or score with its interval in a sentence, with a digit more where the interval is small."""
    if value is None:
        return "–"
    if not isinstance(value, Interval):
        return number(value, 2, signed)
    return words(value, 2 if value.half >= 0.095 else 3, signed)


def share_entry(value: Interval | float | None, signed: bool = False) -> Entry:
    """A share, or a difference of shares, in a table; a number alone has no interval."""
    return Entry(number(value, 3, signed)) if isinstance(value, float) else entry(value, 3, signed)


def percent(value: Interval | float | None) -> Entry:
    """A share [%] in a table."""
    return Entry(number(value, 1)) if isinstance(value, float) else entry(value, 1)


def microseconds(value: float | None) -> str:
    """CPU time [µs] to three digits."""
    return "–" if value is None else number(value, 0 if value >= 100.0 else 1)


def grouped(pairs: Iterable[tuple[K, V]]) -> dict[K, list[V]]:
    """The second of pairs by the first, both in their order."""
    found: dict[K, list[V]] = {}
    for key, value in pairs:
        found.setdefault(key, []).append(value)
    return found


def named(name: str) -> str:
    """A name, in quotation marks if it holds a comma."""
    return f"“{name}”" if "," in name else name


def every(environments: Sequence[str]) -> str:
    """All environments, by their number."""
    return (
        "both environments" if len(environments) == 2 else f"all {len(environments)} environments"
    )


def meanings(chosen: Sequence[Metric]) -> str:
    """Meanings of metrics, a sentence each."""
    return " ".join(f"{m.label}: {m.meaning}" for m in chosen)


def file_name(table: str, environment: str) -> str:
    """Name of the file of an environment's table."""
    return f"{table}-{environment}".lower().replace(":", "-")


Rows = Sequence[tuple[str, list[Entry]]]
"""Rows of a table: a name and its entries each."""


def tabled(
    name: str,
    results: Results,
    heads: Sequence[str | tuple[str, str]],
    sections: Mapping[str, Rows],
    first: str = "Estimator",
    file: str = "",
    **values: Any,
) -> list[Block]:
    """The table of a note without rows and sections that have no value; no block if that leaves nothing."""
    title, text = paragraphs(name, results, **values)
    filled = {
        title: [row for row in rows if any(e.value != "–" for e in row[1])]
        for title, rows in sections.items()
    }
    filled = {title: rows for title, rows in filled.items() if rows}
    pairs = [(head, "") if isinstance(head, str) else head for head in heads]
    return [Table(title, text, first, pairs, list(filled.items()), file or name)] if filled else []
