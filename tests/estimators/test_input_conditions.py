"""Conditions for an unknown input: ranks, deviations and zeros of systems built to have them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, solve_discrete_are

from estimators import Gaussian, InputConditions, input_conditions, make
from tests.estimators.cases import random_covariance, unknown_input_system

POLES = (0.9, 0.5, -0.3)


def _with_zeros(
    *numerators: tuple[float, ...], poles: tuple[float, ...] = POLES
) -> tuple[np.ndarray, ...]:
    """``A, C, G, H`` of one input and as many measurements, each of which has these zeros."""
    denominator, n = np.poly(poles), len(poles)
    A = np.eye(n, k=1)
    A[-1] = -denominator[:0:-1]
    C, H = np.zeros((len(numerators), n)), np.zeros((len(numerators), 1))
    for i, zeros in enumerate(numerators):
        numerator = np.poly(zeros) if len(zeros) else np.ones(1)
        numerator = np.concatenate([np.zeros(n + 1 - len(numerator)), numerator])
        H[i] = numerator[0]
        C[i] = (numerator[1:] - numerator[0] * denominator[1:])[::-1]
    return A, C, np.eye(n, 1, 1 - n), H


def _conditions(
    system: tuple[np.ndarray, ...], seed: int = 0, prior: float = 1.0
) -> InputConditions:
    """Of a system in other coordinates of its states, and other sums of measurements and inputs."""
    A, C, G, H = system
    rng = np.random.default_rng(seed)
    x, y, d = (random_covariance(rng, k) for k in (len(A), *H.shape))
    back = np.linalg.inv(x)
    system = x @ A @ back, y @ C @ back, x @ G @ d, y @ H @ d
    return input_conditions(
        *system, random_covariance(rng, len(A)), random_covariance(rng, len(C)), prior
    )


def _assert_zeros(found: np.ndarray, *expected: complex) -> None:
    np.testing.assert_allclose(np.poly(found), np.poly(expected), rtol=0, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "zeros", [(), (1.5,), (-0.4, 1.1), (2.0, 0.6, -0.1), (1.2, 0.5 + 1.0j, 0.5 - 1.0j)]
)
def test_the_zeros_are_those_of_the_transfer_function(zeros: tuple[complex, ...], seed: int):
    """It shows at once with as many zeros as poles, one step later with one less."""
    found = _conditions(_with_zeros(zeros), seed)
    _assert_zeros(found.zeros, *zeros)
    assert found.rank == np.isfinite(found.sd).all() == (len(zeros) >= 2)


@pytest.mark.parametrize("seed", range(3))
def test_of_several_measurements_the_common_zeros_are_left(seed: int):
    _assert_zeros(_conditions(_with_zeros((1.4, 0.3), (1.4, -0.6)), seed).zeros, 1.4)
    _assert_zeros(_conditions(_with_zeros((1.4, 0.3), (-0.6, 0.1, 0.7), (0.3,)), seed).zeros)


@pytest.mark.parametrize("seed", range(3))
def test_inputs_side_by_side_have_the_zeros_of_each(seed: int):
    parts = _with_zeros((1.4, 0.3, 0.8)), _with_zeros((0.1, -1.2), poles=(0.2, 0.6, -0.8))
    A, C, G, H = (block_diag(*matrices) for matrices in zip(*parts, strict=True))
    found = _conditions((A, C, G, H), seed)
    _assert_zeros(found.zeros, 1.4, 0.3, 0.8, 0.1, -1.2)
    assert found.rank == 2
    # With the second measurement lost, no number tells the two apart.
    found = _conditions((A, C[:1], G, H[:1]), seed)
    assert np.isnan(found.zeros).all()
    assert found.rank == 1
    assert np.isinf(found.sd).all()


def test_an_unobservable_mode_is_no_zero_of_the_input():
    A, C, G, H = _with_zeros((0.4, 0.3))
    A, C = block_diag(A, np.diag([1.0, 0.7])), np.hstack([C, np.zeros((1, 2))])
    for hidden in ([[0.0], [0.0]], [[2.0], [1.0]]):
        _assert_zeros(_conditions((A, C, np.vstack([G, hidden]), H)).zeros, 0.4, 0.3)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["kf-umv-ui", "kf-umv-ui-wdf"])
def test_deviations_are_those_of_one_step_from_the_steady_kf(name: str, seed: int):
    model = unknown_input_system(seed, name == "kf-umv-ui", p=4, q=2).model
    prior = np.array([[9.0, 2.0], [2.0, 4.0]])
    found = input_conditions(model.A, model.C, model.G, model.H, model.Q, model.R, prior)
    assert found.rank == 2
    assert np.abs(found.zeros).max(initial=0.0) < 1.0
    P = solve_discrete_are(model.A.T, model.C.T, model.Q, model.R)
    filter = make(name, replace(model, B=None), input_prior=1e6 * prior)
    belief = filter.init(Gaussian(np.zeros(4), P))
    if filter.input_delay:
        # as if d acted on a state that was known so well that the prediction is as uncertain as P
        belief = filter.predict(belief).replace(cov=P)
    cov = filter.update(belief, np.zeros(4)).input_cov
    np.testing.assert_allclose(found.sd, np.sqrt(np.diag(cov) / np.diag(prior)), rtol=1e-5)


def test_without_a_steady_state_deviations_are_of_measurements():
    """A mode that grows and that no measurement shows."""
    A, C, G, H = _with_zeros((0.4, 0.3))
    A, C, G = block_diag(A, 1.1), np.hstack([C, [[0.0]]]), np.vstack([G, [[0.0]]])
    found = input_conditions(A, C, G, H, np.eye(4), [[0.25]], 4.0)
    np.testing.assert_allclose(found.sd, 0.5 / np.abs(C @ G).ravel() / 2.0, rtol=1e-9)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"A": np.zeros((2, 3, 3))}, r"A must have shape \(n, m\)"),
        ({"R": [[0.0]]}, "not positive definite"),
        ({"prior": -1.0}, "prior must be positive semidefinite"),
    ],
)
def test_what_is_no_single_system_is_refused_in_a_sentence(changes: dict, sentence: str):
    system = dict(zip("ACGH", _with_zeros((0.4, 0.3)), strict=True))
    given = system | {"Q": np.eye(3), "R": np.eye(1), "prior": 1.0} | changes
    with pytest.raises(ValueError, match=sentence):
        input_conditions(**given)
