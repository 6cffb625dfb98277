"""Sensors, disturbances, tasks and vehicles of one's own as their pages show them, and what users' functions may do."""

import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from pages import OWN, PAGES, code, my_sensor, my_vehicle

from agents import rollout
from agents.metrics import scores
from agents.studies.plan import plan
from agents.studies.study import read_study
from estimators import EnsembleKalmanFilter, compiled
from estimators.metrics import chi_square_band, nees
from estimators.varying import is_compiled
from vessel_gym.core import Core
from vessel_gym.disturbances import Disturbance, Fault
from vessel_gym.envs import (
    ItsunusaAUVEnv,
    SegorogeniAUVEnv,
    ShipEnv,
    SigmaCorvetteEnv,
    ThesisCorvetteEnv,
    register_environment,
)
from vessel_gym.estimation import estimator_names
from vessel_gym.processes import Process
from vessel_gym.sensors import Sensor
from vessel_gym.tasks import circle_track
from vessel_gym.tasks.task import Task
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.vehicles import ship


@pytest.mark.parametrize("module", PAGES)
def test_a_part_of_ones_own_takes_few_formatted_lines(module: str) -> None:
    assert len([line for line in code(module).splitlines() if line.strip()]) <= (
        {"my_vehicle": 55, "usv": 120}.get(module, 45)
    )


@pytest.mark.parametrize("env_id", [*OWN, "USV-v0", "Route-v0"])
def test_filters_run_the_equations_of_a_page_compiled_with_their_exact_derivatives(
    env_id: str,
) -> None:
    env: Any = gym.make(env_id, estimator="ekf")
    env.reset(seed=0)
    core = env.unwrapped.core
    model, x, u = (
        core.config.composition.model,
        core.now.belief.mean,
        core.config.system.vehicle.cruise[1][None],
    )
    for name, function in (("transition", model.transition), ("measurement", model.measurement)):
        assert is_compiled(function)
        jacobian = getattr(model, f"linearise_{name}")(x, u)[1]
        step = 1e-5 * np.eye(model.n)
        slopes = (
            function(x + step, np.tile(u, (model.n, 1)))
            - function(x - step, np.tile(u, (model.n, 1)))
        ) / 2e-5
        np.testing.assert_allclose(jacobian[0], slopes.T, rtol=1e-5, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", OWN)
@pytest.mark.parametrize("estimator", estimator_names())
def test_every_estimator_that_ours_carry_carries_a_part_of_ones_own(
    env_id: str, estimator: str
) -> None:
    ours = {"Docking-v0": ItsunusaAUVEnv, "HeavyShip-v0": ShipEnv}.get(env_id, SegorogeniAUVEnv)
    try:
        ours(estimator=estimator)
    except ValueError:
        pytest.skip("ours refuses it, too")
    few = {"pf": {"particles": 20}}
    flown = rollout(
        "random",
        env_id,
        range(2),
        {"estimator": estimator, "estimator_options": few.get(estimator, {})},
    )
    for key in ("truth", "estimate", "covariance"):
        assert np.isfinite(flown.history[key]).all()
    assert np.isfinite(flown.returns).all()


@pytest.mark.slow
def test_filters_that_assume_ones_own_sensor_or_disturbance_are_consistent() -> None:
    """64 dives: the mean NEES of 14 components over hundreds of steps lies within a quarter of its expectation.

    Of 1,536 dives on other seeds two missed their goal: that three of 64 do happens once in ten
    thousand times.
    """
    for env_id in ("Usbl-v0", "Shear-v0"):
        figures = scores(rollout("autopilot", env_id, range(64), {"estimator": "ekf"}))
        assert (figures["arrived"] < 100.0).sum() <= 2
        assert 0.75 < figures["nees"].mean() < 1.25


@pytest.mark.slow
def test_a_sensor_of_ones_own_is_not_ignored_by_the_default_filter() -> None:
    """It halves the error: 0.51 ± 0.07 times in twelve times 16 dives on other seeds, and once where it is ignored."""
    without = [s for s in my_sensor.SENSORS if s.name != "USBL"]
    error = {}
    for name, sensors in (("with", my_sensor.SENSORS), ("without", without)):
        flown = rollout("autopilot", "SegorogeniAUV-v0", range(16), {"sensors": sensors})
        error[name] = scores(flown)["position_rmse"].mean()
    assert error["with"] < 0.8 * error["without"]


@pytest.mark.slow
def test_a_task_of_ones_own_has_controller_score_and_picture() -> None:
    pytest.importorskip("pygame")
    flown = rollout("autopilot", "Docking-v0", range(8))
    assert scores(flown)["docked"].mean() == 100.0
    assert flown.score.min() > 0.8
    env = gym.make("Docking-v0", render_mode="rgb_array")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20


STUDY = """
title = "Parts of one's own"
episodes = 2

[environments."Usbl-v0"]
[environments."Shear-v0"]

[estimators.truth]
[estimators.own]
estimator = "default"

[agents.autopilot]
"""


@pytest.mark.slow
def test_a_study_runs_over_parts_of_ones_own(tmp_path: Path) -> None:
    from agents.jobs import run

    path = tmp_path / "own.toml"
    path.write_text(STUDY, encoding="utf-8")
    jobs = {flight.job.key: flight.job for flight in plan(read_study(path)).flights}
    outcome = run(list(jobs.values()), tmp_path / "results", processes=1)
    assert not outcome.failures
    assert len(jobs) == 2 * 3  # dead-reckoning flies in any case


def test_the_name_of_another_environment_is_not_taken() -> None:
    for name in ("CartPole-v1", "SegorogeniAUV-v0"):
        with pytest.raises(
            ValueError, match="is an environment already: give yours a name of its own"
        ):
            register_environment(replace(SegorogeniAUVEnv.system, name=name))


def test_numbers_of_ones_own_need_be_neither_doubles_nor_a_row_each() -> None:
    """What broadcasts in NumPy, or is float32, counts as its doubles for every row."""
    system = SigmaCorvetteEnv.system

    class Narrow(circle_track.CircleTrack):
        def commanded(self, scenario: Any, step: Any) -> Any:
            return np.array([[0.005, 0.0]], np.float32)

        def reference(self, scenario: Any, step: Any, state: Any) -> Any:
            return super().reference(scenario, step, state).astype(np.float32)

        def score(self, *args: Any) -> Any:
            _, end, score_state = super().score(*args)
            return np.float32(0.25), end, score_state

    class Light(ship.Ship):
        def actuate(self, before: Any, action: Any) -> Any:
            return super().actuate(before, action).astype(np.float32)

        def known_input(self, before: Any, after: Any, commanded: Any) -> Any:
            return super().known_input(before, after, commanded).astype(np.float32)

    task, vehicle = Narrow(system.vehicle.ship), Light(system.vehicle.ship)
    core = Core(replace(system, task=task, vehicle=vehicle), 4)
    core.start(0, None)
    for steps in range(1, 4):
        core.step(np.full((4, 1), 0.3, np.float32))
        np.testing.assert_array_equal(
            core.now.belief.u[:, 1], np.full(4, np.float32(0.005))
        )  # not only after a reset
        np.testing.assert_array_equal(core.now.total, np.full(4, 0.25 * steps))
        assert core.now.actuators.dtype == core.now.reference.dtype == float
    assert np.isfinite(core.observe()).all()
    one = system.vehicle.actuate(np.zeros((1, 1)), np.ones((1, 1)))
    np.testing.assert_array_equal(
        system.vehicle.actuate(np.zeros((4, 1)), np.ones((1, 1))), one.repeat(4, 0)
    )


def test_numbers_that_a_filter_of_ones_own_keeps_stay_those_of_their_step() -> None:
    kept = []

    class Keeps(EnsembleKalmanFilter):
        def _predict(self, belief: Any, u: Any, *moved: Any) -> Any:
            kept.append((moved[-1], moved[-1].normals(3)))
            return super()._predict(belief, u, *moved)

    env = gym.make("SigmaCorvette-v0", estimator=Keeps)
    env.reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())
    for rng, drawn in kept:
        np.testing.assert_array_equal(rng.normals(3), drawn)


# --- a vehicle of one's own equations -------------------------------------------------------------


@pytest.mark.parametrize("env_id", ["USV-v0", "Route-v0"])
def test_a_vehicle_follows_the_waypoints_of_the_page_on_a_filter(env_id: str) -> None:
    shares = {}
    for estimator in ("truth", "ekf", "dead-reckoning"):
        flown = rollout("autopilot", env_id, range(8), {"estimator": estimator})
        if estimator == "dead-reckoning":  # believes that it arrives, and the truth decides
            assert (flown.end == "missed").mean() > 0.75
        else:
            assert (flown.end == "arrived").all()
        shares[estimator] = flown.score.mean()
    assert 0.9 > shares["truth"] > shares["ekf"] > 0.7 > shares["dead-reckoning"]


def test_filters_of_ones_own_equations_are_as_good_as_they_say_and_rows_alike() -> None:
    """The mean NEES of 200 rows within its band, left by chance once in 10,000 times; a row is a single environment."""
    made = {"num_envs": 200, "sensors": "nominal", "disturbance": "moderate"}
    many, one = gym.make_vec("Route-v0", **made), gym.make("Route-v0")
    many.reset(seed=7)
    one.reset(seed=7 + 3)
    for _ in range(40):
        info = many.step(np.tile(np.float32([0.5, 0.45]), (200, 1)))[4]
        alone = one.step(np.float32([0.5, 0.45]))[4]
    core = many.unwrapped.core
    truth, angles = (
        core.config.true_state.in_filter_order(core.truth),
        core.config.estimation.filter.model.state_angles,
    )
    low, high = chi_square_band(200, truth.shape[1], 1.0 - 1e-4)
    assert low < nees(core.now.belief.mean, core.now.belief.cov, truth, angles).mean() < high
    for name in ("truth", "measurement", "available"):
        np.testing.assert_array_equal(info[name][3], alone[name])
    np.testing.assert_allclose(info["estimate"][3], alone["estimate"], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("name", "shape"), [("step", (1, 4)), ("drift", (1, 3)), ("drift", (5,))])
def test_equations_of_another_shape_are_refused_in_a_sentence(
    name: str, shape: tuple[int, ...]
) -> None:
    wrong = type("Wrong", (my_vehicle.Catamaran,), {name: lambda self, *given: np.zeros(shape)})
    system = replace(gym.spec("Route-v0").entry_point.system, vehicle=wrong())
    with pytest.raises(
        ValueError,
        match=rf"^{name} of Wrong must give a row of 5 numbers .* {re.escape(str(shape))}$",
    ):
        Core(system, 1)


# --- what users' functions may do -----------------------------------------------------------------

SYSTEM = SegorogeniAUVEnv.system
STATES = SYSTEM.vehicle.state_names


class Writing(Disturbance):
    """A current, whose effect writes where it reads on request."""

    names = forces = ("current north", "current east")
    process = Process.wandering((0.2, 0.2), time=200.0, dt=0.1)

    def __init__(self, writes: bool) -> None:
        self.writes = writes

    def effect(self, z: Any, state: Any) -> Any:
        given = z * np.exp(-np.abs(state[..., 8:9]) / 50.0)
        if self.writes:
            z[...] = 0.3
            state[..., STATES.index("z")] += 5.0
        return given


def writing_sensors(writes: bool) -> list[Sensor]:
    def hear(state: Any, exogenous: Any) -> Any:
        heard = np.hypot(state[..., 6:7] - 20.0, state[..., 7:8])
        if writes:
            state[..., STATES.index("z")] += 5.0
            exogenous[...] = 1.0
        return heard

    return [*SYSTEM.vehicle.sensors, Sensor("range", ("range [m]",), hear, (0.2,))]


class WritingTask(Task):
    """A dive that nobody guides; its functions write into their arguments on request."""

    vehicle, horizon, uniforms, ends = ItsunusaAUVEnv.system.vehicle, 60, 1, ("",)
    prior_sd = (0.05, 0.05, 0.02, 0.2, 0.2, 0.05)

    def __init__(self, writes: bool) -> None:
        self.writes = writes

    def _spoil(self, *arrays: Any) -> None:
        for array in arrays if self.writes else ():
            array[...] = 7

    def reference(self, scenario: Any, step: Any, state: Any) -> Any:
        reference = np.hstack([scenario, state[:, :1], step[:, None]])
        self._spoil(scenario, step, state)
        return reference

    def observe(self, estimate: Any, scenario: Any, reference: Any, actuators: Any) -> Any:
        seen = np.hstack([estimate.state, reference, actuators])
        self._spoil(estimate.state, estimate.flow, scenario, reference, actuators)
        return seen

    def over(self, scenario: Any, reference: Any) -> Any:
        self._spoil(scenario, reference)
        return np.zeros(len(reference), bool)

    def score(
        self,
        state: Any,
        exogenous: Any,
        scenario: Any,
        reference: Any,
        over: Any,
        actuators: Any,
        action: Any,
        score_state: Any,
    ) -> Any:
        reward = np.exp(-np.abs(state[:, 4]))
        self._spoil(state, exogenous, scenario, reference, actuators, action)
        return reward, np.zeros(len(state), int), score_state


class WritingVehicle(type(ItsunusaAUVEnv.system.vehicle)):  # type: ignore[misc]
    """ITSUNUSA, whose functions write into their arguments on request."""

    writes = False

    def _spoiling(self, function: Any, *arrays: Any) -> Any:
        given = function(*arrays)
        for array in arrays if self.writes else ():
            if array is not None:
                array[...] = 0.2
        return given

    def drift(self, x: Any, u: Any, flow: Any) -> Any:
        return self._spoiling(super().drift, x, u, flow)

    def step(self, state: Any, before: Any, after: Any, exogenous: Any, parameters: Any) -> Any:
        return self._spoiling(super().step, state, before, after, exogenous, parameters)

    def actuate(self, before: Any, action: Any) -> Any:
        return self._spoiling(super().actuate, before, action)

    def known_input(self, before: Any, after: Any, commanded: Any) -> Any:
        return self._spoiling(super().known_input, before, after, commanded)


class WritesAll(WritingVehicle):
    """It does."""

    writes = True


def written(part: str, writes: bool) -> Core:
    if part == "vehicle":
        made = (WritesAll if writes else WritingVehicle)(ItsunusaAUVEnv.system.vehicle.body)
        return Core(replace(ItsunusaAUVEnv.system, vehicle=made), 3, "ukf")
    if part == "task":
        return Core(
            replace(ItsunusaAUVEnv.system, task=WritingTask(writes)), 3, "ekf", observe="mean+std"
        )
    options = (
        {"disturbance": Writing(writes)}
        if part == "effect"
        else {"sensors": writing_sensors(writes)}
    )
    if part == "fault":
        options = {"disturbance": Fault("stern plane", bias=0.02, beside=Writing(writes))}
    return Core(SYSTEM, 3, "ekf", **options)


@pytest.mark.parametrize("part", ["effect", "fault", "reads", "vehicle", "task"])
def test_a_function_that_writes_where_it_reads_changes_neither_truth_nor_belief_nor_observation(
    part: str,
) -> None:
    """To the last bit: the twin whose functions leave alone what they read flies the same."""
    one, other = written(part, writes=True), written(part, writes=False)
    for core in (one, other):
        core.start(3)
    for _ in range(4):
        for core in (one, other):
            core.step(np.full(core.action_shape, 0.4))
        ours, theirs = (
            one.info() | {"seen": one.observe()},
            other.info() | {"seen": other.observe()},
        )
        for name, values in ours.items():
            np.testing.assert_array_equal(values, theirs[name], name)


def refused(core: Core, steps: int = 6) -> str:
    """What an environment says when a function of its user's fails in flight."""

    def fly() -> None:
        core.start(1)
        for _ in range(steps):
            core.step(np.zeros(core.action_shape))
            core.observe()

    with pytest.raises(ValueError, match=" gave ") as caught:
        fly()
    message = str(caught.value)
    assert len(message) < 250
    assert "\n" not in message
    return message


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_effect_that_is_not_finite_is_refused_at_its_step_and_in_its_row(bad: float) -> None:
    calls = []

    class Breaking(Writing):
        def effect(self, z: Any, state: Any) -> Any:
            given = super().effect(z, state)
            if len(state) == 3 and z.shape == (3, 2):
                calls.append(0)
                if state[1, STATES.index("x")] > 0.5:  # under way
                    given[1, 0] = bad
            return given

    message = refused(Core(SYSTEM, 3, "dead-reckoning", disturbance=Breaking(False)), 100)
    assert message.startswith("effect of Breaking gave [")
    assert " in row 1: it must give finite numbers" in message
    assert " at step 0 " not in message


@pytest.mark.parametrize(("name", "column"), [("score", 0), ("observe", 2), ("reference", 1)])
def test_a_task_that_gives_nan_is_refused_at_its_step(name: str, column: int) -> None:
    def spoilt(self: Any, *arguments: Any) -> Any:
        given = getattr(WritingTask, name)(self, *arguments)
        values = given[0][:, None] if isinstance(given, tuple) else given
        if len(values) == 3 and name != "reference":
            values[2, column] = np.nan
        elif len(values) == 3:
            values[2, column] = np.where(arguments[1][2] == 2, np.nan, 0.0)
        return given

    task = type("Broken", (WritingTask,), {name: spoilt})(False)
    message = refused(Core(replace(ItsunusaAUVEnv.system, task=task), 3, "ekf"))
    step = {"score": 1, "observe": 0, "reference": 2}[name]
    assert f" at step {step} in row 2" in message
    assert " Broken" in message


def test_a_vehicle_that_gives_nan_is_refused_and_one_that_has_run_away_is_not() -> None:
    class Breaks(WritingVehicle):
        def step(self, state: Any, *others: Any) -> Any:
            after = super().step(state, *others)
            after[len(after) // 2 :, 0] = np.where(state[len(after) // 2 :, 3] > 0.5, np.nan, 1.0)
            return after

    class Flees(WritingVehicle):
        def step(self, state: Any, *others: Any) -> Any:
            return 1e60 * (
                1.0 + np.abs(super().step(np.clip(state, -1.0, 1.0), *others)) + np.abs(state)
            )

    body = ItsunusaAUVEnv.system.vehicle.body
    message = refused(Core(replace(ItsunusaAUVEnv.system, vehicle=Breaks(body)), 3, "ekf"), 100)
    assert message.startswith("step of Breaks gave [nan, ")
    assert " in row 1: " in message
    core = Core(replace(ItsunusaAUVEnv.system, vehicle=Flees(body)), 2, "ekf")
    core.start(0)
    with np.errstate(all="ignore"):
        for _ in range(8):  # 1e60, 1e120, ... infinity
            core.step(np.zeros(core.action_shape))
    assert np.isfinite(core.now.belief.mean).all()
    assert np.isinf(core.now.state).any()


@pytest.mark.parametrize("end", [7, -1, 0.5])
def test_an_end_that_there_is_not_is_refused(end: float) -> None:
    class Ends(WritingTask):
        def score(self, *arguments: Any) -> Any:
            reward, _, score_state = super().score(*arguments)
            return reward, np.full(len(reward), end), score_state

    message = refused(Core(replace(ItsunusaAUVEnv.system, task=Ends(False)), 2, "ekf"))
    assert message.startswith("score of Ends gave the numbers of end_reasons [")


# --- arrays of users' functions -------------------------------------------------------------------

THESIS = ThesisCorvetteEnv.system
MALFORMED = [
    (
        "vehicle",
        "start",
        lambda x: (None, x[1]),
        "as the state, must give an array of real numbers, got None",
    ),
    ("vehicle", "step", lambda x: x[:1], "must give a row of 8 numbers for each vehicle: for 3 "),
    ("vehicle", "parameters", lambda x: x[:, :2], "must give a row of 28 numbers"),
    ("vehicle", "known_input", lambda x: x * np.nan, "must give finite numbers"),
    ("vehicle", "drift", lambda x: x * 1j, "must give an array of real numbers"),
    ("task", "scenario", lambda x: x[:, :1], "must give a row of 3 numbers"),
    ("task", "prior", lambda x: None, "must give a Gaussian, got None"),
    ("task", "sizes", lambda x: {}, "must give guided, got {}"),
    ("task", "reference", lambda x: x[:1], "must give a row of 5 numbers for each vehicle: for 3 "),
    ("task", "commanded", lambda x: x * np.nan, "must give finite numbers"),
    (
        "task",
        "observe",
        lambda x: x if len(x) == 1 else x[:, : 6 + (np.abs(x[0, 4]) < 1e-9)],
        "must give a row of 7 ",
    ),
    ("task", "over", lambda x: "a", "must give an array of real numbers, got 'a'"),
    ("task", "score", lambda x: None, "must give 3 arrays, reward, end, score_state, got None"),
    (
        "task",
        "score",
        lambda x: (x[0][:1], *x[1:]),
        "as the reward, must give one number for each vehicle: for 3 ",
    ),
    (
        "task",
        "score",
        lambda x: (*x[:2], np.zeros((3, 1))),
        "as the score_state, must give a row of 2 numbers",
    ),
]


def own(part: str, **members: Any) -> Any:
    """The thesis's system with a subclass of its vehicle or task."""
    of = getattr(THESIS, part)
    mine = object.__new__(type("Mine", (type(of),), members))
    vars(mine).update(vars(of))
    return replace(THESIS, **{part: mine})


def flown(system: Any, **options: Any) -> Core:
    core = Core(system, 3, "ekf", **options)
    core.start(0)
    core.observe()
    core.step(np.full(core.action_shape, 0.5))
    core.observe()
    return core


@pytest.mark.parametrize(("part", "name", "change", "sentence"), MALFORMED)
def test_an_array_of_another_shape_or_kind_is_refused_in_a_sentence(
    part: str, name: str, change: Any, sentence: str
) -> None:
    """Else nothing would say where NaN came from, or whose columns are missing."""
    base = getattr(type(getattr(THESIS, part)), name)
    broken = own(part, **{name: lambda self, *arguments: change(base(self, *arguments))})
    warnings.simplefilter("error")  # which pytest takes back
    with pytest.raises((ValueError, TypeError)) as caught:
        flown(broken, mismatch=0.1)
    message = str(caught.value)
    assert message.startswith(f"{name} of Mine")
    assert sentence in message
    assert "\n" not in message
    assert len(message) < 300


def test_nan_in_a_score_state_is_refused_and_infinity_and_rewards_of_any_range_are_not() -> None:
    base = TurningCircle.score

    def remembering(first: float, later: float) -> Any:
        def score(self: Any, *arguments: Any) -> Any:
            *others, score_state = arguments
            reward, end, _ = base(self, *others, np.zeros_like(score_state))
            return -2000.0 * reward, end, score_state + later

        return own(
            "task",
            initial_score_state=lambda self, state, scenario: np.full((len(state), 2), first),
            score=score,
        )

    core = flown(remembering(np.inf, 0.0))
    assert (core.now.total < -1.0).all()
    assert np.isinf(core.now.score_state).all()
    with pytest.raises(
        ValueError,
        match=(
            r"^score of Mine, as the score_state, gave \[nan, nan\] at step 1 in row 0: it must"
            r" give"
        ),
    ):
        flown(remembering(0.0, np.nan))


def test_a_subclass_flies_to_the_bit_as_the_parts_that_it_derives_from() -> None:
    ours = flown(THESIS).info()
    for part in ("vehicle", "task"):
        theirs = flown(own(part)).info()
        for name, values in ours.items():
            np.testing.assert_array_equal(values, theirs[name], name)


@pytest.mark.parametrize(
    ("member", "value", "sentence"),
    [("process", Process(1e6 * np.eye(2), np.eye(2), np.eye(2)), "process of Own grows by a factor of 1e+06 a step"),
     ("believed", "calm", "believed of Own must be a Disturbance, or None, got 'calm'"),
     ("input_sd", (-1.0, 1.0), "input_sd of Own must be numbers of at least 0"),
     ("scale", (0.0, 1.0), "scale of Own must be numbers above 0"),
     ("effect", lambda self, z, state: z * 1j, "effect of Own must give real numbers, got "),
     ("effect", lambda self, z, state: z if len(z) != 3 else z.tolist()[:1], "effect of Own must give a row of 2 ")],
)  # fmt: skip
def test_a_disturbance_of_no_use_is_refused_in_a_sentence(
    member: str, value: Any, sentence: str
) -> None:
    made = {"names": ("a", "b"), "forces": ("current north", "current east"), "assumed_as": "process-noise",
            "process": Process.wandering((0.2, 0.2), 200.0, 0.5)}  # fmt: skip
    disturbance = type("Own", (Disturbance,), made | {member: value})()
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}"):
        flown(SigmaCorvetteEnv.system, disturbance=disturbance)


# --- what users' functions read -------------------------------------------------------------------


class Windy(my_vehicle.Catamaran):
    """A catamaran that a wind blows along."""

    def __init__(self) -> None:
        self.wind = 0.0

    def step(self, state: Any, before: Any, after: Any, exogenous: Any, parameters: Any) -> Any:
        moved = super().step(state, before, after, exogenous, parameters)
        return np.concatenate([moved[..., :1] + self.dt * self.wind, moved[..., 1:]], -1)


def test_what_a_function_reads_may_change_in_flight() -> None:
    vehicle = Windy()
    core = Core(replace(gym.spec("Route-v0").entry_point.system, vehicle=vehicle), 2, "truth")
    core.start(5)
    for vehicle.wind in np.linspace(0.0, 2.0, 12):
        state, before, exogenous = core.now.state, core.now.actuators, core.now.exogenous
        core.step(np.full((2, 2), 0.5))
        expected = vehicle.step(state, before, core.now.actuators, exogenous, core.now.parameters)
        np.testing.assert_array_equal(core.now.state, expected)


def test_what_a_compiled_method_reads_is_frozen_when_it_is_traced() -> None:
    class Frozen(Windy):
        step = compiled(Windy.step)

    vehicle = Frozen()
    core = Core(replace(gym.spec("Route-v0").entry_point.system, vehicle=vehicle), 2, "truth")
    core.start(5)
    for vehicle.wind in (0.0, 2.0):
        given = core.now.state, core.now.actuators, core.now.exogenous, core.now.parameters
        core.step(np.full((2, 2), 0.5))
        state, before, exogenous, parameters = given
        calm = Windy().step(state, before, core.now.actuators, exogenous, parameters)
        np.testing.assert_allclose(core.now.state, calm, rtol=1e-12)


def test_a_vehicle_may_draw_random_numbers_a_row_each() -> None:
    rng = np.random.default_rng(0)

    class Tossed(my_vehicle.Catamaran):
        def step(self, state: Any, *others: Any) -> Any:
            return super().step(state, *others) + 0.01 * rng.standard_normal(state.shape)

    core = Core(
        replace(gym.spec("Route-v0").entry_point.system, vehicle=Tossed()),
        3,
        "truth",
        disturbance="calm",
    )
    core.start(0)
    core.step(np.zeros((3, 2)))
    assert len(np.unique(core.now.state[:, 3])) == 3


def test_a_function_that_does_not_repeat_itself_is_refused_when_an_environment_is_made() -> None:
    rng = np.random.default_rng(0)

    class Dice(Writing):
        def effect(self, z: Any, state: Any) -> Any:
            return super().effect(z, state) + rng.standard_normal(z.shape)

    class Rolling(WritingVehicle):
        def drift(self, x: Any, u: Any, flow: Any) -> Any:
            return super().drift(x, u, flow) + rng.standard_normal()

    def noisy(state: Any, exogenous: Any) -> Any:
        return state[..., :1] + rng.standard_normal()

    rolling = Rolling(ItsunusaAUVEnv.system.vehicle.body)
    for who, make in {
        "effect of Dice": lambda: Core(SYSTEM, 1, disturbance=Dice(False)),
        "reads of noisy": lambda: Core(
            SYSTEM, 1, sensors=[*SYSTEM.vehicle.sensors, Sensor("noisy", ("u",), noisy, (1.0,))]
        ),
        "drift of Rolling": lambda: Core(replace(ItsunusaAUVEnv.system, vehicle=rolling), 1),
    }.items():
        with pytest.raises(
            ValueError,
            match=f"^{who} gave two values for the same arguments: it must depend on these",
        ):
            make()
