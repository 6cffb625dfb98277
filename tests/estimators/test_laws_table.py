"""The table of laws in the documentation: each law, and the filters that it is tried on."""

import csv
from collections.abc import Iterable
from pathlib import Path

from tests.estimators import test_batches, test_laws
from tests.estimators.cases import CASES

TABLE = Path(__file__).parents[2] / "docs" / "estimators" / "laws.csv"


def listed(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def test_the_table_names_the_filters_that_each_law_is_tried_on():
    filters = {case.name: 0 for case in CASES}
    found = {}
    for name, test in (vars(test_laws) | vars(test_batches)).items():
        if hasattr(test, "laws"):
            tried = {case.name: 0 for case in CASES if case.laws.issuperset(test.laws)}
            law = name.removeprefix("test_").replace("_", " ")
            found[law] = "every filter" if tried == filters else listed(tried)
    with TABLE.open(encoding="utf-8", newline="") as file:
        _, *rows = csv.reader(file)
    assert dict(rows) == found
    assert len(rows) == len(found)
