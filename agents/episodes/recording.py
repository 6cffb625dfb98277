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
from agents.metrics import WITHOUT_COVARIANCE, core_of
from agents.named import vector_class
from agents.rollouts import Rollout, rollout
from estimators import Filter
from estimators.angles import difference
from estimators.checks import short_repr
from vessel_gym import checks
from vessel_gym.estimation import build, chosen_disturbance
from vessel_gym.surroundings import in_words, pose, surroundings_of
from vessel_gym.system import System

COMPARED = ("ekf", "enkf", "dead-reckoning", "truth")
"""Estimators beside the environment's own, as far as its models carry them."""
FRAMES = 1500
"""Moments of an episode that a page holds at most; of a longer one it holds every second, third and so on."""
CLOUDS, MEMBERS = 300, 40
"""Moments at which an ensemble is kept at most, and how many of its members."""
CHARTS = 4
"""Errors of components that are charted at most."""


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

        names = ["vendor/uplot.min.js", *(["vendor/three.min.js"] if self.page["scene"]["space"] else []), "episode.js"]
        # "<" never stands in the data, so that no label of anybody ends the element that holds it.
        parts = {
            "title": html.escape(self.page["title"]),
            "style": source("vendor/uplot.min.css") + source("episode.css"),
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
    around, shown = asdict(surroundings_of(core, scenario[0])), _focus(core)
    stride = 1 + int(max(each.length[0] for each in flown)) // FRAMES
    config = core.config
    words = [f"{config.disturbance_name} disturbance", f"{config.sensors_name} sensors", f"seed {flown[0].seeds[0]}"]
    return {
        "title": f"{core.system.name}: one episode on {len(flown)} estimator{'s' * (len(flown) > 1)}",
        "name": core.system.name,
        "environment": flown[0].env_id,
        "conditions": words,
        "step": core.vehicle.dt,
        "dt": core.vehicle.dt * stride,
        "placed": bool({"x", "y", "z", "h"} & set(core.vehicle.state_names)),
        "located": bool({"x", "y"} & set(shown)),
        "focus": [in_words(name, core.vehicle.angles)[:2] for name in shown],
        "scene": {key: packed(value) if isinstance(value, np.ndarray) else value for key, value in around.items()},
        "flights": [_flight(each, name, shown, stride) for each, name in zip(flown, names, strict=True)],
    }


def _focus(core: Any) -> list[str]:
    """Components of the close-up: estimated ones of the position, or else the heading or the first component."""
    names = core.composition.names[: core.composition.base]
    return [name for name in ("y", "x", "z", "h") if name in names] or (["psi"] if "psi" in names else [names[0]])


def _flight(flown: Rollout, name: str, shown: list[str], stride: int) -> dict[str, Any]:
    """Data of a page about the first episode of a rollout."""
    core, composition = core_of(flown), core_of(flown).composition
    keep = np.unique(np.append(np.arange(0, flown.length[0], stride), flown.length[0]))
    h = {key: values[keep, 0] for key, values in flown.history.items() if key != "ensemble"}
    base = composition.names[: composition.base]
    believed = [base.index(each) for each in shown]
    true = h["truth"][:, [core.truth_names.index(each) for each in shown]]
    angles = tuple(i for i, each in enumerate(shown) if each in core.vehicle.angles)
    scale = np.array([in_words(each, core.vehicle.angles)[2] for each in shown])
    error = difference(h["estimate"][:, believed], true, angles) * scale
    claims = core.estimator not in WITHOUT_COVARIANCE
    cov = h["covariance"][:, believed][:, :, believed] * np.outer(scale, scale)
    guess = h["truth"].copy()  # what is not estimated stands where it truly is
    places = [core.truth_names.index(each) for each in base]
    guess[:, places] = h["estimate"][:, : composition.base]
    return {
        "estimator": name,
        "score": float(flown.score[0]),
        "end": str(flown.end[0]),
        "true": packed(pose(h["truth"], core.truth_names)),
        "believed": packed(pose(guess, core.truth_names)),
        "error": packed(error),
        "covariance": packed(cov.reshape(len(cov), -1)) if claims else None,
        "members": _members(flown, believed, angles, scale),
        "fix": packed(_fixes(core, h, shown, true, angles) * scale),
        "charts": [*_errors(core, h, claims), *_inputs(core, h), _score(h)],
    }  # fmt: skip


def packed(values: np.ndarray) -> dict[str, Any]:
    """An array as JSON can hold it: float32, little-endian, in base64."""
    return {"shape": values.shape, "float32": base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()}


def unpacked(packing: dict[str, Any]) -> np.ndarray:
    """The array of `packed`."""
    return np.frombuffer(base64.b64decode(packing["float32"]), "<f4").reshape(packing["shape"])


def _members(flown: Rollout, believed: list[int], angles: tuple[int, ...], scale: np.ndarray) -> dict[str, Any] | None:
    """Deviations of an ensemble's members from their mean ``(F, m, k)``, as 16-bit integers, with their steps."""
    if "ensemble" not in flown.history:
        return None
    last = int(flown.length[0])
    at = np.arange(0, last, 1 + last // CLOUDS)  # of the end itself a batch that resets at once keeps nothing
    ensemble = flown.history["ensemble"][at, 0, :MEMBERS][..., believed]
    mean = flown.history["estimate"][at, 0][:, None, believed]
    away = difference(ensemble, mean, angles) * scale
    unit = float(np.abs(away).max(initial=1e-12)) / 32767.0
    integers = base64.b64encode(np.round(away / unit).astype("<i2").tobytes()).decode()
    return {"shape": away.shape, "int16": integers, "unit": unit, "every": int(at[1]) if len(at) > 1 else 1}


def _fixes(
    core: Any, h: dict[str, np.ndarray], shown: list[str], true: np.ndarray, angles: tuple[int, ...]
) -> np.ndarray:
    """Measurements of components minus their truth ``(T, k)``; NaN where none came."""
    fixes = np.full(true.shape, np.nan)
    for i, name in enumerate(shown):
        for channel in (c for c, given in enumerate(core.sensors.gives) if given == name):
            off = difference(h["measurement"][:, [channel]], true[:, [i]], (0,) if i in angles else ())[:, 0]
            fixes[:, i] = np.where(h["available"][:, channel], off, fixes[:, i])
    return fixes


def _errors(core: Any, h: dict[str, np.ndarray], claims: bool) -> list[dict[str, Any]]:
    """Charts of what is believed minus what is true, with the band that the estimator claims, and the measurements."""
    names = core.composition.names[: core.composition.base]
    first = [name for name in ("y", "x", "z", "h", "psi", "phi") if name in names]
    charts = []
    for name in [*first, *(name for name in names if name not in first)][:CHARTS]:
        i, (label, unit, scale) = names.index(name), in_words(name, core.vehicle.angles)
        true = h["truth"][:, [core.truth_names.index(name)]]
        angle = (0,) if name in core.vehicle.angles else ()
        sd = np.sqrt(np.maximum(h["covariance"][:, i, i], 0.0))
        fixes = _fixes(core, h, [name], true, angle)
        charts.append({
            "title": f"{label[:1].upper()}{label[1:]} error",
            "unit": unit,
            "believed": packed(scale * difference(h["estimate"][:, [i]], true, angle)[:, 0]),
            "two_sigma": packed(2.0 * scale * sd) if claims else None,
            "true": None,
            "measurements": packed(scale * fixes[:, 0]) if name in core.sensors.gives else None,
        })  # fmt: skip
    return charts


def _inputs(core: Any, h: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """A chart of the unknown input, true and estimated, where there is one only: of many it would say little."""
    if len(core.unknown_inputs) != 1 or not np.isfinite(h["unknown_input"]).all():
        return []
    name, true = core.unknown_inputs[0], h["unknown_input"][:, 0]
    scale, unit = (1e3, "mrad") if name == "yaw increment" else (1.0, "")
    estimate = None
    if core.belief.input_mean is not None:
        delay = core.filter.input_delay or 0
        late = h["input_estimate"][delay:, 0]
        estimate = packed(scale * np.append(late, np.full(len(true) - len(late), np.nan)))
    return [
        {"title": f"Unknown {name} d", "unit": unit, "believed": estimate, "two_sigma": None,
         "true": packed(scale * true), "measurements": None}
    ]  # fmt: skip


def _score(h: dict[str, np.ndarray]) -> dict[str, Any]:
    return {"title": "Score so far", "unit": "", "believed": packed(h["score"]), "two_sigma": None, "true": None,
            "measurements": None}  # fmt: skip
