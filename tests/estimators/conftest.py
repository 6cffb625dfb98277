"""Writes docs/estimators/laws.md, the table of filters and the laws that they obey."""

import inspect
from collections.abc import Iterable
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "estimators" / "laws.md"
INTRODUCTION = """# Laws and filters

This page lists the laws (tested properties) of each filter, for readers who ask how filters are
tested. The tests (`tests/estimators`) write the page: they try every law with several sets of
options and random systems. Each list holds for the filters above it. A filter missing from a
list differs by design, or has other or shorter tests. `huber-kf` and `robust-kf` obey the third
list, and the last law of the second, only with `gamma=np.inf` and `radius=0`. `enkf-sr` is another
name of `etkf`.
"""

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
    """Write the page after a run in which every law was tried on every case that it applies to."""
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
    PAGE.parent.mkdir(parents=True, exist_ok=True)
    PAGE.write_text(_page(laws, CASES), encoding="utf-8")


def _page(laws: dict[str, tuple[str, ...]], cases: tuple) -> str:
    names = tuple(dict.fromkeys(case.name for case in cases))
    groups: dict[tuple[str, ...], list[str]] = {}
    for law, tags in sorted(laws.items()):
        tried = [case for case in cases if case.laws.issuperset(tags)]
        failed = dict.fromkeys(case.name for case in tried if not _passed[law, case.id])
        line = f"- {law.removeprefix('test_').replace('_', ' ')}"
        group = tuple(name for name in names if name in {case.name for case in tried})
        groups.setdefault(group, []).append(line + (f": **not** {_listed(failed)}" * bool(failed)))
    parts = [INTRODUCTION]
    for group in sorted(groups, key=len, reverse=True):
        parts += [("Every filter" if group == names else _listed(group)) + ":", ""]
        parts += [*groups[group], ""]
    return "\n".join(parts)


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)
