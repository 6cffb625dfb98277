"""What the papers on ensembles share: runs that any filter may watch, and trends over the number of members."""

import numpy as np
import pytest

from agents.reproduction.comparison import Published
from agents.reproduction.ensembles import Experiment, channel_sd, rms, seconds_a_step, thinned
from agents.reproduction.pages.ensembles import (
    change,
    comparisons,
    exponents,
    growth_table,
    printed_slopes,
    slope,
    slopes,
    time_comparisons,
    verdict,
)
from agents.statistics import Interval
from estimators import make
from vessel_gym.vehicles.segorogeni import Segorogeni

MEMBERS = (10, 20, 50)
PRINTED = {
    members: {
        "x": Published(f"{1.0 / members:.6f}", "m", "Table 1"),
        "time": Published(str(members), "s", "Table 1"),
    }
    for members in MEMBERS
}


def decay(states: np.ndarray, control: np.ndarray) -> np.ndarray:
    """A state that decays to its control, and one that integrates it."""
    after = np.array(states)
    after[..., 0] = 0.9 * states[..., 0] + 0.1 * control[..., 0]
    after[..., 1] += 0.1 * states[..., 0]
    return after


def experiment() -> Experiment:
    """200 steps of it, of which a filter estimates the first component."""
    return Experiment(
        decay, np.zeros(2), np.ones((200, 1)), [0], [0], np.array([0.02]), np.array([0.3]), np.array([0.1])
    )  # fmt: skip


# --- flights ------------------------------------------------------------------------------------------


def test_readings_and_kicks_have_the_noise_that_the_filter_is_told():
    watched = experiment()
    truth, readings = watched.fly(200, np.random.default_rng(0))
    noise = readings - truth[1:, :, :1]
    kicks = truth[1:, :, 0] - decay(truth[:-1], watched.controls[:, None])[..., 0]
    assert noise.std() == pytest.approx(0.3, rel=0.02)
    assert abs(noise.mean()) < 0.01
    assert kicks.std() == pytest.approx(0.02, rel=0.02)
    assert abs(kicks.mean()) < 0.001
    assert watched.model.Q[0, 0] == pytest.approx(0.02**2)
    assert watched.model.R[0, 0] == pytest.approx(0.3**2)


def test_what_no_filter_estimates_is_not_kicked():
    truth, _ = experiment().fly(3, np.random.default_rng(1))
    np.testing.assert_allclose(np.diff(truth[..., 1], axis=0), 0.1 * truth[:-1, :, 0], atol=1e-12)


def test_flights_depend_on_the_seed_alone():
    first, second = (experiment().fly(4, np.random.default_rng(7)) for _ in range(2))
    np.testing.assert_array_equal(first.truth, second.truth)
    np.testing.assert_array_equal(first.readings, second.readings)


@pytest.mark.slow
def test_a_large_ensemble_estimates_like_the_exact_filter():
    watched = experiment()
    truth, readings = watched.fly(20, np.random.default_rng(2))
    exact = watched.estimates(make("ekf", watched.model), readings, np.random.default_rng(3))
    sampled = watched.estimates(make("enkf", watched.model, members=2000), readings, np.random.default_rng(3))
    assert rms(sampled - exact).max() < 0.1 * rms(exact - truth[..., :1]).min()
    assert rms(exact[1:] - truth[1:, :, :1]).max() < rms(readings - truth[1:, :, :1]).min()


def test_a_step_takes_some_time_for_every_size_and_repeat():
    watched = experiment()
    seconds = seconds_a_step(watched, lambda n: make("enkf", watched.model, members=n), MEMBERS, 5, 3, 0)
    assert seconds.shape == (3, len(MEMBERS))
    assert (seconds > 0.0).all()


def test_noise_of_channels_is_found_by_name():
    np.testing.assert_array_equal(channel_sd(Segorogeni.sensors, ("r", "z")), [0.005, 0.02])


def test_a_thinned_history_keeps_its_ends():
    history = np.arange(1000.0)
    short = thinned(history, 7)
    assert len(short) == 7
    assert short[0] == history[0]
    assert short[-1] == history[-1]
    np.testing.assert_array_equal(thinned(history[:5], 7), history[:5])


# --- trends -------------------------------------------------------------------------------------------


def test_a_power_law_has_its_exponent():
    assert exponents(MEMBERS, np.array(MEMBERS) ** -0.5) == pytest.approx(-0.5)
    assert printed_slopes(PRINTED) == pytest.approx({"x": -1.0, "time": 1.0}, abs=1e-4)


def test_how_hard_a_run_is_does_not_blur_the_trend_over_its_members():
    hard = np.exp(np.random.default_rng(4).normal(size=(30, 1)))
    trend = slope(MEMBERS, hard * np.array(MEMBERS) ** -0.1)
    assert trend is not None
    assert trend.mean == pytest.approx(-0.1)
    assert trend.half < 1e-9


def test_the_last_slope_is_that_of_the_geometric_mean():
    falling = {n: np.stack([np.full(5, n**-1.0), np.full(5, n**-0.5)], -1) for n in MEMBERS}
    found = [each.mean for each in slopes(falling) if each is not None]
    assert found == pytest.approx([-1.0, -0.5, -0.75])


@pytest.mark.parametrize(
    ("trend", "words"),
    [
        (Interval(-0.1, -0.2, -0.01), "true"),
        (Interval(0.1, 0.01, 0.2), "false"),
        (Interval(-0.1, -0.2, 0.01), "undecided, no detectable difference"),
        (None, "undecided, no detectable difference"),
    ],
)
def test_a_fall_is_true_only_beyond_doubt(trend: Interval | None, words: str):
    assert verdict(trend, -1) == words


def test_an_exponent_in_words_is_a_change_between_two_sizes():
    assert change(Interval(-0.5, -1.0, 0.0), 100, 400) == "−50.0 % (−75.0 to 0.0 %)"


def test_every_published_number_is_compared_and_times_are_not():
    errors = {n: np.array([[0.9 / n], [1.0 / n]]) for n in MEMBERS}
    found = comparisons(PRINTED, errors, {})
    assert [(c.row, c.column, c.kind) for c in found] == [(f"{n} members", "x", "at or below") for n in MEMBERS]
    times = time_comparisons(PRINTED, "time", np.full((2, 3), 0.5))
    assert [(c.row, c.column, c.kind) for c in times] == [(f"{n} members", "time", "not comparable") for n in MEMBERS]


def test_an_error_above_the_published_one_needs_a_reason():
    errors = {n: np.array([[2.0 / n], [2.1 / n]]) for n in MEMBERS}
    with pytest.raises(ValueError, match="say why"):
        comparisons(PRINTED, errors, {})
    assert comparisons(PRINTED, errors, {"x": "half the fixes"})[0].kind == "above"


def test_the_exponents_of_all_columns_stand_in_one_table():
    errors = {n: np.full((3, 1), n**-0.25) for n in MEMBERS}
    published, ours = growth_table("", "", PRINTED, {"ours": errors}).rows()[1:]
    assert published == ["published", "−1.000", "–"]
    assert [text.split(" ")[0] for text in ours[1:]] == ["−0.250", "−0.250"]
