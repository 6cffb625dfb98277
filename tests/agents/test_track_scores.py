"""What a turn on a track is scored by: figures of flights whose errors are known."""

from dataclasses import replace

import numpy as np
import pytest

from agents import Rollout, rollout
from agents.metrics import metrics, scores

SEEDS = [3, 4, 5]
ESTIMATED = ("x", "y", "psi", "u", "v", "r", "current north", "current east")


@pytest.fixture(scope="module")
def flown() -> Rollout:
    return rollout("autopilot", "SigmaCorvette-v0", SEEDS, {"disturbance": "calm"})


def _with(flown: Rollout, **history: np.ndarray) -> Rollout:
    return replace(flown, history=flown.history | history)


def _perfect(flown: Rollout) -> Rollout:
    """The same flight, had the filter known everything."""
    h, core = flown.history, flown.env.unwrapped.core
    assert core.composition.names == ESTIMATED
    return _with(flown, estimate=core.estimated(h["truth"]), input_estimate=h["unknown_input"].copy())


def test_every_metric_has_a_value_for_every_episode(flown: Rollout):
    figures = scores(flown)
    assert set(figures) == {m.key for m in metrics(flown.env.unwrapped.system)}
    for values in figures.values():
        assert values.shape == (3,)
        assert np.isfinite(values).all()


def test_a_perfect_estimate_has_no_error_and_no_nees(flown: Rollout):
    figures = scores(_perfect(flown))
    for key in (
        "position_rmse", "current_rmse", "heading_rmse", "yaw_rate_rmse", "sway_rmse", "input_rmse", "nees",
        "position_nees",
    ):  # fmt: skip
        np.testing.assert_array_equal(figures[key], 0.0)


@pytest.mark.parametrize(
    ("names", "key", "expected"),
    [(("x", "y"), "position_rmse", 0.02 * np.sqrt(2.0)), (("current north",), "current_rmse", 0.02),
     (("psi",), "heading_rmse", 20.0), (("r",), "yaw_rate_rmse", 20.0), (("v",), "sway_rmse", 0.02)],
)  # fmt: skip
def test_a_constant_offset_is_the_rmse_of_its_components(
    flown: Rollout, names: tuple[str, ...], key: str, expected: float
):
    perfect = _perfect(flown)
    figures = scores(_with(perfect, estimate=perfect.history["estimate"] + 0.02 * np.isin(ESTIMATED, names)))
    np.testing.assert_allclose(figures[key], expected, rtol=1e-6)
    others = {"position_rmse", "current_rmse", "heading_rmse", "yaw_rate_rmse", "sway_rmse"} - {key}
    for other in others:
        np.testing.assert_array_equal(figures[other], 0.0)


def test_errors_of_the_input_are_those_of_the_estimate(flown: Rollout):
    figures = scores(_with(flown, input_estimate=flown.history["unknown_input"] + 3e-3))
    np.testing.assert_allclose(figures["input_rmse"], 3.0)


@pytest.mark.parametrize("aside", [0.0, 25.0, -40.0])
def test_a_ship_beside_its_track_is_as_far_off_and_turns_on_another_radius(flown: Rollout, aside: float):
    core, truth = flown.env.unwrapped.core, flown.history["truth"].copy()
    task = core.task
    course = task.course_of(flown.history["reference"][0])
    for k in range(len(truth)):
        x, y, direction = task.nominal(course, np.full(len(course), k))[:, :3].T
        truth[k, :, 0], truth[k, :, 1] = x - aside * np.sin(direction), y + aside * np.cos(direction)
        truth[k, :, 2] = direction
    figures = scores(_with(flown, truth=truth))
    np.testing.assert_allclose(figures["track_error"], abs(aside), rtol=0, atol=0.02)
    other = 100.0 * np.abs(aside * course[:, 2])  # the circle's radius is as much smaller or larger
    np.testing.assert_allclose(figures["radius_error"], other, rtol=0, atol=0.05)
    np.testing.assert_allclose(figures["out_of_round"], 0.0, atol=0.05)


def test_roll_and_rudder_rate_are_those_of_the_ship(flown: Rollout):
    truth = flown.history["truth"].copy()
    truth[..., 6] = np.deg2rad(-2.0)
    ramp = np.deg2rad(0.2) * np.arange(601.0)[:, None, None] * np.ones((1, 3, 1))
    figures = scores(_with(flown, truth=truth, actuators=ramp))
    np.testing.assert_allclose(figures["roll"], 2.0)
    np.testing.assert_allclose(figures["rudder_rate"], 0.4)
