"""Section of a report: learned agents, beside the classical one and each other."""

from collections.abc import Sequence

from agents.page import Block, Entry, Prose, Section, Table, entry
from agents.statistics import probability_of_improvement
from agents.studies.figures import (
    Row,
    columns_of,
    dots,
    framed,
    policy_looks,
    profile_figure,
    share_rows,
    transfer_figure,
    unitless,
)
from agents.studies.records import FEW_SEEDS
from agents.studies.results import Policy, Results
from agents.studies.shares import difference, kept, learners, reference_policy
from agents.studies.wording import many, note, share_entry, tabled


def learning(results: Results) -> Section:
    """Shares kept by learned agents, on estimates and on measurements."""
    title = "Learned agents"
    learned = learners(results)
    environments = [e for e in results.environments if any(results.runs([e], p) is not None for p in learned)]
    if not learned or not environments:
        return Section(title, [])
    seeds = results.plan.study.training_seeds
    runs = many(seeds, "training run")
    blocks: list[Block] = []
    if seeds < FEW_SEEDS:
        blocks.append(Prose(note("few-runs", runs=runs, few=FEW_SEEDS)))
    unseen = 100.0 * (1.0 - 0.05 ** (1.0 / seeds))
    blocks.append(Prose(note("rare-failures", runs=many(seeds, "run"), share=unseen)))
    heads, columns = columns_of(environments, len(environments) > 1)
    look = policy_looks(results)
    rows = [
        Row(str(policy), look[policy], [kept(results, column, policy, None) for column in columns])
        for policy in results.schools()
    ]
    at_home = note("at-home", runs=runs)
    shares = dots(rows, heads, "share of the oracle's performance kept")
    sections, name = [("", share_rows(rows))], "Share of the oracle's performance kept, by agent"
    blocks += [
        framed(shares, "Share kept by each agent", at_home + " Hollow: one run, no interval."),
        Table(name, at_home, "Agent", unitless(heads), sections, "agents"),
    ]
    reference = reference_policy(results)
    if reference is not None:
        others = [policy for policy in learned if policy != reference]
        blocks += _against(results, reference, others, columns, heads)
    blocks.append(framed(profile_figure(results), "Performance profiles", note("profiles")))
    for agent in (a for a in results.plan.study.agents if a.learned and not a.raw):
        figure = transfer_figure(results, agent.name)
        if figure is not None:
            heading = f"{agent.name}: trained on one estimator, flown on another"
            blocks.append(framed(figure, heading, note("transfer")))
    return Section(title, blocks)


def _against(
    results: Results, reference: Policy, others: list[Policy], columns: list[Sequence[str]], heads: list[str]
) -> list[Block]:
    """Other policies against the reference: probability of improvement, and what those without a filter gain."""
    raw = [policy for policy in others if results.agent(policy).raw]

    def better(policy: Policy, column: Sequence[str]) -> Entry:
        ours, theirs = (results.runs(column, p) for p in (policy, reference))
        return Entry("–") if ours is None or theirs is None else entry(probability_of_improvement(ours, theirs), 2)

    def gain(policy: Policy, column: Sequence[str]) -> Entry:
        return share_entry(difference(results, column, policy, reference, len(raw)), signed=True)

    title, text = f"Probability of improvement over {reference}", note("improvement", reference=reference)
    rows = [(str(policy), [better(policy, column) for column in columns]) for policy in others]
    blocks = tabled("improvement", title, text, heads, {"": rows}, "Agent")
    rows = [(str(policy), [gain(policy, column) for column in columns]) for policy in raw]
    text = note("without-filter", reference=reference)
    return [*blocks, *tabled("without-filter", "Learning without a filter", text, heads, {"": rows}, "Agent")]
