"""A filter's model is composed of vehicle, disturbance and sensors, of one's own too, as much as it is told of them.

Statistical tests have fixed seeds; their bands say their false-alarm rates.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import (
    OURS,
    assert_apart,
    assert_same_tree,
    make_core,
    observations_when_truth_is_altered,
    single_class,
)
from heading_ship import HEADING_SHIP
from refusals import refused
from scipy.linalg import block_diag
from scipy.stats import chi2
from scipy.stats import t as student

from estimators import NonlinearModel, chi_square_band, nees
from estimators.varying import resolve
from vessel_gym.core import Core
from vessel_gym.disturbances import Disturbance, Fault, Sea
from vessel_gym.filter_models.exogenous import Forces
from vessel_gym.processes import Process
from vessel_gym.sensors import Bias, Sensor, plain

every_environment = pytest.mark.parametrize("env_id", OURS)
AUV, SHIP = "SegorogeniAUV-v0", HEADING_SHIP.name


# --- sensors and disturbances of one's own --------------------------------------------------------


def slant(state: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
    """Slant range, bearing and elevation of the vehicle from the origin."""
    x, y, z = state[..., 6], state[..., 7], state[..., 8]
    level = np.hypot(x, y)
    return np.stack([np.hypot(level, z), np.arctan2(y, x), np.arctan2(z, level)], -1)


def place(measurements: np.ndarray, known: Any) -> dict[str, np.ndarray]:
    distance, bearing, elevation = measurements[..., 0], measurements[..., 1], measurements[..., 2]
    level = distance * np.cos(elevation)
    return {
        "x": level * np.cos(bearing),
        "y": level * np.sin(bearing),
        "z": distance * np.sin(elevation),
    }


USBL = Sensor(
    "USBL", ("slant range [m]", "bearing [rad]", "elevation [rad]"), slant, (0.1, 0.02, 0.02), rate=1.0, dropout=0.1,
    range=((1.0, 100.0), (-4.0, 4.0), (-2.0, 2.0)), angles=(1, 2), scale=(10.0, 1.0, 1.0), inverse=place,
)  # fmt: skip
WITHOUT_FIXES = [
    sensor
    for sensor in single_class(AUV).system.vehicle.sensors
    if sensor.name != "acoustic position"
]
WITH_USBL = [*WITHOUT_FIXES, USBL]


class Sheared(Disturbance):
    """A current that wanders, and fades with depth; and turbulence."""

    names = ("surface current north", "surface current east")
    forces = ("current north", "current east")
    process = Process.wandering((0.3, 0.3), 60.0, 0.1)
    white_increments = tuple(f"{name} increment" for name in "uvwpqr")
    white = 0.005 * np.eye(6)
    dt = 0.1

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """The current at the vehicle's depth."""
        return z * np.exp(-np.maximum(state[..., 8:9], 0.0) / 4.0)


class Swell(Disturbance):
    """Second-order swell that heaves and pitches a vehicle, less and less with depth; and turbulence."""

    names = ("swell", "swell rate")
    forces = ("w increment", "q increment")
    process = Process.stationary(np.array([[0.0, 1.0], [-1.0, -0.2]]), np.diag([0.0, 0.4]), 0.1)
    white_increments = ("u increment", "v increment", "p increment", "r increment")
    white = 0.005 * np.eye(4)
    dt = 0.1

    def effect(self, z: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Increments on heave and pitch rate over a step."""
        return z * [0.01, 0.02] * np.exp(-np.maximum(state[..., 8:9], 0.0) / 10.0)


OWN = {"sheared": Sheared(), "swell": Swell()}
own_disturbances = pytest.mark.parametrize("disturbance", OWN.values(), ids=OWN)


def gyroscope(**bias: Any) -> list[Sensor]:
    """The nominal sensors, but for a bias of the gyroscope."""
    names = tuple(f"bias {name}" for name in "pqr")
    return [
        (
            replace(sensor, bias=Bias(names, scale=0.01, **bias))
            if sensor.name == "gyroscope"
            else sensor
        )
        for sensor in single_class(AUV).system.vehicle.sensors
    ]


BIASED = {
    "constant": gyroscope(start=(0.02,) * 3),
    "walking": gyroscope(start=(0.01,) * 3, pace=(0.003,) * 3),
    "drifting": gyroscope(start=(0.01,) * 3, slope=(0.001,) * 3),
    "correlated": gyroscope(start=(0.02,) * 3, time=20.0),
}


_FAULT: dict[str, Any] = {"bias": 0.03, "loss": 0.2, "amplitude": 0.05, "start": 0.03, "walk": 0.02}
FAULTS = [
    (AUV, Fault("stern plane", beside=single_class(AUV).system.disturbances["rough"], **_FAULT)),
    (
        "PunaUAV-v0",
        Fault("bank", beside=single_class("PunaUAV-v0").system.disturbances["rough"], **_FAULT),
    ),
]


# --- the model is the world's ---------------------------------------------------------------------

MET: dict[str, dict[str, Any]] = {
    env_id: {"disturbance": single_class(env_id).system.disturbances["rough"].modelled}
    for env_id in ("SigmaCorvette-v0", "SigmaChannel-v0", "vessel_gym/Ship-v0")
}
"""Where filters take a sea for another one, unless they assume its bands, which stand for a field of waves."""
DISTURBED = [env_id for env_id in OURS if env_id != "ThesisCorvette-v0"]
"""Those with a sea or an air, of which filters have the world's model: the thesis' have not."""
WORLDS: list[tuple[str, dict[str, Any]]] = [
    *(
        (
            env_id,
            MET.get(env_id, {})
            | {
                "estimator_options": {
                    "assume": {"as": "states"} | MET.get(env_id, {}),
                    "model": "nonlinear",
                }
            },
        )
        for env_id in DISTURBED
    ),
    *((AUV, {"sensors": sensors}) for sensors in (WITH_USBL, *BIASED.values())),
    *((AUV, {"disturbance": disturbance}) for disturbance in OWN.values()),
    *(
        (env_id, {"disturbance": fault, "estimator_options": {"assume": {"as": "states"}}})
        for env_id, fault in FAULTS
    ),
]
every_world = pytest.mark.parametrize(
    ("env_id", "chosen"),
    WORLDS,
    ids=[
        *DISTURBED,
        "USBL",
        *(f"{name} bias" for name in BIASED),
        *OWN,
        "faulty stern plane",
        "faulty bank",
    ],
)


def undisturbed(core: Core) -> None:
    """From now on for a step nothing is new."""
    core.now.noise = np.zeros_like(core.now.noise)
    core.now.exogenous = core.now.exogenous.copy()
    core.now.exogenous[:, core.config.world.forces.white_indices] = 0.0


@pytest.mark.slow
@every_world
def test_without_noise_world_and_filter_model_agree(env_id: str, chosen: dict[str, Any]):
    core = make_core(
        env_id, 5, seed=1, estimator="dead-reckoning", **({"disturbance": "rough"} | chosen)
    )
    core.reset()
    model = core.config.composition.model
    assert isinstance(model, NonlinearModel)
    rng, size = np.random.default_rng(1), core.config.action_size
    for _ in range(20):
        action = rng.uniform(-1.0, 1.0, (5, size)) * (
            env_id not in (SHIP, *MET)
        )  # which is told the mean rudder of a step
        undisturbed(core)
        before, where = core.config.true_state.in_filter_order(core.truth), core.now.actuators
        count = len(core.config.system.vehicle.increments)
        read = np.concatenate(
            [core.now.exogenous_before[:, :count], core.now.exogenous[:, count:]], -1
        )
        exact = core.config.sensors.exact(
            core.now.state, read, core.now.slow[:, core.config.world.size :]
        )
        np.testing.assert_allclose(model.measurement(before, None), exact, atol=1e-12)
        u = core.config.system.vehicle.known_input(
            where,
            core.config.system.vehicle.actuate(where, action),
            core.config.system.task.commanded(core.now.scenario, core.now.steps),
        )
        core.step(action)
        np.testing.assert_allclose(
            core.config.true_state.in_filter_order(core.truth),
            model.transition(before, u),
            rtol=1e-12,
            atol=1e-12,
        )
        assert np.abs(core.config.true_state.in_filter_order(core.truth) - before).max() > 1e-3


@pytest.mark.slow
@every_world
def test_noise_of_world_has_covariance_of_filter_model(env_id: str, chosen: dict[str, Any]):
    rows, steps = 1000, 10
    core = make_core(
        env_id, rows, seed=2, estimator="dead-reckoning", **({"disturbance": "rough"} | chosen)
    )
    core.reset()
    model, vehicle, fresh = core.config.composition.model, core.config.system.vehicle, []
    for _ in range(steps):
        before, where = core.config.true_state.in_filter_order(core.truth), core.now.actuators
        idle = np.zeros((rows, core.config.action_size))
        u = vehicle.known_input(
            where,
            vehicle.actuate(where, idle),
            core.config.system.task.commanded(core.now.scenario, core.now.steps),
        )
        core.step(idle)
        fresh.append(
            core.config.true_state.in_filter_order(core.truth) - model.transition(before, u)
        )
    sample = np.concatenate(fresh)
    Q = model.Q.copy()
    base = core.config.composition.base
    Q[:base, :base] -= np.diag(vehicle.process_sd[:base] ** 2)  # what models leave out comes on top
    moving = np.diag(Q) > 1e-18
    scale = np.sqrt(np.where(moving, np.diag(Q), 0.0))
    np.testing.assert_allclose(sample[:, ~moving], 0.0, atol=1e-12)
    found = (
        sample[:, moving].T
        @ sample[:, moving]
        / len(sample)
        / np.outer(scale[moving], scale[moving])
    )
    # a covariance of 10,000 unit normals has a standard deviation of at most 1.5 / sqrt(10,000): 7
    # of them
    expected = Q[np.ix_(moving, moving)] / np.outer(scale[moving], scale[moving])
    np.testing.assert_allclose(found, expected, rtol=0, atol=7.0 * 1.5 / np.sqrt(len(sample)))


@pytest.mark.slow
@every_world
def test_first_belief_is_consistent_with_starts(env_id: str, chosen: dict[str, Any]):
    """By chi-square of 2000 starts, false alarm 1e-6; dead reckoning believes what it is told and nothing else."""
    rows = 2000
    core = make_core(
        env_id, rows, seed=3, estimator="dead-reckoning", **({"disturbance": "rough"} | chosen)
    )
    core.reset()
    n = len(core.config.composition.names)
    known = np.diagonal(core.now.belief.cov, axis1=-2, axis2=-1)[0] > 0.0
    error = core.config.true_state.in_filter_order(core.truth) - core.now.belief.mean
    np.testing.assert_allclose(error[:, ~known], 0.0, atol=1e-12)  # a drift of nothing
    cov = core.now.belief.cov[..., known, :][..., known]
    values = nees(error[:, known], cov, np.zeros((rows, known.sum())))
    low, high = chi2.ppf([5e-7, 1 - 5e-7], rows * known.sum()) / rows
    assert low < values.mean() < high
    assert known.sum() >= n - 3


# --- biases ---------------------------------------------------------------------------------------


def fly(core: Core, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Steer gently: errors of all that the filter estimates ``(steps, rows, n)``, and their NEES ``(steps, rows)``."""
    angles = tuple(
        i
        for i, name in enumerate(core.config.composition.names)
        if name in core.config.system.vehicle.angles
    )
    errors, values = [], []
    for k in range(steps):
        core.step(np.tile([0.2 * np.sin(0.05 * k), 0.1, 0.0], (core.num_envs, 1)))
        truth, belief = core.config.true_state.in_filter_order(core.truth), core.now.belief
        errors.append(belief.mean - truth)
        values.append(nees(belief.mean, belief.cov, truth, angles=angles))
    return np.stack(errors), np.stack(values)


def assert_consistent(core: Core, values: np.ndarray) -> None:
    """NEES ``(steps, rows)``: at every step the mean over the rows lies in a chi-square band of false alarm 1e-5."""
    low, high = chi_square_band(values.shape[1], len(core.config.composition.names), 1.0 - 1e-5)
    means = values.mean(-1)
    assert low < means.min()
    assert means.max() < high


@pytest.mark.slow
@pytest.mark.parametrize("sensors", BIASED.values(), ids=BIASED)
def test_filter_with_bias_states_finds_bias_and_is_consistent(sensors: list[Sensor]):
    core = make_core(AUV, 200, seed=4, estimator="ekf", sensors=sensors)
    core.reset()
    begun = np.diagonal(core.now.belief.cov, axis1=-2, axis2=-1)[0]
    errors, values = fly(core, 150)
    columns = [core.config.composition.names.index(f"bias {name}") for name in "pqr"]
    found = np.sqrt(np.mean(errors[-20:, :, columns] ** 2))
    raw = np.sqrt(np.mean(core.now.slow[:, core.config.world.size :][:, :3] ** 2))
    assert found < 0.5 * raw
    assert (np.diagonal(core.now.belief.cov, axis1=-2, axis2=-1)[:, columns] < begun[columns]).all()
    assert_consistent(core, values[20:])


# --- a sensor of one's own ------------------------------------------------------------------------


def assert_smaller(one: np.ndarray, other: np.ndarray) -> None:
    """Paired means, with a 99.9 % interval."""
    difference = other - one
    half = student.ppf(0.9995, len(one) - 1) * difference.std(ddof=1) / np.sqrt(len(one))
    assert difference.mean() - half > 0.0


# --- a disturbance of one's own -------------------------------------------------------------------


@pytest.mark.slow
@own_disturbances
def test_ekf_with_user_defined_disturbance_is_consistent(disturbance: Disturbance):
    core = make_core(AUV, 200, seed=10, estimator="ekf", disturbance=disturbance)
    core.reset()
    assert_consistent(core, fly(core, 120)[1][20:])


# --- truth stays where it is ----------------------------------------------------------------------

LEAKS: list[tuple[str, dict[str, Any]]] = [
    (AUV, {"sensors": WITH_USBL, "estimator": "enkf", "disturbance": OWN["sheared"]}),
    (AUV, {"sensors": BIASED["drifting"], "estimator": "ukf-umv", "disturbance": OWN["swell"],
           "estimator_options": {"assume": {"as": "unknown-input"}}}),
    (AUV, {"sensors": BIASED["walking"], "observe": "measurement", "guidance": True}),
    (SHIP, {"estimator": "kf", "estimator_options": {"assume": {"as": "states", "disturbance": "calm"}}}),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "chosen"), LEAKS, ids=range(len(LEAKS)))
def test_user_defined_parts_do_not_leak_truth(env_id: str, chosen: dict[str, Any]):
    one, other, distance = observations_when_truth_is_altered(env_id, **chosen)
    assert_apart(distance)
    for mode in one:
        np.testing.assert_array_equal(one[mode], other[mode], err_msg=mode)
        assert (np.ptp(one[mode], axis=0) > 0.01).any(), mode


# --- assumptions of a filter ----------------------------------------------------------------------


def told(env_id: str, rows: int = 2, estimator: str = "ekf", **chosen: Any) -> Core:
    return make_core(
        env_id, rows, estimator=estimator, disturbance="rough", estimator_options={"assume": chosen}
    )


@every_environment
@pytest.mark.parametrize("how", ["states", "unknown-input", "process-noise"])
def test_assumed_factors_scale_Q_R_and_prior_alone(env_id: str, how: str):
    as_it_is, factored = (
        told(env_id, **{"as": how}),
        told(env_id, **{"as": how}, Q=2.0, R=3.0, prior=5.0),
    )
    one, other = (core.config.composition.model for core in (as_it_is, factored))
    x, u = np.full((1, one.n), 0.5), as_it_is.config.system.vehicle.cruise[1]
    np.testing.assert_array_equal(resolve(other.Q, u), 2.0 * resolve(one.Q, u))
    np.testing.assert_array_equal(resolve(other.R, u), 3.0 * resolve(one.R, u))
    np.testing.assert_array_equal(other.measurement(x, u), one.measurement(x, u))
    np.testing.assert_array_equal(other.transition(x, u), one.transition(x, u))
    starts = []
    for factor in (1.0, 5.0):
        core = told(env_id, estimator="dead-reckoning", prior=factor, **{"as": how})
        core.reset()
        starts.append(core.now.belief)
    np.testing.assert_array_equal(starts[1].cov, 5.0 * starts[0].cov)
    np.testing.assert_array_equal(starts[1].mean, starts[0].mean)


@pytest.mark.parametrize("env_id", DISTURBED)
@pytest.mark.parametrize("how", ["states", "process-noise"])
def test_assumed_sea_gives_same_model_as_true_sea(env_id: str, how: str):
    calm = single_class(env_id).system.disturbances["calm"]
    wrong = told(env_id, disturbance=calm.believed or "calm", **{"as": how})
    options = {"assume": {"as": how}}
    there = make_core(env_id, 2, estimator="ekf", disturbance="calm", estimator_options=options)
    right = told(env_id, **{"as": how})
    np.testing.assert_array_equal(
        wrong.config.composition.model.Q, there.config.composition.model.Q
    )
    np.testing.assert_array_equal(
        wrong.config.composition.model.R, there.config.composition.model.R
    )
    if how != "process-noise" or env_id not in (
        "PunaUAV-v0",
        "vessel_gym/FixedWing-v0",
    ):  # whose increments are the same in every wind
        assert (
            np.diag(wrong.config.composition.model.Q) < np.diag(right.config.composition.model.Q)
        ).any()
    for core in (wrong, there, right):
        core.reset()
    np.testing.assert_array_equal(
        wrong.now.state, right.now.state
    )  # it is another sea to the filter alone
    np.testing.assert_array_equal(wrong.now.slow, right.now.slow)
    np.testing.assert_array_equal(wrong.now.y, right.now.y)
    assert (wrong.now.slow != there.now.slow).any()


@every_environment
def test_oracle_ignores_assumptions(env_id: str):
    cores = [
        told(env_id, estimator="truth", **given)
        for given in ({}, {"as": "process-noise"}, {"disturbance": "calm", "Q": 2.0})
    ]
    for core in cores:
        core.reset()
        for _ in range(5):
            core.step(np.zeros((2, core.config.action_size)))
    for core in cores[1:]:
        assert_same_tree(core.info(), cores[0].info())
        np.testing.assert_array_equal(core.observe(), cores[0].observe())


def flown(core: Core, steps: int = 60) -> dict[str, np.ndarray]:
    """Everything in ``info`` at every step ``(T, N, ...)`` of a gentle zigzag."""
    core.reset()
    frames = [core.info()]
    for k in range(steps):
        core.step(np.full((core.num_envs, 1), 0.5 * np.sin(0.2 * k)))
        frames.append(core.info())
    return {key: np.stack([frame[key] for frame in frames]) for key in frames[0]}


def test_white_input_equals_given_input_cov():
    by_word = told(SHIP, 5, estimator="kf", **{"as": "white-input"})
    sea = single_class(SHIP).system.disturbances["rough"]
    variance = 0.25 * (sea.wave**2 + sea.gust**2)  # of dt times the yaw rates of waves and gusts
    given = {"input_cov": np.array([[variance]])}
    by_hand = make_core(SHIP, 5, estimator="kf", disturbance="rough", estimator_options=given)
    one, other = flown(by_word), flown(by_hand)
    for key in ("estimate", "covariance", "input_estimate", "measurement", "truth"):
        np.testing.assert_allclose(one[key], other[key], rtol=0, atol=1e-12, err_msg=key)
    factored = told(SHIP, estimator="kf", Q=3.0, **{"as": "white-input"}).config.estimation.filter
    np.testing.assert_allclose(factored.input_cov, 3.0 * given["input_cov"], rtol=1e-15)
    ignorant = flown(make_core(SHIP, 5, estimator="kf", disturbance="rough"))
    assert np.abs(one["estimate"] - ignorant["estimate"]).max() > 1e-3


@pytest.mark.parametrize("estimator", ["kf-umv-ui", "ulise"])
def test_unknown_input_filter_without_input_says_what_to_assume(estimator: str):
    for how in ("states", "process-noise"):
        sentence = (
            f'^{estimator} needs an unknown input, but assumes Sea as "{how}": assume one with'
            ' increments, with {"as": "unknown-input"}, or choose another estimator$'
        )
        with refused(ValueError, sentence):
            told(SHIP, estimator=estimator, **{"as": how})


def test_increment_as_noise_enters_Q_and_is_held_as_state():
    as_input, as_noise = (
        told(SHIP, estimator="ekf", **{"as": how}).config.composition
        for how in ("unknown-input", "process-noise")
    )
    d = as_input.forces.increment_cov
    G, H = as_input.model.G, as_input.model.H
    assert as_noise.names == (*as_input.names, "last yaw increment")
    moved, size = np.vstack([G, np.eye(1)]), len(as_input.names)
    Q = block_diag(as_input.model.Q, np.zeros((1, 1)))
    np.testing.assert_allclose(as_noise.model.Q, Q + moved @ d @ moved.T, rtol=1e-14)
    np.testing.assert_array_equal(as_noise.model.R, as_input.model.R)
    x = np.random.default_rng(0).normal(size=size + 1)
    _, C = as_noise.model.linearise_measurement(x, None)
    np.testing.assert_allclose(C[:, size:], H, rtol=0, atol=1e-12)
    assert as_input.model.delayed_feedthrough
    assert as_noise.model.G is None
    assert as_noise.model.H is None
    np.testing.assert_array_equal(G, [[0.0], [0.0], [1.0], [0.0]])
    np.testing.assert_array_equal(H, [[0.0], [1.0]])


def test_composed_linear_model_is_block_of_ship_and_sea():
    composition = told(SHIP, estimator="kf", **{"as": "states"}).config.composition
    waves = "wave yaw", "wave yaw rate", "gust yaw rate", "last yaw increment"
    assert composition.names == ("v", "r", "psi", *waves)  # no current: none shows
    plain_model = told(SHIP, estimator="kf", **{"as": "unknown-input"}).config.composition.model
    model, sea, u = composition.model, composition.forces.disturbance, np.array([0.1, 0.03])
    d = np.array([0.0, 0.5, 0.5])  # yaw increment by wave yaw, wave yaw rate, gust yaw rate
    expected = np.zeros((7, 7))
    expected[:3, :3], expected[3:6, 3:6] = plain_model.A(u), sea.process.transition[:3, :3]
    expected[[2, 6], 3:6] = d
    np.testing.assert_allclose(model.A(u), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        model.B(u), np.vstack([plain_model.B(u), np.zeros((4, 2))]), rtol=0, atol=1e-15
    )
    np.testing.assert_allclose(
        model.C, [[0, 0, 1, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0, 1]], rtol=0, atol=1e-12
    )


# --- what is misdeclared --------------------------------------------------------------------------


def disturbance(**attributes: Any) -> Disturbance:
    """A current for the underwater vehicle, but for some attributes."""
    base = {"names": ("a", "b"), "forces": ("current north", "current east"), "dt": 0.1,
            "process": Process.wandering((0.1, 0.1), 50.0, 0.1)}  # fmt: skip
    return type("Mine", (Disturbance,), base | attributes)()


MISDECLARED = [
    (AUV, disturbance(forces=("current north", "tide")), "Mine gives 'tide', but what acts on this vehicle is .*"),
    (AUV, disturbance(dt=0.5), "Mine was made for steps of 0.5 s, the vehicle's are 0.1 s: give it dt=0.1"),
]  # fmt: skip


@pytest.mark.parametrize(("env_id", "mine", "sentence"), MISDECLARED, ids=range(len(MISDECLARED)))
def test_misdeclared_disturbance_is_refused_in_one_sentence(
    env_id: str, mine: Disturbance, sentence: str
):
    for chosen in ({"disturbance": mine}, {"estimator_options": {"assume": {"disturbance": mine}}}):
        with refused(ValueError, f"^{sentence}$"):
            make_core(env_id, 1, **chosen)


def sensor(reads: Callable[..., np.ndarray], **changed: Any) -> Sensor:
    return Sensor("mine", ("a", "b"), reads, (1.0, 1.0), **changed)


WRONG_SENSORS = [
    (AUV, sensor(plain((6,))), r"reads of mine must give 2 values for each state: \(2, 3, 12\) gave \(2, 3, 1\), .*"),
    (SHIP, sensor(plain((0, 1))), "mine reads x, which filters of this model do not estimate .they estimate v, r, "
                                  "psi.: leave it out, or choose another model"),
    (AUV, sensor(plain((6, 7)), bias=Bias(("x", "y"), start=(1.0, 1.0))), "a bias is called 'x', as another .*"),
    (AUV, sensor(plain((6, 7)), bias=Bias(("current north",), start=(1.0,))),
     "a bias is called 'current north', as is a component of Water"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("env_id", "mine", "sentence"), WRONG_SENSORS, ids=range(len(WRONG_SENSORS))
)
def test_misdeclared_sensor_is_refused_in_one_sentence(env_id: str, mine: Sensor, sentence: str):
    sensors = [*single_class(env_id).system.vehicle.sensors, mine]
    with refused(ValueError, f"^{sentence}$"):
        make_core(env_id, 1, sensors=sensors)


def test_robust_kf_radius_above_slowest_bias_is_warned_of():
    """A warning is an error in tests, so that the default, and any radius without biases, must give none."""
    core = make_core(AUV, 1, estimator="robust-kf", sensors="budget")
    assert core.config.estimation.filter.radius == 1e-6
    message = (
        "^robust-kf with radius 0.01 enlarges variances by 0.14 of themselves a step, and the"
        " sensors' slowest bias"
    )
    with pytest.warns(UserWarning, match=message):
        make_core(
            AUV, 1, estimator="robust-kf", sensors="budget", estimator_options={"radius": 0.01}
        )
    make_core(AUV, 1, estimator="robust-kf", sensors="budget", estimator_options={"radius": 0.0})


CURRENT_METER = Sensor(
    "current meter", ("north", "east"), lambda state, exogenous: exogenous[..., 1:3], (0.05, 0.05)
)


@pytest.mark.parametrize("how", ["states", "unknown-input"])
@pytest.mark.parametrize("estimator", ["kf", "ekf"])
def test_current_seen_by_one_sensor_alone_is_estimated(estimator: str, how: str):
    sensors = [*single_class(SHIP).system.vehicle.sensors, CURRENT_METER]
    options = {"assume": {"as": how}}
    core = make_core(
        SHIP, 50, seed=14, estimator=estimator, estimator_options=options, sensors=sensors
    )
    core.reset()
    for _ in range(60):
        core.step(np.zeros((50, 1)))
    current = [
        core.config.composition.names.index(f"current {direction}")
        for direction in ("north", "east")
    ]
    error = core.now.belief.mean[:, current] - core.now.slow[:, : core.config.world.size][:, -2:]
    cov = core.now.belief.cov[:, current][..., current]
    low, high = chi_square_band(50, 2, 1.0 - 1e-5)
    assert low < nees(error, cov, np.zeros(error.shape)).mean() < high


@pytest.mark.filterwarnings("error")
def test_sensor_may_read_what_has_no_value_at_rest():
    drift = Sensor(
        "vane",
        ("drift angle",),
        lambda state, exogenous: state[..., 4:5] / state[..., 3:4],
        (0.01,),
    )
    sensors = [*single_class(SHIP).system.vehicle.sensors, drift]
    for chosen in ({}, {"assume": {"as": "process-noise"}}, {"assume": {"as": "states"}}):
        make_core(SHIP, 1, estimator="ekf", estimator_options=chosen, sensors=sensors).reset()


def test_white_input_concerns_only_filters_with_a_model():
    mine = type("Mine", (Sea,), {"assumed_as": "white-input"})(
        wave=0.01, peak=0.8, gust=0.002, current=0.3
    )
    for estimator in ("kf", "truth", "measurement", "dead-reckoning"):
        make_core(SHIP, 1, estimator=estimator, disturbance=mine).reset()
    with refused(ValueError, "^only kf can assume a white input of known variance, not ekf: "):
        make_core(SHIP, 1, estimator="ekf", disturbance=mine)


def test_sensor_of_unassumed_current_needs_no_measurement_model():
    sensors = [*single_class(SHIP).system.vehicle.sensors, CURRENT_METER]
    noise = type("Noise", (Sea,), {"assumed_as": "process-noise"})(
        wave=0.01, peak=0.8, gust=0.002, current=0.3
    )
    chosen: dict[str, Any] = {"sensors": sensors, "disturbance": noise}
    for estimator in ("truth", "measurement", "dead-reckoning"):
        make_core(
            SHIP, 1, estimator=estimator, observe="measurement", guidance=True, **chosen
        ).reset()
    make_core(
        SHIP, 1, estimator="kf", estimator_options={"assume": {"as": "process-noise"}}, **chosen
    )  # who insists
    sentence = (
        "^current meter reads current north, of which a filter knows nothing that assumes Noise as"
        ' "process-noise": assume it with {"as": "states"}, or leave it out$'
    )
    with refused(ValueError, sentence):
        make_core(SHIP, 1, estimator="kf", **chosen)


def test_nonlinear_sensor_is_refused_by_linear_filters_alone():
    squared = sensor(lambda state, exogenous: state[..., [2, 2]] ** 2)
    sensors = [*single_class(SHIP).system.vehicle.sensors, squared]
    sentence = (
        "^mine is not linear in what the filter estimates: choose a filter for nonlinear models$"
    )
    with refused(ValueError, sentence):
        make_core(SHIP, 1, sensors=sensors)
    make_core(SHIP, 1, sensors=sensors, estimator="ekf").reset()


WRONGLY_TOLD = [
    ({"sea": "calm"}, TypeError, "unknown key of assume 'sea': choose from disturbance, as, Q, R, prior"),
    ({"disturbance": 3}, TypeError, "disturbance must be one of calm, moderate, rough, or a Disturbance object, got 3"),
    ({"as": "state"}, ValueError, "unknown way to assume a disturbance .state. .* choose from states, unknown-input, "
                                  "white-input, process-noise"),
    ({"Q": 0.0}, ValueError, "Q of assume must be a factor above 0, got 0.0"),
    ({"R": np.eye(2)}, ValueError, "R of assume must be a factor above 0, got .*"),
]  # fmt: skip


@pytest.mark.parametrize(("wrong", "kind", "sentence"), WRONGLY_TOLD, ids=range(len(WRONGLY_TOLD)))
def test_bad_assumption_is_refused_in_one_sentence(
    wrong: Any, kind: type[Exception], sentence: str
):
    with refused(kind, f"^{sentence}$"):
        make_core(SHIP, 1, estimator="ekf", estimator_options={"assume": wrong})


def test_kf_of_white_increment_is_exact_however_assumed():
    """State and measurement have it when its step has ended: as a state, as noise or as an input of known variance."""
    shaken = {"names": (), "forces": (), "process": Process.joined(), "dt": 0.5, "white_increments": ("yaw increment",),
              "white": np.array([[0.009]])}  # fmt: skip
    mine = disturbance(**shaken, assumed_as="unknown-input")
    np.testing.assert_allclose(
        Forces(single_class(SHIP).system.vehicle, mine).increment_cov, [[0.009**2]]
    )
    errors, ways = (
        [],
        [("kf", how) for how in ("white-input", "states", "process-noise", "unknown-input")],
    )
    for estimator, how in (*ways, ("kf-umv-ui", "unknown-input")):
        options = {"assume": {"as": how}}
        core = make_core(
            SHIP, 32, seed=13, estimator=estimator, estimator_options=options, disturbance=mine
        )
        seen = flown(core, 100)
        errors.append(np.sqrt(np.mean((seen["estimate"][..., 2] - seen["truth"][..., 2]) ** 2, 0)))
    np.testing.assert_allclose(errors[1:3], errors[:1] * 2, rtol=1e-9)
    assert_smaller(errors[0], errors[3])
    assert_smaller(errors[4], errors[3])


def test_names_of_composition_are_unique_and_complete():
    for env_id, chosen in WORLDS:
        core = make_core(env_id, 1, estimator="ekf", **chosen)
        names = core.config.composition.names
        assert len(set(names)) == len(names) == core.config.composition.model.n
        assert len(set(core.config.true_state.names)) == len(core.config.true_state.names)
        believed = core.config.world.forces.disturbance.believed
        assert set(names) <= {*core.config.true_state.names, *(believed.names if believed else ())}


def test_effect_that_vanishes_at_cruise_is_still_estimated():
    """Below 1 m, or only in some direction of its state: the filter that is told of it holds it all."""
    for effect in (
        lambda self, z, state: z * (state[..., 8:9] > 1.0),
        lambda self, z, state: np.stack(
            [z[..., 0] * np.cos(z[..., 1]), z[..., 0] * np.sin(z[..., 1])], -1
        ),
    ):
        core = make_core(AUV, 1, estimator="ekf", disturbance=disturbance(effect=effect))
        assert core.config.composition.estimated.tolist() == [0, 1]


def test_a_measurement_that_is_no_number_has_not_come():
    def echo(state, exogenous):
        return np.where(state[..., :1] > 0.1, np.nan, state[..., 8:9])  # when under way

    broken = Sensor("echo", ("z",), echo, (0.1,))
    core = make_core(
        AUV, 2, observe="measurement", sensors=[*single_class(AUV).system.vehicle.sensors, broken]
    )
    core.reset()
    core.step(np.zeros((2, core.config.action_size)))
    assert not core.now.available[:, -1].any()
    assert np.isfinite(core.observe()).all()


@pytest.mark.parametrize(
    ("name", "estimator", "options"),
    [
        ("ekf-waves", "ekf", {"assume": {"disturbance": "moderate", "as": "states"}}),
        ("kf-white", "kf", {"assume": {"as": "white-input"}}),
        ("huber-kf-nonlinear", "huber-kf", {"model": "nonlinear"}),
        ("kf-umv-ui-linear", "kf-umv-ui", {"model": "linear"}),
    ],
)
def test_a_variant_is_an_estimator_with_options(name, estimator, options):
    seen = []
    for chosen in (
        {"estimator": name},
        {"estimator": estimator, "estimator_options": options},
        {"estimator": name, "estimator_options": options | {"late": "as new"}},
    ):
        env = gym.make("SigmaCorvette-v0", **chosen)
        env.reset(seed=3)
        seen.append([env.step(np.array([0.1], np.float32))[0] for _ in range(20)])
        env.close()
    np.testing.assert_array_equal(seen[0], seen[1])
    np.testing.assert_array_equal(seen[0], seen[2])  # nothing is late there
    for wrong in (f"{name}-waves", "truth-linear"):
        with pytest.raises(ValueError, match="unknown estimator"):
            gym.make("SigmaCorvette-v0", estimator=wrong)
