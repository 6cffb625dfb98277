"""The answer of a search as sentences, tables, a picture and a page."""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import vessel_gym
from agents.budget.result import Budget
from agents.budget.search import FAILS, REFUSED
from agents.budget.suites import Choice, Suite
from agents.files import replacing
from agents.page import (
    Bullets,
    Entry,
    Facts,
    Figure,
    Page,
    Section,
    Table,
    csv_text,
    entry,
    many,
    paragraphs,
    write,
)
from agents.plotting import INK, data_uri, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

ROWS = 8
"""The most rows of the table in the console and on the page; the CSV file has all."""
CONFIRMED, NOT_CONFIRMED, NOT_FLOWN = "confirmed", "not confirmed", "not flown"


def conclusion(budget: Budget) -> list[str]:
    """The answer, the conclusion first."""
    verdicts = [budget.search.verdicts.get(i) for i in budget.cheaper]
    surprises = [f'"{budget.suites[i]}"' for i in budget.surprises]
    counted = {"verdicts": verdicts, "fails": FAILS, "refused": REFUSED, "surprises": surprises}
    heading = "not-confirmed" if budget.answer is None else "confirmed"
    return [*_notes(heading, budget), *_notes("flown", budget, **counted)]


def guarantees(budget: Budget, priced: bool) -> list[str]:
    """The assumptions behind the answer, and the probabilities of its errors."""
    return _notes("guarantees", budget, priced=priced)


def _notes(name: str, budget: Budget, **values: Any) -> list[str]:
    return paragraphs("budget-notes.md", name, budget=budget, **values)


def verdict(budget: Budget, suite: int) -> str:
    """Verdict on a suite, that on the fresh seeds if it was flown there."""
    if suite in budget.confirmed:
        return CONFIRMED if budget.confirmed[suite].low >= budget.keep else NOT_CONFIRMED
    return budget.around.verdicts.get(suite, NOT_FLOWN)


def summary(budget: Budget) -> Table:
    """The answer, what else was confirmed or may do, and the suites with one sensor worse, in up to `ROWS` rows."""
    centre = budget.centre
    chosen = dict.fromkeys(
        [centre, *reversed(budget.confirmed), *budget.neighbours(centre), *budget.undecided]
    )
    rows = []
    for suite in list(chosen)[:ROWS]:
        fresh = budget.confirmed.get(suite)
        entries = [
            Entry(f"{budget.suites[suite].price:g}"),
            entry(budget.around.shares.get(suite), 3),
            entry(fresh, 3),
            Entry(verdict(budget, suite), strong=suite == budget.answer),
        ]
        rows.append((_named(budget, suite), entries))
    (note,) = _notes("summary", budget)
    head = [("Price", ""), ("Search", ""), ("Fresh seeds", ""), ("Verdict", "")]
    return Table("Suites round the answer", note, "Suite", head, [("", rows)])


def _named(budget: Budget, suite: int) -> str:
    """A suite by the sensors that differ from the one in the middle."""
    if suite == budget.centre:
        return "the answer" if budget.answer is not None else "the nearest"
    there = budget.suites[budget.centre].choices
    changed = [
        f"{sensor} {choice}"
        for sensor, choice in budget.suites[suite].choices.items()
        if choice != there[sensor]
    ]
    return ", ".join(changed)


def suites_csv(budget: Budget) -> str:
    """Every suite: its grades and price, episodes, shares with their intervals, and verdict."""
    numbers = ["episodes", "share", "low", "high", "fresh_share", "fresh_low", "fresh_high"]
    rows: list[list[Any]] = [[*budget.suites[0].choices, "price", *numbers, "verdict"]]
    for i, suite in enumerate(budget.suites):
        cells: list[Any] = [
            *map(str, suite.choices.values()),
            f"{suite.price:g}",
            len(budget.around.scores.get(i, ())),
        ]
        for share in (budget.around.shares.get(i), budget.confirmed.get(i)):
            cells += (
                [""] * 3
                if share is None
                else [f"{x:.6f}" for x in (share.mean, share.low, share.high)]
            )
        rows.append([*cells, verdict(budget, i)])
    return csv_text(rows)


# --- picture --------------------------------------------------------------------------------------


def picture(budget: Budget) -> "Drawing":
    """Share kept over the grades of each two sensors, the others as in the answer; a line parts it from failure."""
    from matplotlib.figure import Figure as Drawing

    sensors = budget.sensors(budget.centre)
    pairs = list(combinations(sensors, 2)) or [(sensors[0], sensors[0])]
    with styled():
        drawing = Drawing(figsize=(7.2, 0.9 + 2.3 * len(pairs)), layout="constrained")
        panels = drawing.subplots(len(pairs), 1, squeeze=False)[:, 0]
        for panel, (one, other) in zip(panels, pairs, strict=True):
            image = _panel(budget, panel, one, other)
        bar = drawing.colorbar(
            image, ax=list(panels), label="Share kept of the score on the truth", aspect=40
        )
        bar.ax.axhline(budget.keep, color=INK, linewidth=2.0)
    return drawing


def _panel(budget: Budget, panel: "Axes", one: str, other: str) -> Any:
    """Shares over the grades of two sensors, the first to the right; both worse to the right and downwards."""
    centre = budget.suites[budget.centre]
    across, down = (_choices(budget, sensor) for sensor in (one, other))
    if one == other:
        down = [centre.choices[one]]
    numbers = {_key(suite): i for i, suite in enumerate(budget.suites)}
    cells = np.array([
        [numbers[_key(centre, {one: right} | ({} if one == other else {other: below}))] for right in across]
        for below in down
    ])  # fmt: skip
    shares = np.array(
        [
            [getattr(budget.around.shares.get(i), "mean", np.nan) for i in row]
            for row in cells.tolist()
        ]
    )
    image = panel.imshow(
        shares,
        cmap="cividis",
        vmin=min(budget.keep - 0.2, 0.75),
        vmax=1.0,
        aspect="auto",
        alpha=0.75,
    )
    for (y, x), share in np.ndenumerate(shares):
        text = "–" if np.isnan(share) else f"{share:.3f}"
        weight = "bold" if cells[y, x] == budget.answer else "normal"
        panel.text(x, y, text, ha="center", va="center", fontsize=9, weight=weight, bbox={
            "facecolor": "white", "alpha": 0.75, "linewidth": 1.2 if weight == "bold" else 0.0, "pad": 2.0,
        })  # fmt: skip
    _line(panel, shares >= budget.keep)
    panel.set_xticks(range(len(across)), [str(choice) for choice in across], fontsize=8)
    panel.set_yticks(range(len(down)), [str(choice) for choice in down], fontsize=8)
    panel.set_xlabel(one)
    panel.set_ylabel("" if one == other else other)
    rest = [
        f"{sensor} {choice}"
        for sensor, choice in centre.choices.items()
        if sensor not in (one, other)
    ]
    panel.set_title(", ".join(rest), loc="left", fontsize=8.5)
    return image


def _line(panel: "Axes", keeps: np.ndarray) -> None:
    """Line between the cells that keep the share and the others."""
    rows, columns = keeps.shape
    for y in range(rows):
        for x in range(columns):
            if x + 1 < columns and keeps[y, x] != keeps[y, x + 1]:
                panel.plot([x + 0.5, x + 0.5], [y - 0.5, y + 0.5], color=INK, linewidth=2.4)
            if y + 1 < rows and keeps[y, x] != keeps[y + 1, x]:
                panel.plot([x - 0.5, x + 0.5], [y + 0.5, y + 0.5], color=INK, linewidth=2.4)


def _choices(budget: Budget, sensor: str) -> list[Choice]:
    return [budget.suites[i].choices[sensor] for i in budget.line(budget.centre, sensor)]


def _key(suite: Suite, changed: dict[str, Choice] | None = None) -> tuple[Choice, ...]:
    return tuple((dict(suite.choices) | (changed or {})).values())


# --- page -----------------------------------------------------------------------------------------


def page(budget: Budget, priced: bool) -> Page:
    """The report of a search as data."""
    world = budget.world
    (caption,) = _notes("picture", budget)
    image = Figure(data_uri(picture(budget)), "Share kept over the grades of two sensors", caption)
    facts = Facts(
        "Flown",
        [
            ("environment", world.environment),
            ("estimator", world.estimator or "the environment's default"),
            ("agent", world.agent),
            ("disturbance", world.disturbance),
            ("share asked for", f"{budget.keep:g}"),
            ("episodes of a suite, at most", str(budget.search.episodes)),
        ],
    )
    refusals: Sequence[str] = sorted(set(budget.refusals.values()))
    sections = [
        Section("Shares round the answer", [image, summary(budget)]),
        Section("The guarantee, and its limits", [Bullets(guarantees(budget, priced))]),
        *([Section("Refused suites", [Bullets(list(refusals))])] if refusals else []),
        Section("Settings", [facts]),
    ]
    title = f"The cheapest sensors that keep {100 * budget.keep:g} %"
    subtitle = (
        f"vessel-gym {vessel_gym.__version__}: {world.environment},"
        f" {many(len(budget.suites), 'suite')}"
    )
    return Page(title, subtitle, conclusion(budget), sections)


def write_report(budget: Budget, out: Path, priced: bool) -> Path:
    """Write ``budget.html``, ``budget.csv`` and ``budget.png``, each whole or not at all; returns the page.

    Raises:
        OSError: if a file cannot be written.
        ModuleNotFoundError: without Matplotlib or Jinja.
    """
    with replacing(out / "budget.csv") as path:
        path.write_text(suites_csv(budget), encoding="utf-8")
    with replacing(out / "budget.png") as path, styled():
        picture(budget).savefig(path, dpi=150)
    return write(page(budget, priced), out / "budget.html")
