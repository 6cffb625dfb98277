"""The page on the PUNA paper: its paths and its ensemble filter, printed and ours."""

import numpy as np

from agents.page import (
    Block,
    Bullets,
    Claim,
    Claims,
    Entry,
    Facts,
    Figure,
    Page,
    Prose,
    Section,
    Table,
    entry,
    listed,
    number,
    words,
)  # fmt: skip
from agents.reproduction.comparison import tally
from agents.reproduction.pages.comparison import comparison_table
from agents.reproduction.pages.ensembles import slope, verdict
from agents.reproduction.pages.puna_figures import flight_figure, members_figure, obstacle_figure, open_figure
from agents.reproduction.pages.puna_results import (
    Results,
    comparisons,
    errors_of,
    errors_of_size,
    keeps_flying,
    mean_of,
    ratio,
    runs,
)
from agents.reproduction.puna import PLANE, bank, cell_name
from agents.reproduction.settings import puna as paper
from agents.statistics import Interval, paired_difference
from vessel_gym.guidance.dubins import WORDS


def page(results: Results) -> Page:
    """The page, from the values of every cell."""
    obstructed = results["obstructed"]
    counted = {level: tally(comparisons(results, level)) for level in paper.LEVELS}
    gains = {level: [_gain(results, level, "constant", i) for i in range(len(paper.STATES))] for level in paper.LEVELS}
    everywhere = all(gain.low > 1.0 for level in gains.values() for gain in level)
    times = [
        f"{listed([f'{gain.mean:.2f}' for gain in gains[level]])} ({chosen.title})"
        for level, chosen in paper.LEVELS.items()
    ]
    sizes = [f"{paper.BEST_MEMBERS[c]} ({c} angle): {_best_claim(results, c).verdict}" for c in paper.CONTROLS]
    strings = obstructed["strings"]
    answer = [
        f"The paper's main claim {'holds' if everywhere else 'does not hold everywhere'} on its own model: measuring "
        f"every state {'beats' if everywhere else 'does not beat'} measuring x alone, state by state.",
        f"Errors of {listed([s.symbol for s in paper.STATES])} with x alone are, at the two noise levels, "
        f"{' or '.join(times)} times those with everything measured.",
        f"Whether the sizes of ensembles that it names are the best: {'; '.join(sizes)}.",
        "The eight printed errors themselves say little, because neither Q nor R is printed: with both sets of "
        f"measurements {counted['flight']} at the {paper.LEVELS['flight'].title}, and {counted['sizes']} at the "
        f"{paper.LEVELS['sizes'].title}.",
        f"The path {paper.OPEN.word} without an obstacle as the shortest one: {_path_claim(results).verdict}. The path "
        f"{paper.OBSTRUCTED.word} round the obstacle: {strings['SRS']:.1f} m, its mirror image {strings['SLS']:.1f} "
        f"m, and {np.rad2deg(obstructed['bank']):.0f}° of bank for either.",
    ]
    sections = [
        Section("Paths", _paths(results)),
        Section("Estimation: printed and ours", _estimation(results)),
        Section("What the paper claims", [_claims(results)]),
        Section("Ensembles", _ensembles(results)),
        Section("Assumptions", _assumptions(results)),
        Section("Misprints that matter", [Bullets(_misprints(results))]),
    ]
    subtitle = (
        "Dubins paths and the ensemble Kalman filter for an unmanned aircraft (PUNA), with our own planner and filter"
    )
    return Page("PUNA: a path, and where one is on it", subtitle, answer, sections)


def _paths(results: Results) -> list[Block]:
    open_, obstructed = results["open"], results["obstructed"]
    case, least, printed_16 = paper.OPEN, open_["least RSL"], open_["equation 16"]
    heads = [(reading, "m") for reading in paper.READINGS]
    shortest_of = {reading: min(found.values()) for reading, found in open_["lengths"].items()}
    rows = [
        (word, [_length(found.get(word), shortest_of[reading]) for reading, found in open_["lengths"].items()])
        for word in WORDS
    ]
    lengths_table = Table(
        "Without an obstacle: the length of every word under three readings of the printed headings",
        "Bold: the shortest. A dash: no such path, because the turning circles are more than four radii apart; the "
        "paper, too, leaves the words of three arcs out. It says that headings count from the y axis, and its "
        f"figure shows {case.word}.",
        "word",
        heads,
        [("", rows)],
        "words",
    )
    goal_y = obstructed["poses"][1][1]
    strings, kinks = obstructed["strings"], np.rad2deg([obstructed["kinks"][word] for word in ("SRS", "SLS")])
    found = np.asarray(obstructed["tangent points"])
    away = np.abs(found - [paper.OBSTRUCTED.start, paper.OBSTRUCTED.goal])
    point_rows = [
        (
            f"{name}, {axis}",
            [
                Entry(number(printed[k], 4)),
                Entry(number(found[j, k], 6)),
                Entry(number(away[j, k], 6)),
                Entry("the same point" if away[j, k] <= paper.PRINT else "another point"),
            ],
        )
        for j, (name, printed) in enumerate((("start", paper.OBSTRUCTED.start), ("goal", paper.OBSTRUCTED.goal)))
        for k, axis in enumerate("xy")
    ]
    points = Table(
        f"With an obstacle: the printed points, and the tangent points of the {obstructed['word']} path of 100 m "
        "radius from (−500, 100), 60° above the x axis, to "
        f"(0, {goal_y:.3f}), 0°",
        f"The path is {obstructed['length']:.3f} m long. The start is that of the other case; its printed heading "
        "π/3 counts from the x axis here, and is the other case's π/6 from the y axis. Verdict: whether rounding to "
        "the printed digits explains the difference.",
        "printed as",
        [("printed", "m"), ("tangent point", "m"), ("difference", "m"), ("verdict", "")],
        [("", point_rows)],
        "points",
    )
    as_poses = obstructed["as poses"]
    ways = Table(
        "Ways past the obstacle",
        "Strings join the two printed points; the others lead from pose to pose. Kinks: by how much a string leaves "
        "the heading that the aircraft has at the printed points, which are ends of its turns. Bank: of a level "
        "turn at 20 m/s.",
        "way",
        [("length", "m"), ("passes the centre at", "m"), ("kinks", "deg"), ("bank", "deg")],
        [
            (
                "strings of the printed radius of 30 m",
                [
                    (
                        f"{word}, {where}" + (", the paper's" if word == paper.OBSTRUCTED.word else ""),
                        [
                            Entry(number(strings[word], 3)),
                            Entry(number(paper.OBSTRUCTED.obstacle[2], 2)),
                            Entry(listed([number(kink, 1) for kink in kinks[i]])),
                            Entry(number(np.rad2deg(obstructed["bank"]), 1)),
                        ],
                    )
                    for i, (word, where) in enumerate((("SRS", "above"), ("SLS", "below")))
                ],
            ),
            (
                "paths with turns of 100 m, from (−500, 100)",
                [
                    (
                        f"{obstructed['word']}, through the obstacle",
                        _way(obstructed["length"], obstructed["clearance"]),
                    ),
                    ("our plan, round it", _way(obstructed["detour"], paper.OBSTRUCTED.obstacle[2])),
                ],
            ),
            (
                "paths with turns of 100 m, the printed points taken as poses",
                [
                    (f"{way['word']}, headings {reading}", _way(way["length"], way["clearance"]))
                    for reading, way in as_poses.items()
                ],
            ),
        ],
        "obstacle",
    )
    return [
        lengths_table,
        Figure(
            open_figure(open_),
            "The case without an obstacle (the paper's figure 2) under two readings of its headings",
            "Thin: the other words. Red: the printed points.",
        ),
        Prose(
            f"The paper finds the goal's y by minimising the length of RSL, and prints y = {case.goal[1]:.0f} m. No "
            f"formula is given; y = y₀ + 2 r (1 − sin χ₀) yields {open_['final y']:.0f} m here and {goal_y:.3f} m in "
            "the other case, both its values. The true minimum of RSL over y, headings from the y axis, is "
            f"{least['length']:.1f} m at y = {least['y']:.0f} m. Equation (16), meant to be that minimum, gives "
            f"{number(printed_16['first line'], 1)} m in its first line and {number(printed_16['second line'], 1)} m "
            "in its second: it takes the straight with χ₀ from the x axis and the arcs with χ₀ from the y axis, and "
            "adds π/(2r), which is no length."
        ),
        points,
        ways,
        Figure(
            obstacle_figure(obstructed),
            "The case with an obstacle (the paper's figure 3)",
            "Red: the printed points, and the string of the printed type between them. The path planned by us never "
            "turns tighter than 100 m and keeps clear.",
        ),
    ]


def _length(length: float | None, shortest_length: float) -> Entry:
    return Entry("–") if length is None else Entry(number(length, 1), strong=length == shortest_length)


def _way(length: float, clearance: float) -> list[Entry]:
    bank_deg = number(np.rad2deg(bank(paper.RADIUS)), 1)
    return [Entry(number(length, 3)), Entry(number(clearance, 2)), Entry("none"), Entry(bank_deg)]


def _estimation(results: Results) -> list[Block]:
    blocks: list[Block] = [
        Prose(
            "Neither Q nor R is printed, nor the aircraft's constants, the step or the duration. Two noise levels were "
            "written down beforehand, each for its whole table, and not changed after the results. With Q and R "
            "free, the printed errors can be had at will: a match says little, and so does an error below them. "
            f"D stands for diag({', '.join(f'{v:g}' for v in paper.SIZES)}), the squares of the printed errors to "
            "one digit."
        )
    ]
    for level, chosen in paper.LEVELS.items():
        note = (
            f"{chosen.reason} Mean and 95 % interval over {runs(results)} flights; the published numbers are of one "
            f"flight. {tally(comparisons(results, level))}."
        )
        title = f"RMS errors, printed and ours: {chosen.title}"
        blocks.append(comparison_table(title, note, comparisons(results, level), f"errors-{level}"))
    blocks += [
        Prose(_which_set(results)),
        _scales_table(results),
        Figure(
            flight_figure(results),
            "State, true and estimated (the paper's two figures 4): one flight, with the noise of a flight",
            "Of x, what it differs from flying on at 20 m/s is shown: on the scale of 40 m nothing could be told "
            "apart.",
        ),
        Figure(
            members_figure(results),
            "RMS error against the number of members, with the printed values",
            f"Means over {runs(results)} flights with 95 % intervals. Red: printed, at the size that the paper names; "
            "which set of measurements they belong to is not said. The two angles of attack hardly differ.",
        ),
    ]
    return blocks


def _which_set(results: Results) -> str:
    """Which set of measurements the printed numbers belong to, with the reason."""
    printed = [paper.PRINTED[control][3].value / paper.PRINTED[control][2].value for control in paper.CONTROLS]
    ours = {
        measured: listed(
            [
                number(float(np.divide(*errors_of_size(results, level, "constant", measured, 300).mean(0)[[3, 2]])), 2)
                for level in paper.LEVELS
            ]
        )
        for measured in paper.MEASURED
    }
    return (
        "Which measurements each printed number was made with is not said. We take all eight for errors with every "
        f"state measured. The printed error of h is {listed([f'{p:.2f}' for p in printed])} times that of x; ours is "
        f"{ours['all']} times with every state measured, and "
        f"{ours['x']} times with x alone, which does not show h (at the two "
        "noise levels). The abstract, too, names 300 members, those of the constant angle, together with measuring "
        "everything. A Q chosen for each state could undo the argument; so the tables show both."
    )


def _scales_table(results: Results) -> Table:
    sections = []
    for level, chosen in paper.LEVELS.items():
        found = results[f"{level}, scaled"]
        rows = [
            (
                f"Q × {number(q, 2)}, R × {number(r, 2)}",
                [
                    entry(mean_of(values), len(p.printed.partition(".")[2]))
                    for values, p in zip(np.asarray(errors).T, paper.PRINTED["constant"], strict=True)
                ],
            )
            for (q, r), errors in zip(found["scales"], found["rmse"], strict=True)
        ]
        sections.append((chosen.title, rows))
    printed = [Entry(p.printed, strong=True) for p in paper.PRINTED["constant"]]
    last = np.asarray(results["sizes, scaled"]["rmse"])[-1].mean(0)
    other = last / [p.value for p in paper.PRINTED["constant"]]
    return Table(
        "How far Q and R decide the errors",
        f"Every state measured, constant angle of attack, 100 members, {runs(results)} flights. Errors go with the "
        "square root of a common factor. The last line is another pair with the same variance of a random walk, Q "
        f"that of a flight and R far larger: its errors are {listed([f'{share:.2f}' for share in other])} times the "
        f"printed ones, so that a match does not even tell Q from R. γ with the {paper.LEVELS['sizes'].title} is "
        "erratic, because the airspeed passes through zero.",
        "factors",
        [(state.symbol, state.unit) for state in paper.STATES],
        [("printed, constant angle of attack", [("", printed)]), *sections],
        "scales",
    )


def _gain(results: Results, level: str, control: str, i: int) -> Interval:
    """By which factor x alone is worse in a state than every state, with the best ensemble that the abstract names."""
    members = paper.BEST_MEMBERS[control]
    worse, better = (errors_of_size(results, level, control, measured, members)[:, i] for measured in ("x", "all"))
    return ratio(worse, better)


def _claims(results: Results) -> Claims:
    rows = [_path_claim(results), _detour_claim(results)]
    for i, state in enumerate(paper.STATES):
        gains = {(level, c): _gain(results, level, c, i) for level in paper.LEVELS for c in paper.CONTROLS}
        evidence = "; ".join(
            f"{paper.LEVELS[level].title}: "
            + ", ".join(f"{_factor(gains[level, control])} ({control} angle)" for control in paper.CONTROLS)
            for level in paper.LEVELS
        )
        difference = paired_difference(
            *(errors_of_size(results, "flight", "constant", measured, 300)[:, i] for measured in ("x", "all"))
        )
        rows.append(
            Claim(
                f"Measuring every state is much better than measuring x alone: {state.name} {state.symbol}",
                _gain_verdict(list(gains.values())),
                f"Error with x alone over error with every state: {evidence}. Paired difference (constant angle, 300 "
                f"members, {paper.LEVELS['flight'].title}): {words(difference, 4, True)} {state.unit}.",
            )
        )
    rows += [_best_claim(results, control) for control in paper.CONTROLS]
    rows += _trend_claims(results)
    note = (
        f"Pairs are the same flight and the same readings, {runs(results)} of them; intervals are of 95 % each, and "
        "ratios are geometric means. Sizes of ensembles are compared by the geometric mean of the four errors."
    )
    return Claims(rows, note)


def _factor(gain: Interval) -> str:
    return f"{gain.mean:.2f} [{gain.low:.2f}, {gain.high:.2f}]"


def _gain_verdict(gains: list[Interval]) -> str:
    """Whether ratios are above 1 everywhere, and whether "much" is the word."""
    if all(gain.low > 1.0 for gain in gains):
        least, most = (100.0 * (pick(gain.mean for gain in gains) - 1.0) for pick in (min, max))
        return "true" if least >= 50.0 else f"true, but not much: by {least:.0f} to {most:.0f} %"
    return "false" if any(gain.high < 1.0 for gain in gains) else "undecided, not everywhere beyond doubt"


def _path_claim(results: Results) -> Claim:
    found = results["open"]["lengths"]
    best = {reading: min(lengths_, key=lengths_.get) for reading, lengths_ in found.items()}
    agrees = [reading for reading, word in best.items() if word == paper.OPEN.word]
    as_said = [reading for reading in agrees if reading != "from the x axis"]
    evidence = "; ".join(
        f"headings {reading}: "
        + ", ".join(f"{word} {number(lengths_[word], 1)} m" for word in dict.fromkeys((best[reading], paper.OPEN.word)))
        for reading, lengths_ in found.items()
    )
    return Claim(
        f"The path without an obstacle, {paper.OPEN.word}, is optimal",
        "true" if as_said else f"false, as printed; true with headings {listed(agrees)}" if agrees else "false",
        f"The shortest of the six words: {evidence}.",
    )


def _detour_claim(results: Results) -> Claim:
    found, paper_word = results["obstructed"]["strings"], paper.OBSTRUCTED.word
    best = min(found, key=found.get)
    return Claim(
        f"The path with an obstacle, {paper_word}, is optimal",
        "true" if best == paper_word else "false",
        f"Between the printed points {', '.join(f'{word} is {length:.1f} m' for word, length in found.items())} "
        f"long. An arc of 30 m at 20 m/s takes {np.rad2deg(results['obstructed']['bank']):.0f}° of bank, and the "
        "string leaves the turns with kinks.",
    )


def _combined(results: Results, level: str, control: str, measured: str) -> np.ndarray:
    """The logarithm of the geometric mean of the four errors ``(sizes, runs)``."""
    return np.log(errors_of(results, level, control, measured)).mean(-1)


def _against_best(results: Results, level: str, control: str, measured: str) -> list[Interval | None]:
    """By how many percent errors differ from those of the size that the paper calls best, a number each size."""
    logs = _combined(results, level, control, measured)
    best = logs[paper.MEMBERS.index(paper.BEST_MEMBERS[control])]
    return [paired_difference(100.0 * row, 100.0 * best) for row in logs]


def _best_claim(results: Results, control: str) -> Claim:
    best = paper.BEST_MEMBERS[control]
    others = {
        size: gap
        for size, gap in zip(paper.MEMBERS, _against_best(results, "flight", control, "all"), strict=True)
        if size != best and gap is not None
    }
    better = [str(size) for size, gap in others.items() if gap.high < 0.0]
    level = [str(size) for size, gap in others.items() if not gap.excludes_zero]
    if better:
        said = f"false, {listed(better)} are better"
    elif level:
        said = f"undecided, no detectable difference from {listed(level)}"
    else:
        said = "true"
    gaps = ", ".join(f"{size}: {words(gap, 2, True)} %" for size, gap in others.items())
    return Claim(
        f"{best} members are the best ({control} angle of attack)",
        said,
        f"Errors against those with {best} members, every state measured, {paper.LEVELS['flight'].title}: {gaps}.",
    )


def _trend_claims(results: Results) -> list[Claim]:
    trend = slope(paper.MEMBERS, np.exp(_combined(results, "flight", "constant", "all")).T)
    seconds = np.asarray(results["time"]["seconds"])
    cost = slope(paper.MEMBERS, seconds)
    return [
        Claim(
            "More members reduce the error",
            verdict(trend, -1),
            f"Error goes with N to the power {words(trend, 4, True)} (every state, constant angle, "
            f"{paper.LEVELS['flight'].title}): {_percent(trend)} for eight times the members. Each state stands in "
            "the table of slopes below.",
        ),
        Claim(
            "More members cost more time",
            verdict(cost, 1),
            f"Time goes with N to the power {words(cost, 2, True)}; a flight takes "
            f"{listed([f'{1e3 * t:.0f}' for t in seconds.mean(0)])} ms with "
            f"{listed([str(n) for n in paper.MEMBERS])} members. Measured, so not the same in every run.",
        ),
    ]


def _percent(trend: Interval | None) -> str:
    """What a power of N makes of the error between the smallest and the largest ensemble."""
    if trend is None:
        return "–"
    change = (paper.MEMBERS[-1] / paper.MEMBERS[0]) ** trend.mean - 1.0
    return f"{number(100.0 * change, 1, signed=True)} %"


def _ensembles(results: Results) -> list[Block]:
    sizes = [(str(size), "%") for size in paper.MEMBERS]
    gaps, slopes = [], []
    for level, chosen in paper.LEVELS.items():
        gap_rows, slope_rows = [], []
        for control in paper.CONTROLS:
            for measured, name in paper.MEASURED.items():
                title = f"{name}, {control} angle"
                gap = _against_best(results, level, control, measured)
                reference = paper.MEMBERS.index(paper.BEST_MEMBERS[control])
                cells_ = [Entry("0") if i == reference else entry(g, 2, True) for i, g in enumerate(gap)]
                gap_rows.append((f"{title}, against {paper.BEST_MEMBERS[control]}", cells_))
                errors = errors_of(results, level, control, measured)
                trends = [entry(slope(paper.MEMBERS, errors[:, :, i].T), 4, True) for i in range(len(paper.STATES))]
                slope_rows.append((title, trends))
        gaps.append((chosen.title, gap_rows))
        slopes.append((chosen.title, slope_rows))
    flying = keeps_flying(results, "sizes", "constant")
    mended = slope(paper.MEMBERS, errors_of(results, "sizes", "constant", "all")[:, flying, 0].T)
    seconds = 1e3 * np.asarray(results["time"]["seconds"])
    return [
        Table(
            "Errors against those with the size that the paper calls best",
            "Geometric mean of the four errors; bold: beyond doubt (95 %, paired). Where fewer members seem better, "
            "see the note on γ under the next table.",
            "measured",
            sizes,
            gaps,
            "sizes",
        ),
        Table(
            "Exponents a of error ~ N^a",
            "Fitted to each flight, mean and 95 % interval; bold: beyond doubt. With the "
            f"{paper.LEVELS['sizes'].title} the airspeed passes through zero, where the equation of γ divides by it; "
            "a single member there throws the mean off, and more members have more of them. In the flights that "
            f"keep 2 m/s or more, {int(flying.sum())} of {len(flying)} (every state, constant angle), the exponent "
            f"of γ is {words(mended, 4, True)}.",
            "measured",
            [(state.symbol, "") for state in paper.STATES],
            slopes,
            "slopes",
        ),
        Table(
            f"Time to estimate one flight of {paper.STEPS} steps",
            f"Mean and 95 % interval of {len(seconds)} repetitions on one core, every state measured. These numbers "
            "are measured and differ from run to run; all others follow from the seed.",
            "members",
            [("time", "ms")],
            [("", [(str(n), [entry(mean_of(t), 1)]) for n, t in zip(paper.MEMBERS, seconds.T, strict=True)])],
            "time",
        ),
    ]


def _assumptions(results: Results) -> list[Block]:
    model, body = results["aircraft"], PLANE.body
    facts = [
        ("aircraft", f"Skywalker X8 (Gryte 2018): {body.mass} kg, {body.area} m²; the paper prints no constant"),
        ("step", f"{PLANE.dt} s, forward Euler as printed, {paper.STEPS} steps; neither is printed"),
        ("start", f"γ 0, v {paper.SPEED:.0f} m/s, x 0, h {paper.START[3]:.0f} m; not printed"),
        ("thrust", f"{model['thrust']:.2f} N, that of level flight; not printed"),
        ("constant α", f"{np.rad2deg(model['alpha']):.2f}°, that of level flight; not printed"),
        (
            "varying α",
            f"the same ± {np.rad2deg(paper.SWING):.0f}° in a sine of {paper.PERIOD:.0f} s; how it varies is not "
            "printed",
        ),
        (
            "first ensemble",
            "about the initial guess, with the noise of a step, eq. (24); the true start is drawn likewise",
        ),
        ("prediction", "each member from itself; (10) and (25) print the mean"),
        *((chosen.title, chosen.reason) for chosen in paper.LEVELS.values()),
        (
            "flights",
            f"{runs(results)} for each number, seed {paper.SEED}; the same for all sizes and both sets of measurements",
        ),
    ]
    slowest = {level: np.asarray(results[cell_name(level, "constant", "all")]["slowest"]) for level in paper.LEVELS}
    flown = [
        f"{100 * np.mean(slowest[level] <= 0.0):.0f} % with the {chosen.title}"
        for level, chosen in paper.LEVELS.items()
    ]
    return [
        Facts("What the paper does not print", facts),
        Prose(
            f"Flights in which the true airspeed falls to zero within two seconds: {listed(flown)}. The noise that "
            "gives the printed sizes with readings as good as the estimates is therefore not that of an aircraft "
            "that flies."
        ),
    ]


def _misprints(results: Results) -> list[str]:
    model = results["aircraft"]
    return [
        "Equation (1) has g sin α in the airspeed's rate where (19) and (21) have g sin γ; we use γ. With α an "
        "aircraft would climb at no cost.",
        "The second row of (19) and of (21) ends in + γₖ for + vₖ: the airspeed would be replaced by an angle.",
        "Lift acts along the body's normal (L cos α, −L sin α) but drag along the velocity. The lift then brakes: in "
        f"level flight at 20 m/s the airspeed changes by {number(model['braking'], 3)} m/s². We keep it, it is the "
        "paper's model.",
        "Equation (2) writes the lift as ½ρv²S C_L α with C_L = B₁α + B₂, so that α comes twice; we use ½ρv²S C_L.",
        "No constant is printed. Those known for this form are a missile's (Subchan & Żbikowski 2009), which at the "
        f"printed 20 m/s would need a lift coefficient of {model['missile lift coefficient']:.0f}.",
        "Below (20), f is called a linear function. It is not: it has cos γ, 1/v and v².",
        "(10) and (25) predict every member from the mean, and the second line of (25) drops f. Taken literally the "
        "covariance of a prediction would be Q in every step, and measuring x alone would correct nothing but x.",
        "(9) averages x₀,₁ for x₀,ᵢ; (13) has xₖ,ᵢ ~ N(0, R) for vₖ,ᵢ; (27) has zₖ + zₖ,ᵢ for zₖ + vₖ,ᵢ; (26) has "
        "lost the sum of its second line.",
        f"The error of v with a varying angle is printed as {paper.PRINTED['varying'][1].printed}, for "
        f"{paper.PRINTED['varying'][1].value}.",
        "The best ensemble: 300 and 200 members (constant and varying angle) in the abstract, 300 and 100 in the "
        "section on the simulations, 300 for both in the conclusion.",
        "With a constant angle, truth and estimate lie far apart (“terpaut jauh”) in the text; in the conclusion the "
        "error is near the real one (“mendekati real”).",
        "Equation (16) adds π/(2r) [1/m] to lengths, and its two lines differ.",
        "Headings are said to count from the y axis; the figure's word and the obstacle case's points need the x axis.",
    ]
