"""Writes docs/estimators/laws.md, the table of filters and the laws that they obey."""

import inspect
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "estimators" / "laws.md"
WHY_NOT = {
    "kalman": "by design it differs from a Kalman filter, whatever its options",
    "unknown-input": (
        "the law is about filters that estimate an unknown input, and this one does not"
    ),
    "consistent": "it is tested for consistency separately, because it makes a different claim",
    "linear": "it is tested here on a nonlinear system",
    "deterministic": "it draws members at random; the law is stated for them and tested separately",
    "ensemble": "it has no members",
    "square-root": "it does not update its members by a square root",
    "long": (
        "it is tested over fewer steps; ten thousand are run for one filter of each family only"
    ),
}
"""Why a law says nothing about a filter, by the property that the law is about."""
INTRODUCTION = """# Laws and filters

This page lists which filter obeys which law, for readers who want to know how the filters are
tested. The test run (`tests/estimators`) writes it: it tries every law of the common suite on every
filter, with several sets of options and random systems. A *yes* means that the law held in all of
them, a **no** that it failed in one. With a letter the law does not apply to this filter, for the
reason below the table.

Every filter that `make` knows by name is in the table. `enkf-sr` is another name of `etkf`. Laws of
a single filter are tested separately, as is consistency where a filter makes a different claim.
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
    filters = list(dict.fromkeys(case.name for case in cases))
    letters = {tag: chr(ord("a") + i) for i, tag in enumerate(WHY_NOT)}
    rows, used = [], set()
    for law in sorted(laws, key=lambda law: (len(laws[law]), law)):
        cells = []
        for name in filters:
            mine = [case for case in cases if case.name == name]
            tried = [_passed[law, case.id] for case in mine if case.laws.issuperset(laws[law])]
            if tried:
                cells.append("yes" if all(tried) else "**no**")
                continue
            missing = next(tag for tag in WHY_NOT if tag in laws[law] and tag not in mine[0].laws)
            used.add(missing)
            cells.append(letters[missing])
        rows.append(
            f"| {law.removeprefix('test_').replace('_', ' ')} | " + " | ".join(cells) + " |"
        )
    lines = [
        INTRODUCTION,
        "| law | " + " | ".join(filters) + " |",
        "|---|" + "---|" * len(filters),
        *rows,
        "",
        *(f"- **{letters[tag]}**: {WHY_NOT[tag]}." for tag in WHY_NOT if tag in used),
        "",
    ]
    return "\n".join(lines)
