"""The page of logs beside their simulation: its command on simulated logs, its tables on results that are known."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.commands.console import command
from studies.logs import __main__ as findings
from studies.logs import results, tables
from studies.logs.accuracy import accuracy
from tests.vessel_gym.identification.voyages import STEP, coefficients, trial


def pair(measured: float, simulated: float) -> dict[str, Any]:
    """Consistency of a filter on a run of 100 steps, where a sensor without a heading is foretold in 7 of 10 cases."""
    sensors = {"position": 0.95, "heading": 0.7, "yaw rate": 0.99}
    found: dict[str, Any] = {
        place: {"inside": share, "ratio": 1.0, "lag": 0.1}
        for place, share in (("measured", measured), ("simulated", simulated))
    }
    found["measured"] |= {"withheld": sensors, "deviations": {"position": 2.0, "heading": 0.05, "yaw rate": 0.001}}
    return {"steps": 100} | found


FILTERS = {
    "same": [{"run": f"turn_{k}", **pair(0.94 + 0.01 * (k % 2), 0.95 - 0.01 * (k % 2))} for k in range(8)],
    "worse": [{"run": f"turn_{k}", **pair(0.704 + 0.01 * k, 0.95)} for k in range(8)],
    "lost": [{"run": f"turn_{k}", "error": "the estimates are lost"} for k in range(8)],
}
TRACK = {
    "identified model": [0.1, 0.2, 0.4], "without wind": [0.2, 0.3, None], "Nomoto, order 1": [1.0, 2.0, 3.0],
    "Nomoto, order 2": [1.0, None, None], "goes on as it goes": [1.0, 4.0, 9.0],
}  # fmt: skip
ERRORS = ("steady yaw rate", "steady surge", "yaw rate", "circle", "heading", "position")
ACCURACY = {
    name: dict(zip(ERRORS, (k * 1.0, k * 5.0, k * 0.05, None, k * 4.0, k * 0.3), strict=True))
    for k, name in enumerate(TRACK, 1)
}
RUNS: list[dict[str, Any]] = [
    {"name": "turn_01-Jan-2020_00_00_00", "advance": [4.0, 5.0], "tactical diameter": [5.0, 5.5],
     "speed loss": [50.0, 48.0], "overshoots": [[], []], "periods": [[], []], "track error": TRACK},
    {"name": "zigzag_01-Jan-2020_00_00_00", "advance": [None, None], "tactical diameter": [None, None],
     "speed loss": [None, None], "overshoots": [[5.0, 0.5, 6.0, 7.0], [6.0, 9.0, None, 4.0]],
     "periods": [[40.0, 50.0], [44.0, 55.0]], "track error": TRACK},
    *({"name": f"{kind}_01-Jan-2020_00_00_00", "track error": TRACK} for kind in ("random", "berthing")),
]  # fmt: skip
for each in RUNS:
    each["accuracy"] = ACCURACY

SENSORS = [{"surge's lag": each, "gyro's scale": scale} for each, scale in (
    ([0.4, 0.1], [0.01, 0.02]), ([0.8, 0.1], [0.02, 0.01]), (None, None),
)]  # fmt: skip


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "stored", lambda: {"runs": RUNS, "filters": FILTERS, "sensors": SENSORS})


@pytest.mark.usefixtures("known")
def test_filters_that_are_as_consistent_at_sea_are_told_from_others() -> None:
    words = " ".join(tables.consistency().split())
    assert words == (
        "As consistent at sea as in simulation, within the interval, is `same`. `worse` has 21 percentage points "
        "less NIS inside the interval at sea than in simulation. Estimates are lost by `lost` on 8 of 8 runs."
    )
    rows = {row.split(" | ")[0].strip("| "): row for row in tables.filters().splitlines()}
    assert "| 74 % | 95 % | -21.1 ± 2.0 | 8 / 8 of 8 |" in rows["`worse`"]
    assert "the estimates are lost" in rows["`lost`"]


@pytest.mark.usefixtures("known")
def test_manoeuvres_are_compared_where_both_ships_show_them() -> None:
    """A simulated overshoot that is missing pairs with nothing, and one below a degree is not judged."""
    words = " ".join(tables.gap().split())
    assert "Advance differs by 25 (at most 25) %, tactical diameter by 10 (at most 10) %" in words
    assert "Of 2 overshoots above 1 degree 50 % differ by less than 2 degrees, and all by less than 3.0." in words
    assert "Periods differ by 10 (at most 10) %." in words
    (row,) = tables.zigzags().splitlines()[2:]
    assert row == "| 01-Jan-2020, 00:00:00 | 3 | 4.2 / 6.3 | 8.5 | 45.0 / 49.5 | 0.40 |"
    assert tables.tracks().splitlines()[2] == "| turns (1) | 0.20; 0.20 | 0.40; 0.40 | 0.30 | – | 4.00 |"


@pytest.mark.usefixtures("known")
def test_errors_stand_beside_their_targets() -> None:
    """What no run shows is neither met nor missed."""
    rows = dict(row.strip("| ").split(" | ", 1) for row in tables.TABLES["logs, accuracy"]().splitlines())
    assert rows["steady surge [%]"] == "5.0; 5.0 | 4; 10 | 10.0 | 20.0 | 25.0"
    assert rows["position after one circle [L]"] == "–; – | 0.5; 1 | – | – | –"
    assert rows["heading after 60 s [°]"] == "4.0; 4.0 | 9; – | 8.0 | 16.0 | 20.0"
    good, bad = " ".join(tables.targets().split()).split(" Targets that are not met: ")
    assert "steady yaw rate (median); steady yaw rate (largest); steady surge (largest)" in good
    assert bad.startswith("steady surge (median); overshoots. ")


def test_runs_with_the_largest_errors_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seven rows have an error; the zig-zag alone shows its own, and is worst after 60 s."""
    worse = {name: each | {"heading": 30.0, "position": 2.0} for name, each in ACCURACY.items()}
    runs = [run | {"accuracy": worse if run["name"].startswith("zigzag") else ACCURACY} for run in RUNS]
    monkeypatch.setattr(tables, "stored", lambda: {"runs": runs})
    turn, zigzag, random = (f"`{kind}_01-Jan-2020_00_00_00`" for kind in ("turn", "zigzag", "random"))
    words = " ".join(tables.largest_errors().split())
    assert words == f"Of the 7 largest errors 3 are of {turn}, 3 are of {zigzag} and 1 is of {random}."


@pytest.mark.usefixtures("known")
def test_filters_are_judged_by_sensors_that_they_do_not_get() -> None:
    rows = dict(row.strip("| ").split(" | ", 1) for row in tables.withheld().splitlines())
    assert rows["`same`"] == "95 % of ± 4 m | 70 % of ± 5.7 ° | 99 % of ± 0.11 °/s | 0; 8; 0 of 8"
    assert "`lost`" not in rows
    words = " ".join(tables.trusted().split())
    assert "The target of NIS inside, 85 to 98 %, is met by all filters but `worse` (73.9 to 94.5 %)." in words
    assert "The target of the withheld heading, 92 to 98 %, is met by no filter (70.0 to 70.0 %)." in words
    assert "The target of the withheld position, 92 to 98 %, is met by all filters (95.0 to 95.0 %)." in words


@pytest.mark.usefixtures("known")
def test_runs_that_no_filter_foretells_are_named() -> None:
    words = " ".join(tables.lowest().split())
    assert words.startswith("In `turn_0`, `turn_1`")
    assert words.endswith("every filter covers less than 75 % of the withheld heading.")
    assert "position" not in words


def test_deviations_of_ensembles_stand_beside_those_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    wide = pair(0.9, 0.9)
    wide["measured"] |= {"deviations": {"position": 3.0, "heading": 0.05, "yaw rate": 0.002}}
    found = {"ekf": [{"run": "a", **pair(0.9, 0.9)}], "etkf": [{"run": "a", **wide}]}
    monkeypatch.setattr(tables, "stored", lambda: {"filters": found})
    words = " ".join(tables.widths().split())
    assert "a withheld position is 0.7 to 1.0 ship lengths" in words
    assert "are 1.50 (position), 1.00 (heading) and 2.00 (yaw rate) times those of other filters." in words


def test_a_run_whose_propeller_never_turns_is_judged_whole() -> None:
    rng = np.random.default_rng(2)
    voyage = trial(rng, coefficients(rng, 0.2), 100.0)
    adrift = replace(voyage, name="zigzag", control=voyage.control * (1.0, 0.0))
    states = adrift.states[:, None]
    found = accuracy(lambda state, *_: np.broadcast_to(states, (len(states), len(state), 6)), adrift, adrift, 3.0)
    assert found["yaw rate"] == 0.0


def test_a_model_that_is_the_ship_has_no_error() -> None:
    """But for the noise of its first state and measurements; a turn of 3 degrees a second closes its circle."""
    rng = np.random.default_rng(1)
    voyage = trial(rng, coefficients(rng, 0.2), 400.0, noise=0.0)
    states = voyage.states.copy()
    time = STEP * np.arange(len(states))
    states[:, 2], states[:, 5] = np.deg2rad(3.0) * time, np.deg2rad(3.0)
    turn = replace(voyage, name="turn", states=states)
    found = accuracy(lambda state, *_: np.broadcast_to(states[:, None], (len(states), len(state), 6)), turn, turn, 3.0)
    assert all(found[name] == 0.0 for name in ("yaw rate", "steady yaw rate", "steady surge", "circle"))
    faster = states * (1.0, 1.0, 1.0, 1.1, 1.0, 1.2)
    found = accuracy(lambda state, *_: np.broadcast_to(faster[:, None], (len(states), len(state), 6)), turn, turn, 3.0)
    np.testing.assert_allclose([found[name] for name in ERRORS[:3]], [20.0, 10.0, 0.2], rtol=1e-9)


@pytest.mark.usefixtures("known")
def test_errors_of_sensors_are_weighted_by_their_intervals() -> None:
    words = " ".join(tables.sensors().split())
    assert "by 0.60 ± 0.07 s in all logs together; in 2 of 2 logs the interval excludes zero" in words
    assert "turns 1.8 ± 0.9 % faster than the gyro says, and in 1 of 2 logs the interval" in words


def test_what_is_stored_makes_the_page() -> None:
    """So that tables and results do not come from different computations."""
    tables.stored.cache_clear()
    page = tables.PAGE.read_text(encoding="utf-8")
    assert all(made() in page for made in (*tables.TABLES.values(), *tables.TEXTS.values()))


@pytest.mark.slow
def test_the_command_writes_results_and_page_from_logs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    c = coefficients(rng, 0.2)
    headers = [table["column"] for table in results.COLUMNS.chosen.values()]
    for name in ("turn_a", "zigzag_b", "random_c", "berthing_d"):
        voyage = trial(rng, c, 150.0)
        x, y, psi, u, v, r = voyage.states[: len(voyage)].T
        wind = np.hypot(*voyage.air[:, :2].T), np.arctan2(voyage.air[:, 1], voyage.air[:, 0])
        rudder, revolutions = voyage.control.T
        table = np.stack([STEP * np.arange(len(voyage)), x, y, u, v, psi, r, revolutions, rudder, *wind], -1)
        np.savetxt(tmp_path / f"{name}.csv", table, "%.8g", ",", header=",".join(map(str, headers)), comments="")
    page, stored = tmp_path / "page.md", tmp_path / "summary.json"
    page.write_text(tables.PAGE.read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.setattr(results, "FOLDS", 2)
    monkeypatch.setattr(tables, "PAGE", page)
    monkeypatch.setattr(tables, "STORED", stored)
    command(findings.main, [str(tmp_path), "--filters", "ekf"])
    tables.stored.cache_clear()
    found = json.loads(stored.read_text(encoding="utf-8"))
    assert {run["name"] for run in found["runs"]} == {"turn_a", "zigzag_b", "random_c", "berthing_d"}
    assert [len(each) for each in found["filters"].values()] == [4]
    assert all(0.0 < run["simulated"]["inside"] <= 1.0 for run in found["filters"]["ekf"])
    errors = [run["track error"]["identified model"][0] for run in found["runs"]]
    assert max(errors) < 1.0
    assert "| turns (1) |" in page.read_text(encoding="utf-8")


def test_a_folder_of_too_few_logs_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command(findings.main, [str(tmp_path)])
    assert "has 0 CSV files; 4 or more are needed" in capsys.readouterr().err
