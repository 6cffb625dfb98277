"""The papers on underwater vehicles: their dives, and what errors are relative to."""

import numpy as np
import pytest

from agents.papers import settings
from agents.papers.itsunusa import experiment as itsunusa
from agents.papers.segorogeni import experiment as segorogeni
from estimators import Gaussian, LinearModel, make

TRIAL = segorogeni.read(settings("segorogeni")["trial"])
DIVE = settings("itsunusa")["trial"]


@pytest.mark.parametrize("case", ["own step", "printed step", "itsunusa"])
def test_truth_and_measurements_have_the_assumed_noise(case: str):
    own, integrated, place, goal = True, segorogeni.positions, segorogeni._PLACE, TRIAL.goal
    if case == "itsunusa":
        dive, integrated, place = itsunusa.dive(DIVE, 4), itsunusa.scored, itsunusa._SCORED
        goal = 20.0
    else:
        own = case == "own step"
        dive = segorogeni.dive(TRIAL._replace(step=0.05), own)
    truth, measurements = dive.simulate(30, np.random.default_rng(0))
    states = truth[..., dive.estimated]
    process = states[1:] - dive.advance(truth[:-1], dive.controls[:, None])[..., dive.estimated]
    noise = measurements - states[1:][..., dive.measured]
    for of, cov in ((process, dive.model.Q), (noise, dive.model.R)):
        np.testing.assert_allclose(of.std((0, 1)), np.diagonal(cov) ** 0.5, rtol=0.03, atol=1e-12)
    if own:  # true velocities integrate to the true position
        np.testing.assert_allclose(integrated(dive, states), truth[..., place], atol=1e-9)
        end = dive.planned[-1, place][-1 if case == "itsunusa" else slice(3)]
        np.testing.assert_allclose(end, goal, atol=0.2 if case == "itsunusa" else 1e-6)


def test_the_published_square_root_moves_the_mean():
    """By about a quarter of the spread at ten members, root mean square over runs and components."""
    model = LinearModel(A=np.eye(3), C=np.eye(2, 3), Q=np.eye(3), R=np.eye(2))
    published, symmetric = (
        make("enkf-sr", model, members=10, draws="independent", as_printed=way)
        for way in (True, False)
    )
    rng = np.random.default_rng(0)
    before = published.init(Gaussian(np.zeros((4000, 3)), np.eye(3)), rng=rng)
    after, expected = (each.update(before, np.zeros(2), rng=rng) for each in (published, symmetric))
    about = after.ensemble - expected.mean[:, None]
    np.testing.assert_allclose(about.mT @ about / 9, expected.cov, rtol=0, atol=1e-12)
    shift = (after.mean - expected.mean) / np.sqrt(np.diagonal(expected.cov, axis1=-2, axis2=-1))
    assert 0.2 < np.sqrt((shift**2).mean()) < 0.32
