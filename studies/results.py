"""Tables of docs/ from the episodes of studies, and what would overturn them.

They are read from ``results/STUDY``, where ``vessel-gym ablate`` leaves them.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from math import comb
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd

from agents.controllers import make_controller
from agents.page import mean_and_half, text
from agents.refusal import Refusal
from agents.statistics import Interval, crossed_interval, paired_difference
from agents.studies.records import FLOOR, ORACLE
from agents.studies.worlds import system_of
from estimators import compiled
from studies.comparisons import CORVETTE, SETTINGS, arm_metrics
from studies.markdown import NONE, ROOT, table
from vessel_gym.envs import register_environment
from vessel_gym.tasks.circle_track import CircleTrack

HELD, PLAIN, INFORMED = "measurement", "ekf", "ekf-waves"
SUITE = "nominal", "budget", "denied"
PUBLISHED = "ThesisCorvette-v0"
"""A published experiment and no control task."""
MARGIN = 0.05
"""Difference of scores above which cells are bold."""
ALIKE = 5
"""Thousandths of the score by which estimators that share a row differ at most."""


@cache
def read_study(study: str) -> pd.DataFrame:
    """Episodes of a study, those on dead reckoning last."""
    found = pd.read_parquet(ROOT / "results" / study / "results.parquet")
    return found.sort_values("estimator", key=lambda of: of == FLOOR, kind="stable")


def episodes(
    study: str, environment: str, agent: str = "autopilot", key: str = "score"
) -> dict[tuple[str, str], np.ndarray]:
    """A metric ``(runs, seeds)`` by condition and estimator.

    Raises:
        Refusal: if the agent flew nothing there.
    """
    of = read_study(study)
    named = of.policy.str.partition(" trained on ")[0] == agent
    of = of[(of.environment == environment) & named]
    if of.empty:
        raise Refusal(f"{agent} flew nothing in {environment} of results/{study}")
    found: Any = of.groupby(["condition", "estimator"], sort=False)
    return {at: each.pivot(index="run", columns="seed", values=key).to_numpy()
            for at, each in found}  # fmt: skip


class Column(NamedTuple):
    """Scores ``(seeds,)`` in an environment and a condition by estimator.

    ``comparisons`` is the number of pairs of estimators in all columns of the environment.
    """

    environment: str
    condition: str
    scores: dict[str, np.ndarray]
    comparisons: int = 1

    def gap(self, one: str, other: str) -> Interval | None:
        """Paired difference of scores; 95 % hold for all pairs of the environment."""
        if one == other or not {one, other} <= set(self.scores):
            return None
        pair = self.scores[one], self.scores[other]
        return paired_difference(*pair, comparisons=self.comparisons)

    def best(self) -> str:
        """The filter with the highest mean score."""
        filters = [name for name in self.scores if name not in (ORACLE, FLOOR, HELD)]
        return max(filters, key=lambda name: self.scores[name].mean())


def columns(study: str) -> Iterator[Column]:
    """Columns of the autopilot, by environment and condition."""
    for environment in read_study(study).environment.unique():
        each: dict[str, dict[str, np.ndarray]] = {}
        for (condition, name), (scores,) in episodes(study, environment).items():
            each.setdefault(condition, {})[name] = scores
        pairs = sum(comb(len(scores), 2) for scores in each.values())
        yield from (Column(environment, at, scores, pairs) for at, scores in each.items())


def by_suite(study: str, environment: str, sea: str = "", agent: str = "autopilot") -> str:
    """Score and steering travel of estimators in a sea with each suite, by the score in the first.

    95 % hold for all scores at once. Estimators whose scores are alike in every suite share a row,
    with the numbers of the first.
    """
    score, travel = (
        episodes(study, environment, agent, key) for key in ("score", "steering_travel")
    )
    places = [f"{sea}, {suite}" if sea else suite for suite in SUITE]
    names = dict.fromkeys(name for place, name in score if place in places)

    def cell(*at: Any) -> str:
        of = crossed_interval(score[at], len(names) * len(places))
        return f"{text(of)}; {np.nanmean(travel[at]):.0f}"

    means = {name: np.rint([1e3 * score[place, name].mean() for place in places]) for name in names}
    labels: dict[str, list[str]] = {}
    for name, of in means.items():
        near = (first for first in labels if np.abs(means[first] - of).max() <= ALIKE)
        labels.setdefault(next(near, name), []).append(f"`{name}`")
    rows = [(", ".join(labels[first]), *(cell(place, first) for place in places))
            for first in sorted(labels, key=lambda name: -means[name][0])]  # fmt: skip
    return table(("Score; steering travel [°/min]", *SUITE), rows)


def differences(study: str) -> str:
    """The best filter of each column of a control task against its rivals and the truth."""
    rows = []
    for at in columns(study):
        if at.environment == PUBLISHED:
            continue
        best, default = at.best(), system_of(at.environment).estimator
        pairs = (best, HELD), (best, default), (ORACLE, best)
        gaps = [at.gap(*pair) for pair in pairs]
        bold = ["**" if gap and gap.low > MARGIN else "" for gap in gaps]
        cells = (f"{star}{text(gap)}{star}" for gap, star in zip(gaps, bold, strict=True))
        rows.append((f"{at.environment}, {at.condition}", f"`{best}`", *cells))
    heads = "", "best filter", "best − `measurement`", "best − default", "`truth` − best"
    return table(heads, rows)


def wild_and_wrong(study: str) -> str:
    """Differences of scores with wild measurements and with wrong models."""
    best = normalised(study).splitlines()[2].split("|")[1].strip()
    worlds = "PunaUAV-v0", "ItsunusaAUV-v0", "SegorogeniAUV-v0"
    pairs = [(world, "bad sensors", "huber-kf", PLAIN) for world in worlds]
    pairs += [(worlds[0], f"model {share} % off", ORACLE, best) for share in (10, 20)]
    rows = []
    for world, condition, one, other in pairs:
        of = episodes(study, world)
        gap = mean_and_half(of[condition, one] - of[condition, other])
        rows.append((f"{world}, {condition}", f"`{one}` − `{other}`", gap))
    return table(("", "scores", "difference"), rows)


def latency(study: str) -> str:
    """Score, position error and its NEES with fixes 2 s late, by what is done with them."""
    ways = {"fused": "", "as new": ", as new", "discarded": ", discarded"}
    places = [("in time", "ekf"), *(("2 s late", "ekf" + way) for way in ways.values())]
    rows = []
    for world in read_study(study).environment.unique():
        score, error, nees = (
            episodes(study, world, key=key) for key in ("score", "position_rmse", "position_nees")
        )
        cells = (
            f"{mean_and_half(score[at])}; {error[at].mean():.2f}; {nees[at].mean():.2f}"
            for at in places
        )
        rows.append((world.removesuffix("-v0"), *cells))
    return table(("environment", "without latency", *ways), rows)


def normalised(study: str) -> str:
    """The ranking of a study in all its conditions, from its report."""
    page = (ROOT / "results" / study / "ranking.md").read_text(encoding="utf-8")
    ranked = page.partition("## All conditions\n\n")[2].strip().splitlines()
    return "\n".join(line for line in ranked if f" {NONE} " not in line)


# --- what would overturn them ---------------------------------------------------------------------


def variation(
    condition: str, sea: str = "moderate", scaled: Mapping[str, float] | None = None,
    Q: float = 1.0, controller: Mapping[str, float] | None = None, **changes: Any,
) -> Column:  # fmt: skip
    """Scores of the corvette with constants of the score ``scaled`` by factors, or another world.

    The filter that assumes waves assumes those of the ``sea``. Filters assume ``Q`` times their
    process noise, and the autopilot has the parameters ``controller``.
    """
    constants = {name: of * getattr(CircleTrack, name) for name, of in (scaled or {}).items()}
    task: Any = compiled(type("Scored", (CircleTrack,), constants))
    corvette, name = system_of(CORVETTE), f"Scored{len(gym.registry)}-v0"
    system = replace(corvette, name=name, task=task(corvette.vehicle.ship))
    env_id = register_environment(system)
    if controller:
        changes["agent"] = make_controller("autopilot", system, **controller)
    own = {
        "plain": {"assume": {"Q": Q}},
        "nonlinear": {"model": "nonlinear", "assume": {"Q": Q}},
        "with waves": {"assume": {"disturbance": sea, "as": "states", "Q": Q}},
    }
    changes["variants"] = {name: {"estimator_options": options} for name, options in own.items()}
    changes["variants"][""] = {}
    arms = {
        "kf-umv-ui": "kf-umv-ui, plain", PLAIN: "ekf, plain", INFORMED: "ekf, with waves",
        "huber-kf": "huber-kf, nonlinear", HELD: HELD,
    }  # fmt: skip
    scores = {name: arm_metrics(arm, env_id, **changes)["score"] for name, arm in arms.items()}
    return Column("", condition, scores)


def overturn() -> str:
    """The worlds in which differences of scores keep their sign, change it, or are undecided."""
    first, *others = [variation(name, **changes) for name, changes in SETTINGS["overturn"].items()]
    rows = []
    for name, other in (
        ("", HELD),
        ("kf-umv-ui", PLAIN),
        (INFORMED, "kf-umv-ui"),
        ("huber-kf", PLAIN),
    ):
        worlds: dict[bool | None, list[str]] = {True: [], False: [], None: []}
        usual: Any = first.gap(name or first.best(), other)
        for at in others:
            gap: Any = at.gap(name or at.best(), other)
            same = gap.mean * usual.mean > 0.0 if gap.excludes_zero else None
            worlds[same].append(at.condition)
        pair = f"`{name}` − `{other}`" if name else f"best filter − `{other}`"
        held, *names = worlds.values()
        cells = ("; ".join(of) or NONE for of in names)
        rows.append((pair, text(usual), f"{len(held)} of {len(others)}", *cells))
    heads = "scores", "in the studies", "same sign in", "opposite sign", "undecided"
    return table(heads, rows)
