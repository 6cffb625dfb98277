"""The page on Hermawan's five simulations: the tables of the thesis beside ours."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.page import Entry, Page, Table, entry, number, words
from agents.plotting import BELIEVED, INK, PALETTE, PUBLISHED, TRUE, drawing
from agents.reproduction.comparison import Comparison, tally
from agents.reproduction.corvette import LEVELS, MODELS
from agents.reproduction.pages.comparison import comparison_table, mean_of
from agents.reproduction.pages.template import fill
from agents.reproduction.settings import corvette as settings
from agents.reproduction.settings.corvette import QUANTITIES, SAMPLES, SIMULATIONS
from agents.statistics import Interval, paired_difference

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NOISE, _LOW = settings.NOISE, f"{settings.NOISE:g}"
_PREDICTED = "predicted heading"
_ERRORS = (*QUANTITIES, _PREDICTED)
_STATED = {name: simulation.R**0.5 for name, simulation in SIMULATIONS.items()}
"""The noise [rad] that a simulation's R means as a variance."""


def allowed_noise(heading: float, unknown_input: float) -> tuple[float, float]:
    """The reading noise [rad] between which a pair of RMSE of heading and d is possible at all.

    The filter's d is the least-squares one given its heading. With R a multiple of identity and H = [1 1]' that is
    d = ((y1 - psi) + y2) / 2, so twice the error of d plus that of psi is v1 + v2 at every sample, whatever A, G, Q.
    """
    return abs(heading - 2.0 * unknown_input) / np.sqrt(2.0), (heading + 2.0 * unknown_input) / np.sqrt(2.0)


def left_of_start(R: float, prior: float) -> float:
    """The share of a wrong first heading that is left in the second prediction.

    The first reading leaves ``2 R / (prior + 2 R)`` in the heading; d takes half of that with the other sign, and the
    prediction adds d.
    """
    return R / (prior + 2.0 * R)


class _Results:
    """The cells' values, by simulation, model and noise."""

    def __init__(self, values: Mapping[str, Mapping[str, Any]]) -> None:
        self.values = values
        self.runs = self.rmse("I", "heading").size

    def cell(self, simulation: str, model: str = MODELS[0]) -> Mapping[str, Any]:
        return self.values[f"{simulation}, {model}"]

    def rmse(self, simulation: str, quantity: str, level: float = _NOISE, model: str = MODELS[0]) -> np.ndarray:
        return np.asarray(self.cell(simulation, model)["rmse"][f"{level:.4f}"])[_ERRORS.index(quantity)]

    def other(self, key: str, simulation: str, quantity: str) -> np.ndarray:
        """RMSE from a "wide" prior, or where d has "driven" the heading."""
        return np.asarray(self.cell(simulation)[key])[_ERRORS.index(quantity)]

    def quiet(self, simulation: str, quantity: str, part: str, model: str = MODELS[0]) -> float:
        return float(self.cell(simulation, model)["quiet"][part][_ERRORS.index(quantity)])

    def bound(self, simulation: str, quantity: str, model: str = MODELS[0]) -> float:
        return float(self.cell(simulation, model)["bound"][QUANTITIES.index(quantity)])

    def possible(self, simulation: str, quantity: str) -> float:
        """The least that the printed filter errs by in readings of variance R: with process noise Q, or with none."""
        return min(self.bound(simulation, quantity), self.rmse(simulation, quantity, _STATED[simulation]).mean())

    def both_priors(self, simulation: str, quantity: str = _PREDICTED) -> str:
        """An error under both priors, the smaller first, or one number where rounding leaves one."""
        values = (self.rmse(simulation, quantity), self.other("wide", simulation, quantity))
        return " to ".join(sorted({f"{errors.mean():.4f}" for errors in values}))


def _printed(simulation: str, quantity: str) -> float:
    return SIMULATIONS[simulation].published(quantity)["mean"].value


def _span(values: np.ndarray) -> float:
    """Width of the middle 95 % over the mean, in %."""
    return 100.0 * float(np.subtract(*np.quantile(values, [0.975, 0.025])) / values.mean())


def page(results: Mapping[str, Mapping[str, Any]]) -> Page:
    """The page, from the values of `cells`."""
    r = _Results(results)
    compared = _comparisons(r)
    pairs = [(s, q, _printed(s, q), r.possible(s, q)) for s in SIMULATIONS for q in QUANTITIES]
    below = [pair for pair in pairs if pair[2] < pair[3]]
    tables = {
        "published": comparison_table("", "", compared, "published"), "overview": _overview(r),
        "settings": _factorial(r), "pairs": _pairs(), "predicted": _predictions(r), "simulation-v": _candidates(r),
    }  # fmt: skip
    printed_III = [float(value) for value in SIMULATIONS["III"].heading]
    return fill(
        "corvette", tables, {"rmse": _rmse_figure(r), "example": _example_figure(r)}, settings=settings, runs=r.runs,
        noise=_LOW, tally=tally(compared), stated=_STATED, below=len(below),
        below_small=sum(s != "V" for s, *_ in below), factors=[possible / printed for *_, printed, possible in below],
        exceptions=[dict(zip(("simulation", "quantity", "printed", "possible"), pair, strict=True))
                    for pair in pairs if pair not in below],
        least=sum(_printed(s, "unknown input") < stated / np.sqrt(2.0) for s, stated in _STATED.items()),
        predicted={s: r.both_priors(s) for s in SIMULATIONS}, means={s: v.mean_heading for s, v in SIMULATIONS.items()},
        input={s: r.both_priors(s, "unknown input") for s in SIMULATIONS},
        input_means={s: v.mean_unknown_input for s, v in SIMULATIONS.items()},
        allowed={s: allowed_noise(*(_printed(s, q) for q in QUANTITIES)) for s in SIMULATIONS},
        sd_V=np.std(r.rmse("V", "heading", _STATED["V"]), ddof=1),
        printed_spread=100.0 * np.ptp(printed_III) / _printed("III", "heading"),
        spans=[_span(r.rmse("III", "heading", level)) for level in (_NOISE, _STATED["III"])],
        left=[100.0 * left_of_start(SIMULATIONS[s].R, settings.PRIOR) for s in ("I", "III")],
        low={s: r.rmse(s, "heading").mean() for s in SIMULATIONS},
        high={s: r.rmse(s, "heading", LEVELS[2]).mean() for s in SIMULATIONS},
        quiet_d={s: r.quiet(s, "heading", "d") for s in SIMULATIONS}, rises=_rises(r),
        larger=_rise({q: (r.rmse("I", q), r.rmse("V", q)) for q in QUANTITIES}, "I", "V"),
        driven=_rise({q: (r.other("driven", "I", q), r.other("driven", "V", q)) for q in QUANTITIES}, "I", "V"),
        orders=[_order(r, f"{_LOW} rad", dict.fromkeys(SIMULATIONS, _NOISE)), _order(r, "√R of each", _STATED)],
        better=[
            sum(mean_of(r.rmse(s, "heading", x) - np.sqrt(2.0) * x).high < 0.0 for s, x in levels.items())
            for levels in (dict.fromkeys(SIMULATIONS, _NOISE), _STATED)
        ],
        diagonals="; ".join(f"{s}: {v.Q:g}, {v.R:g}" for s, v in SIMULATIONS.items()),
    )  # fmt: skip


def _comparisons(r: _Results) -> list[Comparison]:
    """All 40 printed numbers beside ours: the system as printed at the fixed noise."""
    return [
        Comparison(
            f"Simulation {simulation}, {quantity} ({s.where})", column, published,
            mean_of(r.rmse(simulation, quantity)), _reason(r, simulation, quantity, published.value),
        )
        for simulation, s in SIMULATIONS.items()
        for quantity in QUANTITIES
        for column, published in s.published(quantity).items()
    ]  # fmt: skip


def _reason(r: _Results, simulation: str, quantity: str, published: float) -> str:
    """Why ours is above a printed error: what the noise must give, or what is left without noise, and of what."""
    least = _NOISE / np.sqrt(2.0)
    if quantity == "unknown input" and published < least:
        return f"no unbiased estimate of d from two readings of this noise errs by less than {least:.4f}"
    parts = {part: r.quiet(simulation, quantity, part) for part in ("all", "turn", "d")}
    return (
        f"{parts['all']:.4f} without any noise ({parts['turn']:.4f} from learning the turn, {parts['d']:.4f} from d in "
        "the readings but not in the heading)"
    )


# --- claims -----------------------------------------------------------------------------------------

_STEPS = (
    ("Larger Q alone raises the error", "I", "II"),
    ("Larger Q raises the error where R is large already", "III", "IV"),
    ("Larger R alone raises the error", "I", "III"),
    ("Larger R raises the error where Q is large already", "II", "IV"),
    ("Larger Q and R together raise the error", "I", "IV"),
)


def _rises(r: _Results) -> list[dict[str, Any]]:
    """The claims on Q and R, at the fixed noise and at that of each R."""
    found = []
    for text, before, after in _STEPS:
        same_ratio = SIMULATIONS[before].Q * SIMULATIONS[after].R == SIMULATIONS[after].Q * SIMULATIONS[before].R
        for noise, levels in ((f"{_LOW} rad", (_NOISE, _NOISE)), ("√R of each", (_STATED[before], _STATED[after]))):
            pairs = {q: (r.rmse(before, q, levels[0]), r.rmse(after, q, levels[1])) for q in QUANTITIES}
            found.append(_rise(pairs, before, after) | {"text": text, "noise": noise, "same_ratio": same_ratio})
    return found


def _rise(pairs: Mapping[str, tuple[np.ndarray, np.ndarray]], before: str, after: str) -> dict[str, Any]:
    """Verdict on a rise from the first to the second of each pair, in heading and unknown input alike."""
    rises = {q: paired_difference(second, first) for q, (first, second) in pairs.items()}
    tiny = 1e-9  # rad: differences of rounding are none
    signs = {int(np.sign(i.mean)) if i and i.excludes_zero and abs(i.mean) > tiny else 0 for i in rises.values()}
    change = ", ".join(f"{q} × {second.mean() / first.mean():#.3g}" for q, (first, second) in pairs.items())
    said = f"{'true' if signs == {1} else 'false' if signs == {-1} else 'undecided'}, {change}"
    return {
        "before": before, "after": after, "verdict": "false, no detectable difference" if signs == {0} else said,
        "evidence": "; ".join(f"{q} {_mrad(rise)}" for q, rise in rises.items()),
        "printed": ", ".join(f"{q} × {_printed(after, q) / _printed(before, q):#.3g}" for q in QUANTITIES),
    }  # fmt: skip


def _mrad(rise: Interval | None) -> str:
    """A difference in words, of rounding errors none."""
    if rise is not None:
        rise = Interval(*(round(1e3 * x, 6) + 0.0 for x in (rise.mean, rise.low, rise.high)))
    return f"{words(rise, 3, signed=True)} mrad"


def _order(r: _Results, noise: str, levels: Mapping[str, float]) -> dict[str, Any]:
    """The thesis' remark below Table 4.8, with a noise for each simulation."""
    differences = {
        s: paired_difference(r.rmse(s, "heading", x), r.rmse(s, "unknown input", x)) for s, x in levels.items()
    }
    shown = sum(i is not None and i.low > 0.0 for i in differences.values())
    reverse = any(i is not None and i.high < 0.0 for i in differences.values())
    return {
        "noise": noise, "shown": shown,
        "verdict": "false" if reverse else "true" if shown == len(levels) else "undecided",
        "evidence": "; ".join(f"{s} {_mrad(i)}" for s, i in differences.items()),
    }  # fmt: skip


# --- tables -----------------------------------------------------------------------------------------


def _rmse_entry(r: _Results, simulation: str, quantity: str, level: float, model: str = MODELS[0]) -> Entry:
    return entry(mean_of(r.rmse(simulation, quantity, level, model)), 5 if level == _NOISE else 4)


def _overview(r: _Results) -> Table:
    def line(s: str, q: str) -> list[Entry]:
        errors = [_rmse_entry(r, s, q, level, model) for level in (_NOISE, _STATED[s]) for model in MODELS]
        bounds = [Entry(number(r.bound(s, q, model), 4)) for model in MODELS]
        return [Entry(SIMULATIONS[s].published(q)["mean"].printed), *errors, *bounds]

    labels = [f"{model}, noise {level}" for level in (_LOW, "√R") for model in MODELS]
    head = [(label, "rad") for label in ("published", *labels, *(f"bound, {model}" for model in MODELS))]
    return Table(
        "", "", "simulation", head, [(q, [(s, line(s, q)) for s in SIMULATIONS]) for q in QUANTITIES], "overview"
    )


def _factorial(r: _Results) -> Table:
    names = {s: f"{s}: Q = {v.Q:g}, R = {v.R:g}" for s, v in SIMULATIONS.items() if s != "V"}
    sections = [
        (q, [(name, [_rmse_entry(r, s, q, level) for level in LEVELS]) for s, name in names.items()])
        for q in QUANTITIES
    ]
    return Table("", "", "filter", [(f"noise {level:.3g}", "rad") for level in LEVELS], sections, "settings")


def _pairs() -> Table:
    def line(simulation: str) -> list[Entry]:
        s, pair = SIMULATIONS[simulation], [_printed(simulation, q) for q in QUANTITIES]
        values = ((pair[0] / pair[1], 1), *((noise, 4) for noise in (*allowed_noise(*pair), _STATED[simulation])))
        return [Entry(s.mean_heading), Entry(s.mean_unknown_input), *(Entry(number(*value)) for value in values)]

    head = [("ψ printed", "rad"), ("d printed", "rad"), ("ψ : d", ""), ("σ at least", "rad"), ("σ at most", "rad"),
            ("√R", "rad")]  # fmt: skip
    return Table("", "", "simulation", head, [("", [(s, line(s)) for s in SIMULATIONS])], "pairs")


def _predictions(r: _Results) -> Table:
    def line(name: str) -> list[Entry]:
        s = SIMULATIONS[name]
        errors = [r.rmse(name, "heading"), r.rmse(name, _PREDICTED), r.other("wide", name, _PREDICTED)]
        inputs = [r.rmse(name, "unknown input"), r.other("wide", name, "unknown input")]
        left, right = ([entry(mean_of(values), 5) for values in each] for each in (errors, inputs))
        return [Entry(s.mean_heading), *left, Entry(s.mean_unknown_input), *right]

    wide = f"P₀ = {settings.WIDE_PRIOR:g}"
    labels = ("ψ printed", "after the reading", "predicted", f"predicted, {wide}", "d printed", "d", f"d, {wide}")
    head = [(label, "rad") for label in labels]
    return Table("", "", "simulation", head, [("", [(s, line(s)) for s in SIMULATIONS])], "predicted")


def _candidates(r: _Results) -> Table:
    parts = {"d up until the middle": "all", "d up for one sample": "literal", "no d at all": "turn"}

    def line(part: str, model: str) -> list[Entry]:
        errors = [r.quiet("V", q, part, model) for q in _ERRORS]
        return [*(Entry(number(value, 4)) for value in errors), Entry(number(errors[0] / errors[1], 2))]

    ratio = number(_printed("V", "heading") / _printed("V", "unknown input"), 2)
    published = [SIMULATIONS["V"].mean_heading, SIMULATIONS["V"].mean_unknown_input, "–", ratio]
    sections = [("", [("published", [Entry(value) for value in published])])]
    sections += [(model, [(name, line(part, model)) for name, part in parts.items()]) for model in MODELS]
    head = [("heading", "rad"), ("d", "rad"), (_PREDICTED, "rad"), ("ratio", "")]
    return Table("", "", "", head, sections, "simulation-v")


# --- figures ----------------------------------------------------------------------------------------


@drawing(7.2, 3.7)
def _rmse_figure(canvas: "Figure", r: _Results) -> None:
    """RMSE by simulation, both quantities, with printed values and bounds."""
    series = [
        (f"{model}, noise {name}", model, levels, colour, marker)
        for name, levels, colours in (
            (f"{_LOW} rad", dict.fromkeys(SIMULATIONS, _NOISE), (TRUE, BELIEVED)), ("√R", _STATED, PALETTE[2:4]),
        )
        for model, colour, marker in zip(MODELS, colours, "os", strict=True)
    ]  # fmt: skip
    panels = canvas.subplots(1, 2, sharey=True)
    x = np.arange(len(SIMULATIONS))
    for panel, quantity in zip(panels, QUANTITIES, strict=True):
        for i, (label, model, levels, colour, marker) in enumerate(series):
            shown = [mean_of(r.rmse(s, quantity, levels[s], model)) for s in SIMULATIONS]
            panel.errorbar(
                x + 0.12 * (i - 1.5), [m.mean for m in shown], [m.half for m in shown], color=colour, marker=marker,
                markersize=4, markerfacecolor="white" if model == "corrected" else colour, elinewidth=1.0,
                capsize=2.0, linestyle="none", label=label,
            )  # fmt: skip
        _printed_and_bounds(panel, r, quantity)
        panel.set_yscale("log")
        panel.set_xticks(x, list(SIMULATIONS))
        panel.set_xlabel("simulation")
        panel.set_title({"heading": "heading ψ", "unknown input": "unknown input d"}[quantity], loc="left")
        panel.grid(axis="y")
    panels[0].set_ylabel("RMSE [rad]")
    canvas.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)


def _printed_and_bounds(panel: "Axes", r: _Results, quantity: str) -> None:
    """The three printed runs of each simulation as crosses, and the bound as a line across."""
    for i, (name, s) in enumerate(SIMULATIONS.items()):
        runs = [published.value for column, published in s.published(quantity).items() if column != "mean"]
        panel.plot(
            [i - 0.34] * 3, runs, color=PUBLISHED, marker="x", markersize=5, linestyle="none",
            label="published runs" if i == 0 else None,
        )  # fmt: skip
        panel.plot(
            [i - 0.42, i + 0.42], [r.bound(name, quantity)] * 2, color=INK, linewidth=1.0,
            label="bound, printed filter" if i == 0 else None,
        )  # fmt: skip


@drawing(7.2, 7.6)
def _example_figure(canvas: "Figure", r: _Results) -> None:
    """Heading, its error and the unknown input of the first run of each simulation."""
    rows = canvas.subplots(len(SIMULATIONS), 3, sharex=True)
    k = np.arange(SAMPLES)
    for name, panels in zip(SIMULATIONS, rows, strict=True):
        example = r.cell(name)["example"]
        errors = np.asarray(example["errors"])
        for panel, quantity, error in zip((panels[0], panels[2]), QUANTITIES, errors, strict=True):
            truth = np.asarray(example[quantity])
            panel.plot(k, truth, color=TRUE, linewidth=1.6, label="real")
            panel.plot(k, truth + error, color=BELIEVED, linestyle="--", linewidth=1.0, label="estimated")
        panels[1].axhline(0.0, color=INK, linewidth=0.6)
        panels[1].plot(k, errors[0], color=BELIEVED, linewidth=0.8)
        for sign in (-1.0, 1.0):
            panels[1].axhline(sign * _printed(name, "heading"), color=PUBLISHED, linewidth=0.8, linestyle=":")
        for panel, label in zip(panels, (f"{name}: ψ [rad]", "ψ̂ − ψ [rad]", "d [rad]"), strict=True):
            panel.set_ylabel(label)
        panels[0].set_ylim(-0.5, 7.0)
        panels[2].margins(y=0.2)
        for panel in panels:
            panel.grid()
            panel.margins(x=0.01)
    for panel, title in zip(rows[0], ("heading", "error of the heading", "unknown input"), strict=True):
        panel.set_title(title, loc="left")
    for panel in rows[-1]:
        panel.set_xlabel("sample")
    handles, labels = rows[0, 0].get_legend_handles_labels()
    printed = rows[0, 1].get_lines()[-1]
    canvas.legend([*handles, printed], [*labels, "± published RMSE"], loc="outside upper right", ncols=3)
    canvas.align_ylabels()
