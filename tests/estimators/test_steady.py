"""What `steady_state` and `steady-kf` promise beyond the common laws."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from estimators import Gaussian, LinearModel, NonlinearModel, compiled, make, steady_state
from tests.estimators.cases import System, assert_same, kalman_system, simulate, track

PERIODS = [pytest.param((1, 1, 1), id="one rate"), pytest.param((1, 2, 4), id="three rates")]
I2 = np.eye(2)
TURN = np.array([[0.8, -0.6], [0.6, 0.8]])
"""A rotation in each step, whose modes are on the unit circle."""


def reported(periods: tuple[int, ...], steps: int) -> np.ndarray:
    """Mask ``(steps, p)`` of the channels that are measured."""
    return np.arange(steps)[:, None] % periods == 0


@pytest.mark.parametrize("periods", PERIODS)
@pytest.mark.parametrize("seed", range(3))
def test_the_kalman_filter_converges_to_the_steady_state(seed: int, periods: tuple[int, ...]):
    system = kalman_system(seed)
    cycle = reported(periods, max(periods))
    steady, kf = steady_state(system.model, cycle), make("kf", system.model)
    belief, T, C = kf.init(system.prior), len(steady.gain), system.model.C
    u, y = np.zeros(system.m), np.zeros(system.model.p)
    for k, available in enumerate(reported(periods, 1200)):
        predicted = kf.predict(belief, u)
        belief = kf.update(predicted, y, available=available)
        if k >= 1200 - T:
            seen = np.where(available[:, None], C, 0.0)
            gain = predicted.cov @ seen.T @ np.linalg.inv(belief.innovation_cov)
            now = gain, predicted.cov, belief.cov
            for found, expected in zip(steady, now, strict=True):
                np.testing.assert_allclose(found[k % T], expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("radius", [0.5, 1.0, 1.3])
def test_a_single_rate_solves_the_algebraic_riccati_equation(radius: float):
    model = kalman_system(4, radius=radius).model
    before = solve_discrete_are(model.A.T, model.C.T, model.Q, model.R)
    found = steady_state(model).before[0]
    np.testing.assert_allclose(found, before, rtol=0, atol=1e-9 * before.max())


def bias_of_position(pace: float) -> LinearModel:
    """A position, its rate, and the bias of the receiver that measures the position."""
    A = np.eye(3) + np.eye(3, k=1) * [[1.0], [0.0], [0.0]]
    return LinearModel(A, [[1.0, 0.0, 1.0]], np.diag([0.0, 1e-2, pace]), [[1.0]])


@pytest.mark.parametrize(
    ("model", "named"),
    [
        (bias_of_position(1e-4), "measurements do not determine 0, 2: "),
        (LinearModel(I2, I2, np.diag([1.0, 0.0]), I2), "no process noise excites 1, "),
        (LinearModel(TURN, [[1.0, 0.0]], 0.0 * I2, [[1.0]]), "no process noise excites 0, 1, "),
        (LinearModel(1.2 * I2, [[1.0, 0.0]], I2, [[1.0]]), "measurements do not determine 1: "),
    ],
    ids=["undetectable", "constant", "oscillation without noise", "unstable and not measured"],
)  # fmt: skip
def test_modes_without_a_steady_state_are_named(model: LinearModel, named: str):
    with pytest.raises(ValueError, match=f"^there is no steady state: {named}"):
        steady_state(model)


def test_sampling_that_never_shows_a_mode_is_refused():
    """A quarter turn a step, of which every second shows the same component again."""
    model = LinearModel([[0.0, -1.0], [1.0, 0.0]], [[1.0, 0.0]], I2, [[1.0]])
    assert steady_state(model).gain.any()
    with pytest.raises(ValueError, match=r"^there is no steady state: .* do not decay"):
        steady_state(model, [[True], [False]])


def test_names_of_states_are_those_that_are_given():
    with pytest.raises(ValueError, match="do not determine place, bias: "):
        steady_state(bias_of_position(1e-4), names=("place", "rate", "bias"))


def test_stable_modes_need_neither_sensor_nor_noise():
    model = LinearModel(np.diag([0.5, 0.9]), [[1.0, 0.0]], np.diag([1.0, 0.0]), [[1.0]])
    steady = steady_state(model)
    np.testing.assert_array_equal(steady.gain[0, 1], 0.0)
    np.testing.assert_array_equal(steady.after[0, 1], 0.0)


# --- the filter -----------------------------------------------------------------------------------


@pytest.mark.parametrize("periods", [(1, 1, 1), (1, 2, 2), (2, 1, 1)])
def test_from_the_steady_state_it_is_the_kalman_filter(periods: tuple[int, ...]):
    """Each phase measures a set of its own."""
    system, steps, cycle = kalman_system(1), 12, reported(periods, max(periods))
    steady = steady_state(system.model, cycle)
    record = simulate(system, 2, 3, steps)
    available = np.broadcast_to(reported(periods, steps)[:, None], record.y.shape)
    start = Gaussian(np.tile(system.mean, (3, 1)), steady.before[0])
    one, other = (
        track(make(name, system.model, **options), start, record, available=available)
        for name, options in (("steady-kf", {"measured": cycle}), ("kf", {}))
    )
    for found, expected in zip(one, other, strict=True):
        assert_same(found, expected, 1e-10)


def test_its_gain_does_not_depend_on_the_prior():
    system = kalman_system(1)
    filter, rng = make("steady-kf", system.model), np.random.default_rng(0)
    y, u = rng.normal(size=system.model.p), np.zeros(system.m)
    beliefs = [filter.init(Gaussian(system.mean, s * system.cov)) for s in (1e-3, 1.0, 1e3)]
    ends = [filter.update(filter.predict(each, u), y) for each in beliefs]
    for each in ends[1:]:
        np.testing.assert_array_equal(each.mean, ends[0].mean)
        np.testing.assert_array_equal(each.cov, ends[0].cov)


def test_without_measurements_it_dead_reckons():
    system, steps = kalman_system(3), 20
    filter, record = make("steady-kf", system.model), simulate(system, 0, 2, steps)
    belief = track(filter, system.rows(2), record)[-1]
    expected = belief.mean
    for u in record.u:
        expected = system.model.transition(expected, u)
        belief = filter.update(filter.predict(belief, u), np.full((2, 3), np.nan))
    np.testing.assert_allclose(belief.mean, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(belief.cov[0], steady_state(system.model).before[0], atol=1e-12)


@pytest.mark.parametrize("pace", [0.0, 1e-4])
def test_a_nuisance_keeps_its_prior_beside_the_other_states(pace: float):
    """Constant, or not to be told from the position."""
    model, rng = bias_of_position(pace), np.random.default_rng(0)
    rest = LinearModel(model.A[:2, :2], model.C[:, :2], model.Q[:2, :2], model.R)
    mean, cov = np.array([0.0, 1.0, 0.0]), np.diag([4.0, 1.0, 9.0])
    one, two = make("steady-kf", model, nuisance=[2]), make("steady-kf", rest)
    whole, part = one.init(Gaussian(mean, cov)), two.init(Gaussian(mean[:2], cov[:2, :2]))
    for y in rng.normal(size=(6, 1)):
        whole, part = one.update(one.predict(whole), y), two.update(two.predict(part), y)
        np.testing.assert_allclose(whole.mean, [*part.mean, 0.0], rtol=0, atol=1e-12)
        expected = np.pad(part.cov, (0, 1)) + np.diag([0.0, 0.0, 9.0])
        np.testing.assert_allclose(whole.cov, expected, rtol=0, atol=1e-12)


def test_a_nuisance_that_is_determined_has_a_gain():
    model = LinearModel(np.diag([1.0, 0.9]), [[1.0, 1.0]], I2, [[1.0]])
    one, two = make("steady-kf", model), make("steady-kf", model, nuisance=[0, 1])
    start, y = Gaussian(np.zeros(2), I2), np.ones(1)
    means = [each.update(each.predict(each.init(start)), y).mean for each in (one, two)]
    np.testing.assert_array_equal(*means)


# --- axes that turn -------------------------------------------------------------------------------


def rotation(angle: Any) -> Any:
    """Rotation ``(..., 4, 4)`` of the place by an angle ``(...)``."""
    sin, cos, zero = np.sin(angle), np.cos(angle), 0.0 * angle
    rows = (cos, -sin, zero, zero), (sin, cos, zero, zero), (zero, zero, zero + 1.0, zero)
    return np.stack([np.stack(row, -1) for row in (*rows, (zero, zero, zero, zero + 1.0))], -2)


def along_its_heading(mean: np.ndarray) -> np.ndarray:
    """Rotation from axes along and across the heading, the third state."""
    return rotation(mean[..., 2])


@pytest.fixture(scope="module")
def boat() -> tuple[System, LinearModel]:
    """Place, heading and speed, of which the speed is not measured; and a model to the north."""

    def transition(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        heading, speed = x[..., 2], x[..., 3]
        moved = speed * np.cos(heading), speed * np.sin(heading), u[..., 0], u[..., 1]
        return x + 0.5 * np.stack(moved, -1)

    model = NonlinearModel(
        compiled(transition), compiled(lambda x, u: x[..., :3]),
        Q=np.diag([0.1, 0.1, 1e-3, 1e-2]), R=np.diag([1.0, 1.0, 1e-2]),
        state_angles=(2,), measurement_angles=(2,),
    )  # fmt: skip
    north, none = np.array([0.0, 0.0, 0.0, 2.0]), np.zeros(2)
    A, C = model.linearise_transition(north, none)[1], model.linearise_measurement(north, none)[1]
    prior = np.diag([1.0, 1.0, 0.01, 0.1])
    return System(model, north, prior, 2), LinearModel(A, C, model.Q, model.R)


@pytest.mark.parametrize("angle", [0.5, 2.0, -3.0])
def test_a_turned_world_gives_the_turned_estimate(boat: tuple[System, LinearModel], angle: float):
    system, design = boat
    filter = make("steady-kf", system.model, design=design, axes=along_its_heading)
    T, turned = rotation(np.array(angle)), np.array([0.0, 0.0, angle, 0.0])
    record = simulate(system, 5, 4, 15)
    available = np.random.default_rng(0).random((15, 4, 3)) < 0.7
    available[..., 1] = available[..., 0]  # one receiver
    seen = record._replace(y=record.y @ T[:3, :3].T + turned[:3])
    start = Gaussian(np.tile(system.mean + turned, (4, 1)), system.cov)
    ours = track(filter, system.rows(4), record, available=available)
    theirs = track(filter, start, seen, available=available)
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(other.mean, one.mean @ T.T + turned, rtol=0, atol=1e-10)
        np.testing.assert_allclose(other.cov, T @ one.cov @ T.T, rtol=0, atol=1e-10)


# --- what is refused ------------------------------------------------------------------------------

LINEAR = LinearModel(I2, I2, I2, I2)
OTHERS = {
    "a nonlinear model alone": (NonlinearModel(np.sin, np.cos, I2, I2), {}, "needs a LinearModel"),
    "a matrix that varies": (LinearModel(lambda u: I2, I2, I2, I2), {}, "needs a LinearModel"),
    "a model a row": (LinearModel(I2[None], I2, I2, I2), {}, "needs a LinearModel"),
    "a small design": (LINEAR, {"design": LinearModel([[1.0]], [[1.0]], [[1.0]], [[1.0]])}, "shape"),
    "channels of others": (LINEAR, {"measured": np.ones((2, 3))}, r"measured must have shape"),
    "a state too many": (LINEAR, {"nuisance": [2]}, "nuisance must be indices below 2"),
}  # fmt: skip


@pytest.mark.parametrize("case", OTHERS)
def test_what_has_no_constant_gain_is_refused_in_a_sentence(case: str):
    model, options, sentence = OTHERS[case]
    with pytest.raises(ValueError, match=sentence):
        make("steady-kf", model, **options)
