"""The benchmark: what it is compared with is the same environment, and it reports what it says."""

import numpy as np
import pytest

from estimators import names
from scripts import benchmark
from scripts.benchmark import HandWrittenLoop, batch, main, microseconds, single
from vessel_gym.core import Core
from vessel_gym.envs.sigma_corvette import SIGMA_CORVETTE


def test_the_hand_written_loop_is_the_same_environment_on_the_same_random_numbers(monkeypatch: pytest.MonkeyPatch):
    core, loop = Core(SIGMA_CORVETTE, 1, estimator="kf"), HandWrittenLoop(seed=0)
    core.start(seed=5)
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, 200)
    loop.heading, loop.rate = core.course[0]
    loop.truth, loop.sea_state = core.state[0].copy(), core.sea_state[0].copy()
    loop.filter.x, loop.filter.P = core.belief.mean[0].copy(), core.belief.cov[0].copy()
    for action in actions:
        sea = _last_normals(core._draws)  # of what moves the sea over the coming step
        reward, _ = core.step(np.array([[action]]))
        monkeypatch.setattr(loop, "rng", _Scripted([sea, _last_normals(core.loop._draws)]))
        observation, hand_reward = loop.step(float(action))
        np.testing.assert_allclose(loop.truth, core.state[0], rtol=0, atol=1e-8)
        np.testing.assert_allclose(loop.filter.x, core.belief.mean[0], rtol=0, atol=1e-8)
        np.testing.assert_allclose(observation, core.observe()[0], rtol=0, atol=1e-5)
        assert hand_reward == pytest.approx(reward[0], abs=1e-8)


def _last_normals(draws) -> np.ndarray:
    return draws._normal[0, draws._common - 1].copy()


class _Scripted:
    """Gives out the normal numbers that the package has just used, in the order of the loop's calls."""

    def __init__(self, numbers: list[np.ndarray]) -> None:
        self._numbers = iter(numbers)

    def standard_normal(self, size: int) -> np.ndarray:
        number = next(self._numbers)
        assert number.shape == (size,)
        return number


@pytest.mark.slow
def test_a_run_counts_every_environment_and_step_of_an_episode():
    assert single("SigmaCorvette-v0", "kf").env_steps == 600
    assert batch("SigmaCorvette-v0", "kf", 3).env_steps == 1800


@pytest.mark.slow
def test_a_run_of_a_dive_ends_with_its_first_arrival():
    assert 300 < single("ItsunusaAUV-v0", "truth").env_steps < 600


@pytest.mark.slow
def test_only_the_corvette_has_a_loop_written_by_hand(capsys: pytest.CaptureFixture[str]):
    main("ItsunusaAUV-v0", what="environment", estimator="truth", num_envs=(2,), repeats=1)
    printed = capsys.readouterr().out
    assert "by hand" not in printed
    assert "ItsunusaAUV-v0, truth" in printed


@pytest.mark.slow
def test_times_are_positive_and_named_as_the_runs():
    times = microseconds({"one": single("SigmaCorvette-v0", "truth")}, repeats=2)
    assert list(times) == ["one"]
    assert times["one"] > 0.0


@pytest.mark.slow
def test_the_report_names_every_size_and_the_loop(capsys: pytest.CaptureFixture[str]):
    main("SigmaCorvette-v0", what="environment", estimator="kf", num_envs=(2,), repeats=1)
    printed = capsys.readouterr().out
    for label in ("by hand", "gymnasium.make", "batch of 2", "times the loop"):
        assert label in printed


@pytest.mark.slow
def test_every_filter_is_timed_beside_filterpy(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr(benchmark, "MEMBERS", 5)
    timed = benchmark.estimator
    monkeypatch.setattr(benchmark, "estimator", lambda name, rows, steps: timed(name, rows, 1))
    main("SigmaCorvette-v0", what="estimators", repeats=1)
    printed = capsys.readouterr().out
    for label in (*names(), "random numbers", "filterpy EnKF"):
        assert label in printed
