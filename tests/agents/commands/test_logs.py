"""The commands for measured logs, from the docs page, on a small log that is simulated here."""

from pathlib import Path

import numpy as np
import pytest

from agents.commands import console, estimate, identify
from tests.vessel_gym.identification.voyages import SHIP, coefficients, trial, write
from vessel_gym.vehicles.measured_ship import MeasuredShip, read


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Particulars and three logs."""
    path, rng = tmp_path_factory.mktemp("logs"), np.random.default_rng(0)
    MeasuredShip.assumed(SHIP).write(path / "all.toml")
    (path / "particulars.toml").write_text((path / "all.toml").read_text().partition("[coefficients]")[0])
    c = coefficients(rng)
    for name in ("a", "b", "c"):
        write(path / f"{name}.csv", trial(rng, c, 300.0))
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


@pytest.mark.parametrize(
    ("main", "arguments", "sentence"),
    [
        (identify.main, ("none.csv", "--vessel", "particulars.toml"), "none.csv"),
        (identify.main, ("a.csv", "--vessel", "a.csv"), "not TOML"),
        (estimate.main, ("a.csv", "--vessel", "particulars.toml"), "has no 'position'"),
        (estimate.main, ("a.csv", "--vessel", "all.toml", "--estimators", "efk"), "did you mean 'ekf'"),
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
