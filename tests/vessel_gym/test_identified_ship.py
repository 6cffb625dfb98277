"""Laws of an identified ship as an environment."""

from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from agents import episode, rollout
from agents.controllers.turning import TrackAutopilot
from agents.metrics import scores
from tests.vessel_gym.identification.voyages import SHIP
from vessel_gym.envs.ship import ship_system
from vessel_gym.vehicles.corvette import steady_turns
from vessel_gym.vehicles.identified import FLOWS, IdentifiedShip
from vessel_gym.vehicles.manoeuvring import AIR, C, rates
from vessel_gym.vehicles.measured_ship import MeasuredShip, read

NOISE = {
    "position": 0.006, "heading": 0.005, "yaw rate": 1e-3, "surge": 1e-3, "sway": 1e-3, "yaw": 5e-4,
    "time constant": 4.0, "growth": 0.25, "gyro drift": 5e-6,
}  # fmt: skip


def identified() -> MeasuredShip:
    """A ship as if identified: the assumed one, with a stiffer hull and an asymmetry, her errors correlated."""
    ship = MeasuredShip.assumed(SHIP)
    c, k = ship.coefficients.copy(), len(ship.coefficients)
    c[C.Nr], c[C.Xvr] = 1.5 * c[C.Nr], -0.15
    c[C.Nn] = 0.005
    mixed = np.eye(k) + 0.3 * np.eye(k, k=1)
    scaled = 0.1 * ship.standard_errors[:, None] * mixed
    covariance = scaled @ scaled.T
    return replace(ship, coefficients=c, covariance=covariance, revolutions=10.0, rudder_rate=0.29, noise=NOISE)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "ship.toml"
    identified().write(path)
    return path


def test_the_file_keeps_the_service(file: Path) -> None:
    found = read(file)
    assert (found.revolutions, found.rudder_rate) == (10.0, 0.29)


def test_speed_and_steady_turns_balance() -> None:
    ship = identified()
    turns = steady_turns(ship)
    motion = np.stack([turns.speed, turns.sway, turns.yaw_rate], -1)
    scale = ship.speed**2 / ship.length * np.array([1.0, 1.0, 1.0 / ship.length])
    assert np.abs(ship.accelerations(motion, turns.rudder[:, None]) / scale).max() < 1e-8
    mirrored = ship.accelerations(motion * [1.0, -1.0, -1.0], -turns.rudder[:, None])
    there = ship.accelerations(motion, turns.rudder[:, None]) * [1.0, -1.0, -1.0]
    assert np.allclose(mirrored, there, rtol=0.0, atol=1e-12 * scale[0])
    assert turns.speed[0] == pytest.approx(ship.speed, rel=1e-9)
    assert (np.diff(turns.rudder) > 0.0).all()


def test_the_mismatch_spreads_as_the_covariance() -> None:
    ship = identified()
    vehicle, k = IdentifiedShip(ship, 0.5), len(ship.coefficients)
    for share in (0.5, 1.0):
        error = vehicle.parameters(share, np.eye(k))[:, :k] - ship.coefficients
        scale = np.outer(ship.standard_errors, ship.standard_errors)
        assert np.allclose(error.T @ error / scale, share**2 * ship.covariance / scale, atol=1e-9)


def test_a_step_integrates_the_identified_model() -> None:
    ship = identified()
    vehicle, h = IdentifiedShip(ship, 0.1), 1e-4
    state, rudder, n = np.array([1.0, 2.0, 0.7, 0.35, -0.03, 0.02]), np.array([0.3]), ship.revolutions
    flow = np.array([0.0, 0.0, 1e-3, -2e-3, 3e-4, 0.8, -0.5])
    air = np.array([0.8, -0.5, 0.0, 0.0])
    assert len(AIR) == len(air)
    expected = state.copy()
    for _ in range(1000):
        rate = rates(expected, np.array([0.3, n]), air, ship.coefficients, ship.particulars.vector())
        rate = rate + np.array([0.0, 0.0, 0.0, 1e-3, -2e-3, 3e-4])
        expected = expected + h * rate
    c = vehicle.parameters(0.0, np.zeros((1, vehicle.normals)))[0]
    found = vehicle.step(state, rudder, rudder, np.append(0.0, flow), c)
    assert np.allclose(found, expected, rtol=0.0, atol=2e-6)  # Euler's error is of order h


def test_water_that_moves_with_the_air_carries_the_ship_along() -> None:
    vehicle = IdentifiedShip(identified(), 0.5)
    c = vehicle.parameters(0.0, np.zeros((1, vehicle.normals)))[0]
    state, rudder = np.array([0.0, 0.0, 2.0, 0.3, 0.05, -0.02]), np.array([-0.2])
    still, moving = np.zeros(1 + len(FLOWS)), np.zeros(1 + len(FLOWS))
    moving[1:3], moving[6:8] = (0.1, -0.2), (-0.1, 0.2)  # the wind comes from where it does not go to
    calm, carried = (vehicle.step(state, rudder, rudder, each, c) for each in (still, moving))
    assert np.allclose(carried - calm, [0.05, -0.1, 0.0, 0.0, 0.0, 0.0], atol=1e-12)


def test_the_autopilot_holds_the_circle_on_a_filter(file: Path) -> None:
    scores = {}
    for estimator in ("truth", "ekf"):
        env = gym.make_vec(
            "vessel_gym/Ship-v0", 8, vectorization_mode="vector_entry_point", vessel=file, estimator=estimator,
            disturbance="calm", mismatch=1.0,
        )  # fmt: skip
        pilot = TrackAutopilot(env.unwrapped.system)  # type: ignore[attr-defined]
        pilot.reset(8)
        observations, _ = env.reset(seed=3)
        total, ended = np.zeros(8), np.zeros(8, bool)
        for _ in range(400):
            observations, rewards, terminated, _, _ = env.step(pilot.act(observations))
            ended |= terminated
            total += rewards
        assert not ended.any()
        assert np.isfinite(observations).all()
        scores[estimator] = total.mean() / 400
    assert scores["truth"] > 0.3
    assert scores["ekf"] > 0.8 * scores["truth"]


def test_metrics_and_the_episode_page_take_the_file(file: Path, tmp_path: Path) -> None:
    flown = rollout("autopilot", "vessel_gym/Ship-v0", [7], {"vessel": file})
    found = scores(flown)
    assert np.isfinite(found["track_error"]).all()
    assert np.isnan(found["roll"]).all()  # her model has none
    page = tmp_path / "episode.html"
    episode("vessel_gym/Ship-v0", ["ekf", "measurement"], seed=7, env_options={"vessel": file}).save(page)
    assert page.stat().st_size > 10_000


def test_a_ship_without_logs_is_refused_in_a_sentence(tmp_path: Path) -> None:
    path = tmp_path / "ship.toml"
    replace(identified(), revolutions=0.0).write(path)
    with pytest.raises(ValueError, match=r"keeps no speed at 0 revolutions.*needs a \[service\] table"):
        ship_system(path)


def test_mismatch_is_a_share(file: Path) -> None:
    with pytest.raises(ValueError, match="mismatch must be between 0 and 1"):
        gym.make("vessel_gym/Ship-v0", vessel=file, mismatch=1.5)
    with pytest.raises(ValueError, match=r"mismatch must be between 0 and 0\.25"):
        gym.make("SigmaCorvette-v0", mismatch=0.5)
