"""Models of filters are the recorded ones, and are composed of a toy system as laws say."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import OURS, make_core
from golden.models import ENVIRONMENTS, recorded, table
from heading_ship import HEADING_SHIP
from refusals import refused
from scipy.stats import chi2
from toy_system import SYSTEM, Cart

from estimators import ExtendedKalmanFilter, check_filter, nees
from vessel_gym import model_of
from vessel_gym.disturbances import Disturbance, Sea
from vessel_gym.models.assumed import ASSUMED, assumed_space
from vessel_gym.models.estimation import variant
from vessel_gym.models.linear import filter_model
from vessel_gym.models.structure import used_entries
from vessel_gym.processes import Process
from vessel_gym.sensors import Bias, Sensor, plain
from vessel_gym.simulation.core import Core
from vessel_gym.tasks.task import Task


@pytest.mark.parametrize("env_id", ENVIRONMENTS)
def test_models_of_filters_are_the_recorded_ones(env_id: str):
    found, expected = table(env_id), recorded()[env_id]
    assert {name: names for name, (names, _) in found.items()} == {
        name: names for name, (names, _) in expected.items()
    }
    for name, (_, sums) in found.items():
        np.testing.assert_allclose(sums, expected[name][1], rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("env_id", OURS)
def test_model_of_is_what_a_filter_of_ones_own_gets(env_id: str):
    got = []

    def own(model: Any) -> ExtendedKalmanFilter:
        got.append(model)
        return ExtendedKalmanFilter(model)

    gym.make(env_id, estimator=own)
    model, start, u = model_of(env_id)
    assert vars(model).keys() == vars(got[0]).keys()
    for belief, given in ((start, u), (start, 0.5 * u)):
        for method in ("linearise_transition", "linearise_measurement"):
            found, expected = (getattr(m, method)(belief.mean, given) for m in (model, got[0]))
            for one, other in zip(found, expected, strict=True):
                np.testing.assert_array_equal(one, other)
    check_filter(ExtendedKalmanFilter, model, start, u)


def test_model_of_names_the_environment_that_has_none():
    with refused(TypeError, "Pendulum-v1 must be of class VesselEnv"):
        model_of("Pendulum-v1")


# --- a toy system ---------------------------------------------------------------------------------


class Stay(Task):
    """Stay at the origin."""

    vehicle, horizon, prior_sd = Cart(), 20, (0.1, 0.1)

    def score(self, state: Any, *_: Any) -> Any:
        return 1.0 / (1.0 + np.abs(state[..., 0])), np.zeros(len(state), int), state[..., :1]


class Wind(Disturbance):
    """A breeze that fades with the place, and gusts, whose state gives increments."""

    names, forces = ("breeze", "gust"), ("breeze", "u increment")
    process = Process.wandering((0.5, 0.2), time=5.0, dt=0.1)

    def effect(self, z: Any, state: Any) -> Any:
        fading = np.exp(-(state[..., 0] ** 2))
        return np.stack([z[..., 0] * fading, 0.1 * z[..., 1]], -1)


class Turbulence(Disturbance):
    """A breeze, and increments of white noise."""

    names, forces, white_increments = ("breeze",), ("breeze",), ("u increment",)
    process, white = Process.wandering((0.5,), time=5.0, dt=0.1), np.array([[0.05]])


def vane(state: Any, exogenous: Any) -> Any:
    """Airspeed, with the increment of the step that has ended."""
    return state[..., 1:] - exogenous[..., 1:] + exogenous[..., :1]


LOG = replace(Cart.sensors[0], bias=Bias(("bias",), start=(0.3,), pace=(0.1,)))
VANE = Sensor("vane", ("airspeed",), vane, (0.1,))
TOY = replace(SYSTEM, task=Stay(), sensors=(LOG, VANE))
WORLDS = {"wind": Wind(), "turbulence": Turbulence(), "nothing": Disturbance()}
every_world = pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)


def toy(rows: int = 1, world: Disturbance = WORLDS["wind"], **options: Any) -> Core:
    core = Core(TOY, rows, **{"estimator": "dead-reckoning", "disturbance": world} | options)
    core.start(3)
    return core


def truth_of(core: Core) -> np.ndarray:
    return core.config.true_state.in_filter_order(core.truth)


@every_world
def test_world_moves_by_f_with_noise_of_covariance_Q(world: Disturbance):
    core = toy(2000, world)
    model, vehicle, errors = core.config.estimation.filter.model, Cart(), []
    for action in np.random.default_rng(1).uniform(-1.0, 1.0, (5, 2000, 1)):
        before, where = truth_of(core), core.now.actuators
        core.step(action)
        u = vehicle.known_input(where, vehicle.actuate(where, action), None)
        errors.append(truth_of(core) - model.transition(before, u))
    sample = np.concatenate(errors)
    scale = np.where(np.diag(model.Q) > 0.0, np.sqrt(np.diag(model.Q)), 1.0)
    found = sample.T @ sample / len(sample) / np.outer(scale, scale)
    # seven standard deviations of a covariance of 10,000 unit normals
    np.testing.assert_allclose(found, model.Q / np.outer(scale, scale), rtol=0, atol=0.105)


@every_world
def test_sensors_measure_h_with_noise_of_covariance_R(world: Disturbance):
    core = toy(5000, world)
    core.step(np.ones((5000, 1)))
    model, space = core.config.estimation.filter.model, core.config.world.space
    error = core.now.y - model.measurement(truth_of(core), None)
    np.testing.assert_allclose(error.T @ error / 5000 / 0.01, model.R / 0.01, rtol=0, atol=0.1)
    flows = core.now.exogenous[:, space.increments :]
    acting = np.concatenate([core.now.exogenous_before[:, : space.increments], flows], -1)
    exact = space.sensors.exact(core.now.state, acting, core.now.slow[:, core.config.world.size :])
    np.testing.assert_allclose(model.measurement(truth_of(core), None), exact, atol=1e-12)


@every_world
def test_first_belief_is_consistent_with_starts(world: Disturbance):
    """By chi-square of 2000 starts, false alarm 1e-6."""
    core = toy(2000, world)
    belief, known = core.now.belief, core.now.belief.cov[0].diagonal() > 1e-5
    error = (truth_of(core) - belief.mean)[:, known]
    values = nees(error, belief.cov[:, known][..., known], np.zeros(error.shape))
    low, high = chi2.ppf([5e-7, 1 - 5e-7], 2000 * known.sum()) / 2000
    assert low < values.mean() < high


# --- assumptions ----------------------------------------------------------------------------------


@pytest.mark.parametrize("how", ASSUMED[:2])
def test_assumed_factors_scale_Q_and_R_alone(how: str):
    one, other = (
        toy(estimator="ekf", estimator_options={"assume": {"as": how} | factors})
        for factors in ({}, {"Q": 2.0, "R": 3.0})
    )
    first, second = (core.config.estimation.filter.model for core in (one, other))
    x, u = np.full((1, first.n), 0.5), Cart.cruise[1]
    np.testing.assert_array_equal(second.Q, 2.0 * first.Q)
    np.testing.assert_array_equal(second.R, 3.0 * first.R)
    np.testing.assert_array_equal(second.measurement(x, u), first.measurement(x, u))
    np.testing.assert_array_equal(second.transition(x, u), first.transition(x, u))


def test_assumed_disturbance_gives_the_model_of_a_world_with_it():
    assume = {"assume": {"disturbance": WORLDS["turbulence"]}}
    wrong, right = toy(estimator="ekf", estimator_options=assume), toy(estimator="ekf")
    there = toy(world=WORLDS["turbulence"], estimator="ekf")
    spaces = [core.config.estimation.space for core in (wrong, there)]
    assert spaces[0].names == spaces[1].names
    np.testing.assert_array_equal(spaces[0].Q, spaces[1].Q)
    for name in ("state", "slow", "y"):
        np.testing.assert_array_equal(getattr(wrong.now, name), getattr(right.now, name))


def test_oracle_ignores_assumptions():
    options = {"assume": {"as": "process-noise", "Q": 2.0}}
    one, other = (toy(estimator="truth", estimator_options=given) for given in (None, options))
    assert one.config.estimation.space.names == other.config.estimation.space.names
    np.testing.assert_array_equal(one.observe(), other.observe())


def test_white_input_has_the_covariance_of_the_increments():
    options = {"assume": {"as": "white-input", "Q": 3.0}}
    core = make_core(SHIP, 1, estimator="kf", disturbance="rough", estimator_options=options)
    sea = HEADING_SHIP.disturbances["rough"]
    variance = 0.25 * (sea.wave**2 + sea.gust**2)  # of dt times the yaw rates of waves and gusts
    np.testing.assert_allclose(core.config.estimation.filter.input_cov, [[3.0 * variance]])


def test_linear_model_is_block_of_ship_and_sea():
    spaces = [
        assumed_space(HEADING_SHIP.vehicle, "corrected", SEA, SENSORS, how)
        for how in ("states", "unknown-input")
    ]
    model, plain_model = map(filter_model, spaces)
    waves = "wave yaw", "wave yaw rate", "gust yaw rate", "last yaw increment"
    assert spaces[0].names == ("v", "r", "psi", *waves)  # no current, as no sensor shows it
    u = np.array([0.1, 0.03])
    expected = np.zeros((7, 7))
    expected[:3, :3], expected[3:6, 3:6] = plain_model.A(u)[:3, :3], SEA.process.transition[:3, :3]
    expected[[2, 6], 3:6] = [0.0, 0.5, 0.5]  # of wave yaw, wave yaw rate, gust yaw rate
    np.testing.assert_allclose(model.A(u), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(model.C @ np.diag([1.0] * 7), np.eye(7)[[2, 6]], atol=1e-12)


@pytest.mark.parametrize(
    ("name", "estimator", "options"),
    [
        ("ekf-waves", "ekf", {"assume": {"disturbance": "moderate", "as": "states"}}),
        ("kf-white", "kf", {"assume": {"as": "white-input"}}),
        ("huber-kf-nonlinear", "huber-kf", {"model": "nonlinear"}),
    ],
)
def test_variant_is_an_estimator_with_options(name: str, estimator: str, options: dict[str, Any]):
    assert variant(name) == (estimator, options)
    assert variant(estimator) == (estimator, {})
    for wrong in (f"{name}-waves", "truth-linear"):
        with refused(ValueError, "unknown estimator"):
            make_core(SHIP, 1, estimator=wrong)


@pytest.mark.parametrize("name", ["ekf-waves", "kf-white"])
def test_given_assumptions_join_those_of_a_variant(name: str):
    given = {"assume": {"R": 4.0}}
    plain, scaled = (
        make_core(SHIP, 1, estimator=name, estimator_options=options).config.estimation
        for options in (None, given)
    )
    assert scaled.space.names == plain.space.names
    assert scaled.space.assumed_as == plain.space.assumed_as
    np.testing.assert_allclose(scaled.filter.model.R, 4.0 * plain.filter.model.R, rtol=1e-15)


# --- structure ------------------------------------------------------------------------------------


def test_used_entries_are_those_that_a_value_depends_on():
    def function(x: Any, y: Any) -> Any:
        return np.where(x[..., 0] > 0.0, x[..., 2], y[..., 1])

    used = used_entries(function, np.ones(3), np.ones(2))
    assert [mask.tolist() for mask in used] == [[True, False, True], [False, True]]


def test_function_that_cannot_be_traced_is_compared_a_unit_away():
    (used,) = used_entries(lambda x: np.asarray(x[..., :1], float), np.ones(2))
    assert used.tolist() == [True, False]


def fading(self: Any, z: Any, state: Any) -> Any:
    """Effect of the first state, which is zero for the cruising cart."""
    return z[..., :1] * (state[..., :1] > 1.0)


@pytest.mark.parametrize(
    ("changed", "kept"),
    [
        ({"effect": fading}, ("breeze",)),
        ({"effect": lambda self, z, state: z[..., :1] * np.cos(z[..., 1:])}, ("breeze", "gust")),
        ({"effect": lambda self, z, state: 0.0 * state[..., :1]}, ()),
        ({"effect": fading, "assumed_as": "process-noise"}, ()),
        ({"effect": fading, "inputs": ("breeze",), "assumed_as": "unknown-input"}, ()),
    ],
)
def test_states_that_may_matter_are_estimated(changed: dict[str, Any], kept: tuple[str, ...]):
    world = type("Mine", (Wind,), {"forces": ("breeze",)} | changed)()
    space = assumed_space(Cart(), "nonlinear", world, TOY.sensors_of([LOG]))
    assert space.names == ("x", "u", *kept, "bias")


def test_sensor_alone_makes_a_current_a_state():
    sensors = [*HEADING_SHIP.vehicle.sensors, CURRENT_METER]
    options = {"assume": {"as": "states"}}
    core = make_core(SHIP, 1, estimator="kf", estimator_options=options, sensors=sensors)
    assert {"current north", "current east"} <= {*core.config.estimation.space.names}


# --- refusals -------------------------------------------------------------------------------------

SHIP, SEA = HEADING_SHIP.name, HEADING_SHIP.disturbances["rough"]
SENSORS = HEADING_SHIP.sensors_of("nominal")
CURRENT_METER = Sensor("meter", ("north", "east"), lambda x, f: f[..., 1:3], (0.05, 0.05))


def mine(reads: Callable[..., np.ndarray], **changed: Any) -> Sensor:
    return Sensor("mine", ("a", "b"), reads, (1.0, 1.0), **changed)


SENSORS_REFUSED = [
    (mine(plain((6,))), r"reads of mine must give 2 values for each state: \(2, 3, 8\) gave .*"),
    (mine(plain((0, 1))), "mine reads x, which filters of this model do not estimate .they "
                          "estimate v, r, psi.: leave it out, or choose another model"),
    (mine(plain((2, 4)), bias=Bias(("x", "y"), start=(1.0, 1.0))), "a bias is called 'x', .*"),
    (mine(plain((2, 4)), bias=Bias(("gust yaw rate",), start=(1.0,))),
     "a bias is called 'gust yaw rate', as is a component of Sea"),
    (mine(lambda x, f: x[..., [2, 2]] ** 2), "mine is not linear in what the filter estimates: .*"),
]  # fmt: skip


@pytest.mark.parametrize(("sensor", "sentence"), SENSORS_REFUSED, ids=range(len(SENSORS_REFUSED)))
def test_unsuitable_sensor_is_refused_in_one_sentence(sensor: Sensor, sentence: str):
    with refused(ValueError, f"^{sentence}$"):
        make_core(SHIP, 1, sensors=[*HEADING_SHIP.vehicle.sensors, sensor])


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"forces": ("tide", "breeze")}, "Mine gives 'tide', but what acts on this vehicle is .*"),
        ({"dt": 0.5}, "Mine was made for steps of 0.5 s, the vehicle's are 0.1 s: give it dt=0.1"),
    ],
)
def test_unsuitable_disturbance_is_refused(changed: dict[str, Any], sentence: str):
    world = type("Mine", (Wind,), changed)()
    for chosen in ({"world": world}, {"estimator_options": {"assume": {"disturbance": world}}}):
        with refused(ValueError, f"^{sentence}$"):
            toy(**chosen)


@pytest.mark.parametrize("how", ["states", "process-noise"])
def test_filter_of_an_unknown_input_says_what_to_assume(how: str):
    sentence = (
        f'^kf-umv-ui needs an unknown input, but assumes Sea as "{how}": assume one with'
        ' increments, with {"as": "unknown-input"}, or choose another estimator$'
    )
    with refused(ValueError, sentence):
        make_core(SHIP, 1, estimator="kf-umv-ui", estimator_options={"assume": {"as": how}})


def test_white_input_is_for_the_kalman_filter_alone():
    options = {"assume": {"as": "white-input"}}
    for estimator in ("kf", "truth", "measurement", "dead-reckoning"):
        make_core(SHIP, 1, estimator=estimator, estimator_options=options)
    with refused(ValueError, "^only kf can assume a white input of known variance, not ekf: "):
        make_core(SHIP, 1, estimator="ekf", estimator_options=options)


def test_sensor_of_a_flow_without_model_is_refused():
    noise = type("Noise", (Sea,), {"assumed_as": "process-noise"})
    world = noise(wave=0.01, peak=0.8, gust=0.002, current=0.3)
    sensors = [*HEADING_SHIP.vehicle.sensors, CURRENT_METER]
    for estimator in ("truth", "measurement", "dead-reckoning"):
        make_core(SHIP, 1, estimator=estimator, sensors=sensors, disturbance=world)
    sentence = (
        "^meter reads current north, of which a filter knows nothing that assumes Noise as"
        ' "process-noise": assume it with {"as": "states"}, or leave it out$'
    )
    with refused(ValueError, sentence):
        make_core(SHIP, 1, estimator="kf", sensors=sensors, disturbance=world)


def test_increments_and_flows_shown_are_not_one_unknown_input():
    inputs = {"inputs": ("yaw increment", "current north")}
    world = type("Mine", (Sea,), inputs)(wave=0.01, peak=0.8, gust=0.002, current=0.3)
    sensors = HEADING_SHIP.sensors_of([*HEADING_SHIP.vehicle.sensors, CURRENT_METER])
    space = assumed_space(HEADING_SHIP.vehicle, "corrected", world, sensors)
    with refused(ValueError, "^sensors show increments of .* and flows as they are now, of yaw"):
        filter_model(space)


@pytest.mark.parametrize(
    ("wrong", "kind", "sentence"),
    [
        ({"sea": "calm"}, TypeError, "unknown key of assume 'sea': choose from disturbance, .*"),
        ({"disturbance": 3}, TypeError, "disturbance must be one of calm, .*, got 3"),
        ({"as": "state"}, ValueError, "unknown way to assume a disturbance .state. .*"),
        ({"Q": 0.0}, ValueError, "Q of assume must be a factor above 0, got 0.0"),
        ({"R": np.eye(2)}, ValueError, "R of assume must be a factor above 0, got .*"),
    ],
)
def test_bad_assumption_is_refused_in_one_sentence(
    wrong: Any, kind: type[Exception], sentence: str
):
    with refused(kind, f"^{sentence}$"):
        make_core(SHIP, 1, estimator="ekf", estimator_options={"assume": wrong})
