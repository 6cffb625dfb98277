"""One episode with several estimators: simulated, and packed into a page."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np

from agents.episodes.page import Episode, drawn, packed
from agents.metrics import metrics, scores
from agents.page import listed, number
from agents.rollouts import Rollout, batch, rollout
from agents.seeds import evaluation_seeds
from agents.wrapped import core_of
from estimators.checks import short_repr
from estimators.linalg import semidefinite_cholesky
from vessel_gym import checks
from vessel_gym.rendering.scene import Chart, Scene, Series, ambients, waves_of

TYPICAL = 40
"""Episodes of which the most typical one is shown where no seed is asked for."""
CLOUDS, MEMBERS = 300, 40
"""Moments at which an ensemble is kept at most, and how many of its members."""
_BATCH = 8  # episodes of which the first is shown: one alone would need programs of its own
CHARTS = 6
"""Charts of a page at most."""


def episode(
    env_id: str = "SigmaCorvette-v0",
    estimators: Sequence[Any] | None = None,
    agent: Any = "autopilot",
    seed: int | None = 0,
    env_options: dict[str, Any] | None = None,
) -> Episode:
    """Run one episode with each estimator, at equal starts, waves, noise and lost measurements.

    Args:
        env_id: A registered environment of this package, or your own.
        estimators: Estimators in the order in which the result shows them: names, or filters of
            your own. None: the environment's estimator, and the truth.
        agent: An agent as for `rollout`; it is reset for each estimator.
        seed: Seed of the episode. None: of 40 evaluation episodes, the one whose scores lie nearest
            to the means; in an environment of another package, 0.
        env_options: Passed to the environment.

    Raises:
        ValueError: if there is no such environment or estimator, or the agent cannot act there.
        TypeError: for arguments of another kind.
    """
    options = checks.options("env_options", env_options)
    first = options.pop("estimator", None)
    plain = {name: each for name, each in options.items() if name != "estimator_options"}
    with closing(batch(env_id, 1, plain)) as env:
        default, ours = core_of(env).config.estimation.filter.name, hasattr(env.unwrapped, "core")
    if not default:
        raise ValueError(
            f"{env_id!r} has no estimator in the loop: wrap it in"
            " vessel_gym.wrappers.EstimatedObservation"
        )

    def chosen(estimator: Any) -> dict[str, Any]:
        return options if estimator == default else {**options, "estimator": estimator}

    if estimators is None:
        own = first or default
        worlds = {_name(own): chosen(own), "truth": plain | {"estimator": "truth"}}
    elif isinstance(estimators, str) or not isinstance(estimators, Sequence) or not estimators:
        raise TypeError(f"estimators must be a list of one or more, got {short_repr(estimators)}")
    else:
        worlds = {_name(each): chosen(each) for each in estimators}
        if len(worlds) < len(estimators):
            names = ", ".join(map(_name, estimators))
            raise ValueError(f"each estimator is shown once, got {names}")
    if seed is None and not ours:
        seed = 0
    seeds = evaluation_seeds(TYPICAL) if seed is None else [seed]
    return Episode(typical_page(agent, env_id, worlds, seeds))


def typical_seed(scores: np.ndarray, seeds: Sequence[int]) -> int:
    """The seed whose scores lie nearest to their means over all seeds.

    Distances are in standard deviations and summed in squares.

    Args:
        scores: ``(estimators, seeds)``.
        seeds: Of the columns.
    """
    spread = np.maximum(scores.std(1, keepdims=True), np.finfo(float).tiny)
    return seeds[int(np.square((scores - scores.mean(1, keepdims=True)) / spread).sum(0).argmin())]


def typical_page(
    agent: Any,
    env_id: str,
    worlds: Mapping[str, dict[str, Any]],
    seeds: Sequence[int],
) -> dict[str, Any]:
    """Data of the page of the `typical_seed`.

    Args:
        agent: An agent as for `rollout`; it is reset for each estimator.
        env_id: A registered environment.
        worlds: Options of the environment by name of the estimator.
        seeds: Of which the typical one is shown.
    """

    def fly(seeds: Sequence[int], record: bool) -> list[Rollout]:
        return [
            rollout(agent, env_id, seeds, each, None, record, ensembles=record)
            for each in worlds.values()
        ]

    if len(seeds) > 1:
        typical = typical_seed(np.array([each.score for each in fly(seeds, False)]), seeds)
        seeds = [typical, *seeds][:_BATCH]
    return page_of(fly(seeds, True), list(worlds))


def _name(estimator: Any) -> str:
    """Name of an estimator; of a user's own, its ``name`` or ``__name__``."""
    own = getattr(estimator, "name", estimator)
    return own if isinstance(own, str) else getattr(estimator, "__name__", "own")


def page_of(flown: Sequence[Rollout], names: Sequence[str]) -> dict[str, Any]:
    """Data of a page of the first seed of rollouts on estimators of these names.

    An environment of others has no map; its page holds charts of truth and estimate.
    """
    first, system = flown[0], flown[0].config.system
    ours, dt = hasattr(first.env.unwrapped, "core"), system.vehicle.dt
    histories = [
        {key: values[: each.length[0] + 1, 0] for key, values in each.history.items()}
        for each in flown
    ]
    episodes = list(zip(flown, names, histories, strict=True))
    page: dict[str, Any] = {
        "title": f"{system.name}: one episode on {listed(names)}",
        "name": system.name,
        "environment": first.env_id,
        "conditions": [f"seed {first.seeds[0]}"],
        "dt": dt,
        "unit": "s" if ours or dt != 1.0 else "steps",
    }
    if not ours:
        without = {"placed": False, "located": False, "focus": [], "scene": None, "waves": None}
        flights = [
            _figures(each, name) | {"charts": packed(_estimates(history))}
            for each, name, history in episodes
        ]
        return page | without | {"flights": flights}
    around = system.task.workspace(first.scenario[0])
    scenes = [Scene(each.core, around, history) for each, _, history in episodes]
    position = scenes[0].position
    return page | {
        "conditions": [*scenes[0].conditions, *page["conditions"]],
        "placed": bool({"x", "y", "z", "h"} & set(system.vehicle.state_names)),
        "located": scenes[0].located,
        "focus": [
            {"name": name, "unit": unit, "axis": axis}
            for (name, unit, _), axis in zip(position.words, position.axes.tolist(), strict=True)
        ],
        "scene": drawn(scenes),
        "waves": packed(waves_of(first.core, first.constants[0])),
        "flights": [_flight(*each) for each in zip(flown, names, scenes, strict=True)],
    }


def _estimates(history: dict[str, np.ndarray]) -> list[Chart]:
    """Charts of the first components of truth and estimate, from an environment of others."""
    charts = []
    for i, line in enumerate(history["estimate"].T[:CHARTS]):
        sd = np.sqrt(np.maximum(history["covariance"][:, i, i], 0.0))
        true = Series("true", "true_soft", history["truth"][:, i])
        series = [true, Series("estimate ±2σ", "believed", line)]
        charts.append(Chart(f"Component {i}", series, (line - 2.0 * sd, line + 2.0 * sd)))
    return charts


def _figures(flown: Rollout, name: str) -> dict[str, Any]:
    """Name, score and end of an episode; without a score in [0, 1] its return."""
    scored = "score" in flown.history
    return {
        "estimator": name,
        "score": float(flown.score[0]),
        "scored": scored,
        "end": str(flown.end[0]),
        "costs": _costs(flown) if scored else [],
        "steps": int(flown.length[0]),
    }


def _flight(flown: Rollout, name: str, scene: Scene) -> dict[str, Any]:
    """Data of a page about a rollout's episode."""
    position = scene.position
    members = position.members
    apart = 1 + len(scene.true) // CLOUDS
    moving = {
        "true": scene.true,
        "believed": scene.believed,
        "error": position.error,
        "root": None if position.cov is None else semidefinite_cholesky(position.cov),
        "fix": scene.fixes,
        "ambient": ambients(scene.core, scene.history),
    }
    return {
        **_figures(flown, name),
        "legend": scene.legend,
        **packed(moving),
        "members": None if members is None else packed(members[::apart, :MEMBERS]),
        "period": apart * scene.core.config.system.vehicle.dt,
        "charts": packed(scene.charts(CHARTS)),
    }


def _costs(flown: Rollout) -> list[dict[str, Any]]:
    """Costs of an episode to the vehicle's owner; those that it does not have are left out."""
    found = scores(flown)
    return [
        {
            "label": m.label,
            "value": number(found[m.key][0], m.decimals),
            "unit": m.unit,
            "meaning": m.meaning,
        }
        for m in metrics(flown.config.system)
        if m.cost and np.isfinite(found[m.key][0])
    ]
