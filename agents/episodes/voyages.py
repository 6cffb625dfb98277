"""A page of a measured voyage: tracks, estimates and their consistency, of several filters."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.episodes.page import FRAMES, Page, curves, drawn, focus, kept, packed, root
from estimators.angles import difference
from vessel_gym.identification.consistency import Verdict, nis_band, nis_of
from vessel_gym.identification.filtering import SENSORS, Estimates, Voyage
from vessel_gym.rendering.scene import Ambient, Chart, Series, ticks
from vessel_gym.surroundings import Surroundings, in_words

_DEGREES = float(np.rad2deg(1.0))
_SCALES = {"x": 1.0, "y": 1.0, "heading": _DEGREES, "yaw rate": _DEGREES}
_STATES = (
    ("Heading", "°", _DEGREES, "heading"), ("Surge", "m/s", 1.0, ""), ("Sway", "m/s", 1.0, ""),
    ("Yaw rate", "°/s", _DEGREES, "yaw rate"),
    *((f"Unexplained {name}", unit, 1e3, "")
      for name, unit in (("surge", "mm/s²"), ("sway", "mm/s²"), ("yaw", "mrad/s²"))),
)  # fmt: skip
"""Charted states from the third on: words, unit, how many of it are one in SI, and the sensor that measures it."""
_ROOM = 2.5
"""Charts of innovations and NIS reach so many times their bands; an outlier is cut there, and hovering shows it."""


def voyage_page(length: float, voyage: Voyage, judged: Sequence[tuple[str, Estimates, Verdict]]) -> Page:
    """The page of a voyage on which filters ran.

    Args:
        length: Of the ship [m].
        voyage: The measurements.
        judged: Name, estimates and verdict of each filter.
    """
    every = 1 + len(voyage.u) // FRAMES
    poses = [_poses(np.asarray(series.mean)) for _, series, _ in judged]
    return Page({
        "title": f"{voyage.trial.name}: estimates of {len(judged)} filter{'s' * (len(judged) > 1)}",
        "name": voyage.trial.name,
        "environment": voyage.trial.name,
        "conditions": [f"from {voyage.trial.start:g} s of the log", "measured: there is no truth"],
        "dt": voyage.trial.dt * every,
        "unit": "s",
        "truth": False,
        "placed": True,
        "located": True,
        "focus": focus([in_words(name, ()) for name in ("y", "x")], np.eye(3)[[1, 0]]),
        "scene": drawn(Surroundings("ship", length), poses),
        "flights": [_flight(voyage, *each, pose, every) for each, pose in zip(judged, poses, strict=True)],
    })  # fmt: skip


def _poses(mean: np.ndarray) -> np.ndarray:
    """Places and attitudes ``(T, 6)``, see `vessel_gym.surroundings.pose`."""
    level = np.zeros((len(mean), 3))
    return np.concatenate([mean[:, :2], level, np.unwrap(mean[:, 2:3], axis=0)], -1)


def _flight(
    voyage: Voyage, name: str, series: Estimates, verdict: Verdict, pose: np.ndarray, every: int
) -> dict[str, Any]:
    """Data of a page about a filter, in every so many moments and the last."""
    keep, cov = kept(len(pose), every), np.asarray(series.cov)[:, [1, 0]][:, :, [1, 0]]
    fix = voyage.y[:, [1, 0]] - pose[:, [1, 0]]
    fix = np.where(np.isfinite(fix).all(1, keepdims=True), fix, np.nan)
    wind = Ambient("Wind", "m/s", -voyage.u[:, 2:4])  # it comes from there
    return {
        "estimator": name,
        "verdict": f"NIS inside {100.0 * verdict.inside:.0f} %, {'trusted' if verdict.trusted else 'not trusted'}",
        "end": "",
        "costs": [],
        "legend": {"believed": "estimated ship", "ellipse": "estimate ±2σ", "fix": "measured position"},
        "true": packed(pose[keep]),
        "believed": packed(pose[keep]),
        "error": packed(np.zeros((len(keep), 2))),
        "root": packed(root(cov[keep])),
        "members": None,
        "period": voyage.trial.dt,
        "fix": packed(fix[keep]),
        "ambient": [wind._asdict() | {"vector": packed(wind.vector[keep])}] if voyage.u[:, 2:4].any() else [],
        "charts": [*_estimates(voyage, series, every), *_consistency(series, every), *_inputs(voyage, every)],
    }


def _estimates(voyage: Voyage, series: Estimates, every: int) -> list[dict[str, Any]]:
    """Charts of estimated heading, velocities and unexplained accelerations, with their doubled deviations."""
    mean, charts = np.asarray(series.mean), []
    sd = np.sqrt(np.einsum("tii->ti", np.asarray(series.cov)))
    for i, (words, unit, scale, sensor) in enumerate(_STATES, start=2):
        line = scale * (np.unwrap(mean[:, i]) if sensor == "heading" else mean[:, i])
        band, measured = (line - 2.0 * scale * sd[:, i], line + 2.0 * scale * sd[:, i]), None
        if sensor:
            angles = (0,) if sensor == "heading" else ()
            apart = difference(voyage.y[:, [SENSORS.index(sensor)]], mean[:, [i]], angles)[:, 0]
            measured = line + scale * apart
        charts.append(Chart(f"{words} [{unit}]", [Series("estimate ±2σ", "believed", line)], band, measured=measured))
    return curves(charts, every)["charts"]


def _consistency(series: Estimates, every: int) -> list[dict[str, Any]]:
    """Charts of NIS with its central 95 % interval, and of innovations with their doubled deviations."""
    square, count = nis_of(series)
    came = count > 0
    band = np.where(came, nis_band(series)[:, :2].T, np.nan)
    nis = Chart("NIS", [Series("NIS, 95 % interval", "believed", np.where(came, square, np.nan))], (band[0], band[1]))
    charts = [_cut(nis, every, 0.0, float(np.nanmax(band[1], initial=1.0))) | {"range": "95 % interval"}]
    belief: Any = series.tried
    deviations = np.sqrt(np.einsum("tii->ti", np.asarray(belief.innovation_cov)))
    for i, (name, scale) in enumerate(_SCALES.items()):
        words, unit, _ = in_words({"heading": "psi", "yaw rate": "r"}.get(name, name), ("psi",))
        measured = np.asarray(belief.available)[:, i]
        line, two = (scale * np.where(measured, each[:, i], np.nan) for each in (belief.innovation, 2.0 * deviations))
        chart = Chart(f"Innovation of {words} [{unit}]", [Series("innovation ±2σ", "believed", line)], (-two, two))
        if measured.any():
            reach = float(np.nanquantile(two, 0.9))
            charts.append(_cut(chart, every, -reach, reach))
    return charts


def _cut(chart: Chart, every: int, low: float, high: float) -> dict[str, Any]:
    """A chart whose axis reaches so far beyond two levels only, its line drawn across moments without a value."""
    (found,) = curves([chart], every)["charts"]
    low, high = max(chart.limits[0], _ROOM * low), min(chart.limits[1], _ROOM * high)
    lines = [line | {"spanGaps": True} for line in found["series"]]
    return found | {"series": lines, "limits": (low, high), "ticks": ticks(low, high, 3).tolist()}


def _inputs(voyage: Voyage, every: int) -> list[dict[str, Any]]:
    """Charts of rudder and revolutions."""
    words = (("Rudder [°]", _DEGREES), ("Revolutions [1/s]", 1.0))
    charts = [Chart(title, [Series("", "goal", scale * voyage.u[:, i])]) for i, (title, scale) in enumerate(words)]
    return curves(charts, every)["charts"]
