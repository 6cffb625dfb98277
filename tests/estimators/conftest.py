"""Writes docs/estimators/laws.csv, the laws and the filters that obey them."""

import csv
import inspect
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

TABLE = Path(__file__).parents[2] / "docs" / "estimators" / "laws.csv"

_passed: dict[tuple[str, str], bool] = {}


@pytest.fixture(autouse=True)
def _law_and_case(request: pytest.FixtureRequest, record_property) -> None:
    """Tell the table which law and which case a test is about."""
    callspec = getattr(request.node, "callspec", None)
    if callspec is not None and "case" in callspec.params and request.node.path.stem == "test_laws":
        record_property("law", request.node.originalname)
        record_property("case", callspec.params["case"].id)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    properties = dict(report.user_properties)
    if report.when == "call" and "law" in properties:
        key = properties["law"], properties["case"]
        _passed[key] = _passed.get(key, True) and report.passed


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the table after a run in which every law was tried on every case that it applies to."""
    if hasattr(session.config, "workerinput") or not _passed:
        return
    from tests.estimators import test_laws
    from tests.estimators.cases import CASES

    laws = {
        name: function.laws
        for name, function in inspect.getmembers(test_laws, inspect.isfunction)
        if hasattr(function, "laws")
    }
    expected = {
        (law, case.id) for law, tags in laws.items() for case in CASES if case.laws.issuperset(tags)
    }
    if not expected <= _passed.keys():
        return
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(_rows(laws, CASES))


def _rows(laws: dict[str, tuple[str, ...]], cases: tuple) -> Iterator[tuple[str, str]]:
    """Each law and the filters that were tried on it, the most first."""
    names = tuple(dict.fromkeys(case.name for case in cases))
    groups: dict[tuple[str, ...], list[str]] = {}
    for law, tags in sorted(laws.items()):
        tried = [case for case in cases if case.laws.issuperset(tags)]
        failed = dict.fromkeys(case.name for case in tried if not _passed[law, case.id])
        line = law.removeprefix("test_").replace("_", " ")
        group = tuple(name for name in names if name in {case.name for case in tried})
        groups.setdefault(group, []).append(line + (f": **not** {_listed(failed)}" * bool(failed)))
    yield "property", "filters"
    for group in sorted(groups, key=len, reverse=True):
        filters = "every filter" if group == names else _listed(group)
        yield from ((line, filters) for line in groups[group])


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)
