"""Estimator and controller are tuned together, in closed loop, on common random numbers."""

import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from brief import BRIEF
from refusals import refused

from agents import load_agent, rollout
from agents.seeds import tuning_seeds
from agents.tuning import tune as tuning
from agents.tuning.arm import NOISE, Arm, Parameter
from agents.tuning.search import Journal, search
from agents.tuning.trials import Trials
from agents.tuning.tune import _compared, _cpu_seconds, tune
from agents.tuning.tuned import Tuned, load_tuned
from estimators import ExtendedKalmanFilter, Log

CORVETTE = "SigmaCorvette-v0"
NIGHTLY = pytest.mark.nightly
SEEDS = tuning_seeds(3)
CANDIDATES: list[dict[str, float]] = [
    {},
    {"estimator.Q": 3.0, "estimator.R.gyro compass": 5.0},
    {"estimator.R.gyro compass": 0.2, "estimator.R.receiver": 4.0},
]


class Inflated(ExtendedKalmanFilter):
    """An EKF of one's own, in NumPy, whose predicted covariance grows by a factor."""

    tunable = {"factor": Log(1.0, 2.0)}

    def __init__(self, model: Any, factor: float = 1.01) -> None:
        super().__init__(model)
        self.factor = factor

    def _predict(self, *arguments: Any) -> dict[str, Any]:
        predicted = super()._predict(*arguments)
        return predicted | {"cov": self.factor * predicted["cov"]}


def by_environments(arm: Arm, candidates: list[dict[str, float]]) -> np.ndarray:
    """Scores ``(C, conditions * N)`` by an environment for each candidate."""
    found = []
    for values in candidates:
        options = {"estimator_options": arm.estimator_options(values)}
        flown = [
            rollout(arm.made_agent(values), arm.env_id, SEEDS, world | options, record=False)
            for world in arm.worlds
        ]
        found.append(np.concatenate([each.score for each in flown]))
    return np.array(found)


@pytest.mark.parametrize(
    ("estimator", "own"),
    [
        pytest.param("enkf", {"estimator.inflation": 1.02}, marks=NIGHTLY),
        ("truth", {}),
        (Inflated, {"estimator.factor": 1.05}),
        pytest.param("ekf", {}, marks=NIGHTLY),
        pytest.param("huber-kf-nonlinear", {"estimator.gamma": 2.5}, marks=NIGHTLY),
        pytest.param("measurement", {}, marks=NIGHTLY),
    ],
)
def test_candidates_side_by_side_score_as_alone(estimator: Any, own: dict[str, float]):
    conditions = ({"disturbance": "rough"}, {"sensors": "budget"})
    arm = Arm(BRIEF, options={"estimator": estimator}, conditions=conditions)
    candidates = [each | own for each in CANDIDATES[1:]]
    if estimator in ("truth", "measurement"):
        candidates = [{}, {}]
    found = Trials(arm, SEEDS).scores(candidates)
    # The root of Q is scaled in one way and computed anew in the other; members magnify rounding.
    atol = 1e-6 if estimator == "enkf" else 1e-10
    np.testing.assert_allclose(found, by_environments(arm, candidates), rtol=0.0, atol=atol)


@pytest.mark.slow
def test_scores_do_not_depend_on_the_number_of_processes():
    arm = Arm(
        "brief:" + BRIEF, options={"estimator": "ekf"}, conditions=({}, {"sensors": "budget"})
    )
    one, before = Trials(arm, SEEDS).scores(CANDIDATES), Trials.elsewhere
    assert one.shape == (3, 6)
    np.testing.assert_array_equal(one, Trials(arm, SEEDS, 2).scores(CANDIDATES))
    assert Trials.elsewhere > before  # their CPU seconds count


def test_seconds_of_a_tuning_count_other_processes(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Trials, "elsewhere", 1e9)
    assert _cpu_seconds() > 1e9


def test_factors_given_to_the_environment_are_delivered():
    given = {"assume": {"Q": 3.0, "R": {"gyro compass": 5.0}}}
    plain, own = Arm(BRIEF, options={"estimator": "ekf"}), {"estimator_options": given}
    scored = Trials(Arm(BRIEF, options={"estimator": "ekf"} | own), SEEDS).scores([{}])
    np.testing.assert_allclose(scored, Trials(plain, SEEDS).scores(CANDIDATES[1:2]), atol=1e-12)


def test_sensors_that_are_not_tuned_keep_their_factor_on_R():
    given = {"estimator_options": {"assume": {"R": 4.0}}}
    arm = Arm(CORVETTE, options={"estimator": "ekf"} | given)
    assume = arm.estimator_options({"estimator.Q": 2.0, "estimator.R.receiver": 9.0})["assume"]
    R = {"gyro compass": 4.0, "rate gyro": 4.0, "receiver": 9.0}
    assert assume == {"Q": 2.0, "R": R}


@pytest.mark.parametrize("estimator", ["ekf", "kf-umv-ui"])
def test_likelihood_is_that_of_the_prediction_s_measurement(
    estimator: str, monkeypatch: pytest.MonkeyPatch
):
    """In an episode that goes on when others have ended, as the rudder is hard over in all."""
    hard_over = SimpleNamespace(reset=lambda rows: None, act=lambda seen: np.ones((len(seen), 1)))
    monkeypatch.setattr(Trials, "_agent", lambda *_: hard_over)
    options = {"estimator": estimator, "disturbance": "rough"}
    env: Any = gym.make(CORVETTE, **options)
    env.reset(seed=SEEDS[-1])
    core, densities, over = env.unwrapped.core, list[float](), False
    filter, belief = core.config.estimation.filter, core.now.belief
    while not over:
        _, _, terminated, truncated, _ = env.step(np.ones(1))
        now = core.now
        predicted = filter.predict(belief, now.belief.u)
        belief = filter.update(predicted, now.y, available=now.available, u=now.belief.u)
        densities.append(filter.log_likelihood(predicted, belief).item())
        over = terminated or truncated
    found = Trials(Arm(CORVETTE, options=options, by="likelihood"), SEEDS).scores([{}])
    assert found[0, -1] == pytest.approx(np.mean(densities), rel=1e-6)


@pytest.mark.nightly
def test_scores_before_and_after_are_the_task_s_by_likelihood():
    arm = Arm(CORVETTE, picked=("estimator.R.receiver",), by="likelihood")
    found = tune(arm, 2, 1, fresh=2).found
    scores = Trials(replace(arm, by="score"), tuning_seeds(1)).scores([{}])
    assert found["before"] == scores.mean()
    assert 0.0 < found["after"] < 1.0 < found["best_so_far"][-1]


def test_by_likelihood_the_picked_factors_are_tuned_alone():
    arm = Arm(CORVETTE, picked=("estimator.R.receiver",), by="likelihood")
    assert [*arm.parameters] == ["estimator.R.receiver"]
    assert "estimator.Q" in Arm(CORVETTE, by="likelihood").parameters
    with refused(ValueError, "unknown parameter 'agent'.*estimator.Q"):
        Arm(CORVETTE, picked=("agent",), by="likelihood").parameters  # noqa: B018


@pytest.mark.parametrize("estimator", ["huber-kf", "steady-kf", "truth"])
def test_what_has_no_likelihood_is_refused_in_a_sentence(estimator: str):
    arm = Arm(CORVETTE, options={"estimator": estimator}, by="likelihood")
    with refused(ValueError, f"{estimator} cannot be tuned by likelihood: tune it by the score"):
        tune(arm, 4, 2)


def test_a_candidate_without_a_design_has_no_score():
    class Undesigned(Trials):
        def _agent(self, values: Any) -> Any:
            return None if values else super()._agent(values)

    found = Undesigned(Arm(BRIEF, options={"estimator": "ekf"}), SEEDS).scores([{}, {"a": 1.0}])
    assert (found[0] > 0.0).all()
    assert np.isnan(found[1]).all()


# --- search ---------------------------------------------------------------------------------------

PARAMETERS = {name: Parameter(NOISE, 1.0) for name in ("a", "b", "c")}
OPTIMUM = {"a": 3.0, "b": 0.2, "c": 1.5}


def hill(values: dict[str, float]) -> float:
    """A smooth score with its maximum, 1, at `OPTIMUM`."""
    away = [np.log(values[name] / best) for name, best in OPTIMUM.items()]
    return float(np.exp(-0.5 * np.square(away).sum()))


@pytest.mark.parametrize("seed", [0, 1])
def test_a_search_finds_the_top_of_a_smooth_hill(seed: int):
    found = search(hill, PARAMETERS, 100, seed, Journal(None, {}))
    assert {name: pytest.approx(best, rel=0.1) for name, best in OPTIMUM.items()} == found


@pytest.mark.parametrize("evaluations", [1, 2, 12])
def test_a_search_never_ends_below_the_delivered_values(evaluations: int):
    """Within its first radius of a bound, COBYQA moves a start."""
    delivered = {name: Parameter(NOISE, NOISE.from_unit(0.15)) for name in "abc"}

    def sharp(values: dict[str, float]) -> float:
        return -sum(abs(np.log(values[name] / each.value)) for name, each in delivered.items())

    found = search(sharp, delivered, evaluations, 0, journal := Journal(None, {}))
    assert sharp(found) == pytest.approx(0.0, abs=1e-12)
    assert len(journal.points) == evaluations


@pytest.mark.parametrize("seed", [0, 3, 4])
def test_a_search_goes_on_where_one_trust_region_gets_stuck(seed: int):
    def rough(values: dict[str, float]) -> float:
        return hill(values) + 0.1 * sum(np.sin(9.0 * np.log(each)) for each in values.values())

    found = search(rough, PARAMETERS, 150, seed, Journal(None, {}))
    assert rough(found) > 1.2


def test_an_interrupted_search_ends_at_the_same_bits(tmp_path: Path):
    whole = tmp_path / "whole.jsonl"
    expected = search(hill, PARAMETERS, 40, 1, Journal(whole, {"made": "by"}))
    lines = whole.read_text().splitlines(keepends=True)
    cut = tmp_path / "cut.jsonl"
    cut.write_text("".join(lines[:12]) + lines[12][:9])  # killed in the middle of a line
    asked: list[float] = []

    def counted(values: dict[str, float]) -> float:
        asked.append(values["a"])
        return hill(values)

    assert search(counted, PARAMETERS, 40, 1, Journal(cut, {"made": "by"})) == expected
    assert len(asked) == len(lines) - 12
    assert cut.read_text() == whole.read_text()


@pytest.mark.parametrize("failed", [np.nan, -np.inf])
def test_values_that_fail_are_never_the_best_of_negative_ones(failed: float):
    def score(values: dict[str, float]) -> float:
        return failed if values["a"] > 2.0 or len(journal.points) == 0 else hill(values) - 500.0

    journal = Journal(None, {})
    found = search(score, PARAMETERS, 40, 0, journal)
    finite = [each for _, each in journal.points if np.isfinite(each)]
    assert len(finite) < len(journal.points) == 40
    assert score(found) == pytest.approx(max(finite), abs=1e-12)
    with refused(ValueError, "no candidate has a finite score"):
        search(lambda values: failed, PARAMETERS, 5, 0, Journal(None, {}))


def test_an_interrupt_keeps_the_best_so_far():
    asked: list[float] = []

    def stopped(values: dict[str, float]) -> float:
        if len(asked) == 12:
            raise KeyboardInterrupt
        asked.append(hill(values))
        return asked[-1]

    found = search(stopped, PARAMETERS, 40, 0, Journal(None, {}))
    assert hill(found) == max(asked)


# --- tunings and their files ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def tuned() -> Tuned:
    """The EKF's factors on R, tuned in a few evaluations."""
    arm = Arm(CORVETTE, options={"estimator": "ekf"}, picked=())
    return tune(arm, evaluations=12, episodes=4, fresh=8)


def test_what_is_tuned_is_what_the_file_gives(tuned: Tuned, tmp_path: Path):
    tuned.write(path := tmp_path / "tuned.toml")
    read = load_tuned(path)
    assert (read.values, read.made_by) == (tuned.values, tuned.made_by)
    assert json.dumps(read.found) == json.dumps(tuned.found)
    ours, theirs = (
        rollout(each.agent(), CORVETTE, SEEDS, each.env_options).score for each in (tuned, read)
    )
    np.testing.assert_array_equal(ours, theirs)
    by_name = rollout(str(path), CORVETTE, SEEDS, read.env_options).score
    np.testing.assert_array_equal(ours, by_name)


def test_the_scale_of_Q_and_R_makes_NEES_one(tuned: Tuned):
    gained = tuned.found["after"] - max(tuned.found["best_so_far"])
    assert abs(gained) < 0.002
    assert 0.5 < tuned.found["position_nees"] < 2.0


def test_an_episode_that_diverges_does_not_move_the_NEES(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Trials, "flown", lambda *_, **__: [None])
    usual = np.random.default_rng(0).chisquare(2, 41) / 2.0
    diverged = np.where(usual == usual.max(), 1e9, usual)
    found = []
    for values in (usual, diverged):
        monkeypatch.setattr(tuning, "scores", lambda *_, values=values: {"position_nees": values})
        found.append(tuning._nees(Trials(Arm(CORVETTE), SEEDS), {}))
    assert found[0] == found[1]


def test_a_tuned_file_is_refused_elsewhere(tuned: Tuned):
    assert tuned.options_for(CORVETTE, {"disturbance": "rough"})["disturbance"] == "rough"
    for env_id, given, said in (
        ("SigmaChannel-v0", {}, "tuned for environment SigmaCorvette-v0, not for SigmaChannel"),
        (CORVETTE, {"sensors": "budget"}, "tuned for sensors nominal, not for budget: tune"),
        (CORVETTE, {"estimator": "ukf"}, "tuned for estimator ekf, not for ukf"),
    ):
        with pytest.raises(ValueError, match=said):
            tuned.options_for(env_id, given)


def test_a_tuned_controller_is_refused_elsewhere(tuned: Tuned, tmp_path: Path):
    tuned.write(path := tmp_path / "tuned.toml")
    for env_id, given, said in (
        ("SigmaChannel-v0", {}, "were tuned for SigmaCorvette-v0, not for this"),
        (CORVETTE, {"observe": "measurement"}, "needs estimates"),
        (CORVETTE, {"guidance": False}, "goes by guidance"),
    ):
        with refused(ValueError, said):
            rollout(str(path), env_id, SEEDS, given)
    with closing(gym.make(CORVETTE)) as env:
        observation = np.zeros((1, *env.observation_space.shape))
        assert load_agent(path, env).act(observation).shape == (1, 1)


def test_a_tuned_estimator_keeps_its_vessel_and_options(tuned: Tuned):
    for given, said in (
        ({"vessel": "mariner"}, "tuned for vessel as registered, not for mariner"),
        ({"estimator_options": {"late": "discarded"}}, "estimator options {}, not for .*late"),
    ):
        with refused(ValueError, said):
            tuned.options_for(CORVETTE, given)
    named = replace(tuned.arm, env_id=f"agents.tuning:{CORVETTE}")
    assert replace(tuned, arm=named).options_for(CORVETTE, {}) == tuned.env_options


def test_options_without_a_value_survive_the_file(tuned: Tuned, tmp_path: Path):
    options = {"estimator": "enkf", "estimator_options": {"members": None}}
    replace(tuned, arm=Arm(CORVETTE, options=options)).write(path := tmp_path / "tuned.toml")
    assert load_tuned(path).arm.options == options
    with refused(TypeError, "cannot hold .*Inflated.*module:object"):
        replace(tuned, arm=Arm(CORVETTE, options={"estimator": Inflated})).write(path)


def test_all_others_as_searched_show_what_a_parameter_gains(tuned: Tuned):
    names = [*tuned.arm.parameters]
    searched = {name: tuned.arm.delivered[name] for name in names}
    scaled = {n: 100.0 * v if n.startswith("estimator") else v for n, v in searched.items()}
    trials = Trials(tuned.arm, tuning_seeds(4, first=9))
    found = _compared(trials, searched, scaled | {"estimator.Q": 100.0})
    assert found["gain_of"] == {name: [0.0, 0.0, 0.0] for name in names}


@pytest.mark.parametrize("text", ["", "[arm]\nenv_id = 3", "x = ["])
def test_other_files_hold_no_tuned_parameters(text: str, tmp_path: Path):
    (path := tmp_path / "other.toml").write_text(text)
    with pytest.raises(ValueError, match=r"other\.toml"):
        load_tuned(path)


@pytest.mark.parametrize(
    ("arm", "said"),
    [
        (Arm(CORVETTE, picked=("estimator.S",)), "unknown parameter 'estimator.S'.*estimator.Q"),
        (Arm(CORVETTE, "random", {"estimator": "truth"}), "nothing that can be tuned"),
    ],
)
def test_an_arm_without_the_parameters_is_refused(arm: Arm, said: str):
    with pytest.raises(ValueError, match=said):
        arm.parameters  # noqa: B018


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"fresh": 1}, "fresh must be a whole number of at least 2"),
        ({"episodes": 0}, "episodes must be a whole number of at least 1"),
        ({"evaluations": 0}, "evaluations must be"),
        ({"seed": -1}, "seed must be"),
        ({"seed": 12_500, "episodes": 40}, "500000 seeds to tune on.* needs 500040"),
    ],
)
def test_numbers_are_refused_before_a_tuning(given: dict[str, int], said: str):
    with refused(ValueError, said):
        tune(Arm(CORVETTE), **given)


@pytest.mark.parametrize("options", [{}, {"estimator_options": None}])
def test_conditions_of_an_arm_have_equal_sensors(options: dict[str, Any]):
    sensors = [*Arm(CORVETTE).configurations[0].sensors.each]
    arm = Arm(CORVETTE, "autopilot", options, ({}, {"sensors": sensors[:-1]}))
    with refused(ValueError, "conditions of a tuning need equal sensors"):
        arm.parameters  # noqa: B018
    with refused(ValueError, "only the vessel of a registered environment"):
        Arm(CORVETTE, options=options | {"vessel": "mariner"}).parameters  # noqa: B018


def test_a_controller_is_tuned_on_what_it_can_use():
    arm = Arm(CORVETTE, options={"observe": "measurement"})
    with refused(ValueError, "the autopilot needs estimates"):
        tune(arm, evaluations=1, episodes=1)


def test_a_late_sensor_in_any_condition_needs_environments():
    late = {"latency": {"receiver": 2.0}}
    assert Arm(CORVETTE).by_rows
    assert not Arm(CORVETTE, conditions=({}, late)).by_rows


@pytest.mark.parametrize("text", ["3\n", '[[0.1], "a"]\n', "[[0.1]]\n", "{\n"])
def test_a_damaged_journal_is_refused(text: str, tmp_path: Path):
    Journal(path := tmp_path / "a.jsonl", {})
    path.write_text(path.read_text() + text)
    with refused(ValueError, "is damaged: remove it"):
        Journal(path, {})


@pytest.mark.parametrize("text", ["", "{"])
def test_a_journal_without_its_head_is_refused(text: str, tmp_path: Path):
    (path := tmp_path / "a.jsonl").write_text(text)
    with refused(ValueError, "the journal of another tuning"):
        Journal(path, {})


@pytest.mark.parametrize("cut", range(1, 12))
def test_a_line_cut_anywhere_is_read_as_missing(cut: int, tmp_path: Path):
    journal = Journal(path := tmp_path / "a.jsonl", {})
    journal.score(np.array([0.5]), lambda: 1.0)
    whole = path.read_text()
    path.write_text(whole[:-cut])
    Journal(path, {}).score(np.array([0.5]), lambda: 1.0)
    assert path.read_text() == whole


def test_a_journal_of_another_tuning_is_refused(tmp_path: Path):
    arm = Arm(BRIEF, picked=("estimator",))
    tune(arm, 1, 1, fresh=2, journal=tmp_path / "b.jsonl")
    with pytest.raises(ValueError, match="the journal of another tuning"):
        tune(replace(arm, by="likelihood"), 1, 1, fresh=2, journal=tmp_path / "b.jsonl")
