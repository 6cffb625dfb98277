"""The page of an episode, which needs no network: its data, and the document around them."""

import base64
import html
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from agents.files import replacing
from vessel_gym.rendering.hulls import HULLS
from vessel_gym.rendering.palette import DARK, LIGHT
from vessel_gym.rendering.scene import Chart
from vessel_gym.surroundings import Surroundings

FRAMES = 1500
"""Moments that a page holds at most; of a longer one it holds every second, third and so on."""
SCRIPTS = ("data", "canvas", "plan", "space", "charts", "controls")
"""Files of the page's own script, in the order in which they are joined."""


@dataclass(frozen=True, eq=False)
class Episode:
    """The same episode on several estimators, as a page that needs no network: a notebook shows it, `save` writes it.

    Attributes:
        page: What it shows, as JSON holds it.
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

        light, dark = (
            "".join(f"--{name}:{value};" for name, value in each.items()) for each in (LIGHT, DARK)
        )
        colours = f":root{{{light}}}@media (prefers-color-scheme: dark){{:root{{{dark}}}}}\n"
        space = self.page["scene"] is not None and self.page["scene"]["space"]
        libraries = ["uplot", "three"] if space else ["uplot"]
        own = "".join(source(f"{name}.js") for name in SCRIPTS)
        scripts = [
            *(source(f"vendor/{name}.min.js") for name in libraries),
            f'"use strict";(() => {{\n{own}}})();',
        ]
        # "<" never stands in the data, so that no label of anybody ends the element that holds it.
        parts = {
            "title": html.escape(self.page["title"]),
            "style": source("vendor/uplot.min.css") + colours + source("episode.css"),
            "data": (
                json.dumps(self.page, separators=(",", ":"), allow_nan=False).replace(
                    "<", "\\u003c"
                )
            ),
            "scripts": "".join(f"<script>{script}</script>\n" for script in scripts),
        }
        head, *rest = source("episode.html").split("{{")
        return head + "".join(
            parts[name] + after for name, _, after in (each.partition("}}") for each in rest)
        )

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


def kept(length: int, every: int) -> np.ndarray:
    """Indices of every so many moments of an episode, and of the last."""
    return np.unique(np.append(np.arange(0, length, every), length - 1))


def curves(charts: Sequence[Chart], every: int) -> dict[str, Any]:
    """Charts as a page holds them."""

    def packing(values: np.ndarray) -> dict[str, Any]:
        return packed(values[kept(len(values), every)])

    return {
        "charts": [
            {
                "title": each.title,
                "limits": each.limits,
                "ticks": each.ticks,
                "series": [line._asdict() | {"value": packing(line.value)} for line in each.series],
                "band": None if each.band is None else [packing(edge) for edge in each.band],
                "measured": None if each.measured is None else packing(each.measured),
            }
            for each in charts
        ]
    }


def packed(values: np.ndarray) -> dict[str, Any]:
    """An array as JSON can hold it: float32, little-endian, in base64."""
    return {
        "shape": values.shape,
        "float32": base64.b64encode(np.asarray(values, "<f4").tobytes()).decode(),
    }


def root(cov: np.ndarray) -> np.ndarray:
    """Lower triangular roots ``(T, k, k)`` of covariances, which may be singular."""
    values, vectors = np.linalg.eigh(cov)
    upper = np.linalg.qr(
        np.swapaxes(vectors * np.sqrt(np.maximum(values, 0.0))[:, None], -1, -2), mode="r"
    )
    return np.swapaxes(
        upper * np.where(np.diagonal(upper, axis1=-2, axis2=-1) < 0.0, -1.0, 1.0)[..., None], -1, -2
    )


def focus(words: Sequence[tuple[str, str, float]], axes: np.ndarray) -> list[dict[str, Any]]:
    """Components of the position, for the close-up: words as of `vessel_gym.surroundings.in_words`, axes ``(k, 3)``."""
    return [
        {"name": name, "unit": unit, "axis": axis}
        for (name, unit, _), axis in zip(words, axes.tolist(), strict=True)
    ]


def drawn(around: Surroundings, tracks: Sequence[np.ndarray]) -> dict[str, Any]:
    """The map of surroundings and tracks ``(T, 6)``."""
    values = {
        key: packed(value) if isinstance(value, np.ndarray) else value
        for key, value in asdict(around).items()
    }
    (low, high), hull = _extent(around, tracks), HULLS[around.hull]
    return values | {"outline": hull.above.tolist(), "least": hull.least, "low": low, "high": high}


def _extent(around: Surroundings, tracks: Sequence[np.ndarray]) -> tuple[list[float], list[float]]:
    """Least and most north, east and down [m] of path, obstacles and tracks."""
    points = np.concatenate([around.path, *(track[:, :3] for track in tracks)])
    place, radius = around.obstacles[:, :2], around.obstacles[:, 2:]
    level = np.concatenate([points[:, :2], place - radius, place + radius])
    return [*level.min(0).tolist(), float(points[:, 2].min())], [
        *level.max(0).tolist(),
        float(points[:, 2].max()),
    ]
