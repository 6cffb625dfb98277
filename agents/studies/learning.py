"""Section of a report: learned agents, beside the classical one and each other."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from agents.page import Block, Entry, Prose, Section, Table, entry, number
from agents.plotting import INK
from agents.statistics import performance_profile, probability_of_improvement
from agents.studies.figures import Row, dots, framed, grid, legend, panels, policy_looks, share_rows
from agents.studies.records import FEW_SEEDS, RAW
from agents.studies.results import Policy, Results
from agents.studies.shares import columns, difference, kept, learners, reference_policy
from agents.studies.wording import note, paragraphs, share_entry, tabled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def learning(results: Results) -> Section:
    """Shares kept by learned agents, on estimates and on measurements."""
    title = "Learned agents"
    learned = learners(results)
    environments = [
        e for e in results.environments if any(results.runs([e], p) is not None for p in learned)
    ]
    if not learned or not environments:
        return Section(title, [])
    seeds = results.plan.study.training_seeds
    blocks: list[Block] = []
    if seeds < FEW_SEEDS:
        blocks.append(Prose(note("few-runs", results)))
    blocks.append(Prose(note("rare-failures", results)))
    by_head, (heading, at_home) = (
        columns(environments, len(environments) > 1),
        paragraphs("at-home", results),
    )
    heads = list(by_head)
    look = policy_looks(results)
    rows = [
        Row(
            str(policy),
            look[policy],
            [kept(results, column, policy, None) for column in by_head.values()],
        )
        for policy in results.schools()
    ]
    shares, pairs = (
        dots(rows, heads, "share of the oracle's performance kept"),
        [(head, "") for head in heads],
    )
    blocks += [
        framed(shares, "at-home-figure", results, at_home=at_home),
        Table(heading, at_home, "Agent", pairs, [("", share_rows(rows))], "agents"),
    ]
    reference = reference_policy(results)
    if reference is not None:
        others = [policy for policy in learned if policy != reference]
        blocks += _against(results, reference, others, by_head)
    blocks.append(framed(profile_figure(results), "profiles", results))
    for agent in (a for a in results.plan.study.agents if a.learned and not a.raw):
        figure = transfer_figure(results, agent.name)
        if figure is not None:
            blocks.append(framed(figure, "transfer", results, agent=agent.name))
    return Section(title, blocks)


def _against(
    results: Results, reference: Policy, others: list[Policy], by_head: Mapping[str, Sequence[str]]
) -> list[Block]:
    """Other policies against the reference: probability of improvement, and what those without a filter gain."""
    raw = [policy for policy in others if results.agent(policy).raw]

    def better(policy: Policy, column: Sequence[str]) -> Entry:
        ours, theirs = (results.runs(column, p) for p in (policy, reference))
        return (
            Entry("–")
            if ours is None or theirs is None
            else entry(probability_of_improvement(ours, theirs), 2)
        )

    def gain(policy: Policy, column: Sequence[str]) -> Entry:
        return share_entry(difference(results, column, policy, reference, len(raw)), signed=True)

    rows = [
        (str(policy), [better(policy, column) for column in by_head.values()]) for policy in others
    ]
    blocks = tabled("improvement", results, list(by_head), {"": rows}, "Agent", reference=reference)
    rows = [(str(policy), [gain(policy, column) for column in by_head.values()]) for policy in raw]
    return blocks + tabled(
        "without-filter", results, list(by_head), {"": rows}, "Agent", reference=reference
    )


def profile_figure(results: Results) -> "Figure":
    """Share of training runs that keep more than some share of the oracle's performance, a panel an environment.

    The pointwise bands are drawn where runs lie; beyond them they go on, and would hide each other.
    """
    look, learned = policy_looks(results), learners(results)
    each = {
        e: {p: runs for p in learned if (runs := results.runs([e], p)) is not None}
        for e in results.environments
    }
    drawn = {environment: flown for environment, flown in each.items() if flown}
    with panels(list(drawn), 0.6 + 0.2 * -(-len(learned) // 3), 1.9, sharey=True) as (figure, axes):
        for panel, flown in zip(axes, drawn.values(), strict=True):
            every = np.concatenate([runs.ravel() for runs in flown.values()])
            margin = 0.08 * max(float(np.ptp(every)), 0.05)
            thresholds = np.linspace(every.min() - margin, every.max() + margin, 201)
            for policy, runs in flown.items():
                profile = performance_profile(runs, thresholds)
                low, mean, high = np.array(
                    [(share.low, share.mean, share.high) for share in profile]
                ).T
                colour, near = look[policy].colour, 0.5 * margin
                there = (thresholds > runs.min() - near) & (thresholds < runs.max() + near)
                panel.fill_between(
                    thresholds, low, high, where=there, color=colour, alpha=0.15, linewidth=0.0
                )
                panel.plot(
                    thresholds, mean, color=colour, linestyle=look[policy].line, label=str(policy)
                )
            panel.set_xlabel("share kept")
            panel.set_ylim(-0.03, 1.03)
        figure.supylabel("share of runs above", fontsize=10)
        legend(figure, axes, 3)
    return figure


def transfer_figure(results: Results, agent: str) -> "Figure | None":
    """Share kept by policies trained on one estimator and flown on another; None if nothing was trained.

    Args:
        results: Of a study.
        agent: Name of one that learns and flies on estimates.
    """
    from matplotlib.patches import Rectangle

    tables = {}
    for environment in results.environments:
        policies = [p for p in results.policies(environment) if p.agent == agent]
        on = [name for name in results.estimators(environment) if name != RAW]
        runs = [[results.runs([environment], policy, name) for name in on] for policy in policies]
        shares = np.array(
            [[np.nan if each is None else each.mean() for each in row] for row in runs]
        )
        if np.isfinite(shares).any():
            tables[environment] = ([p.trained_on for p in policies], on, shares)
    if not tables:
        return None
    heights = [0.25 * len(rows) + 1.05 for rows, _, _ in tables.values()]
    with grid(sum(heights), len(tables), 1, height_ratios=heights) as (figure, axes):
        for panel, (environment, (rows, on, shares)) in zip(
            axes[:, 0], tables.items(), strict=True
        ):
            panel.imshow(np.clip(shares, 0.0, 1.0), cmap="Blues", vmin=0.0, vmax=1.4, aspect="auto")
            for (i, j), share in np.ndenumerate(shares):
                own = rows[i] == on[j]
                weight = "bold" if own else "normal"
                panel.text(
                    j, i, number(share, 2), ha="center", va="center", fontsize=8.5, weight=weight
                )
                if own:
                    box = Rectangle(
                        (j - 0.5, i - 0.5), 1.0, 1.0, fill=False, edgecolor=INK, linewidth=1.2
                    )
                    panel.add_patch(box).set_clip_on(False)
            panel.set_xticks(
                range(len(on)), on, rotation=35, ha="right", rotation_mode="anchor", fontsize=8.5
            )
            panel.set_yticks(range(len(rows)), rows)
            panel.tick_params(length=0)
            panel.spines[:].set_visible(False)
            panel.set_title(environment, loc="left")
            panel.set_ylabel("trained on")
        panel.set_xlabel("flown on")
    return figure
