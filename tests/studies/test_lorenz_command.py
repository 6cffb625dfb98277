"""The command that holds the ensemble filters against published scores."""

import dataclasses

import numpy as np
import pytest

import studies.lorenz.benchmarks
from studies.lorenz import __main__ as lorenz
from studies.lorenz.benchmarks import BENCHMARKS


@pytest.fixture
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "250")


@pytest.mark.usefixtures("wide")
def test_the_table_has_every_published_score_beside_ours(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(
        studies.lorenz.benchmarks, "analysis_rmse", lambda row, *_: row.published * np.array([0.9, 1.1])
    )
    lorenz.main(runs=2, cycles=1)
    printed = capsys.readouterr().out
    rows = [line for line in printed.splitlines() if " ± " in line]
    assert len(rows) == len(BENCHMARKS)
    for line, row in zip(rows, BENCHMARKS, strict=True):
        assert all(name in line for name in row.filters)
        assert f"{row.published:.3f} ± " in line
        assert row.described in line
        assert row.source in printed
        assert ("reported" in line) == row.reported_only


@pytest.mark.usefixtures("wide")
@pytest.mark.parametrize(("excess", "verdict"), [(1.04, "yes"), (1.06, "no")])
def test_a_score_is_within_if_the_lower_end_is_at_most_five_percent_above(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], excess: float, verdict: str
):
    row = dataclasses.replace(BENCHMARKS[0], reported_only=False)
    monkeypatch.setattr(studies.lorenz.benchmarks, "BENCHMARKS", (row,))
    monkeypatch.setattr(studies.lorenz.benchmarks, "analysis_rmse", lambda row, *_: np.full(3, excess * row.published))
    lorenz.main(runs=3, cycles=1)
    (line,) = (line for line in capsys.readouterr().out.splitlines() if " ± " in line)
    assert line.split()[-1] == verdict


@pytest.mark.parametrize(("arguments", "name"), [({"runs": 1}, "runs"), ({"cycles": 0}, "cycles")])
def test_runs_and_cycles_too_few_for_a_score_are_named(arguments: dict[str, int], name: str):
    with pytest.raises(ValueError, match=rf"^{name} must be at least"):
        lorenz.main(**{"cycles": 1, **arguments})
