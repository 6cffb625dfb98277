"""The thesis on the corvette: its experiment, and what was probably done."""

import numpy as np
import pytest

from agents.papers import settings
from agents.papers.corvette import experiment
from vessel_gym.tasks.turning import SAMPLES
from vessel_gym.vehicles.corvette_thesis import SIMULATIONS

FIRST = {name: choice["first"] for name, choice in settings("corvette")["open"].items()}


@pytest.mark.parametrize("simulation", SIMULATIONS)
def test_errors_of_heading_and_d_add_up_to_the_noise(simulation: str):
    """The law by which the updated headings cannot be the printed ones."""
    rng, s, heading = np.random.default_rng(1), SIMULATIONS[simulation], experiment.RECORD
    d, noise = rng.normal(size=SAMPLES), 0.01 * rng.standard_normal((3, SAMPLES, 2))
    start = 0.1 * rng.standard_normal((3, 3))
    of = experiment.follow(s, 1.0, start, heading, d, noise)
    found = of.mean[..., 2].T - heading + 2.0 * (of.input_mean[..., 0].T - d)
    np.testing.assert_allclose(found, noise.sum(-1), rtol=0, atol=1e-12)
    # of a wrong first heading d takes the share that the page states
    wrong = experiment.follow(s, 1.0, start, heading, d, 0.0 * noise).input_mean[0, :, 0] - d[0]
    expected = -s.R / (1.0 + 2.0 * s.R) * (start[:, 2] - heading[0])
    np.testing.assert_allclose(wrong, expected, rtol=1e-9)


def test_errors_do_not_depend_on_a_d_that_drives_the_heading():
    of = experiment.explain(FIRST | {"drives": 1.0}, 3, 0)
    np.testing.assert_allclose(of["I"], of["V"], rtol=0, atol=1e-10)


def test_a_combination_of_choices_is_what_the_filter_does():
    """The baseline combination has the errors of the experiment as it was set up before the search."""
    for name, found in experiment.explain(FIRST, 200, 0).items():
        expected = experiment.simulate(name, "as_printed", 200, 1)
        np.testing.assert_allclose(found.mean(-1), expected.mean(-1), rtol=0.02)
