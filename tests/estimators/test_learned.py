"""The filter whose gain is learned: it runs in NumPy as it was trained in torch, and keeps the contract of filters."""

import subprocess
import sys

import numpy as np
import pytest

from estimators import Belief, GainNetwork, Gaussian, LearnedGainFilter, LinearModel, NonlinearModel, Recovery
from tests.estimators.cases import System, arrays, assert_covariance, assert_same, kalman_system, simulate, track


def _network(n: int, p: int, k: int = 5, seed: int = 0) -> GainNetwork:
    rng = np.random.default_rng(seed)
    shapes = ((3 * k, p + n), (3 * k, k), (3 * k,), (3 * k,), (n * p, k), (n * p,))
    weights = [0.5 * rng.normal(size=shape) for shape in shapes]
    weights[4], weights[5] = 0.2 * weights[4], 0.2 * weights[5]  # gains that keep it stable
    return GainNetwork(*weights, rng.uniform(1, 2, p), rng.uniform(1, 2, n))


def _case(seed: int = 0) -> tuple[System, LearnedGainFilter]:
    system = kalman_system(seed)
    return system, LearnedGainFilter(system.model, _network(system.model.n, system.model.p))


@pytest.mark.slow
def test_torch_and_numpy_make_the_same_means():
    """With measurements missing and an angle among them."""
    torch = pytest.importorskip("torch")
    from dataclasses import fields, replace

    from agents.training.learned_filter import means

    system, _ = _case()
    model = replace(system.model, measurement_angles=(1,))
    filter = LearnedGainFilter(model, _network(4, 3))
    record = simulate(system, 0, 6, 20)
    y = np.where(np.random.default_rng(0).random(record.y.shape) < 0.7, record.y, np.nan)
    y[7, 0, 0] = 1e9  # more than the network is told
    moved = np.zeros(record.x.shape)
    moved[1:] = record.u[:-1] @ system.model.B.T
    network = {field.name: torch.as_tensor(getattr(filter.network, field.name)) for field in fields(GainNetwork)}
    theirs = means(network, model, system.mean, torch.as_tensor(y), torch.as_tensor(moved)).numpy()
    ours = [belief.mean for belief in track(filter, system.rows(6), record._replace(y=y))]
    np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-10)
    assert np.abs(theirs).max() > 1.0


def test_the_unit_is_that_of_cho_et_al():
    """One number, by hand."""
    network = GainNetwork([[1.0, 0.5], [2.0, 0.0], [-1.0, 1.0]], [[0.3], [0.2], [0.4]], [0.1, 0.2, 0.3],
                          [0.0, -0.1, 0.5], [[2.0]], [0.7], [2.0], [4.0])  # fmt: skip
    hidden, gain = network(np.array([0.5]), np.array([3.0]), np.array([2.0]))
    e, c, h = 1.5, 0.5, 0.5
    reset = 1 / (1 + np.exp(-(1.0 * e + 0.5 * c + 0.1 + 0.3 * h)))
    update = 1 / (1 + np.exp(-(2.0 * e + 0.2 + 0.2 * h - 0.1)))
    candidate = np.tanh(-e + c + 0.3 + reset * (0.4 * h + 0.5))
    np.testing.assert_allclose(hidden, [(1 - update) * candidate + update * h], rtol=1e-14)
    np.testing.assert_allclose(gain, [[(2.0 * hidden[0] + 0.7) * 4.0 / 2.0]], rtol=1e-14)


def test_with_the_gain_of_the_kalman_filter_it_is_the_kalman_filter():
    """No weights but a bias, the steady gain: then mean, covariance and innovation are the steady filter's."""
    from scipy.linalg import solve_discrete_are

    system = kalman_system(3)
    model, n, p, k = system.model, 4, 3, 2
    P = solve_discrete_are(model.A.T, model.C.T, model.Q, model.R)
    K = np.linalg.solve(model.C @ P @ model.C.T + model.R, model.C @ P).T
    network = GainNetwork(
        np.zeros((3 * k, p + n)), np.zeros((3 * k, k)), np.zeros(3 * k), np.zeros(3 * k), np.zeros((n * p, k)),
        K.ravel(), np.ones(p), np.ones(n),
    )  # fmt: skip
    record = simulate(system, 3, 4, 400)
    from estimators import make

    one, other = (
        track(filter, system.rows(4), record)[-1] for filter in (LearnedGainFilter(model, network), make("kf", model))
    )
    for name in ("mean", "cov", "innovation", "innovation_cov"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0, atol=1e-9)


def test_the_covariance_is_that_of_the_gain_it_takes_in_josephs_form():
    system, filter = _case()
    model, record = system.model, simulate(system, 0, 3, 4)
    before = filter.predict(track(filter, system.rows(3), record)[-1], record.u[-1])
    after = filter.update(before, record.y[-1])
    _, K = filter.network(before.hidden, after.innovation, before.correction)
    left = np.eye(4) - K @ model.C
    expected = left @ before.cov @ left.mT + K @ model.R @ K.mT
    np.testing.assert_allclose(after.cov, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(after.correction, after.mean - before.mean, rtol=0, atol=1e-12)
    assert_covariance(after.cov)


# --- the contract -----------------------------------------------------------------------------------


def test_a_batch_equals_a_loop_over_its_rows_with_gaps_and_covariances_of_their_own():
    system, filter = _case()
    record = simulate(system, 0, 5, 12)
    rng = np.random.default_rng(0)
    available = rng.random(record.y.shape) < 0.6
    R = system.model.R * rng.uniform(0.5, 2.0, (12, 5, 1, 1))
    batch = track(filter, system.rows(5), record, available=available, R=R)
    for i in range(5):
        own = record._replace(y=record.y[:, i], u=record.u[:, i])
        single = track(filter, system.prior, own, available=available[:, i], R=R[:, i])
        for one, other in zip(batch, single, strict=True):
            assert_same(one[i], other, 1e-12)


def test_a_missing_measurement_says_nothing_whatever_stands_in_its_place():
    system, filter = _case()
    record = simulate(system, 0, 4, 10)
    available = np.random.default_rng(1).random(record.y.shape) < 0.6
    available[4] = False
    masked = track(filter, system.rows(4), record, available=available)
    for garbage in (np.nan, np.inf, -1e300):
        holes = record._replace(y=np.where(available, record.y, garbage))
        for one, other in zip(masked, track(filter, system.rows(4), holes, available=available), strict=True):
            assert_same(one, other)
    for name in ("hidden", "correction"):  # nothing came: nothing to remember
        np.testing.assert_array_equal(getattr(masked[4], name), getattr(masked[3], name))
    prediction = filter.predict(masked[3], record.u[3])
    np.testing.assert_array_equal(masked[4].mean, prediction.mean)
    np.testing.assert_allclose(masked[4].cov, prediction.cov, rtol=0, atol=1e-12)


def test_trouble_costs_the_row_no_more_than_it_must():
    system, filter = _case()
    record = simulate(system, 0, 3, 3)
    belief = filter.predict(track(filter, system.rows(3), record)[-1], record.u[-1])
    y = record.y[-1].copy()
    y[1] = np.finfo(float).max
    far = filter.update(belief.replace(mean=belief.mean - [[0.0], [1e308], [0.0]]), y)
    lost = filter.update(belief.replace(mean=belief.mean * [[1.0], [np.nan], [1.0]]), record.y[-1])
    for updated in (far, lost):
        for name, array in arrays(updated).items():
            assert np.isfinite(array).all(), name
        assert updated.healthy[[0, 2]].all()
    assert lost.recovery[1] == Recovery.PRIOR
    fresh = filter.update(filter.init(system.rows(1)).replace(u=record.u[-1][1:2]), record.y[-1][1:2])
    assert_same(lost[1:2], fresh, 1e-13, ignore=["recovery", "u"])


@pytest.mark.parametrize("absurd", [1e160, -1e306])
def test_after_an_absurd_measurement_it_goes_on_as_usual(absurd: float):
    """In scales of a thousandth: the next features are no numbers, but for their bounds. The gain is nearly steady."""
    from estimators import make

    for seed in range(5):
        system = kalman_system(seed)
        model, n, p, rng = system.model, 4, 3, np.random.default_rng(seed)
        kf = make("kf", model)
        K = track(kf, system.rows(1), simulate(system, seed, 1, 100))[-1]
        K = K.cov[0] @ model.C.T @ np.linalg.inv(model.R)
        weights = dict(vars(_network(n, p, seed=seed)))
        weights |= {"gain_weights": 1e-3 * rng.normal(size=(n * p, 5)), "gain_bias": K.ravel()}
        filter = LearnedGainFilter(model, GainNetwork(**(weights | {
            "innovation_scale": np.full(p, 1e-3), "state_scale": np.full(n, 1e-3),
        })))  # fmt: skip
        beliefs = [filter.init(system.prior), kf.init(system.prior)]
        for k in range(300):
            y = np.where((k == 5) & (np.arange(p) == 0), absurd, 0.0)
            beliefs = [f.update(f.predict(b, np.zeros(2)), y) for f, b in zip((filter, kf), beliefs, strict=True)]
            assert beliefs[0].healthy, k
            if k == 5:
                begun = [np.abs(b.mean).max() for b in beliefs]
        left = [np.log10(np.abs(b.mean).max() / start) for b, start in zip(beliefs, begun, strict=True)]
        assert left[0] < 0.8 * left[1] < 0.0  # it comes back nearly as fast


def test_rows_begin_again_and_go_on():
    system, filter = _case()
    record = simulate(system, 0, 4, 4)
    belief = track(filter, system.rows(4), record)[-1]
    rows = np.array([False, True, False, True])
    mixed = belief.with_rows(rows, filter.init(system.rows(4))[rows])
    np.testing.assert_array_equal(mixed.hidden[rows], 0.0)
    one, other = (filter.update(filter.predict(b, record.u[0]), record.y[0]) for b in (mixed, belief))
    assert_same(one[~rows], other[~rows], 1e-13)


def test_a_nonlinear_model_runs_on_a_network_as_well():
    model = NonlinearModel(lambda x, u: np.sin(x), lambda x, u: x[..., :1] ** 3, 0.1 * np.eye(2), [[1.0]])
    filter = LearnedGainFilter(model, _network(2, 1))
    belief: Belief = filter.init(Gaussian(np.ones((3, 2)), np.eye(2)))
    for _ in range(3):
        belief = filter.update(filter.predict(belief), np.ones((3, 1)))
    assert belief.healthy.all()


# --- files and refusals -----------------------------------------------------------------------------


def test_weights_are_saved_as_plain_arrays_and_loaded_without_pickle(tmp_path):
    network = _network(2, 1)
    network.save(tmp_path / "gain.npz")
    again = GainNetwork.load(tmp_path / "gain.npz")
    for name, array in vars(network).items():
        np.testing.assert_array_equal(getattr(again, name), array)
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ValueError, match="holds a: no weights of a GainNetwork"):
        GainNetwork.load(tmp_path / "other.npz")
    pickled = {name: np.array([object()]) for name in vars(network)}
    np.savez(tmp_path / "pickled.npz", **pickled)
    with pytest.raises(ValueError, match="more than plain arrays: no weights of a GainNetwork"):
        GainNetwork.load(tmp_path / "pickled.npz")
    network.save(tmp_path / "gain")  # the same name for both
    np.testing.assert_array_equal(GainNetwork.load(tmp_path / "gain").gain_bias, network.gain_bias)
    np.save(tmp_path / "array.npy", np.zeros(3))
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "text").write_text("weights")
    for name in ("array.npy", "empty", "text"):
        with pytest.raises(ValueError, match=f"{name} is no .npz file: no weights of a GainNetwork"):
            GainNetwork.load(tmp_path / name)
    with pytest.raises(OSError, match="No such file"):
        GainNetwork.load(tmp_path / "nothing")


def test_weights_that_do_not_fit_are_named():
    model = LinearModel(np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    with pytest.raises(ValueError, match="the network is for 2 states, 1 measurements; the model has 2 and 2"):
        LearnedGainFilter(model, _network(2, 1))
    with pytest.raises(TypeError, match="network must be a GainNetwork, got dict"):
        LearnedGainFilter(model, {})
    weights = dict(vars(_network(2, 2)))
    with pytest.raises(ValueError, match=r"gain_bias must have shape \(4,\), got \(3,\)"):
        GainNetwork(**(weights | {"gain_bias": np.zeros(3)}))
    with pytest.raises(ValueError, match="hidden_bias must be finite"):
        GainNetwork(**(weights | {"hidden_bias": np.full(15, np.nan)}))
    for scale in ("innovation_scale", "state_scale"):
        for wrong in (0.0, -1.0):
            with pytest.raises(ValueError, match=f"{scale} must be positive, got {wrong:g}"):
                GainNetwork(**(weights | {scale: np.array([1.0, wrong])}))
    with pytest.raises(ValueError, match=r"hidden_weights must have shape \(15, 5\), got \(\)"):
        GainNetwork(**(weights | {"hidden_weights": 1.0}))


def test_weights_are_its_own_whatever_becomes_of_those_given():
    weights = {name: np.array(array) for name, array in vars(_network(2, 2)).items()}
    network = GainNetwork(**weights)
    before = network(np.zeros(5), np.ones(2), np.ones(2))
    for array in weights.values():
        array += 1.0
    np.testing.assert_array_equal(network(np.zeros(5), np.ones(2), np.ones(2))[1], before[1])


def test_running_needs_no_torch():
    program = "import sys, estimators; estimators.LearnedGainFilter; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.split() == ["False"]
