"""Faults of a measured log: what a filter or an identification should know before it uses it.

Each check looks at one fault. Levels are robust statistics of the channel itself: no ship or sensor need be known.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import median_abs_deviation

from vessel_gym.logs.log import ANGLES, Channel, Log

GAP = 3.5
"""Steps without a row that count as a gap."""
_HELD = 5
"""Equal values in a row of a moving ship that count as held."""
_FAR = 12.0
"""Robust standard deviations of second differences that count as a jump."""
_LISTED = 5
_STEPS = 200
"""A channel with at most so many different values, evenly spaced, is quantised."""
_RANGES = {"heading": 10.0, "rudder": 1.2, "yaw rate": 2.0, "revolutions": 60.0, "surge": 60.0, "sway": 30.0}
"""Largest plausible absolute value in SI units; beyond it the unit is wrong."""


@dataclass(frozen=True)
class Finding:
    """A fault.

    Attributes:
        kind: "damaged row", "missing", "time", "gap", "held", "jump", "quantised", "unit", "lag" or "scale".
        channel: Name of the channel; empty if it concerns the whole log.
        line: First line of the file that it concerns.
        sentence: What was found.
    """

    kind: str
    channel: str
    line: int
    sentence: str


def inspect(log: Log) -> list[Finding]:
    """The faults of a log, in the order of their lines."""
    found = [*_damaged(log)]
    clocks = {id(each.times): each for each in reversed(log.channels.values())}  # rows of a table share one
    for channel in clocks.values():
        found += _times(channel, "" if len(clocks) == 1 else channel.name)
    for channel in log.channels.values():
        for check in (_missing, _repeats, _jumps, _quantised, _unit):
            found += check(channel)
    found += [*_lags(log), *_scale(log)]
    return sorted(found, key=lambda each: each.line)


def _damaged(log: Log) -> Iterator[Finding]:
    """Damaged rows; of those that say the same the first, with their number."""
    same: dict[str, list[int]] = {}
    for line, sentence in log.remarks:
        same.setdefault(sentence, []).append(line)
    for sentence, lines in same.items():
        often = f", as of {len(lines) - 1} other rows until line {lines[-1]}" if len(lines) > 1 else ""
        yield Finding("damaged row", "", lines[0], sentence + often)


def noise(channel: Channel) -> float:
    """Standard deviation of the noise of a channel, told from its third differences; 0 of a quantised one."""
    _, values = channel.measured()
    if len(values) < 8:
        return float("nan")
    values = np.unwrap(values) if channel.name in ANGLES else values
    return float(median_abs_deviation(np.diff(values, 3), scale="normal") / np.sqrt(20.0))


def rate(channel: Channel) -> float:
    """Median rate of the rows with a number [Hz]."""
    times, _ = channel.measured()
    return float("nan") if len(times) < 2 else 1.0 / float(np.median(np.diff(times)))


def _times(channel: Channel, name: str) -> Iterator[Finding]:
    times, lines = channel.times, channel.lines
    for i in np.flatnonzero(~np.isfinite(times))[:1]:
        yield Finding("time", name, int(lines[i]), f"{(~np.isfinite(times)).sum()} rows have no time")
    good = np.isfinite(times)
    times, lines = times[good], lines[good]
    steps = np.diff(times)
    for words, at in (("runs back", steps < 0.0), ("stands still", steps == 0.0)):
        for i in np.flatnonzero(at)[:20]:
            yield Finding("time", name, int(lines[i + 1]), f"time {words} at {times[i + 1]:.6g} s")
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else np.inf
    for i in np.flatnonzero(steps > GAP * usual)[:20]:
        yield Finding("gap", name, int(lines[i + 1]), f"{steps[i]:.3g} s without a row, usually {usual:.3g} s")


def _missing(channel: Channel) -> Iterator[Finding]:
    for first, last in _spans(~np.isfinite(channel.values))[:20]:
        count = last - first
        yield Finding("missing", channel.name, int(channel.lines[first]), f"{count} rows without a number")


def _repeats(channel: Channel) -> Iterator[Finding]:
    if channel.name in ("rudder", "revolutions"):
        return  # commands stay
    same = np.concatenate([[False], np.diff(channel.values) == 0.0])
    spans = _spans(same, _HELD)
    if not spans:
        return
    first, last = max(spans, key=lambda span: span[1] - span[0])
    often = f"{len(spans)} times, for up to" if len(spans) > 1 else "for"
    yield Finding("held", channel.name, int(channel.lines[first]), f"held {often} {last - first + 1} rows")


def _jumps(channel: Channel) -> Iterator[Finding]:
    """Single steps far beyond the scatter of second differences, held values left out."""
    if channel.name in ("rudder", "revolutions", "wind speed", "wind direction") or "relative" in channel.name:
        return
    good = np.isfinite(channel.values) & np.concatenate([[True], np.diff(channel.values) != 0.0])
    values, lines, times = channel.values[good], channel.lines[good], channel.times[good]
    if len(values) < 20:
        return
    values = np.unwrap(values) if channel.name in ANGLES else values
    bend, waits = np.abs(np.diff(values, 2)), np.diff(times)
    bend[np.maximum(waits[1:], waits[:-1]) > GAP * np.median(waits)] = 0.0  # a gap is no jump
    scale = float(median_abs_deviation(np.diff(values, 2), scale="normal"))
    far = np.flatnonzero(bend > _FAR * max(scale, 1e-12)) + 1
    apart = far[np.concatenate([[True], np.diff(far) > 3])] if len(far) else far
    steps = np.concatenate([[0.0], np.diff(values), [0.0]])
    apart = apart + (np.abs(steps[apart + 1]) > np.abs(steps[apart]))  # the row that the larger step leads to
    sizes = steps[apart]
    for rank in np.argsort(-np.abs(sizes))[:_LISTED]:
        sentence = f"jumps by {sizes[rank]:.3g} {channel.unit} at {times[apart[rank]]:.6g} s"
        yield Finding("jump", channel.name, int(lines[apart[rank]]), sentence)
    if len(apart) > _LISTED:
        sentence = f"jumps {len(apart)} times; the {_LISTED} largest are listed"
        yield Finding("jump", channel.name, int(lines[apart[0]]), sentence)


def _quantised(channel: Channel) -> Iterator[Finding]:
    values = np.unique(channel.values[np.isfinite(channel.values)])
    if 3 <= len(values) <= _STEPS and len(channel.values) > 5 * len(values):
        steps = np.diff(values)
        step = float(np.median(steps))
        if np.abs(steps / step - np.round(steps / step)).max() < 0.1:
            sentence = f"in steps of {step:.3g} {channel.unit}"
            yield Finding("quantised", channel.name, int(channel.lines[0]), sentence)


def _unit(channel: Channel) -> Iterator[Finding]:
    limit = _RANGES.get(channel.name)
    values = np.where(np.isfinite(channel.values), channel.values, 0.0)
    if channel.name == "heading":
        values = np.diff(values, prepend=values[:1])  # an unwrapped heading may be large, its steps may not
        values = np.where(np.abs(np.abs(values) - 2.0 * np.pi) < 1.0, 0.0, values)
        limit = np.pi
    if limit is not None and (np.abs(values) > limit).mean() > 0.01:
        i = int(np.argmax(np.abs(values) > limit))
        sentence = f"{channel.values[i]:.4g} {channel.unit} is beyond any ship: is it in another unit?"
        yield Finding("unit", channel.name, int(channel.lines[i]), sentence)


def _lags(log: Log) -> Iterator[Finding]:
    """Lag of the yaw rate behind the heading, and of surge and sway behind the position, with its 95 % interval."""
    from vessel_gym.logs.lag import lag

    pairs = (("yaw rate", ("heading",)), ("surge", ("x", "y", "heading")), ("sway", ("x", "y", "heading")))
    for name, others in pairs:
        if name in log and all(each in log for each in others):
            found = lag(log, name)
            if found is not None and found[0] - found[1] > 0.0:
                sentence = f"lags {found[0]:.2f} s (± {found[1]:.2f} s) behind the derivative of {others[0]}"
                yield Finding("lag", name, int(log[name].lines[0]), sentence)


def _scale(log: Log) -> Iterator[Finding]:
    """Scale error of the yaw rate against the heading, where its 95 % interval excludes 0."""
    from vessel_gym.logs.scale import scale

    found = scale(log) if "yaw rate" in log and "heading" in log else None
    if found is not None and abs(found[0]) > found[1]:
        words = f"{100.0 * abs(found[0]):.2g} % (± {100.0 * found[1]:.2g} %) {'faster' if found[0] > 0.0 else 'slower'}"
        sentence = f"its scale is off: the heading turns {words}"
        yield Finding("scale", "yaw rate", int(log["yaw rate"].lines[0]), sentence)


def _spans(mask: np.ndarray, least: int = 1) -> list[tuple[int, int]]:
    """First and last + 1 of each run of so many true values or more."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]))).reshape(-1, 2)
    return [(int(a), int(b)) for a, b in edges[edges[:, 1] - edges[:, 0] >= least]]
