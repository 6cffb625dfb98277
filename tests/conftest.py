"""How many examples and cases are tried, and how code is compiled.

Hypothesis draws the same examples every time; ``--hypothesis-profile thorough`` draws ten thousand.
Of a test's cases ``make test`` runs so many that every value of every parameter occurs, of a slow
test's one, elsewhere for every test. Environments and their estimators take turns: one case does,
if other parameters have no more values. ``make quick`` runs one of each test that is not slow,
``make nightly`` all, and optimises what it compiles.
"""

import gc
import os
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any
from zlib import crc32

import pytest
from hypothesis import settings

settings.register_profile("default", derandomize=True, deadline=None, max_examples=50)
settings.register_profile("thorough", settings.get_profile("default"), max_examples=10_000)
settings.load_profile("default")

gc.set_threshold(200_000)  # tracing makes many objects and little garbage
IN_TURNS = {"env_id", "estimator"}
os.environ.setdefault(
    "VESSEL_GYM_OPTIMISE", "0"
)  # of other processes, too: compiling took half of the time


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    cases = defaultdict(list)
    for item in items:
        if not item.get_closest_marker("nightly") and hasattr(item, "callspec"):
            cases[item.nodeid.partition("[")[0]].append(item)
    for test, group in cases.items():
        if group[0].get_closest_marker("slow"):
            kept = {crc32(test.encode()) % len(group)}
        else:
            kept = covering(
                [item.callspec.params for item in group], [item.nodeid for item in group]
            )
        for i, item in enumerate(group):
            if i != min(kept):
                item.add_marker("further" if i in kept else "nightly")
    gc.freeze()  # imported modules and tests live to the end


def pytest_sessionfinish() -> None:
    """Leave memory to the system: to free it takes seconds."""
    gc.freeze()


def covering(cases: Sequence[Mapping[str, Any]], names: Sequence[str]) -> set[int]:
    """Indices of few cases that hold every value of every parameter, but for those in turns.

    The next case has the most new values; of several, the one whose name comes first in a random
    order.
    """
    kept, seen = set(), set()
    values = []
    for case in cases:
        plain = {name: isinstance(value, str | float | int | None) for name, value in case.items()}
        values.append({(name, type(x), x if plain[name] else id(x)) for name, x in case.items()})
    left = sorted(range(len(cases)), key=lambda i: crc32(names[i].encode()))
    while left := [i for i in left if not values[i] <= seen]:
        best = max(left, key=lambda i: len(values[i] - seen))
        kept.add(best)
        seen |= values[best]
        if "env_id" in cases[best]:
            seen |= {each for case in values for each in case if each[0] in IN_TURNS}
    return kept


@pytest.fixture(autouse=True, scope="module")
def _forget(request: pytest.FixtureRequest) -> Iterator[None]:
    """Let go of what a module's tests have shared, such as flights of a hundred megabytes each."""
    yield
    for shared in vars(request.module).values():
        if hasattr(shared, "cache_clear") and shared.__module__ == request.module.__name__:
            shared.cache_clear()
