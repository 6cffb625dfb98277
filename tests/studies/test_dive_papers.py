"""The papers on underwater vehicles: their dives, and what errors are relative to."""

from dataclasses import replace

import numpy as np
import pytest

from estimators import Gaussian, LinearModel, make
from studies.papers import settings
from studies.papers.dive import Experiment
from studies.papers.itsunusa import experiment as itsunusa
from studies.papers.segorogeni import experiment as segorogeni
from vessel_gym.vehicles.itsunusa import STATE as DIVER
from vessel_gym.vehicles.segorogeni import STATE

TRIAL = segorogeni.read(settings("segorogeni")["trial"])
DIVE = settings("itsunusa")["trial"]
PLACE = [STATE.index(name) for name in ("x", "y", "z", "psi")]


def decay(states: np.ndarray, control: np.ndarray) -> np.ndarray:
    """A state that decays to its control, and one that integrates it."""
    after = np.array(states)
    after[..., 0] = 0.9 * states[..., 0] + 0.1 * control[..., 0]
    after[..., 1] += 0.1 * states[..., 0]
    return after


def test_measurements_and_process_have_the_noise_that_the_filter_assumes():
    watched = Experiment(
        decay, np.zeros(2), np.ones((200, 1)), [0], [0], np.array([0.02]), np.array([0.3]), np.array([0.1])
    )  # fmt: skip
    truth, measurements = watched.run(200, np.random.default_rng(0))
    noise = measurements - truth[1:, :, :1]
    process = truth[1:, :, 0] - decay(truth[:-1], watched.controls[:, None])[..., 0]
    assert noise.std() == pytest.approx(0.3, rel=0.02)
    assert process.std() == pytest.approx(0.02, rel=0.02)
    assert watched.model.Q[0, 0] == pytest.approx(0.02**2)
    quiet = replace(watched, process_sd=np.zeros(1), measurement_sd=np.zeros(1)).run(
        2, np.random.default_rng(0)
    )
    np.testing.assert_allclose(quiet.truth[:, 0], watched.planned)


@pytest.mark.slow
@pytest.mark.parametrize(("own", "tolerance"), [(True, 1e-6), (False, 0.01)])
def test_the_planned_path_of_segorogeni_goes_from_rest_to_the_papers_goal(
    own: bool, tolerance: float
):
    dive = segorogeni.dive(TRIAL, own)
    np.testing.assert_allclose(dive.planned[-1, PLACE[:3]], TRIAL.goal, atol=tolerance)
    assert dive.controls[0, 0] == pytest.approx(np.deg2rad(5.0))


def test_both_steps_have_the_same_white_noise_and_a_factor_scales_it():
    own, printed = (segorogeni.dive(TRIAL, each) for each in (True, False))
    np.testing.assert_allclose(
        own.process_sd**2 / segorogeni.OWN_STEP, printed.process_sd**2 / TRIAL.step
    )
    np.testing.assert_allclose(
        own.measurement_sd**2 * segorogeni.OWN_STEP, printed.measurement_sd**2 * TRIAL.step
    )
    np.testing.assert_allclose(
        segorogeni.dive(TRIAL, True, process=3.0).process_sd, 3.0 * own.process_sd
    )
    assert [STATE[own.estimated[i]] for i in own.measured] == ["u", "v", "w", "r"]


def test_true_velocities_integrate_to_the_true_position():
    dive = segorogeni.dive(TRIAL, True)
    truth = dive.run(3, np.random.default_rng(0)).truth
    np.testing.assert_allclose(
        segorogeni.positions(dive, truth[..., dive.estimated]), truth[..., PLACE], atol=1e-9
    )
    diver = itsunusa.dive(DIVE)
    truth = diver.run(3, np.random.default_rng(0)).truth
    depths = itsunusa.depths(diver, truth[..., diver.estimated])
    np.testing.assert_allclose(depths, truth[..., DIVER.index("z")], atol=1e-9)


@pytest.mark.slow
def test_against_the_planned_path_the_error_is_the_vehicles_and_hardly_the_filters():
    """What explains that members and measurements do not matter in the paper's Table III."""
    trial = TRIAL._asdict()
    large, exact = (segorogeni.estimate(True, members, 10, 0, trial) for members in (200, 0))
    planned, true = (exact[reference].mean(0) for reference in segorogeni.REFERENCES)
    assert (planned > 2.0 * true).all()
    np.testing.assert_allclose(large["planned path"].mean(0), planned, rtol=0.05)
    louder = segorogeni.estimate(True, 0, 10, 0, trial, process=2.0)
    np.testing.assert_allclose(louder["planned path"].mean(0) / planned, 2.0, rtol=0.2)


@pytest.mark.slow
def test_the_undisturbed_dive_of_itsunusa_goes_from_rest_to_20_m():
    dive = itsunusa.dive(DIVE)
    np.testing.assert_allclose(
        dive.planned[-1, [DIVER.index("x"), DIVER.index("z")]], [60.0, 20.0], atol=0.2
    )
    assert round(itsunusa.VEHICLE.body.mass) == 96


@pytest.mark.slow
def test_depth_is_far_better_known_where_pitch_is_measured_and_noise_scales_the_motions():
    without, measured, louder = (
        itsunusa.estimate("ekf", 0, 10, 0, DIVE, **options)["rmse"].mean(0)
        for options in ({}, {"measured": 4}, {"process": 2.0, "measurement": 2.0})
    )
    assert measured[3] < 0.3 * without[3]
    np.testing.assert_allclose(louder[:3] / without[:3], 2.0, rtol=0.02)


def test_the_published_square_root_keeps_the_second_moments_about_the_analysis_and_moves_the_mean():
    """By about a quarter of the spread at ten members, root mean square over runs and components."""
    runs, members = 4000, 10
    model = LinearModel(A=np.eye(3), C=np.eye(2, 3), Q=np.eye(3), R=np.eye(2))
    published, rng = itsunusa.PublishedSquareRootFilter(model, members), np.random.default_rng(0)
    symmetric = make("enkf-sr", model, members=members, draws="independent")
    before = published.init(Gaussian(np.zeros((runs, 3)), np.eye(3)), rng=rng)
    after, expected = (
        filter.update(before, np.zeros(2), rng=rng) for filter in (published, symmetric)
    )
    about = after.ensemble - expected.mean[:, None]
    np.testing.assert_allclose(about.mT @ about / (members - 1), expected.cov, rtol=0, atol=1e-12)
    shift = (after.mean - expected.mean) / np.sqrt(np.diagonal(expected.cov, axis1=-2, axis2=-1))
    assert 0.2 < np.sqrt((shift**2).mean()) < 0.32
