"""The answer of a search: sentences, one table of suites, and a page."""

from collections import Counter
from pathlib import Path

import pandas as pd

import vessel_gym
from agents.budget.result import Budget
from agents.budget.suites import MOST
from agents.files import replacing
from agents.page import bullets, many, table, text, words, write_page
from agents.studies.answer import markdown_frame

LIMITS = (
    "The fresh seeds were not used in the search, so it may have compared any number of suites. On"
    " them suites are tried in an order fixed before, the safest first, up to the first that is not"
    " confirmed. An answer that keeps less than was asked for has a probability of at most 2.5 %.",
    "A suite that is no better in any sensor than one that keeps less was not flown. That it keeps"
    " less, too, is an assumption: the claim that nothing cheaper will do needs it, and the"
    " answer's share does not.",
    "A disaster rarer than one episode in a few hundred may occur in no flight, and is then in no"
    " interval.",
)


def conclusion(budget: Budget) -> list[str]:
    """The answer, the conclusion first."""
    share = f"{100 * budget.keep:g} % of the score on the truth"
    suite, number, noun = budget.suites[budget.nearest], len(budget.suites), "suite"
    if budget.answer is None:
        kept = words(budget.shares.get(budget.nearest), 3)
        found = [
            f"No suite is confirmed to keep {share}.",
            f"The nearest, {suite}, keeps {kept} in the search.",
        ]
    else:
        number, noun = sum(other.cost < suite.cost for other in budget.suites), "cheaper suite"
        kept = words(budget.confirmed[budget.answer], 3)
        found = [
            f"The cheapest suite that is confirmed to keep {share}: {suite}.",
            f"Its price is {suite.cost[0]:g}, and it keeps {kept} on {budget.episodes} fresh"
            " seeds.",
        ]
    verdicts = Counter(budget.verdicts.get(i, "not flown") for i in range(number))
    counts = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
    return [*found, f"Of {many(number, noun)}: {counts}." if counts else "No suite is cheaper."]


def suites_table(budget: Budget, most: int = MOST) -> pd.DataFrame:
    """Suites that were flown, the cheapest first: price, shares with their intervals, verdict.

    If there are too many, those are left out whose prices are far from that of the answer.
    """
    near = sorted(budget.verdicts, key=lambda i: abs(i - budget.nearest))[:most]
    rows = {
        str(budget.suites[i]): {
            "price": f"{budget.suites[i].cost[0]:g}",
            "search": text(budget.shares.get(i), 3),
            "fresh seeds": text(budget.confirmed.get(i), 3),
            "verdict": budget.verdicts[i],
        }
        for i in sorted(near)
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("suite")


def write_report(budget: Budget, notes: list[str]) -> Path:
    """Write ``budget.html``, ``budget.md`` and ``results.parquet``, each whole or not at all.

    Args:
        budget: After its run.
        notes: Sentences about its prices.

    Returns:
        The page.

    Raises:
        OSError: if a file cannot be written.
        ModuleNotFoundError: without Jinja or PyArrow.
    """
    folder, study, suites = budget.folder, budget.study, suites_table(budget)
    with replacing(folder / "results.parquet") as path:
        flown = pd.concat(budget.tables, ignore_index=True).drop_duplicates()
        flown[["condition", "estimator", "seed", "end", "score"]].to_parquet(path, index=False)
    with replacing(folder / "budget.md") as path:
        blocks = f"# {study.title}", *conclusion(budget), markdown_frame(suites)
        path.write_text("\n\n".join(blocks) + "\n", encoding="utf-8")
    arms = (*study.environments, study.estimators[0].name, study.agents[0].name)
    subtitle = f"vessel-gym {vessel_gym.__version__}: {', '.join(arms)}"
    return write_page(folder / "budget.html", study.title, subtitle, conclusion(budget), [
        table(
            "Suites that were flown, the cheapest first",
            suites,
            "Share of the score on the truth with 95 % intervals: in the search for all suites and"
            " looks at once, on fresh seeds for one suite.",
        ),
        bullets("The guarantee, and its limits", [*LIMITS, *notes]),
        bullets("Refused suites", sorted(budget.refusals) or ["None."]),
    ])  # fmt: skip
