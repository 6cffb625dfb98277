"""Costs beside the score: wear of the steering, added resistance and fuel of ships, energy, clearance and tails."""

from dataclasses import replace
from functools import cache

import gymnasium as gym
import numpy as np
import pytest

from agents import Rollout, rollout
from agents.metrics import STEERING, metrics, scores
from agents.metrics.costs import DEAD_BAND, tails, turning_points
from vessel_gym.envs import SigmaCorvetteEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.vehicles.corvette import steady_turns
from vessel_gym.vehicles.corvette_equations import (
    AROUND,
    STATE,
    CorvetteParameters,
    I,
    corvette_rates,
    propulsion,
    straight_course,
)
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.ship import Ship

THESIS, SIGMA, AUV, PUNA = "ThesisCorvette-v0", "SigmaCorvette-v0", "SegorogeniAUV-v0", "PunaUAV-v0"
SHIPS = ("corvette", "corvette-thesis", "mariner")
COMMON = {"score", "steering_travel", "reversals", "saturation"}
COSTS = {
    THESIS: COMMON | {"added_resistance", "fuel", "heading_error_95", "outside"},
    SIGMA: COMMON | {"added_resistance", "fuel", "off_track_95", "outside"},
    "SigmaChannel-v0": COMMON | {"added_resistance", "fuel", "off_track_95", "outside"},
    AUV: COMMON | {"energy", "clearance", "off_track_95", "outside"},
    "ItsunusaAUV-v0": COMMON | {"energy", "clearance", "off_track_95", "outside"},
    PUNA: COMMON | {"energy", "clearance", "off_track_95", "outside"},
}
PERIOD, DT = 40, 0.5  # steps, and seconds of one


class Steady:
    """An agent whose action is always the same, or changes its sign in every step."""

    def __init__(self, actions: int, value: float, alternating: bool = False) -> None:
        self.action, self.alternating = np.full(actions, value, np.float32), alternating

    def reset(self, num_envs: int) -> None:
        self.rows, self.sign = num_envs, 1.0

    def act(self, observations: np.ndarray) -> np.ndarray:
        self.sign *= -1.0 if self.alternating else 1.0
        return np.tile(self.sign * self.action, (self.rows, 1)).astype(np.float32)


@cache
def flown(env_id: str) -> Rollout:
    return rollout("autopilot", env_id, [3, 4, 5], {"estimator": "truth", "disturbance": "calm"})


def changed(kept: Rollout, **history: np.ndarray) -> Rollout:
    return replace(kept, history=kept.history | history)


def steered(angle: np.ndarray) -> dict[str, np.ndarray]:
    """Metrics of a ship whose rudder has these angles [rad], ``(601,)``, in 5 minutes."""
    return scores(changed(flown(SIGMA), actuators=np.tile(angle[:, None, None], (1, 3, 1))))


def sine(amplitude: float) -> np.ndarray:
    return amplitude * np.sin(2.0 * np.pi * np.arange(601) / PERIOD)


@pytest.mark.parametrize("env_id", COSTS)
def test_an_owner_s_costs_are_finite_and_few_enough_for_a_table(env_id: str):
    figures, every = scores(flown(env_id)), metrics(flown(env_id).env.unwrapped.system)
    assert {m.key for m in every if m.cost} | {"score"} == COSTS[env_id]
    assert len(COSTS[env_id]) <= 8
    for m in every:
        if m.cost:
            assert np.isfinite(figures[m.key]).all(), m.key


# --- steering -------------------------------------------------------------------------------------


def test_a_sinusoid_travels_four_amplitudes_and_turns_twice_in_a_period():
    figures = steered(sine(np.deg2rad(10.0)))
    periods = 600 / PERIOD
    np.testing.assert_allclose(figures["steering_travel"], 40.0 * periods / 5.0)
    np.testing.assert_allclose(figures["reversals"], 2.0 * periods / 5.0)


def test_a_ramp_has_no_reversal_and_travels_its_rise():
    figures = steered(np.deg2rad(0.03) * np.arange(601.0))
    np.testing.assert_allclose(figures["steering_travel"], 18.0 / 5.0)
    np.testing.assert_array_equal(figures["reversals"], 0.0)


def test_motion_within_the_dead_band_is_no_reversal_and_does_not_hide_one():
    noise = 0.49 * DEAD_BAND * np.random.default_rng(0).uniform(-1.0, 1.0, 601)
    for still in (sine(0.49 * DEAD_BAND), noise, noise + 3.0 * DEAD_BAND * np.arange(601)):
        np.testing.assert_array_equal(steered(still)["reversals"], 0.0)
    wave = steered(sine(np.deg2rad(10.0)) + noise)["reversals"]
    np.testing.assert_allclose(wave, steered(sine(np.deg2rad(10.0)))["reversals"])


def test_turning_points_are_those_of_each_series_alone():
    series = np.random.default_rng(1).normal(size=(300, 4, 2)).cumsum(0)
    alone = [[turning_points(series[:, i, j], 0.7) for j in range(2)] for i in range(4)]
    np.testing.assert_array_equal(turning_points(series, 0.7), alone)
    np.testing.assert_array_equal(turning_points(np.array([0.0, 1.0, 0.5, 1.5, -1.0]), 0.7), 1.0)


@pytest.mark.parametrize("env_id", [THESIS, SIGMA, AUV, PUNA])
def test_bang_bang_is_always_saturated_and_gentle_commands_never_are(env_id: str):
    system = flown(env_id).env.unwrapped.system
    size = len(system.vehicle.action_names)
    options = {"estimator": "truth", "disturbance": "calm", "max_episode_steps": 60}
    brisk = scores(rollout(Steady(size, 1.0, alternating=True), env_id, [1, 2], options))
    np.testing.assert_array_equal(brisk["saturation"], 100.0)
    gentle = scores(rollout(Steady(size, 0.01), env_id, [1, 2], options))
    np.testing.assert_array_equal(gentle["saturation"], 0.0)
    assert (gentle["steering_travel"] < 0.1 * brisk["steering_travel"]).all()


def test_a_vehicle_that_says_nothing_of_its_steering_has_no_costs_of_it():
    class Nameless(Ship):
        steering = ()

    system = flown(SIGMA).env.unwrapped.system
    mute = {m.key for m in metrics(replace(system, vehicle=Nameless()))}
    assert {m.key for m in metrics(system)} - mute == {m.key for m in STEERING}


class TwoRudders(Ship):
    """A ship of a user's own, whose second actuator does not exist."""

    steering = (0, 1)


class OneRudder(Ship):
    """One whose only actuator is her rudder."""


@pytest.mark.parametrize("vehicle", [OneRudder(), TwoRudders()])
def test_a_vehicle_of_ones_own_has_the_costs_of_the_actuators_that_it_names(vehicle: Ship):
    class OwnEnv(VesselVectorEnv):
        system = replace(SigmaCorvetteEnv.system, name="Own-v0", vehicle=vehicle)
        max_episode_steps = 60

    gym.register(
        "OwnRudders-v0", entry_point=OwnEnv, vector_entry_point=OwnEnv, max_episode_steps=60
    )
    try:
        kept = rollout(
            "autopilot", "OwnRudders-v0", [3, 4], {"estimator": "truth", "disturbance": "calm"}
        )
    finally:
        del gym.registry["OwnRudders-v0"]
    if isinstance(vehicle, TwoRudders):
        with pytest.raises(
            ValueError,
            match=(
                r"^steering of TwoRudders must be indices below 1, the number of its actuators,"
                r" got 1$"
            ),
        ):
            scores(kept)
        return
    ours = rollout(
        "autopilot",
        SIGMA,
        [3, 4],
        {"estimator": "truth", "disturbance": "calm", "max_episode_steps": 60},
    )
    for key in COSTS[SIGMA]:
        np.testing.assert_allclose(scores(kept)[key], scores(ours)[key], rtol=1e-9, err_msg=key)


# --- propulsion -----------------------------------------------------------------------------------


def ship(name: str) -> CorvetteParameters:
    return load(name, CorvetteParameters)


@pytest.mark.parametrize("name", SHIPS)
def test_added_resistance_and_load_are_what_the_surge_equation_has_beside_the_hull_s_resistance(
    name: str,
):
    c, rng = ship(name).vector(), np.random.default_rng(2)
    state = np.zeros((500, len(STATE)))
    state[:, 3:6] = (
        rng.uniform([0.2, -0.2, -1.0], [1.2, 0.2, 1.0], (500, 3)) * [ship(name).speed] * 3
    )
    state[:, 5] /= ship(name).length
    rudder = rng.uniform(-0.6, 0.6, 500)
    load, added = propulsion(state, rudder, c)
    rates = corvette_rates(
        state, rudder[:, None], np.zeros((500, len(AROUND))), np.tile(c, (500, 1))
    )
    u = state[:, 3]
    force = c[I.thrust] * (load - added) - c[I.resistance] * u * np.abs(u)
    np.testing.assert_allclose(
        force, c[I.surge_inertia] * rates[:, 3], rtol=0, atol=1e-9 * c[I.thrust]
    )


@pytest.mark.parametrize("name", SHIPS)
def test_in_a_steady_turn_added_resistance_is_what_slows_the_ship(name: str):
    turns, zero = steady_turns(ship(name)), np.zeros(165)
    state = np.stack([zero, zero, zero, turns.speed, turns.sway, turns.yaw_rate, zero, zero], -1)
    load, added = propulsion(state, turns.rudder, ship(name).vector())
    np.testing.assert_allclose(added, load - (turns.speed / ship(name).speed) ** 2, atol=1e-8)
    assert added[0] == pytest.approx(0.0, abs=1e-12)
    assert (np.diff(added) > 0.0).all()
    state[:, 4:6] *= -1.0
    np.testing.assert_allclose(propulsion(state, -turns.rudder, ship(name).vector())[1], added)


@pytest.mark.parametrize("name", SHIPS)
def test_a_straight_course_in_calm_water_is_steady_whatever_the_mismatch(name: str):
    vehicle = Ship(ship(name))
    c = vehicle.parameters(0.3, np.random.default_rng(3).standard_normal((20, vehicle.normals)))
    speed, load = straight_course(c)
    state = np.zeros((20, len(STATE)))
    state[:, 3] = speed
    rates = corvette_rates(state, np.zeros((20, 1)), np.zeros((20, len(AROUND))), c)
    np.testing.assert_allclose(rates[:, 3:6], 0.0, atol=1e-12)
    np.testing.assert_allclose(propulsion(state, np.zeros(20), c)[0], load)
    nominal = straight_course(ship(name).vector())
    np.testing.assert_allclose(nominal, [ship(name).speed, 1.0])


@pytest.mark.parametrize(
    ("env_id", "share", "fuel"), [(SIGMA, 1.0, 100.0), (THESIS, 1.0, 100.0), (THESIS, 0.5, 200.0)]
)
def test_a_straight_course_burns_the_fuel_of_one_and_a_slow_one_more(
    env_id: str, share: float, fuel: float
):
    """Propellers of constant revolutions and thrust burn as much in a second at half of the speed."""
    kept = replace(flown(env_id), length=np.full(3, 6))  # the track is straight for 10 steps
    h, task = kept.history, kept.env.unwrapped.core.task
    truth, speed = np.zeros_like(h["truth"]), share * task.ship.speed
    heading = h["reference"][..., 5] if env_id == SIGMA else h["reference"][..., 0]
    way = speed * task.dt * np.arange(len(truth))[:, None]
    truth[..., 0], truth[..., 1] = way * np.cos(heading[0]), way * np.sin(heading[0])
    truth[..., 2], truth[..., 3] = heading, speed
    figures = scores(changed(kept, truth=truth, actuators=np.zeros_like(h["actuators"])))
    np.testing.assert_allclose(figures["added_resistance"], 0.0, atol=1e-12)
    np.testing.assert_allclose(figures["fuel"], fuel)


@pytest.mark.parametrize("wind", [0.0, 4.0])
def test_energy_of_a_flight_is_thrust_times_airspeed_whatever_the_wind_carries(wind: float):
    kept = flown(PUNA)
    core, h = kept.env.unwrapped.core, kept.history
    truth, actuators = np.zeros_like(h["truth"]), h["actuators"].copy()
    truth[..., 3], actuators[..., 0] = 18.0 + wind, 2.0 * core.task.body.cruise[0]
    truth[..., core.truth_names.index("mean wind north")] = wind
    length = core.task.length_of(core.task.scenario_of(h["reference"][0]))
    expected = 2.0 * 18.0 * kept.length * core.vehicle.dt / length
    np.testing.assert_allclose(
        scores(changed(kept, truth=truth, actuators=actuators))["energy"], expected
    )


def test_clearance_of_a_dive_is_its_least_height_above_the_depth_at_which_it_is_lost():
    kept = flown(AUV)
    task, truth = kept.env.unwrapped.core.task, kept.history["truth"].copy()
    deepest = kept.history["reference"][0, :, 10] + task.margin
    truth[..., 8] = 0.0
    truth[7, :, 8] = deepest - 0.7
    np.testing.assert_allclose(scores(changed(kept, truth=truth))["clearance"], 0.7)


# --- tails ----------------------------------------------------------------------------------------


def test_tails_are_the_percentiles_of_the_time_that_was_lived():
    rng = np.random.default_rng(4)
    error, length = rng.normal(size=(200, 3)), np.array([199, 40, 0])
    alive = np.arange(200)[:, None] <= length
    found = tails("off_track", error, alive, 1.5)
    for i, last in enumerate(length):
        lived = np.abs(error[: last + 1, i])
        assert found["off_track_95"][i] == pytest.approx(np.percentile(lived, 95.0))
        assert found["off_track_max"][i] == lived.max()
        assert found["outside"][i] == pytest.approx(100.0 * np.mean(lived > 1.5))


@pytest.mark.parametrize(("margin", "outside"), [(None, 100.0), (40.0, 0.0)])
def test_outside_is_beyond_the_margin_of_the_task_or_else_its_tolerance(
    margin: float | None, outside: float, monkeypatch: pytest.MonkeyPatch
):
    kept = flown(SIGMA)
    task, truth = kept.env.unwrapped.core.task, kept.history["truth"].copy()
    scenario = task.scenario_of(kept.history["reference"][0])
    for k in range(len(truth)):
        x, y, direction = task.nominal(scenario, np.full(3, k))[:, :3].T
        truth[k, :, :3] = np.stack(
            [x - 25.0 * np.sin(direction), y + 25.0 * np.cos(direction), direction], -1
        )
    if margin is not None:
        monkeypatch.setattr(type(task), "margin", margin, raising=False)
    figures = scores(changed(kept, truth=truth))
    np.testing.assert_allclose(figures["off_track_95"], 25.0, atol=0.05)
    np.testing.assert_allclose(figures["off_track_max"], 25.0, atol=0.05)
    np.testing.assert_array_equal(figures["outside"], outside)


def test_tails_of_a_turn_are_those_of_its_heading():
    kept = flown(THESIS)
    truth, off = kept.history["truth"].copy(), np.deg2rad(np.linspace(-8.0, 12.0, len(kept.alive)))
    truth[..., 2] = kept.history["reference"][..., 0] + off[:, None]
    figures, limit = (
        scores(changed(kept, truth=truth)),
        kept.env.unwrapped.core.task.HEADING_TOLERANCE,
    )
    np.testing.assert_allclose(
        figures["heading_error_95"], np.rad2deg(np.percentile(np.abs(off), 95.0))
    )
    np.testing.assert_allclose(figures["heading_error_max"], 12.0)
    np.testing.assert_allclose(figures["outside"], 100.0 * np.mean(np.abs(off) > limit))
