"""A page of a measured log: each channel over time, with its faults."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from agents.episodes.page import FRAMES, Page, curves
from vessel_gym.logs import Channel, Log
from vessel_gym.logs.inspection import GAP, Finding, noise, rate
from vessel_gym.rendering.scene import Chart, Series


def log_page(log: Log, findings: Sequence[Finding]) -> Page:
    """The page of a log, and of what `vessel_gym.logs.inspection.inspect` found in it."""
    first, last = log.span
    steps = [1.0 / rate(each) for each in log.channels.values()]
    dt = max(np.nanmin([last - first, *steps]), (last - first) / (FRAMES - 1), 1e-6)
    count = round((last - first) / dt) + 1
    charted = {name: channel for name, channel in log.channels.items() if len(channel.measured()[0])}
    charts = [
        _chart(channel, first, dt, count)
        | {"faults": [_fault(log, each, first, "") for each in findings if each.channel == name]}
        for name, channel in charted.items()
    ]
    others = [_fault(log, each, first, each.channel) for each in findings if each.channel not in charted]
    number = f"{len(findings)} fault{'s' * (len(findings) != 1)}" if findings else "no fault found"
    return Page({
        "title": f"{log.name}: {number}",
        "name": log.name,
        "environment": log.name,
        "conditions": [f"{last - first:.6g} s from {first:.10g} s", number],
        "dt": dt,
        "unit": "s",
        "truth": False,
        "placed": False,
        "located": False,
        "focus": [],
        "scene": None,
        "faults": others,
        "flights": [{"estimator": "measured", "verdict": number, "end": "", "costs": [], "charts": charts}],
    })  # fmt: skip


def _fault(log: Log, finding: Finding, first: float, channel: str) -> dict[str, Any]:
    """A fault with its time on the page; None where the line has none."""
    named = [log.channels[finding.channel]] if finding.channel in log.channels else log.channels.values()
    times = np.concatenate([each.times[each.lines == finding.line] for each in named])
    known = times[np.isfinite(times)]
    text = f"{channel}: {finding.sentence}" if channel else finding.sentence
    return {"line": finding.line, "at": float(known[0] - first) if len(known) else None, "text": text}


def _chart(channel: Channel, first: float, dt: float, count: int) -> dict[str, Any]:
    """Chart of a channel: of least and most in each of ``count`` intervals, if more measurements came than these."""
    times, values = channel.measured()
    low, high = _binned(times, values, first, dt, count)
    dense = bool((high > low).any())
    line = Series("", "measurement", 0.5 * (low + high))
    (found,) = curves([Chart(f"{channel.name} [{channel.unit}]", [line],
                             (low, high) if dense else None)], 1)["charts"]  # fmt: skip
    words = (f"{len(values):,} numbers", f"{rate(channel):.3g} Hz", f"{values.min():.4g} to {values.max():.4g}",
             f"noise {noise(channel):.2g}")  # fmt: skip
    return found | {"note": " · ".join(words), "range": "least to most"}


def _binned(
    times: np.ndarray, values: np.ndarray, first: float, dt: float, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Least and most ``(count,)`` in intervals about a grid; between measurements linear, NaN in gaps."""
    low, high = np.full(count, np.nan), np.full(count, np.nan)
    index = np.clip(np.round((times - first) / dt).astype(int), 0, count - 1)
    np.fmin.at(low, index, values)
    np.fmax.at(high, index, values)
    if len(times) < 2:
        return low, high
    grid, steps = first + dt * np.arange(count), np.diff(times)
    after = np.searchsorted(times, grid).clip(1, len(times) - 1)
    empty = np.isnan(low) & (steps[after - 1] <= GAP * np.median(steps)) & (grid > times[0]) & (grid < times[-1])
    low[empty] = high[empty] = np.interp(grid[empty], times, values)
    return low, high
