"""Are the estimates as good as theory says, and does the task tell estimators apart? Seeds are fixed throughout."""

from functools import cache

import numpy as np
import pytest
from contract import make_core
from heading_ship import HEADING_SHIP
from scipy.stats import t as student
from sensing import assumed

from agents import load_agent
from estimators import Gaussian, LinearModel, chi_square_band, make, nees, wrap
from vessel_gym.processes import root_of
from vessel_gym.simulation.core import Core

SEEDS = 64
KEPT = ("truth", "measurement", "unknown_input", "estimate", "covariance", "input_estimate")
PSI, YAW_RATE = 2, 1  # in the filter's state
TRUE_PSI, TRUE_YAW_RATE = 2, 5


def paired_interval(difference: np.ndarray) -> tuple[float, float]:
    """The two-sided 95 % interval of the mean of paired differences: false alarm 2.5 % on either side."""
    half = (
        student.ppf(0.975, len(difference) - 1) * difference.std(ddof=1) / np.sqrt(len(difference))
    )
    return float(difference.mean() - half), float(difference.mean() + half)


# --- the same ship under the same rudder, estimated by one filter and another ---------------------


@cache
def rudder_programs(disturbance: str) -> np.ndarray:
    """``(T, N, 1)`` what an autopilot that knows the truth does: one program a seed, the same for every estimator."""
    core = make_core(HEADING_SHIP.name, SEEDS, estimator="truth", disturbance=disturbance)
    core.reset()
    controller = load_agent("autopilot", _Face(core))
    controller.reset(SEEDS)
    actions = []
    for _ in range(core.config.system.task.horizon):
        actions.append(controller.act(core.observe()))
        core.step(actions[-1])
    return np.stack(actions)


class _Face:
    """What `load_agent` asks of an environment."""

    def __init__(self, core: Core) -> None:
        self.unwrapped, self.core, self.system = self, core, core.config.system


@cache
def estimated(
    estimator: str, disturbance: str = "rough", assumed_as: str = ""
) -> dict[str, np.ndarray]:
    """Those of `KEPT` at every step ``(T, N, ...)``; ``assumed_as`` says how the filter assumes the sea."""
    options = {"assume": {"as": assumed_as}} if assumed_as else {}
    core = make_core(
        HEADING_SHIP.name,
        SEEDS,
        estimator=estimator,
        estimator_options=options,
        disturbance=disturbance,
    )
    core.reset()
    frames = []
    for actions in rudder_programs(disturbance):
        core.step(actions)
        info = core.info()
        frames.append({key: info[key] for key in KEPT if key in info})
    return {key: np.stack([frame[key] for frame in frames]) for key in frames[0]}


def heading_rmse(history: dict[str, np.ndarray]) -> np.ndarray:
    """One value a seed ``(N,)``."""
    return np.sqrt(
        np.mean(wrap(history["estimate"][..., PSI] - history["truth"][..., TRUE_PSI]) ** 2, axis=0)
    )


@pytest.mark.slow
def test_every_estimator_watched_the_same_ships():
    one = estimated("kf-umv-ui")
    assert one["truth"].shape == (600, SEEDS, 8)
    assert estimated("kf", assumed_as="states")["truth"].shape == (
        600,
        SEEDS,
        14,
    )  # and the sea, and its last increment
    for other in (
        estimated("kf"),
        estimated("kf", assumed_as="white-input"),
        estimated("dead-reckoning"),
    ):
        for key in ("truth", "unknown_input", "measurement"):
            np.testing.assert_array_equal(one[key], other[key])


@pytest.mark.slow
def test_kf_umv_ui_estimates_heading_better_than_kf_that_ignores_the_unknown_input():
    low, _ = paired_interval(heading_rmse(estimated("kf")) - heading_rmse(estimated("kf-umv-ui")))
    assert low > 0.0


@pytest.mark.slow
def test_telling_kf_the_true_variance_of_the_unknown_input_makes_it_as_good_as_kf_umv_ui():
    """In a rough sea the input is so large that knowing its variance adds next to nothing to not knowing it."""
    white, unbiased = (
        heading_rmse(estimated("kf", assumed_as="white-input")),
        heading_rmse(estimated("kf-umv-ui")),
    )
    assert paired_interval(heading_rmse(estimated("kf")) - white)[0] > 0.0
    low, high = paired_interval(white - unbiased)
    assert -0.01 * unbiased.mean() < low
    assert high < 0.01 * unbiased.mean()


def test_a_kalman_filter_that_holds_the_waves_as_states_sees_the_heading_no_worse_than_kf_umv_ui():
    """It knows their spectrum, too: measured, 0.0141 +- 0.0018 mrad better of 1.431."""
    states, unbiased = (
        heading_rmse(estimated("kf", assumed_as="states")),
        heading_rmse(estimated("kf-umv-ui")),
    )
    _, high = paired_interval(states - unbiased)
    assert high < 0.0


def test_who_holds_the_waves_as_states_is_not_too_sure_of_them():
    """By a chi-square of one time, false alarm 1e-6; of the ship itself it is cautious, as its process noise is."""
    history = estimated("kf", assumed_as="states")
    core = make_core(
        HEADING_SHIP.name, 1, estimator="kf", estimator_options={"assume": {"as": "states"}}
    )
    truth = core.config.true_state.in_filter_order(history["truth"])
    high = chi_square_band(SEEDS, 6, 1.0 - 2e-6)[1]
    for k in (30, 150, 300, 450, 599):
        assert (
            nees(history["estimate"][k], history["covariance"][k], truth[k], angles=(PSI,)).mean()
            < high
        )


# --- a linear truth: the filter's own model, with the rough sea -----------------------------------

RUNS, TIMES, TRANSIENT = 200, 400, 100


def linear_truth(
    model: LinearModel, u: np.ndarray, disturbance: str | None, seed: int, prior: Gaussian
):
    """States, unknown inputs and measurements ``(T, M, ...)`` of the filter's model itself."""
    rng = np.random.default_rng(seed)
    A, B = model.A(u), model.B(u)
    root = np.linalg.cholesky(model.Q)
    x = prior.mean + rng.normal(size=(RUNS, model.n)) @ np.linalg.cholesky(prior.cov).T
    sea = HEADING_SHIP.disturbances[disturbance or "calm"]
    process = sea.process
    waves = rng.normal(size=(RUNS, process.size)) @ root_of(process.start_cov).T
    states, inputs, measurements = [], [], []
    for _ in range(TIMES):
        d = sea.effect(waves, x)[:, :1] * (disturbance is not None)
        v = rng.normal(size=(RUNS, model.p)) * np.sqrt(np.diag(model.R))
        states.append(x)
        inputs.append(d)
        measurements.append(x @ model.C.T + d @ model.H.T + v)
        x = x @ A.T + u @ B.T + d @ model.G.T + rng.normal(size=(RUNS, model.n)) @ root.T
        waves = process.advance(waves) + rng.normal(size=(RUNS, process.normals)) @ process.root.T
    return np.stack(states), np.stack(inputs), np.stack(measurements)


@cache
def consistency(estimator: str, disturbance: str | None, seed: int = 3) -> np.ndarray:
    """NEES ``(T, M)``: one value a time and run; for kf-umv-ui of the state, and of state and input together."""
    sensors = make_core(HEADING_SHIP.name, 1).config.sensors
    _, model = assumed(
        HEADING_SHIP.vehicle, "corrected", HEADING_SHIP.disturbances["calm"], sensors
    )
    u = np.array([0.15, 0.02])  # rudder and commanded yaw rate of a turn
    prior = Gaussian(np.array([0.0, 0.0, 0.5]), np.diag([0.2, 0.002, 0.03]) ** 2)
    states, _, measurements = linear_truth(model, u, disturbance, seed, prior)
    filter = make(estimator, model)
    belief = filter.init(Gaussian(np.tile(prior.mean, (RUNS, 1)), prior.cov))
    values = []
    for k in range(TIMES):
        if k:
            belief = filter.predict(belief, u)
        belief = filter.update(belief, measurements[k], u=u)
        values.append(nees(belief.mean, belief.cov, states[k], angles=(PSI,)))
    return np.stack(values)


def share_inside(values: np.ndarray) -> float:
    """The share of times whose mean over the runs lies in the 95 % band of chi-square, both sides."""
    low, high = chi_square_band(values.shape[1], degrees=3)
    means = values.mean(axis=1)
    return float(np.mean((low <= means) & (means <= high)))


@pytest.mark.slow
@pytest.mark.parametrize(("estimator", "disturbance"), [("kf-umv-ui", "rough"), ("kf", None)])
def test_errors_are_as_large_as_the_filter_says_at_nine_times_in_ten(
    estimator: str, disturbance: str | None
):
    values = consistency(estimator, disturbance)
    assert share_inside(values) >= 0.9
    assert share_inside(values[TRANSIENT:]) >= 0.9


def test_a_filter_that_ignores_the_rough_sea_is_not_consistent_in_it():
    """The test above can fail."""
    assert share_inside(consistency("kf", "rough")) < 0.05
