"""The page on the robust filters: the figures of the paper beside ours, and its claim put to the test."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from agents.page import Bullets, Claim, Claims, Entry, Facts, Page, Prose, Section, Table, entry, listed, number, words
from agents.reproduction.pages.robust_figures import (
    covariance_figure,
    crossed_figure,
    disturbance_figure,
    estimates_figure,
    gain_figure,
    sweep_figure,
    systems_figure,
    traits_figure,
)
from agents.reproduction.pages.robust_results import (
    MODEL_ERRORS,
    NOTHING,
    OTHERS,
    ROBUST,
    SHOWN,
    SHOWN_TITLES,
    WHERE,
    Results,
    exponential,
    known,
    mean_ratio,
    percent,
    rmse_of_units,
    system_traits,
    unit_ratios,
)
from agents.reproduction.settings import robust as settings
from agents.reproduction.settings.robust import Condition
from agents.statistics import Interval, mean_interval, paired_difference

# --- tables -----------------------------------------------------------------------------------------

_HEAD = [("KF, RMSE", ""), *((f"{name} / KF", "") for name in OTHERS)]
_RATIO_NOTE = (
    "KF: geometric mean of the RMSE of the state vector, in units of the state, where a reading has σ = "
    "1. Others: geometric "
    "mean of the RMSE divided by that of the KF on the same readings, from the paired difference of "
    "logarithms, with the ends of the "
    "95 % interval (Student's t). Bold: the interval excludes 1. "
)


def _ratio_table(
    results: Results,
    title: str,
    name: str,
    note: str,
    rows: Mapping[str, Sequence[tuple[str, Condition]]],
    populations: list[str],
) -> Table:
    """KF error and ratios; a section for every population and group of rows."""
    several = len(rows) > 1
    sections = [
        (
            settings.POPULATIONS[population].title + several * f"; {group}",
            [_row(results, population, *row) for row in named],
        )
        for population in populations
        for group, named in rows.items()
    ]
    return Table(title, _RATIO_NOTE + note, "condition", _HEAD, sections, name)


def _row(results: Results, population: str, label: str, condition: Condition) -> tuple[str, list[Entry]]:
    kf = np.exp(np.log(rmse_of_units(results, population, condition, "kf")).mean())
    entries = [Entry(number(float(kf), 2))]
    for name in OTHERS:
        entries.append(_ratio_entry(mean_ratio(results, population, condition, name)))
    return label, entries


def _ratio_entry(ratio: Interval) -> Entry:
    """Bold where the interval excludes 1."""
    return replace(entry(ratio, 3), strong=ratio.high < 1.0 or ratio.low > 1.0)


def _outlier_table(results: Results) -> Table:
    rows = {
        f"outliers of {settings.OUTLIERS.size:g} σ": [
            (f"{percent(c.rate)} of readings", c) for c in settings.SWEEPS["rate"]
        ],
        f"{percent(settings.OUTLIERS.rate)} outliers": [(f"of {c.size:g} σ", c) for c in settings.SWEEPS["size"]],
    }
    return _ratio_table(results, "Outliers", "outliers", "", rows, [settings.RANDOM, settings.PAPER])


def _model_error_table(results: Results) -> Table:
    rows = {
        "least-favourable model": [(f"c = {c.tolerance:g}", c) for c in settings.SWEEPS["tolerance"]],
        "error of A": [(f"δ = {percent(c.parameters)}", c) for c in settings.SWEEPS["parameters"]],
    }
    note = (
        "Least favourable: nature's noise is the worst for robust-kf within its ball of size c. δ: the "
        "true A is off by δ|A| "
        "(Frobenius norm) in a random direction, drawn again where the true system would not be stable."
    )
    return _ratio_table(results, "Model error", "model-error", note, rows, [settings.RANDOM, settings.PAPER])


def _crossed_table(results: Results) -> Table:
    rows = {
        MODEL_ERRORS[name]: [(f"{percent(c.rate)} outliers", c) for c in conditions]
        for name, conditions in settings.CROSSED.items()
    }
    note = f"Outliers of {settings.OUTLIERS.size:g} σ."
    return _ratio_table(results, "Both at once", "both", note, rows, [settings.RANDOM, settings.PAPER])


def _one_reading_table(results: Results) -> Table:
    rows = {"two readings or one": list(zip(_ALONE, settings.ALONE, strict=True))}
    populations = [settings.RANDOM, settings.ONE_READING]
    title = "The same systems with two readings and with the first alone"
    return _ratio_table(results, title, "one-reading", "", rows, populations)


_ALONE = (
    "nothing wrong",
    f"{percent(settings.OUTLIERS.rate)} outliers of {settings.OUTLIERS.size:g} σ",
    f"A off by {percent(settings.PARAMETERS.parameters)}",
)


def _spread_table(results: Results) -> Table:
    sections = []
    for title, condition in zip(SHOWN_TITLES, SHOWN, strict=True):
        rows = []
        for name in OTHERS:
            ratios = unit_ratios(results, condition, name)
            quantiles = np.quantile(ratios, (0.0, 0.1, 0.5, 0.9, 1.0))
            share = 100.0 * float((ratios < 1.0).mean())
            rows.append((name, [Entry(number(share, 0)), *(Entry(number(float(q), 2)) for q in quantiles)]))
        sections.append((title, rows))
    head = [
        ("systems below the KF", "%"), ("best", ""), ("10 %", ""), ("median", ""), ("90 %", ""), ("worst", "")
    ]  # fmt: skip
    note = (
        f"RMSE over that of the KF in each of the {settings.POPULATIONS[settings.RANDOM].title}, "
        f"{settings.POPULATIONS[settings.RANDOM].runs} runs each: quantiles over the systems. The noise "
        f"of so few runs is in them."
    )
    return Table("System by system", note, "filter", head, sections, "systems")


def _halves_table(results: Results) -> Table:
    """Ratios in the systems whose readings show their weakest direction better, and worse, than the median's do."""
    weakest = system_traits()["weakest"]
    shown = weakest > np.median(weakest)
    sections = []
    for half, title in ((shown, "weakest direction shown better than the median"), (~shown, "shown worse")):
        rows = []
        for label, condition in zip(SHOWN_TITLES, SHOWN, strict=True):
            entries = []
            for name in OTHERS:
                ratio = exponential(known(mean_interval(np.log(unit_ratios(results, condition, name)[half]))))
                entries.append(_ratio_entry(ratio))
            rows.append((label, entries))
        sections.append((title, rows))
    note = (
        "RMSE over that of the KF, as before, with the random systems split at the median of the "
        "smallest singular value "
        "of C. The split was made after the results were seen: it explains, it does not confirm."
    )
    head = [(f"{name} / KF", "") for name in OTHERS]
    return Table("By how well the readings show the state", note, "condition", head, sections, "halves")


# --- claims -----------------------------------------------------------------------------------------


def _verdict(ratios: Sequence[Interval]) -> str:
    """Whether every ratio is below 1: "true", "false" where one is above beyond chance, else "undecided"."""
    if all(ratio.high < 1.0 for ratio in ratios):
        return "true"
    below, above = sum(ratio.high < 1.0 for ratio in ratios), sum(ratio.low > 1.0 for ratio in ratios)
    counts = f"below in {below} and above in {above} of {len(ratios)}"
    return f"false, {counts}" if above else f"undecided, {counts}"


def _lower(results: Results, text: str, name: str, sweep: Sequence[tuple[str, Condition]]) -> Claim:
    """The claim that a filter has less error than the KF in every condition, over the random systems."""
    ratios = [mean_ratio(results, settings.RANDOM, condition, name) for _, condition in sweep]
    evidence = "; ".join(f"{label}: {words(ratio, 3)}" for (label, _), ratio in zip(sweep, ratios, strict=True))
    return Claim(text, _verdict(ratios), evidence)


def _labelled(key: str, form: Callable[[float], str]) -> list[tuple[str, Condition]]:
    """The conditions of a sweep in which something is wrong, with a label each."""
    return [(form(getattr(c, key)), c) for c in settings.SWEEPS[key] if getattr(c, key)]


def _claims(results: Results) -> list[Claim]:
    rates, sizes = _labelled("rate", percent), _labelled("size", "{:g} σ".format)
    tolerances, parameters = _labelled("tolerance", "c {:g}".format), _labelled("parameters", percent)
    found = [
        _printed_claim(results),
        _lower(results, "Under outliers of 10 σ huber-kf has less error than the KF at every rate.", "huber-kf", rates),
        _lower(results, "At 10 % outliers huber-kf has less error than the KF at every size.", "huber-kf", sizes),
    ]
    for name in ROBUST:
        found += [
            _lower(results, f"Under the least-favourable model {name} has less error than the KF.", name, tolerances),
            _lower(results, f"With errors of A {name} has less error than the KF.", name, parameters),
            _lower(results, f"Under outliers {name} has less error than the KF.", name, rates),
        ]
    found += [
        _lower(results, "With errors of A huber-kf has less error than the KF.", "huber-kf", parameters),
        *_cost_claims(results),
        *_crossed_claims(results),
        _consistency_claim(results),
    ]
    return found


def _printed_claim(results: Results) -> Claim:
    return Claim(
        "The algorithm that the paper prints as RKF has less error than the KF.",
        "false, it is the KF",
        f"eqs (6) to (9) and the summary of step 4, as printed, differ from our KF by at most "
        f"{results['example']['printed']:.0e} over {settings.STEPS} readings",
    )


def _cost_claims(results: Results) -> list[Claim]:
    """What each filter costs where nothing is wrong."""
    found = []
    for name in OTHERS:
        ratio = mean_ratio(results, settings.RANDOM, NOTHING, name)
        verdict = "false" if ratio.low > 1.0 else "true" if ratio.high < 1.0 else "undecided"
        found.append(Claim(f"Where nothing is wrong {name} costs nothing.", verdict, f"RMSE / KF {words(ratio, 3)}"))
    return found


def _crossed_claims(results: Results) -> list[Claim]:
    found = []
    for name, conditions in settings.CROSSED.items():
        sweep = [(f"{percent(c.rate)} outliers", c) for c in conditions if c.rate]
        found += [
            _lower(
                results, f"With outliers and {MODEL_ERRORS[name]}, {filter} has less error than the KF.", filter, sweep
            )
            for filter in ("huber-kf", ROBUST[0])
        ]
    return found


def _consistency_claim(results: Results) -> Claim:
    """The paper's word "consistently", taken system by system."""
    shares = {
        f"{name}, {title}": float((unit_ratios(results, condition, name) < 1.0).mean())
        for title, condition, names in (
            (SHOWN_TITLES[1], settings.OUTLIERS, ("huber-kf",)),
            (SHOWN_TITLES[2], settings.LEAST_FAVOURABLE, ROBUST),
            (SHOWN_TITLES[3], settings.PARAMETERS, ROBUST),
        )
        for name in names
    }
    everywhere = [label for label, share in shares.items() if share == 1.0]
    verdict = (
        "true" if len(everywhere) == len(shares) else "false" + (f", only {listed(everywhere)}" if everywhere else "")
    )
    evidence = "systems with less error than the KF: " + "; ".join(f"{k}: {100 * v:.0f} %" for k, v in shares.items())
    return Claim("“RKF consistently gives lower errors” on its own ground: in every system drawn.", verdict, evidence)


def _figure_claims(results: Results) -> list[Claim]:
    """What the paper reads off its figures, on the system in its place; the printed algorithm is our kf."""
    kf = results["example"]["kf"]
    rmse, gain, variance = (np.asarray(kf[key]) for key in ("rmse", "gain", "variance"))
    runs = settings.POPULATIONS[settings.PAPER].runs
    settled = float(np.sqrt(np.mean(rmse[settings.SKIPPED :] ** 2)))
    start = np.sqrt(settings.PRIOR_VARIANCE * settings.STATES)
    after = settings.SKIPPED * settings.STEP
    affected = {}
    for name in settings.FILTERS:
        hit, free = (
            np.log(rmse_of_units(results, settings.PAPER, condition, name))
            for condition in (settings.DISTURBANCE, NOTHING)
        )
        affected[name] = exponential(known(paired_difference(hit, free)))
    unmoved = [name for name, ratio in affected.items() if ratio.low <= 1.0]
    return [
        Claim(
            "The estimates approach the true states with time (figures 1, 2).",
            "true" if settled < rmse[0] < start else "false",
            f"RMSE of {runs} runs: {start:.2f} before any reading, {rmse[0]:.2f} after the first, {settled:.2f} from "
            f"{after:g} s on",
        ),
        Claim(
            "The gain is large at first and settles (figure 3).",
            "true" if gain[0, 0] > gain[-1, 0] else "false",
            f"largest singular value {gain[0, 0]:.2f} at the first reading, {gain[-1, 0]:.2f} at the last",
        ),
        Claim(
            "The diagonal of the error covariance falls (figure 4).",
            "true" if (variance[-1] < variance[0]).all() else "false",
            f"from {_pair(variance[0])} after the first reading to {_pair(variance[-1])} after the last",
        ),
        Claim(
            "Disturbance does not keep the estimates from the true states (figure 5).",
            "true" if len(unmoved) == len(affected) else "false" + (f", but for {listed(unmoved)}" if unmoved else ""),
            "RMSE with disturbance over without: " + "; ".join(f"{name} {words(r, 2)}" for name, r in affected.items()),
        ),
    ]


def _pair(values: np.ndarray) -> str:
    return listed([f"{value:.2f}" for value in values])


# --- the page ---------------------------------------------------------------------------------------


def page(results: Results) -> Page:
    """The page, from the values of every cell under the same names."""
    return Page(
        settings.TITLE,
        f"{settings.JOURNAL}: the figures of its random two-state system, and its claim over "
        f"{settings.POPULATIONS[settings.RANDOM].title}",
        _answer(results),
        [
            Section("The paper's claims", [Claims(_claims(results), _CLAIMS_NOTE)]),
            Section("What the paper prints, and what we assumed", [Prose(_NO_NUMBERS), _assumptions()]),
            Section("The paper's figures", _paper_figures(results)),
            Section("Outliers and model error", [
                sweep_figure(results), _outlier_table(results), _model_error_table(results)
            ]),
            Section("Both at "
            "once", [Prose(_crossed_words(results)), crossed_figure(results), _crossed_table(results)]),
            Section("Where each of them loses", [
                systems_figure(results), _spread_table(results), Prose(_where_words(results)),
                traits_figure(results), _halves_table(results),
                _one_reading_table(results),
            ]),
            Section("Misprints", [Prose(_steady_words(results)), Bullets(list(settings.MISPRINTS))]),
        ],
    )  # fmt: skip


def _paper_figures(results: Results) -> list[Any]:
    table = Table(
        "The paper's figures beside ours",
        "The paper prints curves without a number that could be set beside ours; only their shape compares.",
        "figure",
        [("shows", ""), ("verdict", "")],
        [("", [(name, [Entry(what), Entry("not comparable: no number is printed; shape as below")])
               for name, what in settings.FIGURES.items()])],
    )  # fmt: skip
    return [
        table,
        Claims(_figure_claims(results), "On the system of the stated seed; its KF is the printed algorithm."),
        estimates_figure(results, truth=False),
        estimates_figure(results, truth=True),
        gain_figure(results),
        covariance_figure(results),
        disturbance_figure(results),
    ]


_CLAIMS_NOTE = (
    "RMSE over that of the KF, geometric mean over 200 random systems with 95 % interval. True: below 1 in every "
    "condition named. False: above 1 in at least one, beyond chance. Undecided: neither. Costs nothing: not above 1."
)
_NO_NUMBERS = (
    "The paper prints no matrix, no step, no seed and no table of results, so that no number of ours "
    "can be set beside one "
    "of its own; only the shape of its five figures can. The algorithm that it prints is the plain "
    "Kalman filter. Huber's "
    "loss stands in its text alone, and model uncertainty in its title: we take huber-kf for the one "
    "and robust-kf (Levy and "
    "Nikoukhah 2013, Zorzi 2017) for the other."
)


def _assumptions() -> Facts:
    low, high = settings.INTENSITY
    random = settings.POPULATIONS[settings.RANDOM]
    return Facts(
        "Ours, fixed before the runs reported here",
        [
            ("system", settings.RECIPE),
            ("margin", f"uniform from {settings.MARGIN[0]:g} to {settings.MARGIN[1]:g} 1/s: stable, "
            f"memory of 1 to 10 s"),
            ("process noise", f"white, intensity q I, q log-uniform from {low:g} to {high:g} 1/s"),
            ("reading noise", f"variance {settings.READING_VARIANCE:g}, independent: the unit of y"),
            ("start", f"mean 0, variance {settings.PRIOR_VARIANCE:g} of each state, for truth and filters alike"),
            ("known input", f"square wave ±1, period {settings.INPUT_PERIOD * settings.STEP:g} s"),
            ("discretisation", f"exact (Van Loan 1978), step {settings.STEP:g} s, {settings.STEPS} steps"),
            ("errors count", f"after {settings.SKIPPED * settings.STEP:g} s, when the start is forgotten"),
            ("seeds", f"paper's place {settings.PAPER_SEED}; others {random.seeds[0]} to {random.seeds[-1]}; noise "
             f"{settings.NOISE_SEED}, the same in every condition"),
            ("huber-kf", f"γ = {settings.HUBER_THRESHOLD:g}: 95 % of the efficiency of least squares on "
            f"Gaussian noise"),
            ("robust-kf", f"c = {settings.TOLERANCES[0]:g}, the package's default, and c = "
            f"{settings.TOLERANCES[1]:g}; at "
             "each step a mean off by √c standard deviations: meant for errors of A of some 12 % and 40 %"),
            ("two readings", "the paper calls y a vector. A trial with one reading came first; "
            "robust-kf fared so ill in "
             "it, with nothing wrong, that the study uses two and shows the trial at the end. It also "
             "led us to add the "
             "smaller c"),
            ("least-favourable model", "nature plans its noise to the end of the run, against robust-kf "
            "of the same c "
             "that sees no outlier; the start is left as the prior has it"),
        ],
    )  # fmt: skip


def _answer(results: Results) -> list[str]:
    def ratio(condition: Condition, name: str) -> Interval:
        return mean_ratio(results, settings.RANDOM, condition, name)

    largest = settings.SWEEPS["parameters"][-1]
    hit = ratio(settings.OUTLIERS, "huber-kf")
    outliers = f"{percent(settings.OUTLIERS.rate)} of the readings off by {settings.OUTLIERS.size:g} σ"
    return [
        "The filter that the paper prints is the Kalman filter and gains nothing; of the two filters that its words "
        f"describe, huber-kf {_pays(hit)} under outliers, and what the minimax filter robust-kf gains under "
        "model errors stands beside what it loses there and elsewhere.",
        *(
            f"robust-kf with c = {c:g} {_balance(results, _MODEL_ERRORS, name)} model errors, "
            f"{_balance(results, _OUTLIERS, name)} kinds of outliers, and has {words(ratio(NOTHING, name), 3)} of the "
            "KF's error where nothing is wrong."
            for name, c in zip(ROBUST, settings.TOLERANCES, strict=True)
        ),
        f"With {outliers} huber-kf has {words(hit, 3)} of the KF's error, geometric mean over 200 random systems; it "
        f"has {words(ratio(NOTHING, 'huber-kf'), 3)} of it where nothing is wrong and "
        f"{words(ratio(largest, 'huber-kf'), 3)} where A is off by {percent(largest.parameters)}.",
        "The paper has no table of results, so that no number can be set beside ours; the shape of its figures can.",
    ]


_MODEL_ERRORS = [c for key in ("tolerance", "parameters") for c in settings.SWEEPS[key] if getattr(c, key)]
_OUTLIERS = list(dict.fromkeys(c for key in ("rate", "size") for c in settings.SWEEPS[key] if c.rate))


def _balance(results: Results, conditions: Sequence[Condition], name: str) -> str:
    """Of how many conditions a filter gains on the KF, of how many it loses, and by how many percent of the error."""
    ratios = [mean_ratio(results, settings.RANDOM, condition, name) for condition in conditions]
    found = []
    for verb, changes in (
        ("gains", [1.0 - ratio.mean for ratio in ratios if ratio.high < 1.0]),
        ("loses", [ratio.mean - 1.0 for ratio in ratios if ratio.low > 1.0]),
    ):
        if changes:
            sizes = dict.fromkeys(number(100.0 * pick(changes), 1) for pick in (min, max))
            found.append(f"{verb} {' to '.join(sizes)} % in {len(changes)}")
    return f"{' and '.join(found) or 'neither gains nor loses beyond chance in any'} of {len(ratios)}"


def _pays(ratio: Interval) -> str:
    return "pays" if ratio.high < 1.0 else "loses" if ratio.low > 1.0 else "makes no certain difference"


def _crossed_words(results: Results) -> str:
    parts = []
    for name, conditions in settings.CROSSED.items():
        ratios = [mean_ratio(results, settings.RANDOM, c, "huber-kf") for c in conditions]
        better = [percent(c.rate) for c, ratio in zip(conditions, ratios, strict=True) if ratio.high < 1.0]
        found = f"at {listed(better)} outliers" if better else "nowhere"
        parts.append(f"with the {name} {found}")
    return (
        "A large innovation is an outlier to huber-kf and a model error to robust-kf, and they draw "
        "opposite conclusions. "
        f"huber-kf has less error than the KF {listed(parts)}."
    )


def _where_words(results: Results) -> str:
    found = [
        f"{number(_rank_correlation(results, name, condition, trait), 2, signed=True)} between the ratio of {name} "
        f"({SHOWN_TITLES[SHOWN.index(condition)]}) and the {label}"
        for name, condition, trait, label in WHERE
    ]
    hurt = _spearman(system_traits()["doubt"], _hurt_by_outliers(results))
    return (
        f"Rank correlation (Spearman) over the random systems: {listed(found)}. The surer the prediction is, the less "
        "the KF heeds a reading, and the less the outliers harm it that huber-kf guards against: "
        "the correlation of that "
        f"variance and the factor by which they raise the error of the KF is {number(hurt, 2, signed=True)}. "
        "A relative-entropy ball acts at every step and enlarges most what the readings hardly show: there "
        "robust-kf costs most, even under the model that is least favourable to it, as the two tables below say."
    )


def _rank_correlation(results: Results, name: str, condition: Condition, trait: str) -> float:
    return _spearman(system_traits()[trait], unit_ratios(results, condition, name))


def _hurt_by_outliers(results: Results) -> np.ndarray:
    """By what factor outliers raise the error of the KF in every random system."""
    hit, free = (rmse_of_units(results, settings.RANDOM, c, "kf") for c in (settings.OUTLIERS, NOTHING))
    return hit / free


def _spearman(a: np.ndarray, b: np.ndarray) -> float:
    from scipy.stats import spearmanr

    return float(spearmanr(a, b).statistic)


def _steady_words(results: Results) -> str:
    steady = results["example"]["steady"]
    return (
        "Those that matter to who implements the paper. Measured on the system in the paper's place: "
        "the solution of the "
        f"Riccati equation misses eq. (11) as printed by {100 * steady['printed_11']:.1f} % of its "
        f"norm, and with the "
        f"missing A by {steady['corrected_11']:.0e}; eq. (12) read literally gives "
        f"{steady['growth']:.1f} times its variance, and "
        f"eq. (14) is then off by {100 * steady['printed_14']:.0f} %."
    )
