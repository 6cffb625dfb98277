"""The thesis on the corvette: its experiment, and what was probably done."""

from typing import Any

import numpy as np
import pytest

from studies.papers import settings
from studies.papers.corvette import experiment
from vessel_gym.core import Core
from vessel_gym.envs.thesis_corvette import THESIS_CORVETTE
from vessel_gym.tasks.turning_trial import SAMPLES
from vessel_gym.vehicles.corvette_thesis import SIMULATIONS

S = settings("corvette")


@pytest.mark.parametrize("simulation", SIMULATIONS)
def test_a_printed_mean_is_that_of_its_three_runs(simulation: str):
    printed = S["printed"][simulation]
    for runs, mean in zip(
        (printed["heading"], printed["unknown_input"]), printed["means"], strict=True
    ):
        assert np.mean([float(run) for run in runs]) == pytest.approx(
            float(mean), abs=0.00005 + 1e-9
        )


def flown(
    simulation: str, noise: np.ndarray, d: np.ndarray, rudder: float = 0.8, **options: Any
) -> Any:
    """Errors ``(2, rows, T)`` of heading and d of ``ThesisCorvette-v0``, given the noise ``(rows, T, 2)`` and d."""
    core = Core(THESIS_CORVETTE, len(noise), estimator_options=options)
    core.seed(0)
    rudders = np.full((len(noise), 1), rudder)
    heading = experiment.RECORD if rudder else np.zeros(SAMPLES)
    y = experiment.measurements(heading, d, noise)
    errors = np.empty((2, len(noise), SAMPLES))
    for k in range(SAMPLES):
        measurements = y[:, k], np.ones((len(noise), 2))
        if k:
            core.step(rudders, measurements)
        else:
            core.reset(options={"simulation": simulation}, measurements=measurements)
        errors[0, :, k] = core.belief.mean[:, 2] - core.truth[:, 2]
        errors[1, :, k] = core.belief.input_mean[:, 0] - d[k]
    return errors


@pytest.mark.parametrize("model", experiment.MODELS)
@pytest.mark.parametrize("simulation", SIMULATIONS)
def test_after_the_update_the_errors_of_heading_and_d_add_up_to_the_noise(
    simulation: str, model: str
):
    """The law by which the updated headings cannot be the printed ones."""
    noise = 0.01 * np.random.default_rng(1).standard_normal((3, SAMPLES, 2))
    errors = flown(simulation, noise, step_of(0.05, 98), model=model)
    np.testing.assert_allclose(errors[0] + 2.0 * errors[1], noise.sum(-1), rtol=0, atol=1e-12)


def step_of(size: float, switch: int) -> np.ndarray:
    return np.where(np.arange(SAMPLES) < switch, size, -size)


def test_errors_do_not_depend_on_a_d_that_drives_the_heading_and_grow_with_one_that_does_not():
    small, large = (experiment.driven(name, 3, 0)["rmse"] for name in ("I", "V"))
    np.testing.assert_allclose(small, large, rtol=0, atol=1e-10)
    small, large = (experiment.simulate(name, "as-printed", 3, 0)["rmse"] for name in ("I", "V"))
    assert (large > 2.0 * small).all()


PAGE = {
    "I": (0.002916, 0.001517), "II": (0.000843, 0.000598), "III": (0.011086, 0.005558), "IV": (0.002936, 0.001527),
    "V": (0.030515, 0.015263),
}  # fmt: skip
"""RMSE [rad] of heading and d with the corrected filter, as the page shows them for seeds from 0 on."""


@pytest.mark.parametrize("simulation", SIMULATIONS)
def test_a_thousand_runs_of_thesis_corvette_have_the_errors_of_the_page(simulation: str):
    """With other seeds: within five standard deviations of a difference of two means, false alarm 6e-7 each."""
    rmse = experiment.simulate(simulation, "corrected", 1000, 5000)["rmse"]
    spread = np.sqrt(2.0 / 1000.0) * rmse.std(-1, ddof=1)
    assert (np.abs(rmse.mean(-1) - PAGE[simulation]) < 5.0 * spread + 5e-7).all()


# --- combinations of choices ----------------------------------------------------------------------


@pytest.mark.parametrize("simulation", SIMULATIONS)
@pytest.mark.parametrize("prior", [1e-3, 1.0])
def test_the_gains_of_a_combination_are_those_of_kf_umv_ui(simulation: str, prior: float):
    """An independent implementation: the package's filter, run on the same record, d and noise."""
    s, rng = SIMULATIONS[simulation], np.random.default_rng(3)
    d, noise = step_of(s.size, 50), 0.01 * rng.standard_normal((2, SAMPLES, 2))
    noise += np.cumsum(
        rng.normal(0.0, 0.01, (SAMPLES, 2)), 0
    )  # below half a turn, what is measured may be anything
    filter = experiment.recursion(s, "cited", "update", prior)
    still = np.zeros((2, SAMPLES))
    found = experiment.respond(
        filter, "update", still, experiment.measurements(still, d, noise), np.zeros(3)
    )
    factor = {"assume": {"prior": prior / experiment.PRIOR}}
    expected = flown(simulation, noise, d, rudder=0.0, model="as-printed", **factor)
    np.testing.assert_allclose(found[0], expected[0], atol=1e-9)
    np.testing.assert_allclose(found[1] - d, expected[1], atol=1e-9)


def test_a_combination_of_choices_is_what_the_filter_does():
    """The baseline combination has the errors of the experiment as it was set up before the search."""
    first = {name: choice["first"] for name, choice in S["open"].items()}
    found = experiment.explain(first, 200, 0)
    for name in SIMULATIONS:
        expected = experiment.simulate(name, "as-printed", 200, 1)["rmse"]
        np.testing.assert_allclose(found[name].mean(-1), expected.mean(-1), rtol=0.02)


@pytest.mark.parametrize("prior", [1e-3, 1.0])
@pytest.mark.parametrize("simulation", ["I", "III"])
def test_of_a_wrong_first_heading_d_takes_the_share_that_the_page_states(
    simulation: str, prior: float
):
    filter = experiment.recursion(SIMULATIONS[simulation], "cited", "update", prior)
    wrong = np.array([0.0, 0.0, 0.1])
    found = experiment.respond(
        filter, "update", np.zeros((1, SAMPLES)), np.zeros((1, SAMPLES, 2)), wrong
    )
    R = SIMULATIONS[simulation].R
    assert found[1, 0, 0] == pytest.approx(-R / (prior + 2.0 * R) * 0.1)
