"""Fly what the tables of README.md and docs/ show, and write them anew: ``python -m scripts.tables``."""

import csv
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.statistics import crossed_interval
from scripts.console import Refusal, command, progress_bar, put

ROOT = Path(__file__).parents[1]
EPISODES = 100
WITHOUT = "–"


@dataclass(frozen=True)
class Way:
    """How the autopilot flies: on an estimator, in a world."""

    label: str
    estimator: str
    options: dict[str, Any] = field(default_factory=dict)
    world: dict[str, Any] = field(default_factory=dict)


class Flown(NamedTuple):
    """What `EPISODES` flights were like: figures by their key, the share of times in the chi-square band."""

    scores: dict[str, np.ndarray]
    arrived: int
    position_band: float | None
    band: float | None


PLAIN = {"localisation": None}
UNINFLATED = {"localisation": None, "inflation": 1.0}
MISMATCH, DEGRADED, ROUGH = {"mismatch": 0.2}, {"sensors": "degraded"}, {"disturbance": "rough"}
DIVES = (
    Way("`truth`", "truth"),
    Way("`enkf`, localised", "enkf"),
    Way("`enkf`, plain", "enkf", PLAIN),
    Way("`enkf-sr`, localised", "enkf-sr"),
    Way("`enkf-sr`, plain", "enkf-sr", PLAIN),
    *(Way(f"`{name}`", name) for name in ("ekf", "ukf", "huber-kf", "measurement", "dead-reckoning")),
)
FLIGHTS = (
    Way("`truth`", "truth"),
    Way("`enkf`, localised", "enkf"),
    Way("`enkf`, plain, inflation 1", "enkf", UNINFLATED),
    Way("`enkf`, plain, inflation 1.01", "enkf", PLAIN),
    Way("`enkf-sr`, localised", "enkf-sr"),
    Way("`enkf-sr`, plain, inflation 1", "enkf-sr", UNINFLATED),
    Way("`enkf-sr`, plain, inflation 1.01", "enkf-sr", PLAIN),
    *(Way(f"`{name}`", name) for name in ("ekf", "ukf", "huber-kf", "robust-kf", "measurement", "dead-reckoning")),
)


def elsewhere(default: str) -> tuple[Way, ...]:
    """Other members, models, sensors and seas, on an environment's default estimator and its rivals."""
    return (
        Way("default, 1,000 members, inflation 1", default, {"members": 1000, "inflation": 1.0}),
        Way("default, mismatch 0.1", default, world={"mismatch": 0.1}),
        Way("default, mismatch 0.2", default, world=MISMATCH),
        Way("`ekf`, mismatch 0.2", "ekf", world=MISMATCH),
        Way("`truth`, mismatch 0.2", "truth", world=MISMATCH),
        Way("default, degraded", default, world=DEGRADED),
        Way("`ekf`, degraded", "ekf", world=DEGRADED),
        Way("`huber-kf`, degraded", "huber-kf", world=DEGRADED),
        Way("default, rough", default, world=ROUGH),
        Way("`ekf`, rough", "ekf", world=ROUGH),
        Way("`truth`, rough", "truth", world=ROUGH),
    )


JOURNEYS = {
    "SegorogeniAUV-v0": (*DIVES, *elsewhere("enkf")),
    "ItsunusaAUV-v0": (*DIVES, *elsewhere("enkf-sr")),
    "PunaUAV-v0": (*FLIGHTS, *elsewhere("enkf")),
}
"""The ways of each environment's table."""
SHORT = {
    "SegorogeniAUV-v0": ("Segorogeni (`enkf`)", "`truth`", "`enkf`, localised", "`enkf`, plain"),
    "ItsunusaAUV-v0": ("ITSUNUSA (`enkf-sr`)", "`truth`", "`enkf-sr`, localised", "`enkf-sr`, plain"),
    "PunaUAV-v0": ("PUNA (`enkf`)", "`truth`", "`enkf`, localised", "`enkf`, plain, inflation 1"),
}
"""What the README calls each, and which of the ways it shows beside those that it shows of all."""
TOLD = {"calm": 2.2e-7, "moderate": 1.29e-5, "rough": 7.92e-5}
"""The variance of the corvette's unknown input in each sea."""


@cache
def flown(env_id: str, label: str) -> Flown:
    """Fly one of an environment's ways."""
    from agents import rollout
    from agents.metrics import components, consistency
    from agents.scores import scores
    from agents.seeds import evaluation_seeds

    way = next(way for way in JOURNEYS[env_id] if way.label == label)
    world = {"estimator": way.estimator, "estimator_options": way.options, **way.world}
    flight = rollout("autopilot", env_id, evaluation_seeds(EPISODES), world)
    position, of_all = (consistency(flight, where) for where in (components(flight, "x", "y", "z", "h"), None))
    return Flown(scores(flight), int((flight.end == "arrived").sum()), position, of_all)


def journeys(env_id: str) -> str:
    """What estimators are worth in a dive or a flight."""
    from agents.metrics import WITHOUT_COVARIANCE

    altitude = env_id == "PunaUAV-v0"
    heads = ("estimates", f"arrived of {EPISODES}", "off [m]", *(("altitude [m]",) if altitude else ()), "score",
             "position error [m]", "position NEES/n", "in band", "NEES/n, all", "in band")  # fmt: skip
    rows = []
    for way in JOURNEYS[env_id]:
        of = flown(env_id, way.label)
        off = "cross_track" if env_id != "ItsunusaAUV-v0" else "normal"
        sure = way.estimator not in WITHOUT_COVARIANCE
        rows.append((
            way.label, str(of.arrived), number(of.scores[off], 3),
            *((number(of.scores["altitude"], 2),) if altitude else ()), shown(of.scores["score"]),
            number(of.scores["position_rmse"], 3), number(of.scores["position_nees"], 2) if sure else WITHOUT,
            percent(of.position_band), number(of.scores["nees"], 2) if sure else WITHOUT, percent(of.band),
        ))  # fmt: skip
    return table(heads, rows)


def worth(plain: str, *env_ids: str) -> str:
    """Of these tables, what the README shows."""
    same = ("`ekf`", "`measurement`", "`dead-reckoning`")
    rows = []
    for env_id in env_ids:
        name, *labels = SHORT[env_id]
        found = [flown(env_id, label) for label in (*labels, *same)]
        rows.append((name, *(f"{shown(of.scores['score'])} ({of.arrived})" for of in found)))
    return table((f"Score (arrived of {EPISODES})", "`truth`", "default", plain, *same), rows)


def insurance() -> str:
    """The corvette's heading error with `kf`, told of a sea, over that with `kf-umv-ui`."""
    from agents import rollout
    from agents.scores import scores
    from agents.seeds import evaluation_seeds

    def error(sea: str, estimator: str, **options: Any) -> np.ndarray:
        world = {"estimator": estimator, "estimator_options": options, "disturbance": sea}
        return scores(rollout("autopilot", "SigmaCorvette-v0", evaluation_seeds(EPISODES), world))["heading_rmse"]

    ours = {sea: error(sea, "kf-umv-ui") for sea in TOLD}
    rows = []
    for told, variance in (*TOLD.items(), ("nothing", None)):
        cells = []
        for sea in TOLD:
            ratio = error(sea, "kf", **({} if variance is None else {"input_cov": variance})) / ours[sea]
            cells.append(f"**{shown(ratio)}**" if told == sea else shown(ratio))
        rows.append((told if variance is None else f"a {told} sea", *cells))
    return table(("`kf` is told of", *(f"{sea} sea" for sea in TOLD)), rows)


def ablation(results: Path) -> str:
    """Scores of the corvette's study, by its condition and agent."""
    with (results / "episodes.csv").open(encoding="utf-8") as file:
        episodes = list(csv.DictReader(file))
    scores: dict[tuple[str, ...], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for one in sorted(episodes, key=lambda one: int(one["seed"])):
        scores[one["condition"], one["agent"], one["estimator"]][one["training_seed"]].append(float(one["score"]))
    estimators = ("truth", "kf-umv-ui", "kf told d", "kf told less", "kf", "measurement", "dead-reckoning")
    rows = [
        (f"{sea}, {agent}",
         *(shown(np.array(list(scores[sea, agent, name].values()))) for name in estimators))
        for sea in ("moderate", "rough") for agent in ("autopilot", "PPO")
    ]  # fmt: skip
    return table(("Score", *estimators), rows)


def rows_of(page: Path) -> str:
    """The table alone of a report's page."""
    return "\n".join(line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("|"))


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """In Markdown."""
    return "\n".join("| " + " | ".join(line) + " |" for line in (heads, ["---"] * len(heads), *rows))


def shown(values: np.ndarray) -> str:
    """The mean ``(seeds,)`` or ``(runs, seeds)`` with its 95 % interval."""
    interval = crossed_interval(np.atleast_2d(values))
    return WITHOUT if interval is None else f"{interval.mean:.3f} ± {interval.half:.3f}"


def number(values: np.ndarray, decimals: int) -> str:
    """The mean over flights."""
    return f"{np.mean(values):.{decimals}f}"


def percent(share: float | None) -> str:
    """Of times; where there are none, that."""
    return WITHOUT if share is None else f"{100.0 * share:.0f} %"


README = ROOT / "README.md"
TABLES: dict[str, tuple[Path, Callable[[], str]]] = {
    "segorogeni": (ROOT / "docs/dives.md", lambda: journeys("SegorogeniAUV-v0")),
    "itsunusa": (ROOT / "docs/dives.md", lambda: journeys("ItsunusaAUV-v0")),
    "puna": (ROOT / "docs/flight.md", lambda: journeys("PunaUAV-v0")),
    "dives": (README, lambda: worth("plain ensemble", "SegorogeniAUV-v0", "ItsunusaAUV-v0")),
    "flights": (README, lambda: worth("plain ensemble, inflation 1", "PunaUAV-v0")),
    "insurance": (ROOT / "docs/estimators/unknown-input.md", insurance),
    "ablation": (README, lambda: ablation(ROOT / "results/ablation")),
    "shares": (README, lambda: rows_of(ROOT / "results/quick/tables/ranking.md")),
}
"""Where each table stands, and what makes it."""


def main(names: tuple[str, ...] = tuple(TABLES), /) -> None:
    """Write tables of README.md and docs/ anew: dives, flights and the price of insurance are flown, in ten minutes.

    Those of studies are taken from results/ablation and results/quick, where `make ablation` and
    `python -m scripts.ablate studies/quick.toml --out results/quick` leave them.

    Args:
        names: Which.
    """
    for name in names:
        if name not in TABLES:
            raise Refusal(f"there is no table {name!r}: known are {', '.join(TABLES)}")
    with progress_bar("tables", len(names)) as advance:
        for name in names:
            page, made = TABLES[name]
            put(page, f"table: {name}", made())
            advance()


if __name__ == "__main__":
    command(main)
