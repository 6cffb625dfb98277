"""Shares of the oracle's performance that estimators and learned agents keep, compared, with intervals.

Everything is a mean over training runs and evaluation seeds, with the one interval of
`agents.statistics`.
"""

from collections.abc import Iterable, Iterator, Sequence
from math import comb

import numpy as np

from agents.statistics import EQUIVALENT, Interval, mean_interval, paired_difference, verdict
from agents.studies.records import DEFAULT, FLOOR, ORACLE
from agents.studies.results import Policy, Results

ENDS = (ORACLE, FLOOR)
"""Estimators whose share is 1 and 0 by definition."""
ALL = "All"
"""Heading of what holds for all environments together."""


def rankable(results: Results, environments: Sequence[str]) -> dict[str, np.ndarray]:
    """Share kept by the classical agent at each evaluation seed ``(episodes,)``, by estimator that flew everywhere.

    The best first, without the ends.
    """
    names = (name for name in results.flown_on() if name not in ENDS)
    each = {name: results.shares(environments, results.classical, name) for name in names}
    found = {name: values[0] for name, values in each.items() if values is not None}
    return dict(sorted(found.items(), key=lambda item: -float(item[1].mean())))


def ruled(results: Results) -> list[str]:
    """The environments in which shares can be told and somebody was flown."""
    return [e for e in results.environments if rankable(results, [e])]


def columns(environments: Sequence[str], together: bool) -> dict[str, Sequence[str]]:
    """The environments that each column of a table stands for: every one, and before them perhaps all together."""
    return ({ALL: environments} if together else {}) | {e: [e] for e in environments}


def common(results: Results) -> dict[str, np.ndarray]:
    """Shares that are `rankable` over all environments that are `ruled`; empty for fewer than two estimators."""
    environments = ruled(results)
    ranked = rankable(results, environments) if len(environments) > 1 else {}
    return ranked if len(ranked) > 1 else {}


def kept(
    results: Results,
    environments: Sequence[str],
    policy: Policy,
    estimator: str | None,
    among: int = 1,
) -> Interval | float | None:
    """Share that somebody of `Results.schools` keeps; a number where one training run has no interval.

    The interval of the best of several holds only if theirs hold all at once: ``among`` is their
    number.
    """
    shares = results.shares(environments, policy, estimator)
    return None if shares is None else results.interval(policy, shares, among)


def loss(
    results: Results, environments: Iterable[str], estimator: str, among: int = 1
) -> Interval | float | None:
    """Score that the classical agent loses on an estimator against the truth, where there is a scale; as `kept`."""
    return results.price(results.scaled(environments), results.classical, estimator, among)


def gap(ranked: dict[str, np.ndarray], one: str, other: str) -> Interval | None:
    """Difference of the shares kept on two estimators.

    The 95 % hold for all pairs of the ranked at once, because which of them is the best is seen in
    the same episodes: where all are equal, at most one study in twenty tells any two apart.
    """
    return paired_difference(ranked[one], ranked[other], comparisons=comb(len(ranked), 2))


def scales(results: Results, environments: Sequence[str]) -> np.ndarray:
    """Score on the truth minus that on dead reckoning ``(places, episodes)``, wherever it is above zero."""
    ends = (results.scale(place) for place in results.scaled(environments))
    return np.array([high - low for low, high in filter(None, ends)])


def verdicts(
    results: Results, environments: Sequence[str], ranked: dict[str, np.ndarray]
) -> dict[str, str]:
    """Verdict on each estimator but the best against the best, in their order.

    Scores lie in [0, 1], so that shares kept differ by at most the inverse of the mean scale.
    """
    best, *others = ranked
    span, pairs = np.mean(1.0 / scales(results, environments).mean(axis=1)), comb(len(ranked), 2)
    return {
        each: verdict(ranked[each] - ranked[best], results.plan.study.margin, span, pairs)
        for each in others
    }


def cheapest(results: Results, environments: Sequence[str], ranked: dict[str, np.ndarray]) -> str:
    """The best estimator, or one equivalent to it whose step takes least CPU time: less by a tenth, beyond the noise.

    A time counts as a multiple of that on the truth, flown in turns with it: jobs may run on
    several machines.
    """
    best, times = next(iter(ranked)), {}
    equals = [
        name
        for name, found in verdicts(results, environments, ranked).items()
        if found == EQUIVALENT
    ]
    for name in (best, *equals):
        each = [results.step_times(e, name)[:1] for e in environments]
        if not all(each):
            return best
        times[name] = sum(own / truth for [(_, own, truth)] in each)
    least = min(times, key=lambda name: times[name])
    return least if times[least] < 0.9 * times[best] else best


def episodes_to_tell(
    results: Results, environments: Sequence[str], ranked: dict[str, np.ndarray]
) -> float:
    """Number of evaluation seeds that would tell what the best estimator keeps; 0 if those flown do, NaN of one.

    They do if the scale's interval excludes zero and that of the share kept is no wider than the
    scale (Fieller 1954: a ratio whose denominator may be zero has no bounded interval). So many as
    make both half as wide, by their spread.
    """
    from scipy.special import ndtri

    worth, kept = scales(results, environments).mean(axis=0), next(iter(ranked.values()))
    if len(kept) < 2:
        return float("nan")
    needed, enough = 0.0, True
    for values, half, among in ((worth, worth.mean(), 1), (kept, 0.5, len(ranked))):
        found = mean_interval(values, among)
        enough &= found is not None and found.half < half
        needed = max(needed, (2.0 * ndtri(1.0 - 0.025 / among) * values.std(ddof=1) / half) ** 2)
    return 0.0 if enough else float(np.ceil(needed))


def learners(results: Results) -> list[Policy]:
    """Everybody of `Results.schools` that learned."""
    return [policy for policy in results.schools() if results.agent(policy).learned]


def reference_policy(results: Results) -> Policy | None:
    """The learned agent that others are measured against: sees estimates, remembers nothing, trained on the default."""
    plain = [
        policy
        for policy in results.schools()
        if (agent := results.agent(policy)).learned and not agent.raw and agent.memory == "none"
    ]
    return next(
        (policy for policy in plain if policy.trained_on == DEFAULT), plain[0] if plain else None
    )


def learned_differences(results: Results) -> Iterator[tuple[str, str, Interval | float | None]]:
    """Shares that the `reference_policy` keeps at home above the classical agent on the same estimator, and above raw.

    The latter are those of the agents that learned on measurements, of the same training seeds;
    corrected for their number. Each is an environment, the other agent and the difference.
    """
    reference = reference_policy(results)
    raw = [policy for policy in learners(results) if results.agent(policy).raw]
    for environment in results.environments:
        if reference is None or results.runs([environment], reference) is None:
            continue
        here, who = results.own(environment, reference), results.classical
        gaps = results.paired_shares([environment], (reference, here), (who, here))
        value = None if gaps is None else results.interval(reference, gaps)
        yield environment, str(who), value
        for policy in raw:
            value = difference(results, [environment], reference, policy, len(raw))
            yield environment, str(policy), value


def difference(
    results: Results, environments: Sequence[str], one: Policy, other: Policy, comparisons: int = 1
) -> Interval | float | None:
    """Difference of the shares that two policies keep, each at home, in runs of the same training seeds."""
    gaps = results.paired_shares(environments, (one, None), (other, None))
    return None if gaps is None else results.interval(one, gaps, comparisons)
