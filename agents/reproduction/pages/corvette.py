"""The page on Hermawan's five simulations: the tables of the thesis beside ours."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.page import Bullets, Claim, Claims, Entry, Facts, Figure, Page, Prose, Section, Table, entry, number, words
from agents.plotting import BELIEVED, INK, PALETTE, PUBLISHED, TRUE, data_uri, styled
from agents.reproduction.comparison import Comparison, tally
from agents.reproduction.corvette import LEVELS, MODELS
from agents.reproduction.pages.comparison import comparison_table
from agents.reproduction.settings import corvette as settings
from agents.reproduction.settings.corvette import QUANTITIES, SAMPLES, SIMULATIONS
from agents.statistics import Interval, mean_interval, paired_difference

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LOW = f"{settings.NOISE:g}"
_PREDICTED = "predicted heading"
_ERRORS = (*QUANTITIES, _PREDICTED)


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


@dataclass(frozen=True)
class _Results:
    """The cells' values, by simulation, model and noise."""

    values: Mapping[str, Mapping[str, Any]]

    def cell(self, simulation: str, model: str = MODELS[0]) -> Mapping[str, Any]:
        return self.values[f"{simulation}, {model}"]

    def rmse(self, simulation: str, quantity: str, level: float = LEVELS[0], model: str = MODELS[0]) -> np.ndarray:
        return np.asarray(self.cell(simulation, model)["rmse"][f"{level:.4f}"])[_ERRORS.index(quantity)]

    def wide(self, simulation: str, quantity: str) -> np.ndarray:
        return np.asarray(self.cell(simulation)["wide"])[_ERRORS.index(quantity)]

    def driven(self, simulation: str, quantity: str) -> np.ndarray:
        return np.asarray(self.cell(simulation)["driven"])[_ERRORS.index(quantity)]

    def quiet(self, simulation: str, quantity: str, part: str, model: str = MODELS[0]) -> float:
        return float(self.cell(simulation, model)["quiet"][part][_ERRORS.index(quantity)])

    def bound(self, simulation: str, quantity: str, model: str = MODELS[0]) -> float:
        return float(self.cell(simulation, model)["bound"][QUANTITIES.index(quantity)])

    @property
    def runs(self) -> int:
        return self.rmse("I", "heading").size


def _mean(values: np.ndarray) -> Interval:
    interval = mean_interval(values)
    assert interval is not None
    return interval


def _stated(simulation: str) -> float:
    """The noise [rad] that a simulation's R means as a variance."""
    return SIMULATIONS[simulation].R ** 0.5


def page(results: Mapping[str, Mapping[str, Any]]) -> Page:
    """The page, from the values of `cells`."""
    r = _Results(results)
    compared = _comparisons(r)
    claims = _claims(r)
    below = [(s, q) for s in SIMULATIONS for q in QUANTITIES if _printed(s, q) < _possible(r, s, q)]
    small = sum(s != "V" for s, _ in below)
    return Page(
        title="KF-UMV-UI on a corvette",
        subtitle=f"{settings.PAPER}; {r.runs} runs of each simulation",
        answer=[
            f"At one reading noise of {_LOW} rad for all cells, {tally(compared)}.",
            f"Scored before the reading, the heading errs by {_predicted_range(r, 'I')} rad in I and by "
            f"{_predicted_range(r, 'V')} rad in V, printed as {SIMULATIONS['I'].mean_heading} and "
            f"{SIMULATIONS['V'].mean_heading}: the thesis may have scored its predictions. The headings of II to IV "
            "are not explained so.",
            f"{small} of the 8 means of simulations I to IV, and {len(below) - small} of the 2 of V, lie below what "
            "the filter can do if the stated R is the noise, whether its Q is true or there is no process noise at "
            "all.",
            "The filter's equations tie the error of d to that of the heading after the reading; no single noise "
            "satisfies the printed pairs of I and V together, although both state the same R. Predictions are not tied "
            "so.",
            "At a given noise the filter depends on Q and R only through their ratio, once it has settled: the printed "
            "rise from I to IV is no property of the filter.",
            f"Larger Q alone lowers the error at {_LOW} rad and larger R raises it, by a slower filter; where R is "
            "the noise, both raise it.",
            "A larger d raises the error only because d is in the readings and not in the heading: where d drives "
            "the heading as the model says, the error does not depend on it.",
        ],
        sections=[
            Section("The printed results and ours", [
                comparison_table(
                    "Every printed RMSE beside ours",
                    f"The system as printed, reading noise {_LOW} rad; ours, after the reading: mean and 95 % interval "
                    f"over {r.runs} runs, the same for the three runs of a simulation and their mean. Reasons: error "
                    "without noise, and its parts, measured on the same record; the parts add with their signs and may "
                    "cancel.",
                    compared, "published",
                ),
                _overview(r),
                Figure(_rmse_figure(r), "RMSE of heading and unknown input",
                       "Bars of 95 % are smaller than the markers where they are not seen. Crimson: the printed runs. "
                       "Black line: what the covariances of the printed filter settle at, its error if Q and R were "
                       "true; ours has no process noise and errs a little less."),
            ]),
            Section("The simulations", [
                Figure(_example_figure(r), "Heading and unknown input, real and estimated",
                       f"The first run of each, the system as printed, reading noise {_LOW} rad; thesis' "
                       "figures 4.1 to 4.10. In between, the heading's error, which they do not show: the filter has "
                       "to learn the turn, and the step of d. Scales of the error and of d differ."),
            ]),
            Section("The thesis' claims", [
                Claims(claims, f"The system as printed; paired over {r.runs} runs with equal noise draws, 95 % "
                       f"intervals. At {_LOW} rad, and wherever R stays, only the filter's setting changes; elsewhere "
                       "the noise, too."),
                _factorial(r),
                Prose(_reading_of_factorial(r)),
            ]),
            Section("Where the printed errors may come from", [
                _bounds_text(r, below),
                _pairs(),
                Prose(_pairs_text(r)),
                _predictions(r),
                Prose(_predictions_text(r)),
                _candidates(r),
            ]),
            Section("Settings", [Facts("What the thesis prints", [
                ("Model", "eqs. 4.3 to 4.5"),
                ("Step and rudder", f"{settings.PRINTED_STEP:g} s and {settings.PRINTED_RUDDER:g}°"),
                ("Samples", f"{SAMPLES}"),
                ("Diagonals of Q, R", "; ".join(f"{s}: {v.Q:g}, {v.R:g}" for s, v in SIMULATIONS.items())),
                ("Start", "zero, Table 4.3"),
            ]), Facts("What we assumed where it is silent", [
                ("Reading noise", settings.NOISE_REASON),
                ("Trial record", settings.RECORD_REASON),
                ("Unknown input", settings.INPUT_REASON),
                ("Real heading", settings.TRUTH_REASON),
                ("Initial covariance", settings.PRIOR_REASON),
                ("Corrected model", "This package's linear model of the ship in its turn, stepped as the record "
                 "is, with the same Q, R and readings; it knows the rudder and the commanded yaw rate."),
            ])]),
            Section("Misprints that matter here", [Bullets(settings.MISPRINTS)]),
        ],
    )  # fmt: skip


def _possible(r: _Results, simulation: str, quantity: str) -> float:
    """The least that the printed filter errs by in readings of variance R: with process noise Q, or with none."""
    return min(r.bound(simulation, quantity), _mean(r.rmse(simulation, quantity, _stated(simulation))).mean)


def _decimals(level: float) -> int:
    """Decimals that an RMSE [rad] at a noise deserves."""
    return 5 if level == settings.NOISE else 4


def _printed(simulation: str, quantity: str) -> float:
    return SIMULATIONS[simulation].published(quantity)["mean"].value


def _comparisons(r: _Results) -> list[Comparison]:
    """All 40 printed numbers beside ours: the system as printed at the fixed noise."""
    return [
        Comparison(
            f"Simulation {simulation}, {quantity} ({s.where})",
            column,
            published,
            _mean(r.rmse(simulation, quantity)),
            _reason(r, simulation, quantity, published.value),
        )
        for simulation, s in SIMULATIONS.items()
        for quantity in QUANTITIES
        for column, published in s.published(quantity).items()
    ]


def _reason(r: _Results, simulation: str, quantity: str, published: float) -> str:
    """Why ours is above a printed error: what the noise must give, or what is left without noise, and of what."""
    least = settings.NOISE / np.sqrt(2.0)
    if quantity == "unknown input" and published < least:
        return f"no unbiased estimate of d from two readings of this noise errs by less than {least:.4f}"
    parts = {part: r.quiet(simulation, quantity, part) for part in ("all", "turn", "d")}
    return (
        f"{parts['all']:.4f} without any noise ({parts['turn']:.4f} from learning the turn, {parts['d']:.4f} from d in "
        "the readings but not in the heading)"
    )


def _overview(r: _Results) -> Table:
    def line(simulation: str, quantity: str) -> list[Entry]:
        errors = [
            entry(_mean(r.rmse(simulation, quantity, level, model)), _decimals(level))
            for level in (settings.NOISE, _stated(simulation))
            for model in MODELS
        ]
        bounds = [Entry(number(r.bound(simulation, quantity, model), 4)) for model in MODELS]
        return [Entry(SIMULATIONS[simulation].published(quantity)["mean"].printed), *errors, *bounds]

    head = [("published", "rad")] + [(f"{model}, noise {level}", "rad") for level in (_LOW, "√R") for model in MODELS]
    return Table(
        "Mean RMSE under both readings of the noise, and the filter's own bound",
        f"Two models of the ship; noise of standard deviation {_LOW} rad, or √R (0.032 rad in I, II and V, 1 rad in "
        "III and IV). Bound: √P₃₃ and √P_d that the filter's own covariances settle at, its RMSE if the stated Q "
        "and R were true. Our record has no process noise, so that at √R the filter errs less than its bound, unless d "
        "adds more than that (V, corrected).",
        "simulation",
        head + [(f"bound, {model}", "rad") for model in MODELS],
        [(q, [(s, line(s, q)) for s in SIMULATIONS]) for q in QUANTITIES],
        "overview",
    )  # fmt: skip


def _factorial(r: _Results) -> Table:
    def line(simulation: str, quantity: str) -> list[Entry]:
        return [entry(_mean(r.rmse(simulation, quantity, level)), _decimals(level)) for level in LEVELS]

    settings_of = {s: f"{s}: Q = {v.Q:g}, R = {v.R:g}" for s, v in SIMULATIONS.items() if s != "V"}
    return Table(
        "Setting of the filter against noise of the readings: RMSE",
        "Rows: what the filter is told. Columns: what the readings have. The system as printed; d of size 0.01 rad.",
        "filter",
        [(f"noise {level:.3g}", "rad") for level in LEVELS],
        [(q, [(name, line(s, q)) for s, name in settings_of.items()]) for q in QUANTITIES],
        "settings",
    )


def _reading_of_factorial(r: _Results) -> str:
    def heading(simulation: str, level: float) -> str:
        return number(_mean(r.rmse(simulation, "heading", level)).mean, 4)

    return (
        f"Down a column only the filter changes, along a row only the noise. With {_LOW} rad the heading errs by "
        f"{heading('I', LEVELS[0])} (I), {heading('II', LEVELS[0])} (II), {heading('III', LEVELS[0])} (III) and "
        f"{heading('IV', LEVELS[0])} rad (IV): a larger Q makes the filter follow the readings, a larger R makes it "
        "slow to learn the turn, and both together cancel. With 1 rad the heading errs by "
        f"{heading('I', LEVELS[2])}, {heading('II', LEVELS[2])}, {heading('III', LEVELS[2])} and "
        f"{heading('IV', LEVELS[2])} rad: the filter of III is then the best of the four. So where III errs more "
        f"than I at {_LOW} rad, it is the filter's setting; where it does at √R, it is the noise. Were there process "
        "noise of variance Q as well, the bounds above would be the errors: they rise with Q and with R."
    )


def _claims(r: _Results) -> list[Claim]:
    steps = [
        ("Larger Q alone raises the error (I → II)", "I", "II"),
        ("Larger Q raises the error where R is large already (III → IV)", "III", "IV"),
        ("Larger R alone raises the error (I → III)", "I", "III"),
        ("Larger R raises the error where Q is large already (II → IV)", "II", "IV"),
        ("Larger Q and R together raise the error (I → IV)", "I", "IV"),
    ]
    rows = []
    for text, before, after in steps:
        for name, levels in (
            (f"noise {_LOW} rad", (settings.NOISE, settings.NOISE)),
            ("noise √R of each", (_stated(before), _stated(after))),
        ):
            pairs = {q: (r.rmse(before, q, levels[0]), r.rmse(after, q, levels[1])) for q in QUANTITIES}
            same_gain = SIMULATIONS[before].Q * SIMULATIONS[after].R == SIMULATIONS[after].Q * SIMULATIONS[before].R
            why = (
                " Q/R is the same, so the settled filter is; only the start from a fixed P₀ differs."
                if same_gain
                else ""
            )
            rows.append(_rise(f"{text}; {name}", pairs, _printed_rise(before, after) + why))
    rows.append(
        _rise(
            "A larger unknown input raises the error (I → V); d in the readings only",
            {q: (r.rmse("I", q), r.rmse("V", q)) for q in QUANTITIES},
            f"{_printed_rise('I', 'V')} Without noise d adds {r.quiet('I', 'heading', 'd'):.5f} rad to the heading "
            f"in I and {r.quiet('V', 'heading', 'd'):.5f} in V, ten times as much: a model error, proportional to d.",
        )
    )
    rows.append(
        _rise(
            "The same (I → V); d drives the heading too, as eq. 4.4 says",
            {q: (r.driven("I", q), r.driven("V", q)) for q in QUANTITIES},
            " An unbiased filter's error does not depend on d.",
        )
    )
    fixed, stated = dict.fromkeys(SIMULATIONS, settings.NOISE), {s: _stated(s) for s in SIMULATIONS}
    return [*rows, _order(r, f"noise {_LOW} rad", fixed), _order(r, "noise √R of each", stated), _small(r)]


def _rise(text: str, pairs: Mapping[str, tuple[np.ndarray, np.ndarray]], more: str = "") -> Claim:
    """Whether the second of each pair is larger, in heading and unknown input alike."""
    rises = {q: paired_difference(after, before) for q, (before, after) in pairs.items()}
    tiny = 1e-9  # rad: differences of rounding are none
    signs = {int(np.sign(i.mean)) if i and i.excludes_zero and abs(i.mean) > tiny else 0 for i in rises.values()}
    change = ", ".join(f"{q} × {after.mean() / before.mean():#.3g}" for q, (before, after) in pairs.items())
    if signs == {0}:
        verdict = "false, no detectable difference"
    else:
        verdict = f"{'true' if signs == {1} else 'false' if signs == {-1} else 'undecided'}, {change}"
    evidence = "; ".join(f"{q} {_mrad(rise)}" for q, rise in rises.items())
    return Claim(text, verdict, f"{evidence}.{more}")


def _printed_rise(before: str, after: str) -> str:
    factors = ", ".join(f"{q} × {_printed(after, q) / _printed(before, q):#.3g}" for q in QUANTITIES)
    return f" Printed: {factors}."


def _mrad(rise: Interval | None) -> str:
    """A difference in words, of rounding errors none."""
    if rise is not None:
        rise = Interval(*(round(1e3 * x, 6) + 0.0 for x in (rise.mean, rise.low, rise.high)))
    return f"{words(rise, 3, signed=True)} mrad"


def _order(r: _Results, noise: str, levels: Mapping[str, float]) -> Claim:
    """The thesis' remark below Table 4.8, with a noise for each simulation."""
    differences = {
        s: paired_difference(r.rmse(s, "heading", x), r.rmse(s, "unknown input", x)) for s, x in levels.items()
    }
    shown = [s for s, i in differences.items() if i and i.low > 0.0]
    reverse = [s for s, i in differences.items() if i and i.high < 0.0]
    verdict = "false" if reverse else "true" if len(shown) == len(levels) else "undecided"
    return Claim(
        f"The RMSE of d is below that of the heading in all five simulations; {noise}",
        f"{verdict}, shown in {len(shown)} of {len(levels)}",
        f"Heading less d: {'; '.join(f'{s} {_mrad(i)}' for s, i in differences.items())}. Given the heading, d is "
        "the mean of two readings: it has half of the heading's error, and half of the noise of each.",
    )


def _small(r: _Results) -> Claim:
    """Conclusion 1: the error is "relatively small". Against what the readings give without a filter."""
    differences = {
        (s, level): _mean(r.rmse(s, "heading", level) - np.sqrt(2.0) * level)
        for s in SIMULATIONS
        for level in (settings.NOISE, _stated(s))
    }
    better = {name: [i.high < 0.0 for (s, x), i in differences.items() if (x == settings.NOISE) is low]
              for name, low in ((f"{_LOW} rad", True), ("√R", False))}  # fmt: skip
    counts = [f"{sum(of)} of {len(of)} simulations at noise {name}" for name, of in better.items()]
    everywhere = all(all(of) for of in better.values())
    return Claim(
        "The RMSE is relatively small",
        "true" if everywhere else "undecided, it depends on the noise",
        "The difference of the two readings, y₁ − y₂, is the heading with an error of √2 σ and no filter at all. "
        f"The filter beats it in {counts[0]} and {counts[1]}.",
    )


def _bounds_text(r: _Results, below: list[tuple[str, str]]) -> Prose:
    above = [(s, q) for s in SIMULATIONS for q in QUANTITIES if (s, q) not in below]
    rest = "".join(
        f" The exception is the {q} of {s}: {_printed(s, q):.4f} printed, {_possible(r, s, q):.4f} rad possible."
        for s, q in above
    )
    factors = [_possible(r, s, q) / _printed(s, q) for s, q in below]
    least = [q for q in SIMULATIONS if _printed(q, "unknown input") < _stated(q) / np.sqrt(2.0)]
    return Prose(
        f"If R is the variance of the readings, {len(below)} of the 10 means of Table 4.9 lie below both what the "
        "filter's covariances settle at, its error if Q is true as well, and what it errs by on our record, which has "
        f"no process noise: by factors from {min(factors):.0f} to {max(factors):.0f}.{rest} For d no unbiased filter "
        "does better, whatever its Q: two readings show it to no better than √(R/2), "
        f"{_stated('I') / np.sqrt(2.0):.4f} rad in I, II and V and {_stated('III') / np.sqrt(2.0):.2f} rad in III and "
        f"IV, and the printed error of d is below it in {len(least)} of 5. So R is what the filter was told, not the "
        "noise that was simulated."
    )


def _pairs() -> Table:
    def line(simulation: str) -> list[Entry]:
        s, pair = SIMULATIONS[simulation], [_printed(simulation, q) for q in QUANTITIES]
        low, high = allowed_noise(*pair)
        return [
            Entry(s.mean_heading), Entry(s.mean_unknown_input), Entry(number(pair[0] / pair[1], 1)),
            Entry(number(low, 4)), Entry(number(high, 4)), Entry(number(_stated(simulation), 4)),
        ]  # fmt: skip

    return Table(
        "The reading noise that a printed pair of errors allows",
        "Of the estimates after the reading, 2 (d̂ − d) + (ψ̂ − ψ) = v₁ + v₂ holds at every sample for this filter "
        "with R a multiple of identity, whatever its A, G and Q; so √2 σ lies between |ψ − 2 d| and ψ + 2 d of the "
        "RMSE. Without noise ψ : d is 2.",
        "simulation",
        [("ψ printed", "rad"), ("d printed", "rad"), ("ψ : d", ""), ("σ at least", "rad"), ("σ at most", "rad"),
         ("√R", "rad")],
        [("", [(s, line(s)) for s in SIMULATIONS])],
        "pairs",
    )  # fmt: skip


def _pairs_text(r: _Results) -> str:
    ranges = {s: allowed_noise(*(_printed(s, q) for q in QUANTITIES)) for s in SIMULATIONS}
    spread = np.ptp([float(value) for value in SIMULATIONS["III"].heading])
    return (
        f"I needs a noise of at most {ranges['I'][1]:.4f} rad, V one of at least {ranges['V'][0]:.4f}: no level fits "
        "both, and both have the same Q and R. So the two printed headings are not both this filter's after the "
        f"reading, or the noise was not the same. Our {_LOW} rad, taken from the d of II, is below what the pairs of I "
        "and II ask for: the heading error printed there is larger than this filter has, after the reading, with so "
        "good a d. The three runs of V are printed alike to four digits; with noise of 0.032 rad ours differ by a "
        f"standard deviation of {np.std(r.rmse('V', 'heading', _stated('V')), ddof=1):.4f} rad. In III the three "
        f"printed headings are {100 * spread / _printed('III', 'heading'):.0f} % of their mean apart; the middle 95 % "
        f"of our {r.runs} runs span {100 * _span(r.rmse('III', 'heading')):.0f} % at {_LOW} rad and "
        f"{100 * _span(r.rmse('III', 'heading', _stated('III'))):.0f} % at √R. Errors that differ more may come from "
        "a few samples, as the jump at the start that the text describes would."
    )


def _span(values: np.ndarray) -> float:
    """Width of the middle 95 % over the mean."""
    return float(np.subtract(*np.quantile(values, [0.975, 0.025])) / values.mean())


def _predictions(r: _Results) -> Table:
    def line(simulation: str) -> list[Entry]:
        s = SIMULATIONS[simulation]
        errors = [r.rmse(simulation, "heading"), r.rmse(simulation, _PREDICTED), r.wide(simulation, _PREDICTED)]
        inputs = [values(simulation, "unknown input") for values in (r.rmse, r.wide)]
        return [
            Entry(s.mean_heading), *(entry(_mean(values), 5) for values in errors),
            Entry(s.mean_unknown_input), *(entry(_mean(values), 5) for values in inputs),
        ]  # fmt: skip

    wide = f"P₀ = {settings.WIDE_PRIOR:g}"
    return Table(
        "The heading scored before the reading",
        f"RMSE, the system as printed, reading noise {_LOW} rad, mean and 95 % interval over {r.runs} runs. P₀ = "
        f"{settings.PRIOR:g} where no other stands.",
        "simulation",
        [("ψ printed", "rad"), ("after the reading", "rad"), ("predicted", "rad"), (f"predicted, {wide}", "rad"),
         ("d printed", "rad"), ("d", "rad"), (f"d, {wide}", "rad")],
        [("", [(s, line(s)) for s in SIMULATIONS])],
        "predicted",
    )  # fmt: skip


def _predicted_range(r: _Results, simulation: str, quantity: str = _PREDICTED) -> str:
    """An error under both priors, the smaller first, or one number where rounding leaves one."""
    both = {f"{_mean(values(simulation, quantity)).mean:.4f}" for values in (r.rmse, r.wide)}
    return " to ".join(sorted(both))


def _predictions_text(r: _Results) -> str:
    rest = "; ".join(
        f"{s} {_predicted_range(r, s)} ({SIMULATIONS[s].mean_heading})" for s in SIMULATIONS if s not in ("I", "V")
    )
    left = [100.0 * left_of_start(SIMULATIONS[s].R, settings.PRIOR) for s in ("I", "III")]
    return (
        "A program that stores one heading a sample may have stored the filter's prediction, made before the reading. "
        "Scored so, by the two P₀ and with the printed value in brackets, the heading errs by "
        f"{_predicted_range(r, 'I')} rad in I ({SIMULATIONS['I'].mean_heading}) and by {_predicted_range(r, 'V')} in V "
        f"({SIMULATIONS['V'].mean_heading}), where d, which is not predicted, errs by "
        f"{_predicted_range(r, 'V', 'unknown input')} ({SIMULATIONS['V'].mean_unknown_input}). That leaves open the "
        f"headings of the others, {rest}, and the d of I, {_predicted_range(r, 'I', 'unknown input')} "
        f"({SIMULATIONS['I'].mean_unknown_input}). P₀ is open, too. If the jump at the start that the text describes "
        "is a first heading that is not zero, as the filter's is, the second prediction keeps the share R / (P₀ + 2 R) "
        f"of it: {left[0]:.0f} % in I and {left[1]:.0f} % in III with P₀ = {settings.PRIOR:g}. A jump that is over "
        "after one sample asks for a P₀ that is large beside R."
    )


def _candidates(r: _Results) -> Table:
    parts = {"d up until the middle": "all", "d up for one sample": "literal", "no d at all": "turn"}

    def line(part: str, model: str) -> list[Entry]:
        errors = [r.quiet("V", q, part, model) for q in _ERRORS]
        return [*(Entry(number(value, 4)) for value in errors), Entry(number(errors[0] / errors[1], 2))]

    published = [*(Entry(SIMULATIONS["V"].published(q)["mean"].printed) for q in QUANTITIES), Entry("–")]
    ratio = Entry(number(_printed("V", "heading") / _printed("V", "unknown input"), 2))
    return Table(
        "Simulation V without noise: what could give the printed errors",
        "RMSE of one run without noise; ratio: of the heading after the reading to d, which is 2 without noise. Up for "
        "one sample only, the d of the printed filter would err less than the published one: the form of d decides "
        "those four cells.",
        "",
        [("heading", "rad"), ("d", "rad"), (_PREDICTED, "rad"), ("ratio", "")],
        [("", [("published", [*published, ratio])]),
         *((model, [(name, line(part, model)) for name, part in parts.items()]) for model in MODELS)],
        "simulation-v",
    )  # fmt: skip


# --- figures ----------------------------------------------------------------------------------------


def _rmse_figure(r: _Results) -> str:
    """RMSE by simulation, both quantities, with printed values and bounds."""
    from matplotlib.figure import Figure as Canvas

    series = [
        (f"{model}, noise {name}", model, stated, colour, marker)
        for (name, stated), colours in (
            ((f"{_LOW} rad", False), (TRUE, BELIEVED)), (("√R", True), (PALETTE[2], PALETTE[3])),
        )
        for model, colour, marker in zip(MODELS, colours, "os", strict=True)
    ]  # fmt: skip
    with styled():
        canvas = Canvas(figsize=(7.2, 3.7), layout="constrained")
        panels = canvas.subplots(1, 2, sharey=True)
        x = np.arange(len(SIMULATIONS))
        for panel, quantity in zip(panels, QUANTITIES, strict=True):
            for i, (label, model, stated, colour, marker) in enumerate(series):
                shown = [
                    _mean(r.rmse(s, quantity, _stated(s) if stated else settings.NOISE, model)) for s in SIMULATIONS
                ]
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
        return data_uri(canvas)


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


def _example_figure(r: _Results) -> str:
    """Heading, its error and the unknown input of the first run of each simulation."""
    from matplotlib.figure import Figure as Canvas

    with styled():
        canvas = Canvas(figsize=(7.2, 7.6), layout="constrained")
        rows = canvas.subplots(len(SIMULATIONS), 3, sharex=True)
        for name, panels in zip(SIMULATIONS, rows, strict=True):
            example = r.cell(name)["example"]
            k = np.arange(SAMPLES)
            truths = [np.asarray(example[q]) for q in QUANTITIES]
            errors = np.asarray(example["errors"])
            for panel, truth, error in zip((panels[0], panels[2]), truths, errors, strict=True):
                panel.plot(k, truth, color=TRUE, linewidth=1.6, label="real")
                panel.plot(k, truth + error, color=BELIEVED, linestyle="--", linewidth=1.0, label="estimated")
            panels[1].axhline(0.0, color=INK, linewidth=0.6)
            panels[1].plot(k, errors[0], color=BELIEVED, linewidth=0.8)
            for sign in (-1.0, 1.0):
                panels[1].axhline(sign * _printed(name, "heading"), color=PUBLISHED, linewidth=0.8, linestyle=":")
            panels[0].set_ylabel(f"{name}: ψ [rad]")
            panels[1].set_ylabel("ψ̂ − ψ [rad]")
            panels[2].set_ylabel("d [rad]")
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
        return data_uri(canvas)
