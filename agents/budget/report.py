"""The answer of a search: sentences, one table of suites, a chart and a page."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

import vessel_gym
from agents.budget.result import Budget
from agents.budget.search import OPEN
from agents.files import replacing
from agents.page import Block, listed, text, write_page
from agents.plotting import INK, PALETTE, save_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SKIPPED = "not simulated"
LIMITS = (
    "The fresh seeds were not used in the search, so it may have compared any number of suites. On"
    " them suites are tried in an order fixed before, the safest first, up to the first that is not"
    " confirmed. The probability that an answer falls short is at most 2.5 %.",
    "A suite that is better in no sensor than one that falls short was not simulated further. That"
    " it falls short, too, is an assumption: the claim that nothing cheaper suffices needs it, and"
    " the score of the answer does not.",
    "A disaster rarer than one in a few hundred episodes may occur in no simulation. No interval"
    " accounts for it.",
)


def conclusion(budget: Budget) -> list[str]:
    """The answer, the conclusion first."""
    share = f"{100 * budget.keep:g} % of the reference score (truth: perfect state knowledge)"
    suite, number, noun = budget.suites[budget.nearest], len(budget.suites), "All suites"
    if budget.answer is None:
        reached = text(budget.shares.get(budget.nearest))
        found = [
            f"No suite is confirmed to reach {share}.",
            f"The nearest ({suite}) reaches {reached} of it in the search.",
        ]
    else:
        number, noun = sum(o.cost < suite.cost for o in budget.suites), "Cheaper suites"
        reached = text(budget.confirmed[budget.answer])
        found = [
            f"The cheapest suite confirmed to reach {share}: {suite}.",
            f"Its price is {suite.cost[0]:g}, and on {budget.episodes} fresh seeds it reaches"
            f" {reached} of the reference score.",
        ]
    verdicts = Counter(budget.verdicts.get(i, SKIPPED) for i in range(number))
    counts = [f"{verdict} ({count})" for verdict, count in verdicts.items()]
    return [*found, f"{noun}: {listed(counts)}." if counts else "No suite is cheaper."]


def assumption(budget: Budget) -> str:
    """A sentence on the pairs of suites in which the one with better sensors scores less."""
    number, found = len(budget.pairs()), budget.contradictions()
    start = "The search assumes that better sensors never score less."
    if not found:
        return f"{start} None of the {number} pairs of suites that test it contradicts it."
    (worse, better), gap = max(found.items(), key=lambda item: item[1].low)
    return (
        f"{start} This fails in {len(found)} of {number} pairs, most of all here:"
        f" {budget.suites[worse]} scores {text(gap)} more than {budget.suites[better]}. So a"
        " cheaper suite that was not simulated may suffice."
    )


def legend(budget: Budget) -> str:
    """Sentences on the intervals and verdicts of the tables."""
    return (
        "Relative score: the mean score divided by the reference score, with its 95 % interval."
        f" Suffices: the whole interval in the search is at least {budget.keep:g}. Falls short: the"
        " whole interval is below it. Undecided: the interval contains it, and about so many more"
        " episodes would decide. Confirmed: the whole interval on fresh seeds is at least"
        f" {budget.keep:g}. Not confirmed: that interval begins below it. Refused: the environment"
        " cannot run the estimator on these sensors. Not simulated: better in no sensor than a"
        " suite that falls short, or as expensive as one that already suffices."
    )


def suites_table(budget: Budget, most: int | None = None) -> pd.DataFrame:
    """Price, relative scores with intervals and verdict of suites simulated, the cheapest first.

    They are all, or so many whose places are nearest to that of the answer.
    """
    nearest = sorted(budget.verdicts, key=lambda i: abs(i - budget.nearest))[:most]
    rows = [
        {
            "suite": str(budget.suites[i]),
            "price": f"{budget.suites[i].cost[0]:g}",
            "search": text(budget.shares.get(i)),
            "fresh seeds": text(budget.confirmed.get(i)),
            "verdict": _verdict(budget, i),
        }
        for i in sorted(nearest)
    ]
    return pd.DataFrame(rows).set_index("suite")


def _verdict(budget: Budget, suite: int) -> str:
    word = budget.verdicts[suite]
    if word != OPEN:
        return word
    more = budget.episodes_to_decide(suite)
    return f"{word} (about {more:.2g} more episodes)" if more < 1e6 else f"{word} (at the limit)"


def frontier(budget: Budget) -> list[int]:
    """Suites that score more than every cheaper one in the search, the cheapest first."""
    found: list[int] = []
    for i in sorted(budget.shares):
        if not found or budget.shares[i].mean > budget.shares[found[-1]].mean:
            found.append(i)
    return found


def prices_figure(budget: Budget) -> "Figure":
    """Relative score of each suite simulated over its price, with the frontier and the answer."""
    from matplotlib.figure import Figure

    with styled():
        figure = Figure(figsize=(7.2, 3.6), layout="constrained")
        axes = figure.subplots()
        price = [suite.cost[0] for suite in budget.suites]
        for i, share in budget.shares.items():
            ends = [[share.mean - share.low], [share.high - share.mean]]
            axes.errorbar(price[i], share.mean, ends, fmt="o", color="#8a8f96", markersize=3)
        best = frontier(budget)
        heights = [budget.shares[i].mean for i in best]
        axes.step([price[i] for i in best], heights, color=PALETTE[0], where="post",
                  label="frontier: the most for a price")  # fmt: skip
        axes.axhline(budget.keep, color=INK, linestyle="--", linewidth=0.8, label="asked for")
        if budget.answer is not None:
            height = budget.confirmed[budget.answer].mean
            axes.plot(price[budget.answer], height, "D", color=PALETTE[1], label="answer")
        axes.set(xlabel="price", ylabel="relative score")
        axes.grid(axis="y")
        axes.legend(loc="lower right")
    return figure


def write_report(budget: Budget, notes: list[str]) -> Path:
    """Write ``budget.html``, ``budget.svg`` and ``results.parquet``, each whole or not at all.

    Args:
        budget: After its run.
        notes: Sentences about its prices and grades.

    Returns:
        The page.

    Raises:
        OSError: if a file cannot be written.
        ModuleNotFoundError: without Matplotlib, Jinja or PyArrow.
    """
    folder, study = budget.folder, budget.study
    with replacing(folder / "results.parquet") as path:
        every = pd.concat(budget.tables, ignore_index=True).drop_duplicates()
        every[["condition", "estimator", "seed", "end", "score"]].to_parquet(path, index=False)
    figure = prices_figure(budget)
    save_figure(figure, folder / "budget.svg")
    arms = (*study.environments, study.estimators[0].name, study.agents[0].name)
    subtitle = f"vessel-gym {vessel_gym.__version__}: {', '.join(arms)}"
    return write_page(folder / "budget.html", study.title, subtitle, conclusion(budget), [
        Block(
            "Price and score",
            figures={"Price and score": figure},
            note="Suites simulated in the search, with simultaneous 95 % intervals; the answer has"
            " its score on fresh seeds.",
        ),
        Block(
            "Suites simulated, the cheapest first",
            suites_table(budget),
            f"{legend(budget)} Intervals of the search hold for all suites and looks at once, those"
            " on fresh seeds for one suite.",
        ),
        Block("The guarantee, and its limits", items=[*LIMITS, assumption(budget), *notes]),
        Block("Refused suites", items=sorted(budget.refusals) or ["None."]),
    ])  # fmt: skip
