"""What a model accepts, what it refuses and in which words, and how a continuous one becomes discrete."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from estimators import (
    Gaussian,
    LinearModel,
    NonlinearModel,
    Schedule,
    StateNoise,
    compiled,
    forward_euler,
    make,
    van_loan,
    wrap,
    zero_order_hold,
)
from tests.estimators.cases import assert_same, random_covariance, random_transition

I2 = np.eye(2)
FINE = {"A": I2, "C": [[1.0, 0.0]], "Q": I2, "R": [[1.0]]}


# --- covariances whose variances differ -----------------------------------------------------------


@pytest.mark.parametrize(
    "cov",
    [
        np.diag([1e6, -1e-4]),
        [[1e12, 0.0, 0.0], [0.0, 1.0, 2.0], [0.0, 2.0, 1.0]],
        [[[1e12]], [[-1.0]]],
        [[1e-20, 2e-5], [2e-5, 1.0]],
        [[0.0, 1e-6], [1e-6, 1.0]],
        [[0.0, 1e-30], [1e-30, 1.0]],
        [[1.0, 1e160], [1e160, 5e-324]],
        np.diag([1e12, -1e-3]),
        np.diag([1.0, -1e-17]),
        [[1e12, 0.0, 0.0], [0.0, 1e-3, 2e-3], [0.0, 2e-3, 1e-3]],
        np.outer([1e6, 1.0, 1e-6], [1e6, 1.0, 1e-6]) * (1.9 * np.eye(3) - 0.9),
    ],
)
def test_a_covariance_is_judged_by_the_variances_of_its_own_rows(cov: list):
    cov = np.asarray(cov)
    with pytest.raises(ValueError, match=r"^cov must be positive semidefinite.*eigenvalue"):
        Gaussian(np.zeros(cov.shape[-1]), cov)


@pytest.mark.parametrize("rank", [1, 3, 5])
def test_a_covariance_of_any_scales_and_rank_is_taken(rank: int):
    """600 of them, computed with rounding; none is refused, and each is taken to be symmetric."""
    rng = np.random.default_rng(rank)
    roots = rng.normal(size=(600, 5, rank)) * 10.0 ** rng.uniform(-8.0, 8.0, size=(600, 5, 1))
    covs = roots @ roots.mT
    for cov in (covs, covs * (1.0 + 1e-15 * rng.normal(size=covs.shape))):
        for one in cov:
            taken = Gaussian(np.zeros(5), one).cov
            np.testing.assert_allclose(taken, one, rtol=1e-14, atol=0)
            np.testing.assert_array_equal(taken, taken.T)


# --- what is refused ------------------------------------------------------------------------------

BAD = np.array([[1.0, 2.0], [2.0, 1.0]])
NONLINEAR = {
    "transition": lambda x, u: x,
    "measurement": lambda x, u: x[..., :1],
    "Q": I2,
    "R": [[1.0]],
}
PRIOR = {"mean": [0.0, 0.0], "cov": I2}
TABLE = {"table": I2[None], "component": 0, "scale": 1.0, "middle": 0.5}
REFUSED: list[tuple[type, dict, str, object, str]] = [
    *((LinearModel, FINE, name, value, problem) for name, value, problem in [
        ("A", np.ones((2, 3)), "shape"), ("A", [1.0, 2.0], "shape"), ("A", [[np.nan, 0.0], [0.0, 1.0]], "finite"),
        ("C", np.ones((1, 3)), "shape"), ("C", 1.0, "shape"), ("B", np.ones((3, 1)), "shape"),
        ("G", np.ones((3, 1)), "shape"), ("H", np.ones((2, 1)), "shape"), ("Q", np.eye(3), "shape"),
        ("Q", np.ones((2, 3)), "square"), ("Q", [[1.0, 0.5], [0.4, 1.0]], "symmetric"),
        ("Q", [[0.0, 0.0], [1e160, 5e-324]], "symmetric"), ("Q", BAD, "positive semidefinite"),
        ("Q", np.stack([I2, I2, BAD]), "positive semidefinite"), ("R", np.eye(2), "shape"),
        ("R", [[np.inf]], "finite"), ("state_angles", (2,), "below 2"), ("state_angles", (-1,), "below 2"),
        ("measurement_angles", (1,), "below 1"),
    ]),
    *((NonlinearModel, NONLINEAR, name, value, problem) for name, value, problem in [
        ("transition", I2, "function"), ("measurement", None, "function"), ("Q", BAD, "positive semidefinite"),
        ("measurement", lambda x: x, r"function of \(x, u\): too many positional arguments"),
        ("R", lambda x, u: np.eye(1), r"function of \(u\)"), ("G", np.ones((3, 1)), "shape"),
    ]),
    *((Gaussian, PRIOR, name, value, problem) for name, value, problem in [
        ("mean", [0.0] * 3, "shape"), ("mean", 0.0, "shape"), ("mean", [0.0, np.nan], "finite"),
        ("cov", np.stack([I2, BAD]), "positive semidefinite"), ("cov", [1.0, 1.0], "square"),
    ]),
    *((Schedule, TABLE, name, value, problem) for name, value, problem in [
        ("table", np.zeros((0, 2, 2)), "at least one entry"), ("table", np.full((1, 2, 2), np.nan), "finite"),
        ("table", I2, r"have shape \(k, n, m\), got \(2, 2\)"), ("scale", np.nan, "a finite number, got nan"),
        ("component", 0.5, "a whole number of at least 0, got 0.5"),
    ]),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "fine", "name", "value", "problem"), REFUSED)
def test_the_argument_that_is_wrong_is_named_in_one_line(
    kind: type, fine: dict, name: str, value: object, problem: str
):
    with pytest.raises((ValueError, TypeError), match=f"^{name} .*{problem}") as caught:
        kind(**(fine | {name: value}))
    assert len(str(caught.value)) < 160
    kind(**fine)


def test_sizes_are_told_by_arrays_a_function_without_u_or_asked_for():
    model = NonlinearModel(
        lambda x, u: x, lambda x, u: x[..., :1], lambda u: np.eye(3), lambda u: np.eye(1)
    )
    assert (model.n, model.p) == (3, 1)
    with pytest.raises(ValueError, match="cannot tell states: give states=, or one of Q, G as an"):
        NonlinearModel(lambda x, u: x, lambda x, u: x, lambda u: np.eye(3) * u[0], np.eye(3))
    with pytest.raises(ValueError, match=r"cannot tell n: give one of A, .* as an array"):
        LinearModel(A=lambda u: I2, C=lambda u: I2, Q=lambda u: I2, R=I2)
    with pytest.raises(ValueError, match=r"^H has shape"):
        LinearModel(**FINE, G=np.ones((2, 1)), H=np.ones((1, 2)))


def test_a_schedule_of_a_component_that_u_has_not_is_refused():
    schedule = Schedule(I2[None], 5, 1.0, 0.5)
    with pytest.raises(
        ValueError, match=r"^matrices follow component 5 of the known input, but u has 2"
    ):
        schedule(np.zeros(2))
    filter = make("kf", LinearModel(schedule, I2, I2, I2))
    with pytest.raises(
        ValueError, match=r"^matrices follow component 5 of the known input, but u has 2"
    ):
        filter.predict(filter.init(Gaussian(np.zeros(2), I2)), np.zeros(2))


def test_a_jacobian_that_is_not_finite_at_first_is_compared_where_it_is():
    model = NonlinearModel(
        lambda x, u: np.square(x), lambda x, u: x, I2, I2,
        transition_jacobian=lambda x, u: np.where(x == 0.0, np.nan, 7.0)[..., None] * I2,
    )  # fmt: skip
    assert np.isnan(model.linearise_transition(np.zeros(2), None)[1]).any()
    with pytest.raises(
        ValueError, match=r"^transition_jacobian differs from transition: entry \(0, 0\) is 7"
    ):
        model.linearise_transition(np.ones(2), None)


def test_singular_covariances_and_lists_of_integers_are_accepted():
    model = LinearModel(A=[[1, 1], [0, 1]], C=[[1, 0]], Q=np.zeros((2, 2)), R=[[0]])
    assert (model.n, model.p, model.q) == (2, 1, 0)
    assert all(matrix.dtype == float for matrix in (model.A, model.C, model.Q, model.R))
    assert Gaussian([0, 0], np.ones((2, 2))).cov.dtype == float


def test_a_missing_half_of_the_unknown_input_counts_as_zero():
    assert (np.zeros((1, 3)) == LinearModel(**FINE, G=np.ones((2, 3))).H).all()
    assert (np.zeros((2, 3)) == LinearModel(**FINE, H=np.ones((1, 3))).G).all()
    assert LinearModel(**FINE).G is None


# --- linear models --------------------------------------------------------------------------------


def test_linear_functions_are_matrix_products_row_by_row():
    rng = np.random.default_rng(0)
    A, B, C = rng.normal(size=(5, 3, 3)), rng.normal(size=(5, 3, 2)), rng.normal(size=(5, 4, 3))
    model = LinearModel(A=A, B=B, C=C, Q=np.eye(3), R=np.eye(4))
    x, u = rng.normal(size=(5, 3)), rng.normal(size=(5, 2))
    for i in range(5):
        np.testing.assert_allclose(model.transition(x, u)[i], A[i] @ x[i] + B[i] @ u[i], rtol=1e-12)
        np.testing.assert_allclose(model.transition(x, None)[i], A[i] @ x[i], rtol=1e-12)
        np.testing.assert_allclose(model.measurement(x, u)[i], C[i] @ x[i], rtol=1e-12)
    # Members of an ensemble are one more axis before the components of the state.
    shared = LinearModel(A=A[0], B=B[0], C=C[0], Q=np.eye(3), R=np.eye(4))
    members = rng.normal(size=(5, 7, 3))
    np.testing.assert_allclose(
        shared.measurement(members, None)[2, 4], C[0] @ members[2, 4], rtol=1e-12
    )


@pytest.mark.parametrize("name", ["kf", "ekf", "kf-umv-ui", "kf-umv-ui-wdf"])
def test_matrices_may_be_functions_of_the_known_input(name: str):
    """A schedule of matrices gives what a filter built anew at every step gives."""
    rng = np.random.default_rng(1)
    n, p, q = 3, 3, 1
    base = {
        "A": random_transition(rng, n, 0.9), "B": rng.normal(size=(n, 1)), "C": rng.normal(size=(p, n)),
        "Q": random_covariance(rng, n), "R": random_covariance(rng, p),
    }  # fmt: skip
    if "umv" in name:
        base["G"] = rng.normal(size=(n, q))
    if name == "kf-umv-ui":
        base["H"] = rng.normal(size=(p, q))

    def at(key: str):
        return lambda u: base[key] * (1.0 + 0.3 * np.abs(u[..., 0])[..., None, None])

    functions = {key: at(key) for key in base if key != "H"}
    # Sizes must show somewhere: H keeps p and q, else C and G do.
    fixed = ("H",) if "H" in base else ("C", "G") if "G" in base else ("C",)
    functions |= {key: base[key] for key in fixed}
    if name == "kf-umv-ui":
        functions["A"] = base["A"]
    filter = make(name, LinearModel(**functions))
    belief = filter.init(Gaussian(np.zeros((2, n)), np.eye(n)))
    singles = [filter.init(Gaussian(np.zeros(n), np.eye(n))) for _ in range(2)]
    for _ in range(3):
        u, y = rng.normal(size=(2, 1)), rng.normal(size=(2, p))
        belief = filter.update(filter.predict(belief, u), y)
        for i in range(2):
            matrices = {
                key: value(u[i]) if callable(value) else value for key, value in functions.items()
            }
            constant = make(name, LinearModel(**matrices))
            singles[i] = constant.update(constant.predict(singles[i], u[i]), y[i])
            assert_same(belief[i], singles[i], 1e-11)


def test_a_measurement_may_depend_on_an_input_of_its_own_time():
    model = LinearModel(
        A=I2, C=lambda u: np.stack([u, np.zeros_like(u)], -1), Q=I2, R=[[1.0]], B=np.zeros((2, 1))
    )
    filter = make("kf", model)
    predicted = filter.predict(filter.init(Gaussian([1.0, 1.0], I2)), [3.0])
    assert filter.update(predicted, [0.0]).innovation[0] == -3.0
    assert filter.update(predicted, [0.0], u=[5.0]).innovation[0] == -5.0


# --- nonlinear models -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("way", "error"), [(compiled, 1e-13), (lambda f: f, 1e-10)], ids=["compiled", "differences"]
)
def test_jacobians_are_the_analytic_ones(way: Callable, error: float):
    """To rounding; differences of fourth order over steps h of 1e-3 err by 1e-16 / h and by h^4, tens of times."""
    rng = np.random.default_rng(2)
    A, B, C = rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), rng.normal(size=(2, 3))

    def f(x, u):
        return np.sin(np.matvec(A, x)) * np.exp(0.1 * np.matvec(B, u))

    def h(x, u):
        return np.tanh(np.matvec(C, x)) + np.matvec(C, x) ** 2 * u[..., :1]

    model = NonlinearModel(way(f), way(h), np.eye(3), np.eye(2))
    x, u = rng.normal(size=(6, 4, 3)), rng.normal(size=(6, 4, 2))
    value, jacobian = model.linearise_transition(x, u)
    np.testing.assert_allclose(
        value, f(x, u), rtol=1e-12
    )  # elementary functions differ by 2 units in the last place
    expected = (np.cos(np.matvec(A, x)) * np.exp(0.1 * np.matvec(B, u)))[..., None] * A
    np.testing.assert_allclose(jacobian, expected, rtol=0, atol=error)
    value, jacobian = model.linearise_measurement(x, u)
    np.testing.assert_allclose(value, h(x, u), rtol=1e-12, atol=1e-14)
    z = np.matvec(C, x)
    expected = (1.0 - np.tanh(z) ** 2 + 2.0 * z * u[..., :1])[..., None] * C
    np.testing.assert_allclose(jacobian, expected, rtol=0, atol=error)


# --- discretisation -------------------------------------------------------------------------------


def _continuous(seed: int, n: int = 3, m: int = 2) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, n)), rng.normal(size=(n, m)), random_covariance(rng, m)


def _flow(A: np.ndarray, x: np.ndarray, drive: np.ndarray, dt: float) -> np.ndarray:
    """The end of ``x' = A x + drive`` after ``dt``, by integration in small steps."""
    return solve_ivp(
        lambda t, z: A @ z + drive, (0.0, dt), x, rtol=1e-12, atol=1e-13, method="DOP853"
    ).y[:, -1]


@pytest.mark.parametrize("seed", range(3))
def test_zero_order_hold_ends_where_integration_ends(seed: int):
    A, B, _ = _continuous(seed)
    rng = np.random.default_rng(100 + seed)
    F, D = zero_order_hold(A, B, 0.7)
    for _ in range(3):
        x, u = rng.normal(size=3), rng.normal(size=2)
        np.testing.assert_allclose(F @ x + D @ u, _flow(A, x, B @ u, 0.7), rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_van_loan_noise_is_the_integral_that_defines_it(seed: int):
    A, G, Q = _continuous(seed)
    dt = 0.7
    F, noise = van_loan(A, G, Q, dt)
    np.testing.assert_allclose(
        F, np.stack([_flow(A, e, np.zeros(3), dt) for e in np.eye(3)], 1), rtol=0, atol=1e-9
    )
    nodes, weights = np.polynomial.legendre.leggauss(12)
    expected = np.zeros((3, 3))
    for s, weight in zip(0.5 * dt * (nodes + 1.0), 0.5 * dt * weights, strict=True):
        columns = np.stack([_flow(A, g, np.zeros(3), s) for g in G.T], axis=1)  # e^(A s) G
        expected += weight * columns @ Q @ columns.T
    np.testing.assert_allclose(noise, expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(noise, noise.T)


def test_forward_euler_is_the_first_order_of_the_exact_step():
    A, B, _ = _continuous(8)
    F, D = forward_euler(A, B, 0.1)
    np.testing.assert_array_equal(F, np.eye(3) + 0.1 * A)
    np.testing.assert_array_equal(D, 0.1 * B)
    errors = []
    for dt in (1e-3, 5e-4):
        pairs = zip(forward_euler(A, B, dt), zero_order_hold(A, B, dt), strict=True)
        errors.append([np.abs(euler - exact).max() for euler, exact in pairs])
    # The error of a step is of second order: half the step, a quarter of the error.
    np.testing.assert_allclose(np.divide(*errors), 4.0, rtol=0.01)


def test_continuous_models_are_lists_too_and_no_step_goes_back():
    A, G, dt = [[0, 1], [0, 0]], [[0], [1]], 0.1
    np.testing.assert_allclose(zero_order_hold(A, G, dt)[1], [[0.005], [0.1]], rtol=1e-12)
    np.testing.assert_allclose(
        van_loan(A, G, [[2]], dt)[1], [[2e-3 / 3.0, 0.01], [0.01, 0.2]], rtol=1e-12
    )
    for step in (lambda dt: zero_order_hold(A, G, dt), lambda dt: van_loan(A, G, [[2]], dt)):
        np.testing.assert_array_equal(step(0.0)[1], 0.0)
        with pytest.raises(ValueError, match="dt must be at least 0, got"):
            step(-0.1)


def _bearing(**own: object) -> NonlinearModel:
    def bearing(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        return np.arctan2(x[..., 1:2], x[..., :1])

    return NonlinearModel(
        lambda x, u: x, bearing, np.eye(2), [[0.01]], measurement_angles=(0,), **own
    )


def _bearing_jacobian(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
    return (np.stack([-x[..., 1], x[..., 0]], -1) / (x**2).sum(-1, keepdims=True))[..., None, :]


@pytest.mark.parametrize("spread", [0.0, 1e-5, 1.0, 100.0, 1e5])
def test_a_right_jacobian_is_taken_however_far_the_belief_reaches(spread: float):
    filter = make("ekf", _bearing(measurement_jacobian=_bearing_jacobian))
    prior = Gaussian([[-1.0, 0.0], [0.3, 1.0]], spread**2 * np.eye(2))
    assert filter.update(filter.init(prior), [3.0]).healthy.all()


@pytest.mark.parametrize("power", [2, 3])
def test_a_right_jacobian_is_taken_where_it_vanishes(power: int):
    model = NonlinearModel(
        lambda x, u: x, lambda x, u: x**power, [[1.0]], [[1.0]],
        measurement_jacobian=lambda x, u: power * x[..., None] ** (power - 1),
    )  # fmt: skip
    filter = make("ekf", model)
    assert filter.update(filter.init(Gaussian([0.0], [[1.0]])), [3.0]).recovery == 0


def test_a_wrong_jacobian_is_refused_at_every_use():
    filter = make("ekf", _bearing(measurement_jacobian=lambda x, u: -_bearing_jacobian(x, u)))
    belief = filter.init(Gaussian([-1.0, 0.3], np.eye(2)))
    for _ in range(2):
        with pytest.raises(ValueError, match=r"entry \(0, 1\) is 0.917431, by differences -0.9174"):
            filter.update(belief, [3.0])


def test_differences_of_few_digits_are_refused_and_a_jacobian_taken():
    """Of float32 they would be off by 40 %."""
    few = {"Q": 1e-6 * np.eye(2), "R": [[1e-4]]}

    def single(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        x = x.astype(np.float32)
        return x + np.float32(0.1) * np.sin(x)

    def slope(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        return (1.0 + 0.1 * np.cos(x))[..., None] * np.eye(2)

    prior = Gaussian([100.3, 3.7], 1e-8 * np.eye(2))
    filter = make("ekf", NonlinearModel(single, lambda x, u: x[..., :1], **few))
    with pytest.raises(
        ValueError, match=r"transition returns numbers of few digits .* compute it in float64, give"
    ):
        filter.predict(filter.init(prior))
    filter = make(
        "ekf", NonlinearModel(single, lambda x, u: x[..., :1], transition_jacobian=slope, **few)
    )
    exact = slope(prior.mean, None)
    np.testing.assert_allclose(
        filter.predict(filter.init(prior)).cov,
        exact @ prior.cov @ exact.mT + few["Q"],
        rtol=1e-12,
        atol=0.0,
    )
    filter = make("ekf", NonlinearModel(single, lambda x, u: x[..., :1], transition_jacobian=lambda x, u: -slope(x, u),
                                        **few))  # fmt: skip
    with pytest.raises(ValueError, match="transition_jacobian differs from transition"):
        filter.predict(filter.init(Gaussian([100.3, 3.7], np.eye(2))))


@pytest.mark.parametrize("way", [compiled, lambda f: f], ids=["compiled", "differences"])
@pytest.mark.parametrize("spread", [1.0, 100.0, 1e5])
def test_the_jacobian_of_an_angle_is_right_however_little_is_known_of_it(
    spread: float, way: Callable
):
    model = NonlinearModel(
        *2 * [way(lambda x, u: wrap(x))],
        [[1.0]],
        [[1.0]],
        state_angles=(0,),
        measurement_angles=(0,),
    )
    for linearise in (model.linearise_transition, model.linearise_measurement):
        np.testing.assert_allclose(
            linearise(np.array([3.1]), None, [[spread**2]])[1], [[1.0]], rtol=0, atol=1e-10
        )


# --- compiled functions ---------------------------------------------------------------------------


def test_what_is_compiled_is_known_by_name():
    model = NonlinearModel(
        compiled(lambda x, u: 0.9 * x),
        lambda x, u: x[..., :1],
        I2,
        StateNoise(compiled(lambda x, u: np.square(x[..., :1, None])), np.eye(1)),
        G=compiled(lambda x, u: x[..., None]),
        H=np.zeros((1, 1)),
    )
    assert model.is_compiled("transition", "transition_jacobian", "Q", "R", "G", "H")
    assert not model.is_compiled("transition", "measurement")
    linear = LinearModel(Schedule(I2[None], 0, 1, 0), I2, lambda u: I2, I2)
    assert linear.is_compiled("A", "B", "C")
    assert not linear.is_compiled("A", "Q")
    again = replace(model, Q=2.0 * I2)
    assert again.is_compiled("transition", "R")
    np.testing.assert_array_equal(again.transition(np.ones(2), None), 0.9)


def test_a_compiled_jacobian_counts_and_not_the_derivative_once_it_was_compared():
    way: dict[str, Callable] = {"numpy": lambda f: f, "compiled": compiled}
    beliefs = []
    for made in way.values():
        model = NonlinearModel(
            made(lambda x, u: np.sin(x)),
            made(lambda x, u: 2.0 * np.sin(x)),
            I2,
            I2,
            transition_jacobian=made(lambda x, u: 1.0001 * np.cos(x)[..., None] * I2),
            measurement_jacobian=made(lambda x, u: 2.0002 * np.cos(x)[..., None] * I2),
        )
        filter = make("ekf", model)
        belief = filter.init(Gaussian(np.arange(6.0).reshape(3, 2), I2))
        for y in np.random.default_rng(0).normal(size=(5, 3, 2)):
            belief = filter.update(filter.predict(belief), y)
        beliefs.append(belief)
    np.testing.assert_allclose(beliefs[0].mean, beliefs[1].mean, rtol=1e-13)
    np.testing.assert_allclose(beliefs[0].cov, beliefs[1].cov, rtol=1e-13)


@pytest.mark.parametrize("name", ["kf", "huber-kf", "kf-umv-ui"])
def test_compiled_matrices_of_u_are_part_of_the_program_and_give_what_numpy_gives(name: str):
    """A host callback would call the function at every step: it is traced once for predictions, once for updates."""
    calls, results = [], []

    def scaled(matrix: np.ndarray) -> Callable:
        def function(u: np.ndarray) -> np.ndarray:
            calls.append(u)
            return matrix * (1.0 + np.sin(u[..., 1, None, None]))

        return function

    rng = np.random.default_rng(0)
    A, B, C = rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), rng.normal(size=(3, 3))
    u, y = rng.normal(size=(6, 4, 2)), rng.normal(size=(6, 4, 3))
    for way in (compiled, partial(compiled, matrices=True), lambda f: f):
        unknown = {"G": way(scaled(C[:, :1])), "H": np.ones((3, 1))} if name == "kf-umv-ui" else {}
        model = LinearModel(
            way(scaled(A)), way(scaled(C)), np.eye(3), np.eye(3), B=way(scaled(B)), **unknown
        )
        filter = make(name, model)
        belief = filter.init(Gaussian(np.zeros((4, 3)), np.eye(3)))
        for k in range(6):
            belief = filter.update(filter.predict(belief, u[k]), y[k])
            if k < 3:
                calls.clear()
        assert bool(calls) == (len(results) == 2)
        results.append(belief)
    for belief in results[:2]:
        np.testing.assert_allclose(belief.mean, results[2].mean, rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(belief.cov, results[2].cov, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("name", ["ekf-ui-wdf", "ukf-umv"])
def test_a_compiled_g_of_the_state_gives_what_it_gives_in_numpy(name: str):
    beliefs = []
    for way in (compiled, lambda f: f):
        model = NonlinearModel(
            compiled(lambda x, u: x + 0.1 * np.sin(x)), compiled(lambda x, u: x), I2, I2,
            G=way(lambda x, u: np.cos(0.1 * x)[..., None]), H=np.zeros((2, 1)),
        )  # fmt: skip
        filter = make(name, model)
        belief = filter.init(Gaussian(np.ones((3, 2)), I2))
        for y in np.random.default_rng(1).normal(size=(4, 3, 2)):
            belief = filter.update(filter.predict(belief), y)
        beliefs.append(belief)
    np.testing.assert_allclose(beliefs[0].mean, beliefs[1].mean, rtol=1e-12)
    np.testing.assert_allclose(beliefs[0].cov, beliefs[1].cov, rtol=1e-12)
