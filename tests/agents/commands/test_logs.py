"""The commands for measured logs, from the docs page, on a small log that is simulated here."""

import io
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pages import blocks

from agents.commands import console, estimate, identify
from agents.commands import main as vessel_gym_command
from tests.agents.short_training import STEPS as TRAINED
from tests.agents.short_training import TINY
from tests.vessel_gym.identification.voyages import SHIP, STEP, coefficients, trial, write
from vessel_gym.identification.trial import Trial
from vessel_gym.logs.read import tangent_plane
from vessel_gym.vehicles.measured_ship import MeasuredShip, read


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Particulars, three logs, one that is too short for filters, and one of a propeller that never turns."""
    path, rng = tmp_path_factory.mktemp("logs"), np.random.default_rng(0)
    MeasuredShip.assumed(SHIP).write(path / "all.toml")
    (path / "particulars.toml").write_text((path / "all.toml").read_text().partition("[coefficients]")[0])
    c = coefficients(rng)
    for name in ("a", "b", "c"):
        write(path / f"{name}.csv", trial(rng, c, 300.0))
    write(path / "short.csv", trial(rng, c, 30.0))
    afloat = trial(rng, c, 300.0)
    write(path / "adrift.csv", replace(afloat, control=afloat.control * (1.0, 0.0)))
    return path


def call(main, capsys: pytest.CaptureFixture[str], *arguments: object) -> str:  # type: ignore[no-untyped-def]
    """Output of a command line."""
    console.command(main, [str(each) for each in arguments])
    return capsys.readouterr().out


def test_from_logs_to_estimates(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ship, table = folder / "ship.toml", folder / "estimates.csv"
    out = call(
        identify.main, capsys, folder / "a.csv", folder / "b.csv", "--vessel", folder / "particulars.toml",
        "--out", ship, "--check", folder / "c.csv",
    )  # fmt: skip
    assert "Coefficients that the logs determine" in out
    assert "logs that were not used" in out
    assert read(ship).logs == ("a.csv", "b.csv")
    out = call(estimate.main, capsys, folder / "c.csv", "--vessel", ship, "--estimators", "ekf", "ukf", "--out", table)
    assert "Consistency of filters" in out
    numbers = np.genfromtxt(table, delimiter=",", names=True)
    assert len(numbers) > 100
    assert np.isfinite(numbers["heading"]).all()


def test_a_log_too_short_for_filters_is_left_out_of_their_noise(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ship = folder / "two.toml"
    arguments = (folder / "a.csv", folder / "short.csv", "--vessel", folder / "particulars.toml", "--out", ship)
    console.command(identify.main, [str(each) for each in arguments])
    error = capsys.readouterr().err
    assert "short.csv: no part of" in error
    assert "this log says nothing of the noise of filters" in error
    assert read(ship).logs == ("a.csv", "short.csv")
    assert np.isfinite(list(read(ship).noise.values())).all()


@pytest.mark.parametrize(
    ("main", "arguments", "sentence"),
    [
        (identify.main, ("none.csv", "--vessel", "particulars.toml"), "none.csv"),
        (identify.main, ("a.csv", "--vessel", "a.csv"), "not TOML"),
        (estimate.main, ("a.csv", "--vessel", "particulars.toml"), "has no 'position'"),
        (estimate.main, ("a.csv", "--vessel", "all.toml", "--estimators", "efk"), "did you mean 'ekf'"),
        (estimate.main, ("-", "--vessel", "all.toml", "--page", "a.html"), "--page needs a log that ends"),
        (estimate.main, ("-", "--vessel", "all.toml", "--seed", "1"), "--seed needs a log that ends"),
        (identify.main, ("adrift.csv", "--vessel", "particulars.toml", "--out", "adrift.toml"), "never turns"),
        (identify.main, ("short.csv", "--vessel", "particulars.toml", "--out", "short.toml"), "is without gaps"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_sentence(
    main, arguments, sentence: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.chdir(folder)
    with pytest.raises(SystemExit) as stop:
        console.command(main, list(arguments))
    error = capsys.readouterr().err
    assert stop.value.code == 2
    assert sentence in error
    assert "Traceback" not in error


PLACE = (-7.0, 112.0)
"""Latitude and longitude [deg] at which the simulated ship begins."""


def write_as_the_page_s_map_says(path: Path, voyage: Trial) -> None:
    """A log whose columns, units and signs are those of the column map on the docs page."""
    count = len(voyage)
    north, east = tangent_plane(*PLACE)
    x, y, psi, _, _, r = voyage.states[:count].T
    columns = {
        "Time": 1e3 * STEP * np.arange(count),
        "GPS_Lat": PLACE[0] + x / north,
        "GPS_Lon": PLACE[1] + y / east,
        "HDG": np.rad2deg(psi) % 360.0,
        "ROT": 60.0 * np.rad2deg(r),
        "RUD": -np.rad2deg(voyage.control[:, 0]),
        "RPM [rpm]": 60.0 * voyage.control[:, 1],
        "TWS [kn]": np.hypot(*voyage.air[:, :2].T) * 3600.0 / 1852.0,
        "TWD [deg]": np.rad2deg(np.arctan2(voyage.air[:, 1], voyage.air[:, 0])) % 360.0,
    }
    table = np.stack(list(columns.values()), -1)
    np.savetxt(path, table, "%.10g", ",", header=",".join(columns), comments="")


def test_the_command_lines_of_the_docs_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """From logs with the names of its column map to a policy; what takes long is shortened."""
    pytest.importorskip("stable_baselines3")
    monkeypatch.chdir(tmp_path)
    columns, particulars = (
        next(each for each in blocks("logs", "toml") if word in each) for word in ("GPS_Lat", "measured ship")
    )
    Path("map.toml").write_text(columns, encoding="utf-8")
    Path("particulars.toml").write_text(particulars, encoding="utf-8")
    rng = np.random.default_rng(1)
    c = coefficients(rng, 0.2)
    for name in ("turn", "zigzag", "random", "voyage"):
        write_as_the_page_s_map_says(Path(f"{name}.csv"), trial(rng, c, 200.0))
    settings = [f"{key}={value}".replace(" ", "") for key, value in TINY.items()]
    shorter = {
        "estimate": ["--estimators", "ekf"],
        "evaluate": ["--episodes", "1"],
        "train": ["--steps", str(TRAINED), "--set", *settings],
    }
    run = []
    for line in "".join(blocks("logs", "bash")).splitlines():
        before, _, words = line.rpartition("| ")
        program, name, *arguments = shlex.split(words)
        assert program == "vessel-gym"
        if before:  # which would wait for more lines for ever
            assert before.startswith("tail -n +1 -f voyage.csv")
            monkeypatch.setattr(sys, "stdin", io.StringIO(Path("voyage.csv").read_text()))
        monkeypatch.setattr(sys, "argv", [program, name, *arguments, *shorter.get(name, ())])
        assert not vessel_gym_command()
        run.append(name)
        assert capsys.readouterr().out
    assert run == ["inspect", "identify", "estimate", "estimate", "evaluate", "train"]
    made = {path.name for path in tmp_path.iterdir()}
    assert made >= {"voyage.html", "ship.toml", "estimates.csv", "estimates.html"}
    assert Path("results/ppo.zip").is_file()
