"""Environments of others with an `EstimatedObservation`, registered by their user."""

import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from refusals import refused

from agents import episode, load_agent, rollout, save_agent
from agents.commands import main
from agents.jobs import run
from agents.metrics import consistency, scores
from agents.studies.plan import plan
from agents.studies.report import write_report
from agents.studies.results import Results
from agents.studies.study import StudyError, read_study
from agents.studies.worlds import registered_id
from estimators.angles import difference

NAME = "swinging:Swinging-v0"
STUDY = f"""
episodes = 3
[environments."{NAME}"]
[estimators.ekf]
[estimators.ukf]
[agents.brake]
kind = "swinging:Brake"
"""


def _command(monkeypatch: pytest.MonkeyPatch, line: str) -> int | None:
    monkeypatch.setattr(sys, "argv", ["vessel-gym", *line.split()])
    return main()


def test_metrics_are_those_of_info():
    """RMSE and NEES over the steps, from the truth, estimate and covariance of each step, and the return."""
    flown = rollout("swinging:Brake", registered_id(NAME), [0, 1])
    figures, h = scores(flown), flown.history
    error = difference(h["estimate"], h["truth"], (0,))
    nees = np.einsum("tni,tnij,tnj->tn", error, np.linalg.inv(h["covariance"]), error)
    np.testing.assert_allclose(figures["x0_rmse"], np.sqrt((error[..., 0] ** 2).mean(0)))
    np.testing.assert_allclose(figures["x1_rmse"], np.sqrt((error[..., 1] ** 2).mean(0)))
    np.testing.assert_allclose(figures["nees"], nees.mean(0) / 2)
    np.testing.assert_array_equal(figures["score"], flown.returns)
    np.testing.assert_array_equal(figures["steps"], [40, 40])
    assert 0.0 <= consistency(flown) <= 1.0
    assert np.isnan(
        scores(rollout("swinging:Brake", "Swinging-v0", [0], {"estimator": "truth"}))["nees"]
    ).all()


def test_an_unknown_id_names_those_of_its_module():
    assert registered_id(NAME) in NAME
    with refused(ValueError, rf"unknown environment .*did you mean '{NAME}'.*own: module:id"):
        registered_id(NAME.replace("0", "1"))


def test_without_an_estimator_there_are_return_and_length():
    figures = scores(rollout("random", "Pendulum-v1", [0]))
    assert set(figures) == {"score", "steps"}
    assert figures["steps"] == [200]


def test_evaluate_compares_estimators(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    line = f"evaluate {NAME} --agent swinging:Brake --estimator truth ekf ukf --episodes 2"
    assert not _command(monkeypatch, line)
    printed = capsys.readouterr().out
    for word in ("truth", "ekf", "ukf", "Score", "Steps", "x0", "x1", "NEES/n"):
        assert word in printed
    assert "moderate" not in printed  # no option of the environment


def test_the_page_has_a_flight_on_each_estimator(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Without a scene, it shows each component of truth and estimate."""
    flown = episode(registered_id(NAME), None, "swinging:Brake")
    assert list(flown.scores) == ["ukf", "truth"]
    assert (flown.page["scene"], flown.page["dt"], flown.page["unit"]) == (None, 0.05, "s")
    charts = [chart["title"] for chart in flown.page["flights"][0]["charts"]]
    assert charts == ["Component 0", "Component 1"]
    assert "three.js" not in flown.html()
    page = tmp_path / "page.html"
    assert not _command(monkeypatch, f"watch {NAME} --agent swinging:Brake --out {page}")
    assert "Swinging-v0" in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_its_own_pictures_are_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    pytest.importorskip("pygame")
    assert not _command(
        monkeypatch, f"watch {NAME} --agent swinging:Brake --out {tmp_path / 'x.gif'}"
    )
    assert len(pytest.importorskip("imageio").mimread(tmp_path / "x.gif")) >= 7


def test_an_option_that_it_does_not_take_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    with pytest.raises(SystemExit, match=r"^2$"):
        _command(monkeypatch, f"evaluate {NAME} --agent random --disturbance rough")
    said = " ".join(capsys.readouterr().err.split())
    assert "Swinging-v0 takes no option 'disturbance': leave it out" in said


def test_a_study_ranks_the_estimators(tmp_path: Path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    planned = plan(read_study(path))
    assert {f.estimator for f in planned.flights} == {"truth", "dead-reckoning", "ekf", "ukf"}
    assert not planned.skipped
    outcome = run(planned.jobs, tmp_path / "results", 1)
    assert not outcome.failures
    text = write_report(Results.of(planned, outcome), tmp_path, {}).read_text()
    assert "<td>ukf</td>" in text
    assert "NEES" in text


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("swinging:Brake", "ppo"), "is no environment of vessel_gym"),
        (("episodes = 3", "episodes = 3\n[conditions.rough]\ndisturbance = 'rough'"), "rough"),
    ],
)
def test_a_study_names_what_such_an_environment_has_not(
    change: tuple[str, str], sentence: str, tmp_path: Path
):
    path = tmp_path / "study.toml"
    path.write_text(STUDY.replace(*change))
    with pytest.raises(StudyError, match=sentence):
        read_study(path)


@pytest.mark.slow
def test_an_agent_of_stable_baselines3_is_saved_and_flown(tmp_path: Path):
    sac = pytest.importorskip("stable_baselines3").SAC
    env = gym.make(registered_id(NAME))
    model = sac(
        "MlpPolicy", env, learning_starts=10, seed=0, device="cpu", policy_kwargs={"net_arch": [8]}
    ).learn(30)
    seen = np.stack([env.reset(seed=seed)[0] for seed in range(4)])
    path = save_agent(model, tmp_path / "agent")
    agent = load_agent(path, env)
    agent.reset(4)
    expected, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(agent.act(seen), expected, rtol=0, atol=1e-6)
    assert rollout(str(path), "Swinging-v0", [0]).length == [40]
    with pytest.raises(ValueError, match="was trained in another environment"):
        load_agent(path, gym.make("MountainCarContinuous-v0"))
