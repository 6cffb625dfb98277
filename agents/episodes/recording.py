"""One episode on several estimators: flown, packed into a page, shown."""

import base64
import html
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.files import replacing
from agents.metrics import core_of, metrics, scores
from agents.named import vector_class
from agents.page import number
from agents.rollouts import Rollout, rollout
from estimators import Filter
from estimators.checks import short_repr
from vessel_gym import checks
from vessel_gym.estimation import build, chosen_disturbance
from vessel_gym.rendering.hulls import HULLS
from vessel_gym.rendering.palette import DARK, LIGHT
from vessel_gym.rendering.scene import Chart, Scene
from vessel_gym.surroundings import Surroundings, surroundings_of
from vessel_gym.system import System

COMPARED = ("ekf", "enkf", "dead-reckoning", "truth")
"""Estimators beside the environment's own, as far as its models carry them."""
FRAMES = 1500
"""Moments of an episode that a page holds at most; of a longer one it holds every second, third and so on."""
CLOUDS, MEMBERS = 300, 40
"""Moments at which an ensemble is kept at most, and how many of its members."""
CHARTS = 6
"""Charts of a page at most."""


@dataclass(frozen=True, eq=False)
class Episode:
    """The same episode on several estimators, as a page that needs no network: a notebook shows it, `save` writes it.

    Attributes:
        page: What the page shows, as JSON holds it.
    """

    page: dict[str, Any] = field(repr=False)

    def __repr__(self) -> str:
        scores = ", ".join(f"{name} {score:.3f}" for name, score in self.scores.items())
        return f"<Episode {self.page['name']}: {scores}>"

    @property
    def scores(self) -> dict[str, float]:
        """The score on each estimator."""
        return {flight["estimator"]: flight["score"] for flight in self.page["flights"]}

    def html(self) -> str:
        """The whole page: data, drawing and libraries in one document."""
        web = files("agents.episodes") / "web"

        def source(name: str) -> str:
            return (web / name).read_text(encoding="utf-8")

        light, dark = ("".join(f"--{name}:{value};" for name, value in each.items()) for each in (LIGHT, DARK))
        colours = f":root{{{light}}}@media (prefers-color-scheme: dark){{:root{{{dark}}}}}\n"
        names = ["vendor/uplot.min.js", *(["vendor/three.min.js"] if self.page["scene"]["space"] else []), "episode.js"]
        # "<" never stands in the data, so that no label of anybody ends the element that holds it.
        parts = {
            "title": html.escape(self.page["title"]),
            "style": source("vendor/uplot.min.css") + colours + source("episode.css"),
            "data": json.dumps(self.page, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
            "scripts": "".join(f"<script>{source(name)}</script>\n" for name in names),
        }
        head, *rest = source("episode.html").split("{{")
        return head + "".join(parts[name] + after for name, _, after in (each.partition("}}") for each in rest))

    def save(self, path: Path | str) -> None:
        """Write the page.

        Raises:
            OSError: if it cannot be written there.
        """
        with replacing(Path(path)) as temporary:
            temporary.write_text(self.html(), encoding="utf-8")

    def _repr_html_(self) -> str:
        srcdoc, title = (html.escape(text) for text in (self.html(), self.page["title"]))
        return (
            f'<iframe srcdoc="{srcdoc}" title="{title}" sandbox="allow-scripts" loading="lazy" '
            'style="width:100%;height:720px;border:0"></iframe>'
        )


def episode(
    env_id: str = "SigmaCorvette-v0",
    estimators: Sequence[str] | None = None,
    agent: Any = "autopilot",
    seed: int = 0,
    env_options: dict[str, Any] | None = None,
    trust: bool = False,
) -> Episode:
    """Fly one episode on several estimators, all of which meet the same start, waves, losses and sensor noise.

    Args:
        env_id: A registered environment of ours, or your own.
        estimators: The first is shown first; None: the environment's own, then those of `COMPARED` that its models
            carry.
        agent: As `rollout` takes it; it steers on each estimator afresh.
        seed: Of the episode.
        env_options: Passed to the environment.
        trust: See `agents.load_agent`.

    Raises:
        ValueError: if there is no such environment or estimator, or the agent cannot fly it.
        TypeError: for arguments of another kind.
    """
    if not isinstance(env_id, str):
        raise TypeError(f"env_id must be the name of a registered environment, got {short_repr(env_id)}")
    options = checks.options("env_options", env_options)
    try:
        system = getattr(vector_class(env_id), "system", None)
    except gym.error.Error as error:
        raise ValueError(str(error)) from None
    if system is None:
        raise ValueError(f"{env_id!r} has no estimator in the loop: name an environment of vessel_gym, or your own")
    first = options.pop("estimator", None) or system.estimator
    if estimators is None:
        estimators = _compared(system, options, first)
    elif isinstance(estimators, str) or not isinstance(estimators, Sequence) or not estimators:
        raise TypeError(f"estimators must be a list of one or more, got {short_repr(estimators)}")
    names = [_name(each) for each in estimators]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"each estimator is shown once, and {name!r} is named twice")
    flown = [
        rollout(agent, env_id, [seed], {**options, "estimator": each}, trust=trust, ensembles=True)
        for each in estimators
    ]
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


def _compared(system: System, options: dict[str, Any], first: Any) -> list[Any]:
    """An estimator, then the environment's own and those of `COMPARED`, as far as its models and the options do."""
    sensors = system.sensors_of(options.get("sensors", "nominal"))
    disturbance = chosen_disturbance(system, options.get("disturbance", "moderate"))

    def carried(name: str) -> bool:
        try:
            made = build(system, name, options.get("estimator_options"), sensors, disturbance)
        except (ValueError, TypeError):
            return False
        return isinstance(made.filter, Filter)

    return [first, *(name for name in dict.fromkeys((system.estimator, *COMPARED)) if name != first and carried(name))]


def page_of(flown: Sequence[Rollout], names: Sequence[str]) -> dict[str, Any]:
    """Data of a page, from rollouts of one seed on estimators of these names."""
    core, scenario = core_of(flown[0]), flown[0].scenario
    assert scenario is not None
    around, every = surroundings_of(core, scenario[0]), 1 + int(max(each.length[0] for each in flown)) // FRAMES
    scenes = [
        Scene(core_of(each), around, {key: values[: each.length[0] + 1, 0] for key, values in each.history.items()})
        for each in flown
    ]
    first, hull = scenes[0].position, HULLS[around.hull]
    low, high = _extent(around, [scene.true for scene in scenes])
    return {
        "title": f"{core.system.name}: one episode on {len(flown)} estimator{'s' * (len(flown) > 1)}",
        "name": core.system.name,
        "environment": flown[0].env_id,
        "conditions": [*scenes[0].conditions, f"seed {flown[0].seeds[0]}"],
        "dt": core.vehicle.dt * every,
        "placed": bool({"x", "y", "z", "h"} & set(core.vehicle.state_names)),
        "located": scenes[0].located,
        "focus": [
            {"name": name, "unit": unit, "axis": axis}
            for (name, unit, _), axis in zip(first.words, first.axes.tolist(), strict=True)
        ],
        "scene": {
            key: packed(value) if isinstance(value, np.ndarray) else value for key, value in asdict(around).items()
        }
        | {"outline": hull.above.tolist(), "least": hull.least, "low": low, "high": high},
        "flights": [_flight(*each, every) for each in zip(flown, names, scenes, strict=True)],
    }


def _extent(around: Surroundings, tracks: list[np.ndarray]) -> tuple[list[float], list[float]]:
    """Least and most north, east and down [m] of path, obstacles and tracks."""
    points = np.concatenate([around.path, *(track[:, :3] for track in tracks)])
    place, radius = around.obstacles[:, :2], around.obstacles[:, 2:]
    level = np.concatenate([points[:, :2], place - radius, place + radius])
    return [*level.min(0).tolist(), float(points[:, 2].min())], [*level.max(0).tolist(), float(points[:, 2].max())]


def _flight(flown: Rollout, name: str, scene: Scene, every: int) -> dict[str, Any]:
    """Data of a page about a rollout's episode: of it every so many moments, and the last."""
    keep, position = np.unique(np.append(np.arange(0, len(scene.true), every), len(scene.true) - 1)), scene.position
    members = None if position.members is None else position.members[:-1]  # of the end itself there are none
    apart = 1 + len(scene.true) // CLOUDS

    def chart(each: Chart) -> dict[str, Any]:
        series = [line._asdict() | {"value": packed(line.value[keep])} for line in each.series]
        band = None if each.band is None else [packed(edge[keep]) for edge in each.band]
        measured = None if each.measured is None else packed(each.measured[keep])
        return {
            "title": each.title,
            "limits": each.limits,
            "ticks": each.ticks,
            "series": series,
            "band": band,
            "measured": measured,
        }

    return {
        "estimator": name,
        "score": float(flown.score[0]),
        "end": str(flown.end[0]),
        "costs": _costs(flown),
        "legend": scene.legend,
        "true": packed(scene.true[keep]),
        "believed": packed(scene.believed[keep]),
        "error": packed(position.error[keep]),
        "root": None if position.cov is None else packed(_root(position.cov[keep])),
        "members": None if members is None else packed(members[::apart, :MEMBERS]),
        "period": apart * scene.core.vehicle.dt,
        "fix": packed(scene.fixes[keep]),
        "charts": [chart(each) for each in scene.charts(CHARTS)],
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


def packed(values: np.ndarray) -> dict[str, Any]:
    """An array as JSON can hold it: float32, little-endian, in base64."""
    return {"shape": values.shape, "float32": base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()}


def unpacked(packing: dict[str, Any]) -> np.ndarray:
    """The array of `packed`."""
    return np.frombuffer(base64.b64decode(packing["float32"]), "<f4").reshape(packing["shape"])


def _root(cov: np.ndarray) -> np.ndarray:
    """Lower triangular roots ``(T, k, k)`` of covariances, which may be singular."""
    values, vectors = np.linalg.eigh(cov)
    upper = np.linalg.qr(np.swapaxes(vectors * np.sqrt(np.maximum(values, 0.0))[:, None], -1, -2), mode="r")
    return np.swapaxes(upper * np.where(np.diagonal(upper, axis1=-2, axis2=-1) < 0.0, -1.0, 1.0)[..., None], -1, -2)
