"""Metrics, from flights whose errors are known: estimates, turns, tracks, and what owners pay."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from heading_ship import HEADING_SHIP

from agents import Rollout, rollout
from agents.metrics import (
    STEERING,
    components,
    consistency,
    metric,
    metrics,
    nees_of,
    rmse,
    scores,
)
from agents.metrics.costs import DEAD_BAND, turning_points
from vessel_gym.tasks.flight import LENGTH
from vessel_gym.vehicles.corvette import propulsion, straight_course
from vessel_gym.vehicles.corvette_equations import (
    AROUND,
    STATE,
    CorvetteParameters,
    corvette_rates,
)
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.ship import Ship

THESIS, SIGMA, AUV, PUNA = HEADING_SHIP.name, "SigmaCorvette-v0", "SegorogeniAUV-v0", "PunaUAV-v0"
ESTIMATED = {
    THESIS: ("v", "r", "psi"),
    SIGMA: ("x", "y", "psi", "u", "v", "r", "current north", "current east"),
}
KNOWN = (THESIS, SIGMA, "SigmaChannel-v0", AUV, "ItsunusaAUV-v0", PUNA)


@cache
def flown(env_id: str) -> Rollout:
    options = {"disturbance": "calm"} | ({"estimator": "kf-umv-ui"} if env_id == THESIS else {})
    return rollout("autopilot", env_id, [3, 4, 5], options)


def core_of(kept: Rollout) -> Any:
    return kept.env.unwrapped.core


def system_of(kept: Rollout) -> Any:
    return kept.config.system


def changed(kept: Rollout, **history: np.ndarray) -> Rollout:
    return replace(kept, history=kept.history | history)


def perfect(env_id: str) -> Rollout:
    """The flight, had the filter known everything."""
    h, core = flown(env_id).history, core_of(flown(env_id))
    assert core.config.estimation.space.names == ESTIMATED[env_id]
    known = {
        "estimate": core.config.true_state.in_filter_order(h["truth"]),
        "input_estimate": h["unknown_input"].copy(),
    }
    return changed(flown(env_id), **known)


@pytest.mark.parametrize("env_id", KNOWN)
def test_every_metric_has_a_value_and_few_are_costs(env_id: str):
    kept = flown(env_id)
    figures, every = scores(kept), metrics(system_of(kept))
    assert list(figures) == [m.key for m in every]
    assert 6 < sum(m.cost for m in every) < 9  # few enough for a table
    for key, values in figures.items():
        assert values.shape == (3,)
        assert np.isfinite(values).all() or key == "input_rmse", key
    np.testing.assert_allclose(figures["score"], kept.score)
    np.testing.assert_allclose(figures["return"], kept.returns)
    np.testing.assert_array_equal(figures["steps"], kept.length)


# --- estimates ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("env_id", "names", "key", "expected"),
    [
        (THESIS, ("psi",), "heading_rmse", 20.0),
        (SIGMA, ("r",), "yaw_rate_rmse", 20.0),
        (THESIS, ("v",), "sway_rmse", 0.02),
        (SIGMA, ("x", "y"), "position_rmse", 0.02 * np.sqrt(2.0)),
        (SIGMA, ("current north",), "current_rmse", 0.02),
    ],
)
def test_a_constant_offset_is_the_rmse_of_its_components_alone(
    env_id: str, names: tuple[str, ...], key: str, expected: float
):
    """A full turn is no error of the heading."""
    kept = perfect(env_id)
    estimate = kept.history["estimate"] + 0.02 * np.isin(ESTIMATED[env_id], names)
    figures = scores(
        changed(kept, estimate=estimate + 2.0 * np.pi * np.isin(ESTIMATED[env_id], "psi"))
    )
    np.testing.assert_allclose(figures[key], expected, rtol=1e-6)
    for other in {"heading_rmse", "yaw_rate_rmse", "sway_rmse", "input_rmse"} - {key}:
        np.testing.assert_allclose(figures[other], 0.0, atol=1e-9)


@pytest.mark.parametrize("env_id", ESTIMATED)
def test_the_input_error_is_that_of_its_estimate(env_id: str):
    d = flown(env_id).history["unknown_input"]
    figures = scores(changed(flown(env_id), input_estimate=d + 3e-3))
    np.testing.assert_allclose(figures["input_rmse"], 3.0)


def test_what_an_estimator_does_not_have_is_nan():
    for estimator, missing in (("truth", "nees"), ("measurement", "nees"), ("kf", "input_rmse")):
        options = {"estimator": estimator, "max_episode_steps": 20}
        flight = rollout("autopilot", THESIS, [0, 1], options)
        assert np.isnan(scores(flight)[missing]).all()
        assert (consistency(flight) is None) == (missing == "nees")
    assert rmse("u")(flight) is None
    assert components(flight, "psi", "v") == (0, 2)


def test_nees_does_not_depend_on_the_times_computed_at_once(monkeypatch: pytest.MonkeyPatch):
    expected = nees_of(replace(flown(SIGMA)))
    for together in (1, 100, 10**6):
        monkeypatch.setattr(metric, "_TOGETHER", together)
        np.testing.assert_allclose(nees_of(replace(flown(SIGMA))), expected, rtol=1e-9)


def test_nees_is_squared_error_in_units_of_covariance():
    kept = replace(perfect(THESIS), length=np.array([600, 200, 300]))
    sd = np.array([0.1, 0.01, 0.02])
    truth = kept.history["estimate"]
    covariance = np.broadcast_to(np.diag(sd**2), kept.history["covariance"].shape)
    claimed = changed(kept, covariance=covariance, estimate=truth + 2.0 * sd)
    np.testing.assert_allclose(scores(claimed)["nees"], 4.0)
    assert consistency(claimed) == 0.0
    noise = sd * np.random.default_rng(0).standard_normal(truth.shape)
    noisy = changed(kept, covariance=covariance, estimate=truth + noise)
    for names in (), ("psi",):
        share = consistency(noisy, *names)
        assert share is not None
        assert 0.92 < share < 0.98


def test_only_steps_that_an_episode_lived_through_count():
    short = replace(flown(THESIS), length=np.array([600, 200, 600]))
    spoilt = {key: values.copy() for key, values in short.history.items()}
    spoilt["estimate"][201:, 1] += 1.0
    spoilt["reference"][201:, 1, :2] += 1.0
    spoilt["healthy"][201:, 1] = False
    clean, dirty = scores(short), scores(replace(short, history=spoilt))
    for key in clean:
        np.testing.assert_array_equal(clean[key], dirty[key], err_msg=key)
    spoilt["healthy"][10:14, 2] = False
    np.testing.assert_array_equal(scores(replace(short, history=spoilt))["unhealthy"], [0, 0, 4])


# --- turns and tracks -----------------------------------------------------------------------------


def test_true_errors_of_a_turn_are_against_the_reference():
    """Of the time that was lived, to its last step, which is the worst here."""
    kept = replace(flown(THESIS), length=np.array([600, 400, 400]))
    truth, reference = kept.history["truth"].copy(), kept.history["reference"]
    off = np.deg2rad(np.linspace(-3.0, 12.0, 601))
    truth[..., 2] = reference[..., 0] + off[:, None]
    off = off[:401]
    figures, limit = scores(changed(kept, truth=truth)), system_of(kept).task.HEADING_TOLERANCE
    expected = {
        "heading_error": np.rad2deg(np.sqrt(np.mean(off**2))),
        "heading_error_95": np.rad2deg(np.percentile(np.abs(off), 95.0)),
        "heading_error_max": 7.0,
        "outside": 100.0 * np.mean(np.abs(off) > limit),
    }
    for key, value in expected.items():
        np.testing.assert_allclose(figures[key][1:], value, err_msg=key)


@pytest.mark.parametrize(
    ("aside", "margin", "outside"), [(0.0, None, 0.0), (25.0, None, 100.0), (-40.0, 50.0, 0.0)]
)
def test_a_ship_beside_its_track_is_as_far_off(
    aside: float, margin: float | None, outside: float, monkeypatch: pytest.MonkeyPatch
):
    """Outside is beyond the margin of the task or else its tolerance."""
    kept = flown(SIGMA)
    task, truth = system_of(kept).task, kept.history["truth"].copy()
    scenario = kept.scenario
    for k in range(len(truth)):
        along = task.nominal_distance(scenario, np.full(len(scenario), k))
        x, y, direction = task.track(scenario, along).T
        beside = [x - aside * np.sin(direction), y + aside * np.cos(direction), direction]
        truth[k, :, :3] = np.stack(beside, -1)
    truth[..., 6] = np.deg2rad(-2.0)
    if margin is not None:
        monkeypatch.setattr(type(task), "margin", margin, raising=False)
    figures = scores(changed(kept, truth=truth))
    np.testing.assert_allclose(figures["roll"], 2.0)
    np.testing.assert_array_equal(figures["outside"], outside)
    for key in ("track_error", "off_track_95", "off_track_max"):
        np.testing.assert_allclose(figures[key], abs(aside), rtol=0, atol=0.05)


# --- steering -------------------------------------------------------------------------------------


def steered(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Travel and reversals of a ship whose rudder has these angles [rad] for 5 minutes."""
    figures = scores(changed(flown(SIGMA), actuators=np.tile(angle[:, None, None], (1, 3, 1))))
    return figures["steering_travel"], figures["reversals"]


def test_steering_travel_and_reversals_of_known_motions():
    wave = np.sin(2.0 * np.pi * np.arange(601) / 40)  # 15 periods
    noise = 0.49 * DEAD_BAND * np.random.default_rng(0).uniform(-1.0, 1.0, 601)
    travel, reversals = steered(np.deg2rad(10.0) * wave)
    np.testing.assert_allclose(travel, 40.0 * 15 / 5.0)
    np.testing.assert_allclose(reversals, 2.0 * 15 / 5.0)
    np.testing.assert_allclose(steered(np.deg2rad(10.0) * wave + noise)[1], reversals)
    ramp = np.deg2rad(0.03) * np.arange(601.0)
    np.testing.assert_allclose(steered(ramp)[0], 18.0 / 5.0)
    for still in (ramp, 0.49 * DEAD_BAND * wave, noise, noise + 3.0 * DEAD_BAND * np.arange(601)):
        np.testing.assert_array_equal(steered(still)[1], 0.0)


def test_turning_points_are_those_of_each_series_alone():
    series = np.random.default_rng(1).normal(size=(300, 4)).cumsum(0)
    alone = [turning_points(series[:, i], 0.7) for i in range(4)]
    np.testing.assert_array_equal(turning_points(series, 0.7), alone)
    np.testing.assert_array_equal(turning_points(np.array([0.0, 1.0, 0.5, 1.5, -1.0]), 0.7), 1.0)


@pytest.mark.parametrize("env_id", [THESIS, AUV, PUNA])
def test_saturation_of_bang_bang_and_gentle_commands(env_id: str):
    kept, vehicle = flown(env_id), system_of(flown(env_id)).vehicle
    start = kept.history["actuators"][0]
    for size, expected in ((1.0, 100.0), (0.01, 0.0)):
        actuators = [start]
        for k in range(len(kept.alive) - 1):
            action = np.full_like(start, size * (-1.0) ** k)
            actuators.append(vehicle.actuate(actuators[-1], action))
        figures = scores(changed(kept, actuators=np.array(actuators)))
        np.testing.assert_array_equal(figures["saturation"], expected)


def test_vehicle_without_steering_has_no_steering_costs():
    class Nameless(Ship):
        steering = ()

    system = system_of(flown(SIGMA))
    mute = {m.key for m in metrics(replace(system, vehicle=Nameless()))}
    assert {m.key for m in metrics(system)} - mute == {m.key for m in STEERING}


# --- propulsion, energy and clearance -------------------------------------------------------------


@pytest.mark.parametrize("name", ["corvette", "corvette-thesis", "mariner"])
def test_resistance_and_load_fit_surge_equation_and_turns(name: str):
    ship, rng = load(name, CorvetteParameters), np.random.default_rng(2)
    c, still = ship.vector(), np.zeros((500, len(AROUND)))
    state = np.zeros((500, len(STATE)))
    state[:, 3:6] = rng.uniform([0.2, -0.2, -1.0], [1.2, 0.2, 1.0], (500, 3)) * ship.speed * 3
    state[:, 5] /= ship.length
    rudder = rng.uniform(-0.6, 0.6, 500)
    load_of, added = propulsion(state, rudder, c)
    rates = corvette_rates(state, rudder[:, None], still, np.tile(c, (500, 1)))
    of = ship.values()
    force = of.thrust * (load_of - added) - of.resistance * state[:, 3] * np.abs(state[:, 3])
    surge = of.surge_inertia * rates[:, 3]
    np.testing.assert_allclose(force, surge, rtol=0, atol=1e-9 * of.thrust)

    vehicle = Ship(ship)
    c = vehicle.parameters(0.3, rng.standard_normal((20, vehicle.normals)))
    speed, straight_load = straight_course(c)
    state = np.zeros((20, len(STATE)))
    state[:, 3] = speed
    rates = corvette_rates(state, np.zeros((20, 1)), still[:20], c)
    np.testing.assert_allclose(rates[:, 3:6], 0.0, atol=1e-12)
    np.testing.assert_allclose(propulsion(state, np.zeros(20), c)[0], straight_load)


@pytest.mark.parametrize(
    ("env_id", "share", "fuel"), [(SIGMA, 1.0, 100.0), (THESIS, 1.0, 100.0), (THESIS, 0.5, 200.0)]
)
def test_straight_course_burns_100_percent_and_slow_one_more(
    env_id: str, share: float, fuel: float
):
    """Propellers of constant revolutions burn as much in a second at half of the speed."""
    kept = flown(env_id)
    first = {key: values[:7] for key, values in kept.history.items()}
    kept = replace(kept, length=np.full(3, 6), history=first)  # the track is straight for 10 steps
    h, task = kept.history, system_of(kept).task
    truth, speed = np.zeros_like(h["truth"]), share * task.ship.speed
    heading = h["reference"][..., 5 if env_id == SIGMA else 0]
    way = speed * task.dt * np.arange(len(truth))[:, None]
    truth[..., 0], truth[..., 1] = way * np.cos(heading[0]), way * np.sin(heading[0])
    truth[..., 2], truth[..., 3] = heading, speed
    figures = scores(changed(kept, truth=truth, actuators=np.zeros_like(h["actuators"])))
    np.testing.assert_allclose(figures["added_resistance"], 0.0, atol=1e-12)
    np.testing.assert_allclose(figures["fuel"], fuel)


@pytest.mark.parametrize("wind", [0.0, 4.0])
def test_energy_is_thrust_times_airspeed_in_any_wind(wind: float):
    kept = flown(PUNA)
    config, task, h = kept.config, system_of(kept).task, kept.history
    truth, actuators = np.zeros_like(h["truth"]), h["actuators"].copy()
    truth[..., 3], actuators[..., 0] = 18.0 + wind, 2.0 * task.body.cruise[0]
    truth[..., config.true_state.names.index("mean wind north")] = wind
    length = kept.scenario[:, LENGTH]
    figures = scores(changed(kept, truth=truth, actuators=actuators))
    expected = 2.0 * 18.0 * kept.length * config.system.vehicle.dt / length
    np.testing.assert_allclose(figures["energy"], expected)


def test_clearance_of_dive_is_least_height_above_lost_depth():
    kept = flown(AUV)
    truth = kept.history["truth"].copy()
    deepest = kept.scenario[:, 2] + system_of(kept).task.margin
    truth[..., 8] = 0.0
    truth[7, :, 8] = deepest - 0.7
    np.testing.assert_allclose(scores(changed(kept, truth=truth))["clearance"], 0.7)
