"""Models: what they accept and refuse, their Jacobians, and their discretisation."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

from estimators import (
    Belief,
    Gaussian,
    LinearModel,
    NonlinearModel,
    RandomKeys,
    Schedule,
    compiled,
    make,
    van_loan,
    wrap,
    zero_order_hold,
)
from tests.estimators.cases import assert_close, assert_same, random_covariance

I2 = np.eye(2)
FINE = {"A": I2, "C": [[1.0, 0.0]], "Q": I2, "R": [[1.0]]}


# --- covariances whose variances differ -----------------------------------------------------------


@pytest.mark.parametrize("far", [1.0, 1e6, 1e12])
def test_a_covariance_is_judged_by_the_variances_of_its_own_rows(far: float):
    scale = np.array([far, 1.0, 1.0 / far])
    for off, variance in ((1.1, 1.0), (0.0, -1e-17), (1e-30, 0.0)):
        cov = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, off], [0.0, off, variance]])
        for each in (cov * np.outer(scale, scale), [np.eye(3), cov]):
            with pytest.raises(ValueError, match=r"^cov must be positive semidefinite.*eigenvalue"):
                Gaussian(np.zeros(3), each)


@pytest.mark.parametrize("rank", [1, 3, 5])
def test_a_covariance_of_any_scales_and_rank_is_taken(rank: int):
    """600 of them, computed with rounding; none is refused, and each is taken to be symmetric."""
    rng = np.random.default_rng(rank)
    roots = rng.normal(size=(600, 5, rank)) * 10.0 ** rng.uniform(-8.0, 8.0, size=(600, 5, 1))
    covs = roots @ roots.mT
    for one in (*covs, *covs * (1.0 + 1e-15 * rng.normal(size=covs.shape))):
        taken = Gaussian(np.zeros(5), one).cov
        assert_allclose(taken, one, rtol=1e-14, atol=0)
        assert_array_equal(taken, taken.T)


# --- what is refused ------------------------------------------------------------------------------

BAD = np.array([[1.0, 2.0], [2.0, 1.0]])
FUNCTIONS = {"transition": lambda x, u: x, "measurement": lambda x, u: x[..., :1]}
NONLINEAR = FUNCTIONS | {"Q": I2, "R": [[1.0]]}
PRIOR = {"mean": [0.0, 0.0], "cov": I2}
TABLE = {"table": I2[None], "component": 0, "scale": 1.0, "middle": 0.5}
REFUSED: list[tuple[type, dict, str, object, str]] = [
    *((LinearModel, FINE, name, value, problem) for name, value, problem in [
        ("A", np.ones((2, 3)), "shape"), ("A", [[np.nan, 0.0], [0.0, 1.0]], "finite"),
        ("C", 1.0, "shape"), ("H", np.ones((2, 1)), "shape"), ("state_angles", (2,), "below 2"),
        ("Q", np.ones((2, 3)), "square"), ("Q", [[1.0, 0.5], [0.4, 1.0]], "symmetric"),
        ("Q", np.stack([I2, BAD]), "positive semidefinite"),
        ("measurement_angles", (-1,), "below 1"),
    ]),
    *((NonlinearModel, NONLINEAR, name, value, problem) for name, value, problem in [
        ("transition", I2, "function"), ("measurement", None, "function"),
        ("G", np.ones((3, 1)), "shape"),
    ]),
    (Gaussian, PRIOR, "mean", 0.0, "shape"), (Gaussian, PRIOR, "cov", [1.0, 1.0], "shape"),
    *((Schedule, TABLE, name, value, problem) for name, value, problem in [
        ("table", I2, r"have shape \(k, n, m\), got \(2, 2\)"),
        ("scale", np.nan, "a finite number, got nan"),
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


def test_sizes_are_told_by_arrays_or_asked_for():
    model = NonlinearModel(
        lambda x, u: x, lambda x, u: x[..., :1], lambda u: np.eye(3), lambda u: np.eye(1),
        states=3, measurements=1,
    )  # fmt: skip
    assert (model.n, model.p) == (3, 1)
    with pytest.raises(ValueError, match="cannot tell states: give states=, or one of Q, G as an"):
        NonlinearModel(lambda x, u: x, lambda x, u: x, lambda u: np.eye(3) * u[0], np.eye(3))
    with pytest.raises(ValueError, match="cannot tell q"):
        NonlinearModel(**NONLINEAR, G=lambda x, u: np.ones((2, 1)))
    with pytest.raises(ValueError, match=r"cannot tell n: give one of A, .* as an array"):
        LinearModel(A=lambda u: I2, C=lambda u: I2, Q=lambda u: I2, R=I2)
    with pytest.raises(ValueError, match=r"^H must have shape"):
        LinearModel(**FINE, G=np.ones((2, 1)), H=np.ones((1, 2)))


def test_a_schedule_of_a_component_that_u_has_not_is_refused():
    filter = make("kf", LinearModel(Schedule(I2[None], 5, 1.0, 0.5), I2, I2, I2))
    for u in None, np.zeros(2):
        with pytest.raises(ValueError, match=r"^matrices follow component 5 of the known input"):
            filter.predict(filter.init(Gaussian(np.zeros(2), I2)), u)


def test_lists_singular_covariances_and_half_an_input_are_taken():
    model = LinearModel(A=[[1, 1], [0, 1]], C=[[1, 0]], Q=np.zeros((2, 2)), R=[[0]])
    assert (model.n, model.p, model.q, model.G) == (2, 1, 0, None)
    assert model.A.dtype == model.R.dtype == Gaussian([0, 0], np.ones((2, 2))).cov.dtype == float
    # A missing half of the unknown input counts as zero.
    assert (np.zeros((1, 3)) == LinearModel(**FINE, G=np.ones((2, 3))).H).all()
    assert (np.zeros((2, 3)) == LinearModel(**FINE, H=np.ones((1, 3))).G).all()


# --- linear models --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["kf", "ekf", "huber-kf", "enkf", "kf-umv-ui", "kf-umv-ui-wdf"])
def test_matrices_may_be_functions_of_the_known_input(name: str):
    """They give what a filter built anew at every step gives; a warm step calls no compiled one."""
    rng, keys, calls = np.random.default_rng(1), RandomKeys.seeded(range(2)), []
    base = {
        key: rng.normal(size=(3, size)) for key, size in {"A": 3, "B": 2, "C": 3, "G": 1}.items()
    }
    base |= {"Q": np.eye(3), "R": 2.0 * np.eye(3)}
    fixed = "G" if name == "enkf" else "Q"  # an array, which says how many states there are
    constant = {"H": rng.normal(size=(3, 1)) * (name == "kf-umv-ui"), fixed: base.pop(fixed)}

    def changing(key: str) -> Callable:
        def function(u: np.ndarray) -> np.ndarray:
            calls.append(key)
            return base[key] * (1.0 + 0.3 * np.sin(u[..., 1, None, None]))

        return function

    u, y = rng.normal(size=(6, 2, 2)), rng.normal(size=(6, 2, 3))
    for way in (compiled, partial(compiled, matrices=True), lambda f: f):
        functions = {key: way(changing(key)) for key in base}
        filter = make(name, LinearModel(**functions, **constant))
        belief = expected = filter.init(Gaussian(np.zeros((2, 3)), np.eye(3)), rng=keys)
        for k in range(6):
            calls.clear()
            belief = filter.step(belief, y[k], u[k], rng=keys.at(k))
            assert k == 0 or bool(calls) != filter.model.is_compiled("predict")
            matrices = {key: function(u[k]) for key, function in functions.items()}
            anew = make(name, LinearModel(**matrices, **constant))
            expected = anew.step(expected, y[k], u[k], rng=keys.at(k))
            assert_same(belief, expected, 1e-11)


def test_a_measurement_may_depend_on_an_input_of_its_own_time():
    model = LinearModel(I2, lambda u: u[..., None, :], I2, [[1.0]], B=np.zeros((2, 2)))
    filter = make("kf", model)
    predicted = filter.predict(filter.init(Gaussian([1.0, 0.0], I2)), [3.0, 0.0])
    assert filter.update(predicted, [0.0]).innovation[0] == -3.0
    assert filter.update(predicted, [0.0], u=[5.0, 0.0]).innovation[0] == -5.0


# --- nonlinear models -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("way", "error"), [(compiled, 1e-13), (lambda f: f, 1e-10)], ids=["compiled", "differences"]
)
def test_jacobians_are_the_analytic_ones(way: Callable, error: float):
    """To rounding; fourth-order differences over h = 1e-3 err by tens of 1e-16 / h and h^4."""
    rng = np.random.default_rng(2)
    A, B = rng.normal(size=(3, 3)), rng.normal(size=(3, 2))

    def f(x, u):
        return np.sin(np.matvec(A, x)) * np.exp(0.1 * np.matvec(B, u))

    model = NonlinearModel(way(f), way(f), np.eye(3), np.eye(3))
    x, u = rng.normal(size=(6, 4, 3)), rng.normal(size=(6, 4, 2))
    expected = (np.cos(np.matvec(A, x)) * np.exp(0.1 * np.matvec(B, u)))[..., None] * A
    for linearise in (model.linearise_transition, model.linearise_measurement):
        value, jacobian = linearise(x, u)
        # Elementary functions differ by 2 units in the last place.
        assert_allclose(value, f(x, u), rtol=1e-12)
        assert_allclose(jacobian, expected, rtol=0, atol=error)
    x = np.array([1e6, 1e-3])  # large and small states
    squares = NonlinearModel(way(lambda x, u: x**2), lambda x, u: x[..., :1], I2, np.eye(1))
    jacobian = squares.linearise_transition(x, None)[1]
    assert_allclose(jacobian, np.diag(2.0 * x), rtol=1e3 * error, atol=0)


# --- discretisation -------------------------------------------------------------------------------


def _flow(A: np.ndarray, x: np.ndarray, drive: np.ndarray, dt: float) -> np.ndarray:
    """The end of ``x' = A x + drive`` after ``dt``, by integration in small steps."""
    return solve_ivp(
        lambda t, z: A @ z + drive, (0.0, dt), x, rtol=1e-12, atol=1e-13, method="DOP853"
    ).y[:, -1]


@pytest.mark.parametrize("dt", [0.7, 3.0])
def test_discretisations_are_what_integration_gathers(dt: float):
    """In a batch, too, which may share B."""
    rng = np.random.default_rng(100)
    As, B, Q = rng.normal(size=(3, 3, 3)), rng.normal(size=(3, 2)), random_covariance(rng, 2)
    F, D = zero_order_hold(As, B, dt)
    for A, step, held in zip(As, F, D, strict=True):
        x, u = rng.normal(size=3), rng.normal(size=2)
        assert_close(step @ x + held @ u, _flow(A, x, B @ u, dt), 1e-9)
        # P' = A P + P A' + B Q B' from P = 0, as one vector.
        rate = np.kron(A, np.eye(3)) + np.kron(np.eye(3), A)
        gathered = _flow(rate, np.zeros(9), (B @ Q @ B.T).ravel(), dt).reshape(3, 3)
        transition, noise = van_loan(A, B, Q, dt)
        assert_close(transition, step, 1e-12)
        assert_close(noise, gathered, 1e-9)
        assert_array_equal(noise, noise.T)


@pytest.mark.parametrize("unit", [1e-9, 1e12])
def test_the_unit_of_noise_leaves_the_transition_alone(unit: float):
    A, Q = (
        np.random.default_rng(1).normal(size=(3, 3)),
        random_covariance(np.random.default_rng(2), 3),
    )
    (transition, noise), (moved, scaled) = (van_loan(A, np.eye(3), of, 0.7) for of in (Q, unit * Q))
    assert_allclose(moved, transition, rtol=0, atol=1e-13)
    assert_allclose(scaled / unit, noise, rtol=0, atol=1e-13)


def test_continuous_models_are_lists_too_and_no_step_goes_back():
    A, G = [[0, 1], [0, 0]], [[0], [1]]
    for step in (lambda dt: zero_order_hold(A, G, dt), lambda dt: van_loan(A, G, [[2]], dt)):
        assert_array_equal(step(0.0)[1], 0.0)
        with pytest.raises(ValueError, match="dt must be at least 0, got"):
            step(-0.1)


def test_differences_of_few_digits_need_a_jacobian():
    """Of float32 they would be off by 40 %."""

    def predicted(**own: object) -> Belief:
        model = NonlinearModel(
            lambda x, u: np.sin(x.astype(np.float32)), lambda x, u: x, 1e-6 * I2, I2, **own
        )
        filter = make("ekf", model)
        return filter.predict(filter.init(Gaussian([100.3, 3.7], 1e-8 * I2)))

    with pytest.raises(ValueError, match=r"transition returns numbers of few digits .* in float64"):
        predicted()
    found = predicted(transition_jacobian=lambda x, u: np.cos(x)[..., None] * I2).cov
    expected = 1e-8 * np.diag(np.cos([100.3, 3.7]) ** 2) + 1e-6 * I2
    assert_allclose(found, expected, rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("way", [compiled, lambda f: f], ids=["compiled", "differences"])
@pytest.mark.parametrize("spread", [1.0, 100.0, 1e5])
def test_the_jacobian_of_an_angle_is_right_for_any_spread(spread: float, way: Callable):
    angle, noise = way(lambda x, u: wrap(x)), [[1.0]]
    angles = {"state_angles": (0,), "measurement_angles": (0,)}
    model = NonlinearModel(angle, angle, noise, noise, **angles)
    for linearise in (model.linearise_transition, model.linearise_measurement):
        slope = linearise(np.array([np.pi]), None, [[spread**2]])[1]
        assert_allclose(slope, [[1.0]], rtol=0, atol=1e-10)


# --- compiled functions ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "transition",
    [
        lambda x, u: np.stack([x[..., 1] ** 2, x[..., 0], x[..., 0]], -1),
        lambda x, u: np.stack([x[..., 1] ** 2, 0.0 * x[..., 0] + 0.5, 0.0 * x[..., 0]], -1),
        lambda x, u: np.concatenate([x[..., 1:2] ** 2, np.zeros(2)], -1),
    ],
    ids=["equal", "equal but for a number", "constant"],
)
def test_states_that_a_step_makes_equal_are_linearised(transition: Callable):
    """In one program with the prediction, the measurement has the Jacobian that it has alone."""
    seen = compiled(lambda x, u: x[..., :1] * (1.0 + x[..., 1:2]) + np.sin(x[..., 2:]))
    model = NonlinearModel(compiled(transition), seen, 0.1 * np.eye(3), [[0.5]])
    filter, y = make("ekf", model), np.array([2.0])
    belief = filter.init(Gaussian([0.3, 1.2, -0.4], np.eye(3)))
    assert filter.joins_steps()
    assert_same(filter.step(belief, y), filter.update(filter.predict(belief), y), 1e-13)


def test_a_compiled_jacobian_counts_and_not_the_derivative():
    """It is off by a ten-thousandth, and so is the covariance."""
    sine, x = compiled(lambda x, u: np.sin(x)), np.array([0.3, 1.0])
    own = compiled(lambda x, u: 1.0001 * np.cos(x)[..., None] * I2)
    filter = make(
        "ekf", NonlinearModel(sine, sine, I2, I2, transition_jacobian=own, measurement_jacobian=own)
    )
    belief, expected = filter.init(Gaussian(x, I2)), np.diag(np.square(1.0001 * np.cos(x))) + I2
    assert_allclose(filter.predict(belief).cov, expected, rtol=1e-13)
    assert_allclose(filter.update(belief, x).innovation_cov, expected, rtol=1e-13)
