"""Metrics of turns, from flights whose errors are known: turning circles, and circles on a track."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from heading_ship import HEADING_SHIP

from agents import Rollout, rollout
from agents.metrics import consistency, metrics, scores
from agents.metrics.turning import circle_errors
from vessel_gym.vehicles.corvette import steady_turns

SEEDS = [3, 4, 5]
THESIS, SIGMA = HEADING_SHIP.name, "SigmaCorvette-v0"
ESTIMATED = {
    THESIS: ("v", "r", "psi"),
    SIGMA: ("x", "y", "psi", "u", "v", "r", "current north", "current east"),
}
ERRORS = {
    THESIS: ("heading_rmse", "yaw_rate_rmse", "sway_rmse"),
    SIGMA: ("heading_rmse", "yaw_rate_rmse", "sway_rmse", "position_rmse", "current_rmse"),
}


@cache
def calm(env_id: str) -> Rollout:
    options = {"disturbance": "calm"} | ({"estimator": "kf-umv-ui"} if env_id == THESIS else {})
    return rollout("autopilot", env_id, SEEDS, options)


@pytest.fixture
def flown() -> Rollout:
    return calm(THESIS)


def _with(flown: Rollout, **history: np.ndarray) -> Rollout:
    return replace(flown, history=flown.history | history)


def _perfect(flown: Rollout) -> Rollout:
    """The same flight, had the filter known everything."""
    h, core = flown.history, flown.env.unwrapped.core
    assert core.composition.names == ESTIMATED[flown.env_id]
    return _with(
        flown, estimate=core.estimated(h["truth"]), input_estimate=h["unknown_input"].copy()
    )


every_turn = pytest.mark.parametrize("env_id", ESTIMATED)


@every_turn
def test_every_metric_has_a_value_for_every_episode(env_id: str):
    figures = scores(calm(env_id))
    assert set(figures) == {m.key for m in metrics(calm(env_id).env.unwrapped.system)}
    for values in figures.values():
        assert values.shape == (3,)
        assert np.isfinite(values).all()


@every_turn
def test_a_perfect_estimate_has_no_error_and_no_nees(env_id: str):
    figures = scores(_perfect(calm(env_id)))
    for key in (
        *ERRORS[env_id],
        "input_rmse",
        "nees",
        *(["position_nees"] if env_id == SIGMA else []),
    ):
        np.testing.assert_array_equal(figures[key], 0.0)


OFFSETS = [(env_id, *case) for env_id in ESTIMATED for case in (
    (("psi",), "heading_rmse", 20.0), (("r",), "yaw_rate_rmse", 20.0), (("v",), "sway_rmse", 0.02),
)]  # fmt: skip
OFFSETS += [
    (SIGMA, ("x", "y"), "position_rmse", 0.02 * np.sqrt(2.0)), (SIGMA, ("current north",), "current_rmse", 0.02)
]  # fmt: skip


@pytest.mark.parametrize(("env_id", "names", "key", "expected"), OFFSETS)
def test_a_constant_offset_is_the_rmse_of_its_components(
    env_id: str, names: tuple[str, ...], key: str, expected: float
):
    perfect = _perfect(calm(env_id))
    estimate = perfect.history["estimate"] + 0.02 * np.isin(ESTIMATED[env_id], names)
    figures = scores(_with(perfect, estimate=estimate))
    np.testing.assert_allclose(figures[key], expected, rtol=1e-6)
    for other in set(ERRORS[env_id]) - {key}:
        np.testing.assert_array_equal(figures[other], 0.0)


@every_turn
def test_input_errors_are_those_of_the_estimate_and_of_the_second_channel(env_id: str):
    h = calm(env_id).history
    figures = scores(_with(calm(env_id), input_estimate=h["unknown_input"] + 3e-3))
    np.testing.assert_allclose(figures["input_rmse"], 3.0)
    if env_id == THESIS:
        measurement = h["measurement"].copy()
        measurement[..., 1] = h["unknown_input"][..., 0] - 4e-3
        np.testing.assert_allclose(
            scores(_with(calm(env_id), measurement=measurement))["raw_input_rmse"], 4.0
        )


def test_roll_is_that_of_the_ship():
    truth = calm(SIGMA).history["truth"].copy()
    truth[..., 6] = np.deg2rad(-2.0)
    np.testing.assert_allclose(scores(_with(calm(SIGMA), truth=truth))["roll"], 2.0)


def test_score_return_and_steps_are_the_rollouts(flown):
    figures = scores(flown)
    np.testing.assert_allclose(figures["score"], flown.score)
    np.testing.assert_allclose(figures["return"], 600 * flown.score)
    np.testing.assert_array_equal(figures["steps"], flown.length)


def test_a_full_turn_is_no_heading_error(flown):
    perfect = _perfect(flown)
    figures = scores(_with(perfect, estimate=perfect.history["estimate"] + [0.0, 0.0, 2.0 * np.pi]))
    np.testing.assert_allclose(figures["heading_rmse"], 0.0, atol=1e-9)


def test_measurements_that_did_not_arrive_are_no_error_of_the_raw_channel(flown):
    h = flown.history
    measurement, available = h["measurement"].copy(), h["available"].copy()
    measurement[::2, :, 1], available[::2, :, 1] = 1e3, False
    figures = scores(_with(flown, measurement=measurement, available=available))
    assert (figures["raw_input_rmse"] < 5.0).all()


def test_true_errors_are_against_the_reference(flown):
    h = flown.history
    truth = h["truth"].copy()
    truth[..., 2] = h["reference"][..., 0] - np.deg2rad(2.0)
    truth[..., 5] = h["reference"][..., 1] + np.deg2rad(0.5)
    figures = scores(_with(flown, truth=truth))
    np.testing.assert_allclose(figures["heading_error"], 2.0)
    np.testing.assert_allclose(figures["yaw_rate_error"], 0.5)


def test_only_steps_that_an_episode_lived_through_count(flown):
    short = replace(flown, length=np.array([600, 200, 600]))
    spoilt = {key: values.copy() for key, values in flown.history.items()}
    spoilt["estimate"][201:, 1] += 1.0
    spoilt["reference"][201:, 1, :2] += 1.0
    spoilt["healthy"][201:, 1] = False
    spoilt["actuators"][201:, 1] = 9.0
    clean, dirty = scores(short), scores(replace(short, history=spoilt))
    for key in clean:
        np.testing.assert_array_equal(clean[key], dirty[key], err_msg=key)


def test_steps_in_which_the_estimators_usual_update_failed_are_counted(flown):
    healthy = flown.history["healthy"].copy()
    healthy[10:14, 2] = False
    np.testing.assert_array_equal(scores(_with(flown, healthy=healthy))["unhealthy"], [0, 0, 4])


def _circling(flown: Rollout, factor: float, wobble: float = 0.0) -> Rollout:
    """Truth on a circle of ``factor`` times the commanded radius, with a radius that wobbles [m]."""
    h = flown.history
    turns = steady_turns(flown.env.unwrapped.core.task.ship)
    rate = h["reference"][0, :, 3]
    radius = factor / np.interp(np.abs(rate), turns.yaw_rate, 1.0 / turns.radius)
    angle = rate * 0.5 * np.arange(601.0)[:, None]
    radii = radius + wobble * np.cos(8.0 * angle)
    truth = h["truth"].copy()
    truth[..., 0], truth[..., 1] = 50.0 + radii * np.cos(angle), -20.0 + radii * np.sin(angle)
    truth[..., 2] = angle
    return _with(flown, truth=truth)


@pytest.mark.parametrize("factor", [0.9, 1.0, 1.05])
def test_the_radius_error_is_the_share_by_which_the_circle_is_too_large_or_small(flown, factor):
    radius_error, out_of_round = circle_errors(_circling(flown, factor))
    np.testing.assert_allclose(radius_error, 100.0 * abs(factor - 1.0), atol=1e-6)
    np.testing.assert_allclose(out_of_round, 0.0, atol=1e-6)


def test_a_wobble_is_out_of_round_by_its_rms(flown):
    radius_error, out_of_round = circle_errors(_circling(flown, 1.0, wobble=10.0))
    assert (radius_error < 0.5).all()
    np.testing.assert_allclose(out_of_round, 10.0 / np.sqrt(2.0), rtol=0.05)


def test_less_than_half_a_turn_is_no_circle(flown):
    short = replace(flown, length=np.array([600, 80, 600]))
    radius_error, out_of_round = circle_errors(short)
    np.testing.assert_array_equal(np.isfinite(radius_error), [True, False, True])
    np.testing.assert_array_equal(np.isfinite(out_of_round), [True, False, True])


@pytest.mark.parametrize("aside", [0.0, 25.0, -40.0])
def test_a_ship_beside_its_track_is_as_far_off_and_turns_on_another_radius(aside: float):
    flown = calm(SIGMA)
    core, truth = flown.env.unwrapped.core, flown.history["truth"].copy()
    task = core.task
    scenario = task.scenario_of(flown.history["reference"][0])
    for k in range(len(truth)):
        x, y, direction = task.nominal(scenario, np.full(len(scenario), k))[:, :3].T
        truth[k, :, 0], truth[k, :, 1] = (
            x - aside * np.sin(direction),
            y + aside * np.cos(direction),
        )
        truth[k, :, 2] = direction
    figures = scores(_with(flown, truth=truth))
    np.testing.assert_allclose(figures["track_error"], abs(aside), rtol=0, atol=0.02)
    other = 100.0 * np.abs(
        aside * scenario[:, 2]
    )  # the circle's radius is as much smaller or larger
    np.testing.assert_allclose(figures["radius_error"], other, rtol=0, atol=0.05)
    np.testing.assert_allclose(figures["out_of_round"], 0.0, atol=0.05)


def test_nees_is_the_squared_error_in_units_of_the_covariance(flown):
    perfect = _perfect(flown)
    h = perfect.history
    sd = np.array([0.1, 0.01, 0.02])
    covariance = np.broadcast_to(np.diag(sd**2), h["covariance"].shape)
    claimed = _with(perfect, covariance=covariance, estimate=h["estimate"] + 2.0 * sd)
    np.testing.assert_allclose(scores(claimed)["nees"], 4.0)
    assert consistency(claimed) == 0.0


def test_an_honest_filter_lies_in_its_band_nearly_always(flown):
    perfect = _perfect(flown)
    h = perfect.history
    rng = np.random.default_rng(0)
    honest = _with(
        perfect,
        covariance=np.broadcast_to(np.eye(3) * 1e-4, h["covariance"].shape),
        estimate=h["estimate"] + 1e-2 * rng.standard_normal(h["estimate"].shape),
    )
    assert 0.92 < consistency(honest) < 0.98


@pytest.mark.parametrize("estimator", ["truth", "measurement"])
def test_estimators_that_claim_no_covariance_have_no_nees(estimator):
    flight = rollout("autopilot", HEADING_SHIP.name, [0, 1], {"estimator": estimator})
    assert np.isnan(scores(flight)["nees"]).all()
    assert consistency(flight) is None


def test_filters_that_estimate_no_input_have_no_error_of_it():
    flight = rollout("autopilot", HEADING_SHIP.name, [0, 1], {"estimator": "kf"})
    figures = scores(flight)
    assert np.isnan(figures["input_rmse"]).all()
    assert np.isfinite(figures["raw_input_rmse"]).all()


def test_the_oracle_has_no_error():
    figures = scores(rollout("autopilot", HEADING_SHIP.name, [0, 1], {"estimator": "truth"}))
    for key in ("heading_rmse", "yaw_rate_rmse", "sway_rmse", "input_rmse"):
        np.testing.assert_allclose(figures[key], 0.0, atol=1e-9)
