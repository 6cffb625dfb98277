"""What the dives are for: they tell estimators apart, and the default ones say truly how sure they are.

100 evaluation seeds, nominal sensors, moderate disturbance, the autopilot, whose tolerances were tuned on other seeds.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from agents import rollout
from agents.metrics import components, consistency, nees_of
from agents.metrics.dive import POSITION, path_errors
from agents.rollouts import Rollout
from agents.seeds import evaluation_seeds
from agents.statistics import paired_difference

pytestmark = pytest.mark.slow

DEFAULTS = {"SegorogeniAUV-v0": "enkf", "ItsunusaAUV-v0": "enkf-sr"}

every_dive = pytest.mark.parametrize("env_id", DEFAULTS)


@cache
def flown(env_id: str, estimator: str | None = None, plain: bool = False) -> Rollout:
    options = {"estimator": estimator, "estimator_options": {"localisation": None} if plain else {}}
    return rollout("autopilot", env_id, evaluation_seeds(100), options)


def pooled_rms(flight: Rollout) -> float:
    """Root mean square over all times of all episodes: cross-track in three dimensions, else path-normal [m]."""
    cross, normal = path_errors(flight)
    error = cross if "y" in flight.env.unwrapped.system.vehicle.state_names else normal
    return float(np.sqrt(np.mean(error[flight.alive] ** 2)))


@every_dive
def test_on_its_default_estimates_the_autopilot_keeps_the_path_and_arrives(env_id: str):
    flight = flown(env_id)
    assert flight.env.unwrapped.core.estimator == DEFAULTS[env_id]
    assert (flight.end == "arrived").sum() >= 95
    assert pooled_rms(flight) <= 0.3


@every_dive
def test_on_held_readings_it_seldom_arrives_and_strays_twice_as_far(env_id: str):
    held = flown(env_id, "measurement")
    assert (held.end == "arrived").sum() <= 50
    assert pooled_rms(held) >= 2.0 * pooled_rms(flown(env_id))


@every_dive
def test_the_better_it_is_known_where_the_vehicle_is_the_higher_the_score(env_id: str):
    scores = {name: flown(env_id, name).score for name in ("truth", None, "measurement")}
    for better, worse in (("truth", None), (None, "measurement")):
        difference = paired_difference(scores[better], scores[worse])
        assert difference is not None
        assert difference.low > 0.0


@every_dive
def test_a_plain_ensemble_takes_chance_correlations_for_knowledge(env_id: str):
    """Without localisation the position's variance shrinks between two fixes, and dives miss their goal."""
    plain, localised = flown(env_id, plain=True), flown(env_id)
    position = components(plain, *POSITION)
    assert consistency(plain, position) < consistency(localised, position) - 0.05
    difference = paired_difference(localised.score, plain.score)
    assert difference is not None
    assert difference.low > 0.0


@every_dive
def test_the_default_filter_is_as_sure_of_the_position_as_it_may_be(env_id: str):
    """The mean NEES of a run, by its size, is 1 on average: 100 runs, 4 standard errors, false-alarm rate 6e-5.

    The share of times in a chi-square band is no law of 100 runs: errors last, and it scatters from 0.6 to 1.
    """
    flight = flown(env_id)
    position, alive = components(flight, *POSITION), flight.alive
    values = nees_of(flight, position)
    assert values is not None
    means = np.where(alive, values, 0.0).sum(0) / alive.sum(0) / len(position)
    assert abs(means.mean() - 1.0) <= 4.0 * means.std(ddof=1) / np.sqrt(len(means))


def test_the_example_of_the_page_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    page = (Path(__file__).parents[2] / "docs" / "dives.md").read_text(encoding="utf-8")
    code = page[page.index("```python\n") + len("```python\n") :].split("```")[0]
    monkeypatch.setattr("agents.seeds.evaluation_seeds", lambda count: evaluation_seeds(3))
    exec(compile(code, "docs/dives.md", "exec"), {"__name__": "page"})
    assert capsys.readouterr().out.count("position_nees") == 4
