"""What estimators and learned agents keep of the oracle's performance, compared, with the intervals that are due.

The unit is the evaluation seed for an agent that does not learn, and the training run for one that does.
"""

from collections.abc import Iterable, Sequence
from itertools import product

import numpy as np

from agents.statistics import Interval, iqm, mean_interval, paired_bootstrap, paired_difference, stratified_bootstrap
from agents.studies.results import Pilot, Results
from agents.studies.study import DEFAULT, FLOOR, ORACLE

ENDS = (ORACLE, FLOOR)
"""What is 1 and 0 by definition."""


def shares(
    results: Results, environments: Iterable[str], pilot: Pilot, estimator: str | None = None
) -> np.ndarray | None:
    """What an agent that does not learn keeps at each evaluation seed ``(episodes,)``: mean over environments.

    Args:
        results: Of a study.
        environments: Where; None is returned if one of them lacks a flight.
        pilot: Who.
        estimator: On what; None: on each environment's default.
    """
    each = [
        results.paired(results.scaled([e]), pilot, results.own(e, pilot) if estimator is None else estimator)
        for e in environments
    ]
    whole = [values for values in each if values is not None]
    return np.mean(whole, axis=0) if whole and len(whole) == len(each) else None


def rankable(results: Results, environments: Sequence[str]) -> dict[str, np.ndarray]:
    """What the classical agent keeps on each estimator that flew everywhere, the best first, without the ends."""
    names = (name for name in results.flown_on() if name not in ENDS)
    found = {
        name: values for name in names if (values := shares(results, environments, results.classical, name)) is not None
    }
    return dict(sorted(found.items(), key=lambda item: -float(item[1].mean())))


def ruled(results: Results) -> list[str]:
    """The environments in which shares can be told and somebody was flown."""
    return [e for e in results.environments if rankable(results, [e])]


def common(results: Results) -> dict[str, np.ndarray]:
    """What is `rankable` over all environments that are `ruled`; nothing if that leaves nothing to choose between."""
    environments = ruled(results)
    ranked = rankable(results, environments) if len(environments) > 1 else {}
    return ranked if len(ranked) > 1 else {}


def kept(results: Results, environments: Sequence[str], pilot: Pilot, estimator: str | None) -> Interval | float | None:
    """What somebody of `Results.schools` keeps, with the interval that is due: over episodes, or over trainings."""
    if results.agent(pilot).learned:
        return _iqm(results.runs(environments, pilot, estimator))
    values = shares(results, environments, pilot, estimator)
    return None if values is None else mean_interval(values)


def _iqm(runs: np.ndarray | None) -> Interval | float | None:
    """The interquartile mean of training runs ``(runs, environments)``; a number where one run has no interval."""
    if runs is None:
        return None
    interval = stratified_bootstrap(runs)
    return float(iqm(runs)) if interval is None else interval


def loss(results: Results, environments: Iterable[str], estimator: str) -> Interval | None:
    """Score that the classical agent loses on an estimator against the truth, where there is a scale."""
    return results.price(results.scaled(environments), results.classical, estimator)


def clear(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the difference is beyond chance."""
    gap = paired_difference(a, b)
    return gap is not None and gap.excludes_zero


def learners(results: Results) -> list[Pilot]:
    """Everybody of `Results.schools` that learned."""
    return [pilot for pilot in results.schools() if results.agent(pilot).learned]


def reference_pilot(results: Results) -> Pilot | None:
    """The learned agent that others are measured against: sees estimates, remembers nothing, trained on the default."""
    plain = [
        pilot
        for pilot in results.schools()
        if (agent := results.agent(pilot)).learned and not agent.raw and agent.memory == "none"
    ]
    return next((pilot for pilot in plain if pilot.trained_on == DEFAULT), plain[0] if plain else None)


def shared(results: Results, *pilots: Pilot) -> list[str]:
    """The environments in which all of these have results at home."""
    return [e for e in results.environments if all(results.runs([e], pilot) is not None for pilot in pilots)]


def difference(results: Results, environments: Sequence[str], one: Pilot, other: Pilot) -> Interval | float | None:
    """How much more one keeps than the other, each at home, by interquartile means of runs of the same seeds."""
    both = results.paired_runs(environments, (one, None), (other, None))
    if both is None:
        return None
    return paired_bootstrap(*both) or float(iqm(both[0]) - iqm(both[1]))


def against_classical(results: Results, environment: str, pilot: Pilot) -> Interval | float | None:
    """Share that training runs keep above what the classical agent keeps on the same estimator."""
    runs = results.runs([environment], pilot)
    classical = shares(results, [environment], results.classical, results.own(environment, pilot))
    if runs is None or classical is None:
        return None
    gap = runs[:, 0] - classical.mean()
    return mean_interval(gap) or float(gap.mean())


def crossing(results: Results, environment: str) -> Interval | float | None:
    """What policies keep less than those that were trained on the estimator flown, mean over pairs of estimators."""
    schools = [pilot for pilot in results.pilots(environment) if results.agent(pilot).learned]
    lost = []
    for here, stranger in product(schools, schools):
        if here.agent == stranger.agent and here != stranger:
            both = results.paired_runs([environment], (here, None), (stranger, here.trained_on))
            if both is not None:
                lost.append(both[0][:, 0] - both[1][:, 0])
    if not lost or len({len(each) for each in lost}) > 1:
        return None
    mean = np.mean(lost, axis=0)
    return mean_interval(mean) or float(mean.mean())
