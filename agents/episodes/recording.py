"""One episode on several estimators: flown, packed into a page, shown."""

from collections.abc import Sequence
from contextlib import closing
from typing import Any

import gymnasium as gym
import numpy as np

from agents.episodes.page import FRAMES, Episode, curves, drawn, focus, kept, packed, root
from agents.metrics import core_of, metrics, scores
from agents.named import vector_class
from agents.page import number
from agents.rollouts import Rollout, batch, rollout
from agents.seeds import evaluation_seeds
from agents.wrapped import Wrapped, takes, wrapped_system
from estimators import Filter
from estimators.checks import short_repr
from vessel_gym import checks
from vessel_gym.estimation import build, chosen_disturbance
from vessel_gym.rendering.scene import Chart, Scene, Series, ambients
from vessel_gym.surroundings import surroundings_of
from vessel_gym.system import System
from vessel_gym.wrappers.watch import time_step

COMPARED = ("ekf", "enkf", "dead-reckoning", "truth")
"""Estimators beside the environment's own, as far as its models carry them."""
TYPICAL = 40
"""Episodes of which the most typical one is shown where no seed is asked for."""
CLOUDS, MEMBERS = 300, 40
"""Moments at which an ensemble is kept at most, and how many of its members."""
CHARTS = 6
"""Charts of a page at most."""


def episode(
    env_id: str = "SigmaCorvette-v0",
    estimators: Sequence[str] | None = None,
    agent: Any = "autopilot",
    seed: int | None = 0,
    env_options: dict[str, Any] | None = None,
    trust: bool = False,
) -> Episode:
    """One episode on several estimators, which meet the same start, waves, losses and sensor noise.

    Args:
        env_id: A registered environment of ours, or your own.
        estimators: The first is shown first; None: the environment's own, then those of `COMPARED`
            that its models carry.
        agent: As `rollout` takes it; it steers on each estimator afresh.
        seed: Of the episode; None: that of the most typical of `TYPICAL` evaluation episodes, see
            `typical_seed`. An environment of others, whose episodes run one by one, takes 0.
        env_options: Passed to the environment.
        trust: See `agents.load_agent`.

    Raises:
        ValueError: if there is no such environment or estimator, or the agent cannot fly it.
        TypeError: for arguments of another kind.
    """
    if not isinstance(env_id, str):
        raise TypeError(
            f"env_id must be the name of a registered environment, got {short_repr(env_id)}"
        )
    options = checks.options("env_options", env_options)
    try:
        system = getattr(vector_class(env_id), "system", None)
    except gym.error.Error as error:
        raise ValueError(str(error)) from None
    if system and "vessel" in options:  # her own system, with estimators of its own
        with closing(batch(env_id, 1, options)) as env:
            system = env.unwrapped.system  # type: ignore[attr-defined]
    system = system or wrapped_system(env_id)
    if not system.estimator:
        raise ValueError(
            f"{env_id!r} has no estimator in the loop: wrap it in"
            " vessel_gym.wrappers.EstimatedObservation"
        )
    first = options.pop("estimator", None) or system.estimator
    if estimators is None:
        estimators = _compared(system, options, first)
    elif isinstance(estimators, str) or not isinstance(estimators, Sequence) or not estimators:
        raise TypeError(f"estimators must be a list of one or more, got {short_repr(estimators)}")
    names = [_name(each) for each in estimators]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"each estimator is shown once, and {name!r} is named twice")
    worlds = [_with_estimator(system, options, each) for each in estimators]
    if seed is None and isinstance(system, Wrapped):
        seed = 0
    elif seed is None:
        seeds = evaluation_seeds(TYPICAL)
        flown = [
            rollout(agent, env_id, seeds, world, trust=trust, record=False) for world in worlds
        ]
        seed = typical_seed(np.array([each.score for each in flown]), seeds)
    flown = [rollout(agent, env_id, [seed], world, trust=trust, ensembles=True) for world in worlds]
    return Episode(page_of(flown, names))


def typical_seed(scores: np.ndarray, seeds: Sequence[int]) -> int:
    """The seed whose scores lie nearest to their means over all seeds, in standard deviations, summed in squares.

    Args:
        scores: ``(estimators, seeds)``.
        seeds: Of the columns.
    """
    spread = np.maximum(scores.std(1, keepdims=True), np.finfo(float).tiny)
    return seeds[int(np.square((scores - scores.mean(1, keepdims=True)) / spread).sum(0).argmin())]


def _name(estimator: Any) -> str:
    """Name of an estimator; of a user's own, its ``name`` or ``__name__``."""
    if isinstance(estimator, str):
        return estimator
    own = getattr(estimator, "name", None) or getattr(estimator, "__name__", None)
    return own if isinstance(own, str) else "own"


def _with_estimator(
    system: System | Wrapped, options: dict[str, Any], estimator: Any
) -> dict[str, Any]:
    """Options with an estimator, unless it is the only one that an environment of others has."""
    fixed = isinstance(system, Wrapped) and estimator == system.estimator
    return options if fixed else {**options, "estimator": estimator}


def _compared(system: System | Wrapped, options: dict[str, Any], first: Any) -> list[Any]:
    """An estimator, then the environment's own and those of `COMPARED`, as far as its models and the options do."""
    if isinstance(system, Wrapped):
        others = COMPARED if takes(system.name, "estimator") else ()
        return [
            first,
            *(name for name in others if name != first and _carried(system.name, options, name)),
        ]
    sensors = system.sensors_of(options.get("sensors", "nominal"))
    disturbance = chosen_disturbance(system, options.get("disturbance", "moderate"))

    def carried(name: str) -> bool:
        try:
            made = build(system, name, options.get("estimator_options"), sensors, disturbance)
        except (ValueError, TypeError):
            return False
        return isinstance(made.filter, Filter)

    return [
        first,
        *(
            name
            for name in dict.fromkeys((system.estimator, *COMPARED))
            if name != first and carried(name)
        ),
    ]


def _carried(env_id: str, options: dict[str, Any], estimator: str) -> bool:
    """Can an environment of others be made with an estimator?"""
    try:
        gym.make(env_id, **options, estimator=estimator).close()
    except (ValueError, TypeError):
        return False
    return True


def page_of(flown: Sequence[Rollout], names: Sequence[str]) -> dict[str, Any]:
    """Data of a page, from rollouts of one seed on estimators of these names.

    An environment of others has no map; its page holds charts of what its ``info`` holds of truth
    and estimate.

    Raises:
        ValueError: if there are no estimates in an episode.
    """
    env, every = flown[0].env.unwrapped, 1 + int(max(each.length[0] for each in flown)) // FRAMES
    core, histories = getattr(env, "core", None), [_first_row(each) for each in flown]
    page: dict[str, Any] = {
        "title": (
            f"{flown[0].env_id}: one episode on {len(flown)} estimator{'s' * (len(flown) > 1)}"
        ),
        "name": flown[0].env_id,
        "environment": flown[0].env_id,
        "conditions": [f"seed {flown[0].seeds[0]}"],
        "dt": (core.vehicle.dt if core else time_step(env)) * every,
        "unit": "s" if core or time_step(env) != 1.0 else "steps",
        "placed": False,
        "located": False,
        "focus": [],
        "scene": None,
    }
    if core is None:
        pairs = zip(flown, names, histories, strict=True)
        flights = [
            _figures(each, name) | curves(_estimates(history), every)
            for each, name, history in pairs
        ]
        return page | {"flights": flights}
    scenario = flown[0].scenario
    assert scenario is not None
    around = surroundings_of(core, scenario[0])
    scenes = [
        Scene(core_of(each), around, history)
        for each, history in zip(flown, histories, strict=True)
    ]
    first = scenes[0].position
    return page | {
        "title": page["title"].replace(flown[0].env_id, core.system.name, 1),
        "name": core.system.name,
        "conditions": [*scenes[0].conditions, *page["conditions"]],
        "placed": bool({"x", "y", "z", "h"} & set(core.vehicle.state_names)),
        "located": scenes[0].located,
        "focus": focus(first.words, first.axes),
        "scene": drawn(around, [scene.true for scene in scenes]),
        "flights": [_flight(*each, every) for each in zip(flown, names, scenes, strict=True)],
    }


def _first_row(flown: Rollout) -> dict[str, np.ndarray]:
    """History ``(T + 1, ...)`` of the first episode of a rollout."""
    return {key: values[: flown.length[0] + 1, 0] for key, values in flown.history.items()}


def _estimates(history: dict[str, np.ndarray]) -> list[Chart]:
    """Charts of the first components of truth and estimate in the ``info`` of an environment of others."""
    if "estimate" not in history:
        raise ValueError(
            "there is no estimate to show: info of the environment holds no array 'estimate'"
        )
    charts, estimate = [], history["estimate"].reshape(len(history["estimate"]), -1)
    truth, cov = (history.get(key) for key in ("truth", "covariance"))
    for i, line in enumerate(estimate.T[:CHARTS]):
        series, band = [Series("estimate", "believed", line)], None
        if truth is not None and truth.shape == estimate.shape:
            series.insert(0, Series("true", "true_soft", truth[:, i], 3.5))
        if cov is not None and cov.shape == (*estimate.shape, estimate.shape[1]):
            sd = np.sqrt(np.maximum(cov[:, i, i], 0.0))
            band, series[-1] = (
                (line - 2.0 * sd, line + 2.0 * sd),
                series[-1]._replace(label="estimate ±2σ"),
            )
        charts.append(Chart(f"Component {i}", series, band))
    return charts


def _figures(flown: Rollout, name: str) -> dict[str, Any]:
    """Name, score and end of an episode; an environment of others has its return instead of a score in [0, 1]."""
    scored = "score" in flown.history
    return {
        "estimator": name,
        "score": float(flown.score[0]),
        "scored": scored,
        "end": str(flown.end[0]),
        "costs": _costs(flown) if scored else [],
        "steps": int(flown.length[0]),
    }


def _flight(flown: Rollout, name: str, scene: Scene, every: int) -> dict[str, Any]:
    """Data of a page about a rollout's episode, in every so many moments and the last."""
    keep, position = kept(len(scene.true), every), scene.position
    members = (
        None if position.members is None else position.members[:-1]
    )  # of the end itself there are none
    apart = 1 + len(scene.true) // CLOUDS
    return {
        **_figures(flown, name),
        "legend": scene.legend,
        "true": packed(scene.true[keep]),
        "believed": packed(scene.believed[keep]),
        "error": packed(position.error[keep]),
        "root": None if position.cov is None else packed(root(position.cov[keep])),
        "members": None if members is None else packed(members[::apart, :MEMBERS]),
        "period": apart * scene.core.vehicle.dt,
        "fix": packed(scene.fixes[keep]),
        "ambient": [
            each._asdict() | {"vector": packed(each.vector[keep])}
            for each in ambients(scene.core, scene.history)
        ],
        **curves(scene.charts(CHARTS), every),
    }


def _costs(flown: Rollout) -> list[dict[str, Any]]:
    """Costs of an episode to the vehicle's owner; those that it does not have are left out."""
    figures, known = scores(flown), metrics(core_of(flown).system)
    costs = ((m, float(figures[m.key][0])) for m in known if m.cost)
    return [
        {"label": m.label, "value": number(value, m.decimals), "unit": m.unit, "meaning": m.meaning}
        for m, value in costs
        if np.isfinite(value)
    ]
