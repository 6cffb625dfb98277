"""Monitors of faults in the loop: alarms, their observation, and metrics of them.

That without a monitor nothing changes is what every other test says.
"""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from contract import (
    FEW_MEMBERS,
    assert_apart,
    assert_copies_go_on,
    assert_same_tree,
    make_batch,
    make_core,
    observations_when_truth_is_altered,
    random_walk,
)
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv
from refusals import refusal
from scipy.stats import binom
from test_autoreset import assert_same_in_every_mode
from test_time_at_sea import AUV, FIX, at_sea, flown, late_fix, sensors_of

from agents import Rollout, rollout
from agents.metrics import metrics, scores
from agents.studies.plan import plan
from agents.studies.records import Agent, Condition, Estimator, Study
from agents.studies.results import Results
from estimators import ChiSquareMonitor, CusumMonitor, FaultMonitor, Filter, Gaussian, LinearModel
from vessel_gym.core import Core
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.wrappers import EstimatedObservation
from vessel_gym.wrappers.vector import EstimatedObservation as EstimatedObservations

ROWS = 3
OFTEN = {"kind": "chi-square", "false_alarms": 0.2, "window": 3}
"""A monitor that raises alarms soon, where it matters that there are some."""


def watched(estimator: str = "ekf", monitor: Any = OFTEN, **options: Any) -> dict[str, Any]:
    """Options of an environment whose estimator is watched."""
    chosen = FEW_MEMBERS.get(estimator, {}) | options.pop("estimator_options", {}) | {"monitor": monitor}
    return {"estimator": estimator, "estimator_options": chosen, **options}


def alarms(core: Core, steps: int, seed: int = 5) -> np.ndarray:
    """Of the start and each step ``(steps + 1, B, sensors)``."""
    core.start(seed)
    walk, raised = random_walk(0, core.num_envs, core.action_size), [core.loop.alarms]
    for _ in range(steps):
        core.step(next(walk))
        raised.append(core.loop.alarms)
    return np.stack(raised)


# --- what they see ----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("env_id", ["ItsunusaAUV-v0", "PunaUAV-v0"])
def test_where_nothing_is_wrong_alarms_are_as_rare_as_it_was_stated(env_id: str):
    """Steps are independent where the window is one step; a false alarm of the test itself: 1e-4."""
    rows, steps, rate = 300, 100, 0.01
    core = make_core(env_id, rows, **watched(monitor={"kind": "chi-square", "false_alarms": rate, "window": 1}))
    core.start(5)
    rng, raised = np.random.default_rng(0), 0
    for _ in range(steps):
        core.step(rng.uniform(-0.3, 0.3, (rows, core.action_size)))
        raised += core.loop.alarms.any(-1).sum()
    low, high = binom.ppf([5e-5, 1 - 5e-5], rows * steps, rate)
    assert low < raised < high


@pytest.mark.slow
@pytest.mark.parametrize("fault", [SensorFault(FIX, "stuck", begin=5.0), SensorFault(FIX, "bias", 4.0, begin=5.0)])
@pytest.mark.parametrize("kind", ["cusum", "chi-square"])
def test_a_fix_that_is_stuck_or_off_by_four_metres_is_accused_within_ten_seconds(fault: SensorFault, kind: str):
    """Of 40 vehicles 90 % or more, and before it hardly any."""
    core = make_core(AUV, 40, **watched(monitor={"kind": kind, "false_alarms": 1e-4}, sensor_faults=[fault]))
    assert core.loop.monitor is not None
    core.start(1)
    ahead, raised = np.tile([0.5, 0.0, 0.0], (40, 1)), []
    for _ in range(150):
        core.step(ahead)
        raised.append(core.loop.alarms)
    before, after = np.stack(raised[:49]), np.stack(raised[49:])
    assert before.any((0, 2)).mean() <= 0.05
    first = after[after.any(-1).argmax(0), np.arange(40)]
    assert first[:, core.loop.monitor.names.index(FIX)].mean() >= 0.9
    assert (first.sum(-1) <= 1).all()


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["ekf", "enkf"])
def test_a_late_measurement_that_is_fused_is_judged_by_the_innovation_that_it_had_had_in_time(estimator: str):
    """To the last bit, so many steps later; nothing is judged before, and rows that begin again begin again."""
    late, steps, rows = 4, 30, 6
    some = np.array([1, 4])
    raised = []
    for latency in (0, late):
        core = make_core(AUV, rows, **watched(estimator, sensors=sensors_of(AUV, "degraded", latency=latency)))
        core.start(5)
        walk, seen = random_walk(0, rows, core.action_size), [core.loop.alarms]
        for step in range(steps):
            if step == 15:
                core.start(rows=some)
                seen[-1] = core.loop.alarms
            core.step(next(walk))
            seen.append(core.loop.alarms)
        raised.append(np.stack(seen))
    timely, delayed = raised
    others = np.setdiff1d(np.arange(rows), some)
    assert timely[:, some].any()
    assert not delayed[:late].any()
    np.testing.assert_array_equal(delayed[late:, others], timely[:-late, others])
    assert not delayed[15 : 15 + late, some].any()
    np.testing.assert_array_equal(delayed[15 + late :, some], timely[15:-late, some])


@pytest.mark.slow
def test_a_late_measurement_that_is_discarded_raises_what_a_lost_one_does():
    lost = [replace(sensor, dropout=1.0) if sensor.name == FIX else sensor for sensor in late_fix()]
    discarded = make_core(AUV, 20, **watched(sensors=late_fix(latency=0.3), estimator_options={"late": "discarded"}))
    raised = alarms(discarded, 45)
    np.testing.assert_array_equal(raised, alarms(make_core(AUV, 20, **watched(sensors=lost)), 45))
    assert raised.sum() > 20
    assert discarded.loop.monitor is not None
    assert not raised[..., discarded.loop.monitor.names.index(FIX)].any()


# --- what they change, and who sees them --------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["ekf", "enkf"])
@pytest.mark.parametrize("late", ["fused", "as new", "discarded"])
def test_a_monitor_moves_no_measurement_no_belief_and_no_truth(estimator: str, late: str):
    options = watched(estimator, estimator_options={"late": late}, **at_sea(AUV))
    one = make_core(AUV, ROWS, **options)
    del options["estimator_options"]["monitor"]
    other = make_core(AUV, ROWS, **options)
    for (y, available), (same, arrived) in zip(flown(one, 25), flown(other, 25), strict=True):
        np.testing.assert_array_equal(y, same)
        np.testing.assert_array_equal(available, arrived)
    info = one.info()
    assert_same_tree({key: value for key, value in info.items() if key != "alarms"}, other.info())
    np.testing.assert_array_equal(one.observe(), other.observe())


@pytest.mark.parametrize("guidance", [True, False])
@pytest.mark.parametrize("mode", ["mean", "mean+std"])
def test_alarms_stand_behind_all_else_that_is_observed(mode: str, guidance: bool):
    plain, alarmed = (
        make_batch(AUV, 20, **watched(observe=observe, guidance=guidance)) for observe in (mode, f"{mode}+alarms")
    )
    assert alarmed.single_observation_space.shape[0] == plain.single_observation_space.shape[0] + 5
    seen = [env.reset(seed=3)[0] for env in (plain, alarmed)]
    walk, raised = random_walk(1, 20, 3), 0
    for _ in range(20):
        actions = next(walk)
        (seen[0], *_), (seen[1], *_, info) = (env.step(actions) for env in (plain, alarmed))
        np.testing.assert_array_equal(seen[1][:, :-5], seen[0])
        np.testing.assert_array_equal(seen[1][:, -5:], info["alarms"])
        assert (info["alarms"].sum(-1) <= 1).all()
        assert alarmed.observation_space.contains(seen[1])
        raised += info["alarms"].sum()
    assert raised > 10


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["ekf", "enkf"])
@pytest.mark.parametrize("sea", [False, True])
def test_truth_reaches_no_alarm(estimator: str, sea: bool):
    """Measurements replayed to another truth, which is put elsewhere before each step, raise the same."""
    options = watched(estimator, observe="mean+alarms", **(at_sea(AUV) if sea else {"sensors": "degraded"}))
    one, other, distance = observations_when_truth_is_altered(AUV, **options)
    assert_apart(distance)
    assert_same_tree(one, other)
    assert one["mean+alarms"][..., -5:].sum() > 10


@pytest.mark.slow
@pytest.mark.parametrize("sea", [False, True])
def test_the_alarms_of_a_row_are_those_of_a_single_environment_in_every_mode(sea: bool, monkeypatch):
    monkeypatch.setitem(FEW_MEMBERS, "enkf", {"monitor": OFTEN})
    assert_same_in_every_mode(AUV, "enkf", observe="mean+alarms", **(at_sea(AUV) if sea else {"sensors": "degraded"}))


def test_a_watched_copy_goes_on_bit_for_bit():
    env = make_batch(AUV, ROWS, max_episode_steps=12, observe="mean+alarms", **watched(**at_sea(AUV)))
    env.reset(seed=3)
    walk = random_walk(2, ROWS, 3)
    for _ in range(9):
        env.step(next(walk))
    assert_copies_go_on(env, 15)


def test_a_monitor_is_chosen_by_name_by_options_or_made_of_the_sensors_channels():
    given: list[Any] = []

    def own(channels: dict[str, list[int]]) -> FaultMonitor:
        given.append(channels)
        return CusumMonitor({"inside": range(0, 10), "outside": channels[FIX]}, 1e-2)

    ways = "cusum", {"kind": "cusum", "false_alarms": 1e-3}, CusumMonitor, own
    names = [make_core(AUV, ROWS, **watched(monitor=way)).loop.monitor.names for way in ways]  # type: ignore[union-attr]
    assert names[0] == names[1] == names[2] == tuple(given[0])
    assert given[0][FIX] == [10, 11]
    assert names[3] == ("inside", "outside")
    core = make_core(AUV, ROWS, **watched(monitor=ChiSquareMonitor))
    assert isinstance(core.loop.monitor, ChiSquareMonitor)


@pytest.mark.parametrize(
    ("options", "error", "sentence"),
    [
        (watched(monitor="cusm"), ValueError, "unknown kind of monitor 'cusm' (did you mean 'cusum'?)"),
        (watched(monitor={"shift": 1.0}), ValueError, "unknown kind of monitor None"),
        (watched(monitor={"kind": "cusum", "window": 3}), TypeError, "cusum has no option 'window': it takes"),
        (watched(monitor={"kind": "cusum", "false_alarms": 2.0}), ValueError, "a rate of false alarms a step"),
        (watched(monitor=CusumMonitor(12)), TypeError, "monitor must be a name, a dictionary"),
        (watched(monitor=lambda channels: None), TypeError, "monitor must return an estimators.FaultMonitor"),
        ({"observe": "mean+alarms"}, ValueError, 'shows the alarms of a monitor: give one, estimator_options={"mon'),
        ({"observe": "measurement+alarms"}, ValueError, "unknown observe mode"),
        *(
            (watched(name), ValueError, f"{name} has no innovations that a monitor could watch")
            for name in ("truth", "measurement", "dead-reckoning")
        ),
    ],
)
def test_what_cannot_be_watched_gets_one_sentence(options: dict[str, Any], error: type[Exception], sentence: str):
    assert sentence in refusal(error, make_core, AUV, ROWS, **options)


def test_filters_of_an_unknown_input_are_not_watched():
    said = refusal(ValueError, make_core, "SigmaCorvette-v0", 1, **watched("kf-umv-ui"))
    assert "kf-umv-ui carry its unknown input" in said
    noise = watched("kf", estimator_options={"assume": {"as": "white-input"}})
    assert alarms(make_core("SigmaCorvette-v0", ROWS, **noise), 5).shape == (6, ROWS, 3)


def test_a_filter_of_ones_own_that_gives_no_covariance_of_its_innovations_says_so():
    class Still(Filter):
        def _predict(self, belief, u, rng):
            return belief

        def _update(self, belief, measurement, rng):
            return belief

    core = make_core(AUV, 1, estimator=Still, estimator_options={"monitor": "cusum"})
    assert "of a filter that gives both" in refusal(ValueError, core.start, 1)


# --- around anybody's environment ---------------------------------------------------------------------


class Rolling(gym.Env):
    """A cart that is pushed about at random; observed in an array, or in a dictionary."""

    action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float64)

    def __init__(self, named: bool = False) -> None:
        own = gym.spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.named, self.observation_space = named, gym.spaces.Dict({"cart": own}) if named else own

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = 0.1 * self.np_random.normal(size=2)
        return self._seen(), {}

    def step(self, action):
        self.x = ROLLING.A @ self.x + np.sqrt(np.diag(ROLLING.Q)) * self.np_random.normal(size=2)
        return self._seen(), 0.0, bool(abs(self.x[0]) > 0.25), False, {}

    def _seen(self):
        return {"cart": self.x.copy()} if self.named else self.x.copy()


ROLLING = LinearModel([[1.0, 0.1], [0.0, 0.9]], np.eye(2), np.diag([1e-4, 1e-2]), 4e-4 * np.eye(2), B=np.zeros((2, 1)))
CALM = Gaussian([0.0, 0.0], 0.01 * np.eye(2))
JUMP = [SensorFault("y0", "bias", 0.5, begin=6.0, end=12.0)]


def rolling(named: bool = False, **options: Any) -> EstimatedObservation:
    state = (lambda env, seen: seen["cart"]) if named else None
    observation = (lambda x: {"cart": x}) if named else None
    chosen = watched("kf", sensor_faults=JUMP, **options)
    return EstimatedObservation(Rolling(named), ROLLING, CALM, state, observation, **chosen)


def test_wrapped_environments_are_watched_too_many_as_one():
    env = SyncVectorEnv([Rolling] * ROWS)
    many = EstimatedObservations(env, ROLLING, CALM, **watched("kf", sensor_faults=JUMP, observe="mean+std+alarms"))
    ones = [rolling(observe="mean+std+alarms") for _ in range(ROWS)]
    assert many.single_observation_space == ones[0].observation_space
    assert ones[0].observation_space.shape == (6,)
    seen, _ = many.reset(seed=7)
    for i, one in enumerate(ones):
        np.testing.assert_array_equal(one.reset(seed=7 + i)[0], seen[i])
    over, found = np.zeros(ROWS, bool), 0
    for _ in range(60):
        seen, _, terminated, truncated, info = many.step(np.zeros((ROWS, 1)))
        for i, one in enumerate(ones):
            alone, *_, single_info = one.reset() if over[i] else one.step(np.zeros(1))
            np.testing.assert_array_equal(alone, seen[i])
            np.testing.assert_array_equal(single_info["alarms"], info["alarms"][i])
            np.testing.assert_array_equal(alone[-2:], single_info["alarms"])
            assert one.observation_space.contains(alone)
        over = terminated | truncated
        found += (info["alarms"][:, 0] & info["sensor_faults"][:, 0]).sum()
    assert many.watch.episodes.min() >= 1
    assert found >= ROWS


@pytest.mark.filterwarnings("ignore::UserWarning")  # of spaces without bounds, which are the environment's own
@pytest.mark.parametrize("named", [False, True])
def test_gymnasiums_and_stable_baselines_checkers_pass(named: bool):
    env = rolling(named, observe="mean+alarms")
    check_env(env, skip_render_check=True)
    pytest.importorskip("stable_baselines3.common.env_checker").check_env(env, warn=False)


def test_a_dictionary_shows_alarms_by_their_name():
    env = rolling(named=True, observe="mean+alarms")
    seen, _ = env.reset(seed=1)
    assert set(seen) == {"cart", "alarms"}
    for _ in range(8):
        seen, *_, info = env.step(np.zeros(1))
        assert env.observation_space.contains(seen)
        np.testing.assert_array_equal(seen["alarms"], info["alarms"])
    with pytest.raises(ValueError, match="shows the alarms of a monitor"):
        EstimatedObservation(Rolling(), ROLLING, CALM, estimator="kf", observe="mean+alarms")
    with pytest.raises(ValueError, match="truth has no innovations"):
        EstimatedObservation(Rolling(), ROLLING, CALM, **watched("truth"))


# --- what is made of them -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def faulty() -> Rollout:
    faults = [SensorFault("gyroscope", "stuck", begin=1.0), SensorFault(FIX, "bias", 5.0, begin=2.0)]
    return rollout("random", AUV, range(6), watched(monitor="cusum", sensor_faults=faults, termination="task"))


def _with(flight: Rollout, raised: dict[tuple[int, int], str]) -> Rollout:
    """The same flight, had these sensors been accused, at (step, row), and no others."""
    accused = np.zeros_like(flight.history["alarms"])
    for (step, row), name in raised.items():
        accused[step, row, flight.env.unwrapped.core.loop.monitor.names.index(name)] = True
    return replace(flight, history=flight.history | {"alarms": accused})


def test_a_score_sheet_says_whether_how_late_and_rightly_faults_were_seen_and_how_often_in_vain(faulty: Rollout):
    assert (faulty.length > 40).all()
    raised = {
        (25, 1): "gyroscope",  # after 1.5 s, rightly
        (12, 2): FIX,  # after 0.2 s, but the fix begins to be wrong at 2 s
        (22, 3): FIX, (23, 3): "depth gauge",  # the first counts
        (3, 4): "attitude", (4, 4): "attitude", (6, 4): FIX,  # two alarms in the second before any fault
        (3, 5): FIX, (10, 5): "gyroscope",  # as the fault begins
    }  # fmt: skip
    found = scores(_with(faulty, raised))
    np.testing.assert_array_equal(found["detected"], [0.0, 100.0, 100.0, 100.0, 0.0, 100.0])
    np.testing.assert_allclose(found["detection_delay"], [np.nan, 1.5, 0.2, 1.2, np.nan, 0.0], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found["right_sensor"], [np.nan, 100.0, 0.0, 100.0, np.nan, 100.0])
    np.testing.assert_allclose(found["false_alarms"], [0.0, 0.0, 0.0, 0.0, 7200.0, 3600.0])


def test_alarms_after_an_episode_has_ended_count_for_nothing(faulty: Rollout):
    last = int(faulty.length[0])
    length = faulty.length.copy()
    length[0] = last - 5
    short = replace(_with(faulty, {(last - 2, 0): FIX}), length=length)
    assert scores(short)["detected"][0] == 0.0


def test_without_faults_there_is_nothing_to_detect_and_without_a_monitor_no_such_figure():
    sound = rollout("random", AUV, range(6), watched())
    found = scores(sound)
    for key in ("detected", "detection_delay", "right_sensor"):
        assert np.isnan(found[key]).all()
    assert np.isfinite(found["false_alarms"]).all()
    usual = {m.key for m in metrics(sound.env.unwrapped.system)}
    assert set(found) == usual | {"detected", "detection_delay", "right_sensor", "false_alarms"}
    unseen = {key: values for key, values in sound.history.items() if key != "alarms"}
    assert set(scores(replace(sound, history=unseen))) == usual


@pytest.mark.slow
def test_a_study_holds_what_its_monitors_found(faulty: Rollout):
    watchful = Estimator("ekf, watched", "ekf", {"monitor": {"kind": "cusum", "false_alarms": 1e-4}})
    estimators = tuple(Estimator(name, name) for name in ("truth", "dead-reckoning", "ekf"))
    agents = (Agent("autopilot", "autopilot"),)
    study = Study("?", (AUV,), (*estimators, watchful), agents, (Condition("nominal"),), 6, 5)
    planned = plan(study)
    assert not planned.skipped
    assert [f.flown_on for f in planned.flights][-1] == "ekf, watched"
    figures = {key: values.tolist() for key, values in scores(faulty).items()}
    plain = {m.key: figures[m.key] for m in metrics(faulty.env.unwrapped.system)}
    values = {
        f.job.key: {"figures": figures if f.flown_on == "ekf, watched" else plain, "ends": [""] * 6}
        for f in planned.flights
    }
    lines = [line.split(",") for line in Results(planned, values).episodes_csv().replace('"ekf, ', '"').splitlines()]
    at = lines[0].index("false_alarms")
    assert {bool(line[at]) for line in lines[1:] if line[5] == '"watched"'} == {True}
    assert {bool(line[at]) for line in lines[1:] if line[5] != '"watched"'} == {False}
    without = {key: {**value, "figures": plain} for key, value in values.items()}
    assert "false_alarms" not in Results(planned, without).episodes_csv()
