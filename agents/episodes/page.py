"""The page of an episode, which needs no network: its data, and the document around them."""

import base64
import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.episodes.figure import episode_figure
from agents.files import write_text
from agents.page import iframe
from agents.plotting import KINDS, save_figure
from vessel_gym.rendering.hulls import HULLS
from vessel_gym.rendering.palette import DARK, LIGHT
from vessel_gym.rendering.scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCRIPTS = ("data", "canvas", "plan", "space", "charts", "sea", "controls")
"""Files of the page's own script, in the order in which they are joined."""


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode on several estimators, as a page that a notebook shows and `save` writes.

    Attributes:
        page: Data of the page, in JSON's types.
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
        space = (self.page["scene"] or {}).get("space")
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
        return re.sub(r"{{(\w+)}}", lambda found: parts[found[1]], source("episode.html"))

    def figure(self) -> "Figure":
        """Figure for print: the tracks, and the errors of all estimators in their 2σ bands.

        Raises:
            ModuleNotFoundError: without Matplotlib.
        """
        return episode_figure(self.page)

    def save(self, path: Path | str) -> None:
        """Write the page, or the figure for a path that ends in ``.pdf`` or ``.svg``.

        Raises:
            OSError: if it cannot be written there.
            ModuleNotFoundError: as `figure`.
        """
        if (path := Path(path)).suffix.lower() in KINDS:
            save_figure(self.figure(), path)
        else:
            write_text(path, self.html())

    def _repr_html_(self) -> str:
        style = "width:100%;height:720px;border:0"
        return iframe(self.page["title"], self.html(), style)


def packed(value: Any) -> Any:
    """A value as JSON can hold it: arrays as float32, little-endian, in base64, records by name.

    Args:
        value: An array, a number, a text or None; or a record, a list or a dictionary of such.
    """
    if isinstance(value, np.ndarray):
        values = np.asarray(value, "<f4")
        return {"shape": values.shape, "float32": base64.b64encode(values.tobytes()).decode()}
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {key: packed(each) for key, each in value.items()}
    return [packed(each) for each in value] if isinstance(value, list | tuple) else value


def drawn(scenes: Sequence[Scene]) -> dict[str, Any]:
    """The map of a workspace and true tracks, from its least to its most coordinates [m]."""
    around, states = scenes[0].workspace, scenes[0].core.config.system.vehicle.state_names
    points = np.concatenate([around.path, *(scene.true[:, :3] for scene in scenes)])
    place, radius = around.obstacles[:, :2], around.obstacles[:, 2:]
    level = np.concatenate([points[:, :2], place - radius, place + radius])
    low, high = ([*end(level, 0).tolist(), float(end(points[:, 2]))] for end in (np.min, np.max))
    hull = HULLS[around.hull]
    return packed(vars(around)) | {
        "space": bool({"z", "h"} & {*states}),
        "outline": hull.above.tolist(),
        "least": hull.least,
        "low": low,
        "high": high,
    }
