"""Sections of a report: who keeps how much, by how much others are behind, and what estimates cost in score."""

from collections.abc import Sequence

import numpy as np

from agents.page import Block, Entry, Prose, Section, Table
from agents.statistics import BETTER, EQUIVALENT, WORSE, Interval, verdict
from agents.studies.confirmation import FAILED, HELD, OPEN, Confirmed
from agents.studies.figures import ALL, Row, columns_of, dots, framed, looks
from agents.studies.records import FLOOR, ORACLE, RAW, Study
from agents.studies.results import Pilot, Place, Results
from agents.studies.shares import ENDS, common, gap, kept, learners, rankable, ruled
from agents.studies.wording import many, percent, sentence, share_entry, the


def ranking(results: Results) -> Section:
    """Shares kept on estimators, and their differences from the best."""
    title = "Which estimator to fly"
    environments = ruled(results)
    blocks: list[Block] = [
        Prose(
            f"The scale: in each environment and condition, what {the(results.classical)} scores on {FLOOR} is 0 and "
            f"what it scores on {ORACLE} is 1, in the same episodes. A share kept of 0.6 is 60 % of what knowing the "
            "truth is worth. The ends are marks, not limits: values beyond them are shown as they are."
        )
    ]
    if results.environments:
        blocks += [Prose(text) for text in (_ruler(results), *_rulers(results))]
    if not environments:
        return Section(title, blocks if results.environments else [])
    together = bool(common(results))
    heads, columns = columns_of(environments, together)
    overall = f" {ALL}: only the estimators that were flown in every environment." if together else ""
    names = ranked_names(results, environments)
    look = looks(results)
    best = [rankable(results, column) for column in columns]

    def shares(name: str) -> list[Interval | float | None]:
        of = zip(columns, best, strict=True)
        return [kept(results, column, results.classical, name, max(len(ranked), 1)) for column, ranked in of]

    rows = [Row(name, look[name], shares(name)) for name in (*names, *ENDS)]
    blocks.append(
        framed(
            dots(rows, heads, "share of the oracle's performance kept"),
            "Share of the oracle's performance that is kept",
            f"{sentence(the(results.classical))} on each estimator, means over conditions and evaluation seeds with "
            f"95 % intervals for all of a column at once.{overall}",
        )
    )
    blocks.append(
        Table(
            "Share of the oracle's performance kept, by estimator",
            f"{sentence(the(results.classical))}, mean over {many(len(results.conditions), 'condition')} and "
            f"{results.plan.study.episodes} evaluation seeds with its 95 % interval for other seeds, the error of the "
            "scale included. The intervals of a column hold all at once (Bonferroni), so also that of the best, chosen "
            "on these episodes: one for itself holds in 84 to 91 % of studies of 8 to 13 equals."
            f"{overall} A dash: not flown there, or not in every condition.",
            "Estimator",
            [(head, "") for head in heads],
            [("", [(row.name, [share_entry(value) for value in row.values]) for row in rows])],
            "ranking",
        )
    )
    blocks.append(_differences(results, names, best, heads))
    return Section(title, blocks + _learned_ranking(results, environments, columns, heads, names))


def _differences(results: Results, names: list[str], best: list[dict[str, np.ndarray]], heads: list[str]) -> Table:
    """The estimators against the best of each column."""
    margin = results.plan.study.margin
    behind = [(name, [_behind(ranked, name, margin) for ranked in best]) for name in names]
    return Table(
        "Difference from the best",
        "Share kept minus that on the best estimator of the column, paired by evaluation seed. "
        f"{EQUIVALENT.capitalize()}: the interval lies within ±{margin:g}, the margin of the study: no difference "
        "that matters. Worse, bold: the interval lies below zero, and not within the margin. Else nothing is "
        "decided. The best is chosen on the same episodes: the 95 % hold for all pairs of a column at once "
        "(Bonferroni), and where all are equal at most one study in twenty has a bold number.",
        "Estimator",
        [(head, "") for head in heads],
        [("", behind)],
        "behind-the-best",
    )


def _learned_ranking(
    results: Results, environments: list[str], columns: list[Sequence[str]], heads: list[str], names: list[str]
) -> list[Block]:
    """The same for agents that learned: everybody on every estimator."""
    sections = []
    for pilot in (p for p in learners(results) if not results.agent(p).raw):
        rows = [(name, [share_entry(kept(results, c, pilot, name)) for c in columns]) for name in (*names, *ENDS)]
        sections.append((str(pilot), [row for row in rows if any(e.value != "–" for e in row[1])]))
    sections = [(title, rows) for title, rows in sections if rows]
    if not sections:
        return []
    return [
        Table(
            "Share of the oracle's performance kept by learned agents, by the estimator flown on",
            f"Mean over {many(results.plan.study.training_seeds, 'training run')}, conditions and evaluation seeds "
            "with its 95 % interval for other runs on other seeds, on the scale of the classical agent. The policies "
            "are not trained again for what they fly on.",
            "Flown on",
            [(head, "") for head in heads],
            sections,
            "ranking-learned",
        )
    ]


def ranked_names(results: Results, environments: list[str]) -> list[str]:
    """Every estimator but the ends: those that flew everywhere first, by what they keep; last what has no share."""
    everywhere = list(common(results))
    means: dict[str, list[float]] = {}
    for environment in environments:
        for name, values in rankable(results, [environment]).items():
            means.setdefault(name, []).append(float(values.mean()))
    others = sorted((n for n in means if n not in everywhere), key=lambda n: -float(np.mean(means[n])))
    flown = (name for e in environments for name in results.estimators(e, results.classical))
    return list(dict.fromkeys([*everywhere, *others, *(name for name in flown if name not in ENDS)]))


def _behind(ranked: dict[str, np.ndarray], name: str, margin: float) -> Entry:
    if name not in ranked:
        return Entry("–")
    best = next(iter(ranked))
    return Entry("best") if name == best else judged(gap(ranked, name, best), margin)


def judged(difference: Interval | float | None, margin: float) -> Entry:
    """A difference in a table with its verdict; bold for better or worse."""
    found, shown = verdict(difference, margin), share_entry(difference, signed=True)
    return Entry(f"{shown}, {found}" if difference is not None else "–", strong=found in (BETTER, WORSE))


def confirmation(found: Confirmed, fresh: Study) -> Section:
    """The claims of the first pass beside what fresh seeds say of them."""
    sections: dict[str, list[tuple[str, list[Entry]]]] = {}
    for claim in found.claims:
        first, again = judged(claim.first.value, fresh.margin), judged(claim.fresh, fresh.margin)
        row = (f"{claim.first.one} − {claim.first.other}", [first, again, Entry(claim.outcome or "no claim")])
        sections.setdefault(claim.first.column, []).append(row)
    if not sections:
        return Section("Confirmation on fresh seeds", [])
    note = (
        f"Differences of the share kept, with 95 % intervals. Fresh: {fresh.episodes} evaluation seeds from number "
        f"{fresh.first_seed} on, which nobody had seen and which are opened once. What is compared is chosen on the "
        "first seeds, so there the 95 % hold for all pairs of a column at once, and on the fresh ones for its rows. "
        f"{HELD.capitalize()}: the same verdict; {OPEN}: none; {FAILED}: another. Learned agents are the same policies."
    )
    heads = [("First seeds", ""), ("Fresh seeds", ""), ("Claim", "")]
    table = Table("Claims on fresh seeds", note, "Difference", heads, list(sections.items()), "confirmation")
    return Section("Confirmation on fresh seeds", [table])


def _ruler(results: Results) -> str:
    """The termination, for all agents and both ends of the scale."""
    ends = {
        "belief": "the estimate says that the vehicle is there",
        "agent": "the agent declares that the vehicle is there",
        "task": "the vehicle is there in truth",
    }
    chosen = results.plan.study.termination
    return (
        f"One ruler for all columns: by termination {chosen!r} a mission ends where {ends[chosen]}, or is lost, or its "
        "time is up. Estimators, learned agents and both ends of the scale fly so."
    )


def _rulers(results: Results) -> list[str]:
    """Places without a scale, and those whose scale may be chance."""
    none, doubtful = [], []
    for place in results.places():
        worth = results.price([place], results.classical, FLOOR)
        where = f"{place.environment}, {place.condition}"
        if results.scale(place) is None:
            none.append(where)
        elif isinstance(worth, Interval) and not worth.excludes_zero:
            doubtful.append(where)
    texts = []
    if none:
        texts.append(
            f"No scale, because an end was not flown or {ORACLE} scores no higher than {FLOOR}; left out of every "
            f"share: {'; '.join(none)}."
        )
    if doubtful:
        texts.append(
            f"The scale may be chance, {ORACLE} not being shown to be better than {FLOOR}: {'; '.join(doubtful)}."
        )
    return texts


def price(results: Results) -> Section:
    """Score lost against the truth."""
    sections = []
    for environment in results.environments:
        places = results.places([environment])
        names = [name for name in results.estimators(environment, results.classical) if name != ORACLE]
        rows = [(name, [_lost(results, place, results.classical, name) for place in places]) for name in names]
        for pilot in results.pilots(environment):
            own = results.own(environment, pilot)
            if results.agent(pilot).learned and own != RAW and own != ORACLE:
                rows.append((f"{pilot}, on {own}", [_lost(results, place, pilot, own) for place in places]))
        if rows:
            sections.append((environment, rows))
    if not sections:
        return Section("The price of estimation", [])
    table = Table(
        "Score lost against the truth",
        f"Score on the truth minus score on the estimator at the same seed, with its 95 % interval; bold where it "
        f"excludes zero, each for itself: of twenty true zeros one is bold. Intervals follow the skewness of "
        "prices (Hall 1992). Where 2 % of the episodes are disasters, they hold in 59 of 100 studies of 20 seeds, "
        "in 63 of 50 seeds and in 86 of 100 seeds; where 5 % are, in 64, 91 and 98. "
        f"{sentence(the(results.classical))}"
        + ("; learned agents, on the estimator of their training." if learners(results) else "."),
        "Estimator",
        [(condition, "") for condition in results.conditions],
        sections,
        "price",
    )
    return Section("The price of estimation", [*_price_figure(results), table])


def _price_figure(results: Results) -> list[Block]:
    """What is lost on each estimator but the ends: beside dead reckoning the others could not be told apart."""
    environments, look = ruled(results), looks(results)
    names = ranked_names(results, environments)
    lost = {name: [results.price(results.scaled([e]), results.classical, name) for e in environments] for name in names}
    rows = [Row(name, look[name], values) for name, values in lost.items() if any(v is not None for v in values)]
    if not rows:
        return []
    caption = (
        f"{sentence(the(results.classical))}, means over conditions and evaluation seeds with 95 % intervals; the line "
        f"is the truth, and {FLOOR} is beyond the axis."
    )
    figure = dots(rows, environments, "score lost against the truth", (0.0,))
    return [framed(figure, "Score lost against the truth", caption)]


def _lost(results: Results, place: Place, pilot: Pilot, estimator: str) -> Entry:
    return share_entry(results.price([place], pilot, estimator), signed=True)


# --- tails -------------------------------------------------------------------------------------------


def tails(results: Results) -> Section:
    """Tails beside means: completed episodes, and the worst tenth."""
    sections = []
    for environment in results.environments:
        places = results.places([environment])
        flown: list[tuple[str, Pilot, str]] = [
            (name, results.classical, name) for name in results.estimators(environment, results.classical)
        ]
        for pilot in (p for p in results.pilots(environment) if results.agent(p).learned):
            own = results.own(environment, pilot)
            flown.append((str(pilot) if own == RAW else f"{pilot}, on {own}", pilot, own))
        rows = [(label, _tail(results, places, who, on)) for label, who, on in flown]
        sections.append((environment, [row for row in rows if any(e.value != "–" for e in row[1])]))
    sections = [(title, rows) for title, rows in sections if rows]
    if not sections:
        return Section("Tails", [])
    note = (
        f"All conditions together; {the(results.classical)}, and learned agents on what they were trained on. "
        "Completed: episodes that end as the task asks, such as by arriving, or whose time is up where the task is to "
        "go on; with its 95 % interval (Clopper and Pearson's, of as many trials as seeds, for one agent). Worst "
        "decile: mean score of the worst tenth of the episodes, without an interval. An estimator that fails in one "
        "episode of twenty may have the better mean."
    )
    heads = [("Score", ""), ("Completed", "%"), ("Worst decile", "score")]
    return Section("Tails", [Table("Tails beside means", note, "Estimator", heads, sections, "tails")])


def _tail(results: Results, places: Sequence[Place], who: Pilot, on: str) -> list[Entry]:
    found = (results.figure(place, who, on) for place in places)
    flown = [scores for scores in found if scores is not None]
    alike = len({scores.shape for scores in flown}) == 1
    score = results.interval(who, np.mean(np.array(flown), axis=0)) if alike else None
    return [
        share_entry(score),
        percent(results.completed(places, who, on)),
        share_entry(results.worst_decile(places, who, on)),
    ]
