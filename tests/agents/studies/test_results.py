"""What a study found, by place, pilot and estimator."""

import json

import numpy as np
import pytest
from invented import CORVETTE, QUALITY, SEGOROGENI, learned, results, study, without

from agents.cells import Outcome
from agents.studies.plan import RAW
from agents.studies.results import Pilot, Place, Results

NOMINAL = Place(CORVETTE, "nominal")


@pytest.fixture(scope="module")
def found():
    return learned()


def test_the_floor_and_the_oracle_are_0_and_1_of_the_scale(found):
    for name, end in (("dead-reckoning", 0.0), ("truth", 1.0)):
        assert np.mean(found.kept(NOMINAL, found.classical, name)) == pytest.approx(end)


def test_pilots_are_the_same_everywhere_by_the_name_of_their_school(found):
    schools = found.schools()
    assert [str(p) for p in schools] == [
        "autopilot", "PPO trained on default", "PPO trained on ekf", "PPO, raw", "PPO, LSTM",
    ]  # fmt: skip
    assert found.here(CORVETTE, schools[1]) == Pilot("PPO", "kf-umv-ui")
    assert found.here(SEGOROGENI, schools[1]) == Pilot("PPO", "enkf")
    assert [found.own(CORVETTE, p) for p in schools] == ["kf-umv-ui", "kf-umv-ui", "ekf", RAW, RAW]
    assert {found.here(CORVETTE, p) for p in schools} == set(found.pilots(CORVETTE))


def test_runs_of_a_school_are_those_of_its_pilot_in_each_environment(found):
    runs = found.runs([CORVETTE, SEGOROGENI], Pilot("PPO", "default"))
    assert runs.shape == (5, 2)
    for column, environment, name in ((0, CORVETTE, "kf-umv-ui"), (1, SEGOROGENI, "enkf")):
        places = found.places([environment])
        kept = np.mean([found.kept(p, Pilot("PPO", name), name).mean(1) for p in places], axis=0)
        np.testing.assert_allclose(runs[:, column], kept)


def test_a_run_that_lacks_a_flight_is_left_out_and_pairs_are_of_the_same_seeds(found):
    broken = without(
        found,
        lambda f: (
            (f.agent, f.trained_on, f.training_seed, f.condition)
            in [("PPO", "ekf", 2, "calm"), ("PPO, raw", RAW, 0, "rough")]
        ),
    )
    home, raw = Pilot("PPO", "ekf"), Pilot("PPO, raw", RAW)
    whole = [found.runs([CORVETTE], pilot) for pilot in (home, raw)]
    np.testing.assert_array_equal(broken.runs([CORVETTE], home), whole[0][[0, 1, 3, 4]])
    for ours, theirs in zip(broken.paired_runs([CORVETTE], (home, None), (raw, None)), whole, strict=True):
        np.testing.assert_array_equal(ours, theirs[[1, 3, 4]])
    none = without(found, lambda f: f.agent == "PPO" and f.condition == "calm")
    assert none.runs([CORVETTE], home) is None
    assert none.paired_runs([CORVETTE], (home, None), (raw, None)) is None


def test_places_without_a_scale_count_for_nothing(found):
    calm = without(found, lambda f: (f.flown_on, f.condition) == ("truth", "calm"))
    assert [p.condition for p in calm.scaled([CORVETTE])] == ["nominal", "rough", "all wrong"]
    assert calm.runs([CORVETTE], Pilot("PPO", "ekf")).shape == (5, 1)
    flat = results(found.plan, QUALITY | {"truth": -0.1})
    assert flat.scaled() == []


def test_the_price_has_seeds_for_its_unit_or_training_runs(found):
    assert found.price([NOMINAL], found.classical, "truth").mean == 0.0
    truth, ours = (found.figure(NOMINAL, found.classical, name)[0] for name in ("truth", "kf"))
    price = found.price([NOMINAL], found.classical, "kf")
    assert price.mean == pytest.approx(np.mean(truth - ours))
    pilot = Pilot("PPO", "ekf")
    truth, ours = (found.figure(NOMINAL, pilot, name).mean(1) for name in ("truth", "ekf"))
    price = found.price([NOMINAL], pilot, "ekf")
    assert price.mean == pytest.approx(np.mean(truth - ours))
    assert price.half == pytest.approx(2.7764 * np.std(truth - ours, ddof=1) / np.sqrt(5.0), rel=1e-4)
    assert found.price([NOMINAL], Pilot("PPO, raw", RAW), RAW) is None


def test_estimators_come_in_the_order_of_the_study(found):
    assert found.flown_on() == ["truth", "dead-reckoning", "kf-umv-ui", "kf", "ekf", "enkf", RAW]
    assert found.estimators(pilot=found.classical) == ["truth", "dead-reckoning", "ekf", "enkf"]


def test_a_flight_whose_process_had_to_load_compiled_code_counts_only_if_there_is_no_other(tmp_path):
    invented = results(study(environments=(CORVETTE,)))
    flights = [f for f in invented.plan.flights if f.flown_on == "kf"]
    lines = [
        {"key": f.cell.key, "cpu_seconds": seconds, "host": "here", "process": process}
        for f, seconds, process in zip(flights, (9.0, 1.0, 1.0, 9.0), (1, 1, 1, 2), strict=False)
    ]
    for shown in (lines, lines[:1]):
        (tmp_path / "journal.jsonl").write_text("".join(json.dumps(line) + "\n" for line in shown))
        timed = Results.of(invented.plan, Outcome(invented.values), tmp_path)
        steps = invented.values[flights[0].cell.key]["steps"]
        warm = 1.0 if len(shown) > 1 else 9.0
        assert timed.cost(CORVETTE, timed.classical, "kf") == pytest.approx(1e6 * warm / steps)
