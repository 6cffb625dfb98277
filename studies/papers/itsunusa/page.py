"""The page on ITSUNUSA's dive."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents.page import Table, entry, number, words
from agents.statistics import Interval, mean_interval
from studies.papers.itsunusa.experiment import (
    MEASUREMENT_SD,
    PRINTED,
    PROCESS_SD,
    QUANTITIES,
    SYMMETRIC,
    VEHICLE,
    recorded_controls,
)
from studies.papers.measures import (
    EXPLORATORY,
    Comparison,
    Report,
    comparison_table,
    falls,
    percent,
    rows,
    trend,
)
from studies.papers.template import fill

_FORMS = {
    "as printed": f"{PRINTED}, {{}}",
    "pitch measured": f"{SYMMETRIC}, {{}}, pitch",
    "symmetric": f"{SYMMETRIC}, {{}}",
}


def report(settings: Mapping[str, Any], results: Mapping[str, Mapping[str, Any]]) -> Report:
    """Page and measures, from the values of every job."""
    members, printed, trial = settings["members"], settings["printed"], settings["trial"]
    fewest, most = members[0], members[-1]
    errors = {
        form: {size: np.asarray(results[name.format(size)]["rmse"]) for size in members}
        for form, name in _FORMS.items()
    }
    plain, pitched, _ = errors
    columns = {form: _comparisons(settings, errors[form]) for form in (plain, pitched)}
    tables = {"published": comparison_table(columns), "forms": _forms(errors)}
    stacked = {
        form: np.stack([each[size] for size in members], -1) for form, each in errors.items()
    }
    motions = {
        form: trend(members, np.exp(np.log(values[:, :3]).mean(1)))
        for form, values in stacked.items()
    }
    lower = {
        name: 100.0 * (1.0 - float(printed[str(most)][i]) / float(printed[str(fewest)][i]))
        for i, name in enumerate(QUANTITIES)
    }
    sampling = 100.0 * (1.0 - (most / fewest) ** -0.5)
    depth = {form: mean_interval(errors[form][most][:, 3]) for form in (plain, pitched)}
    position = depth[plain]
    assert position is not None
    share = Interval(
        *(100.0 * end / trial["depth"] for end in (position.mean, position.low, position.high))
    )
    page, opening = fill(
        Path(__file__).parent, tables, settings=settings, fewest=fewest, most=most, lower=lower,
        believed=[number(v, 4) for v in np.mean(results["believed"]["rmse"], 0)], printed=printed[str(most)][:-1],
        depth={form: words(interval, 3) for form, interval in depth.items()}, plain=plain, pitched=pitched,
        motions={form: percent(change) for form, change in motions.items()}, falls=falls(motions[plain]),
        sampling=sampling, steep=sum(each > sampling for each in lower.values()), share=words(share, 2),
        below="true" if share.high < 2.0 else "false", process=PROCESS_SD, measurement=MEASUREMENT_SD,
        duration=len(recorded_controls(trial["ahead"], trial["depth"])) * VEHICLE.dt,
        exact=1e4 * _exact_square(settings),
    )  # fmt: skip
    paper = settings["paper"]
    found = [
        *rows(paper, columns[plain]),
        *rows(f"{paper}, {pitched} ({EXPLORATORY})", columns[pitched]),
    ]
    return Report(page, found, opening)


def _comparisons(settings: Mapping[str, Any], errors: Mapping[int, np.ndarray]) -> list[Comparison]:
    """Table 2 beside ours, with its computing times."""
    found = []
    for size in settings["members"]:
        *texts, time = settings["printed"][str(size)]
        for (name, unit), text, ours in zip(QUANTITIES.items(), texts, errors[size].T, strict=True):
            found.append(Comparison(f"{size} members", name, unit, text, "Table 2", ours))
        found.append(
            Comparison(f"{size} members", "time", "s", time, "Table 2", None, reason="its machine")
        )
    return found


def _forms(errors: Mapping[str, Mapping[int, np.ndarray]]) -> Table:
    """Errors by the form of the update, what is measured, and the number of members."""
    sections = [
        (form, [(f"{size} members", [entry(mean_interval(e), d) for e, d in zip(found.T, (5, 5, 6, 4), strict=True)])
                for size, found in each.items()])
        for form, each in errors.items()
    ]  # fmt: skip
    return Table("", "", "", list(QUANTITIES.items()), sections, "forms")


def _exact_square(settings: Mapping[str, Any]) -> float:
    """exact² in error² = exact² + b/N through the printed surge errors with the fewest and the most members."""
    members = settings["members"][0], settings["members"][-1]
    high, low = (float(settings["printed"][str(size)][0]) ** 2 for size in members)
    return low - (high - low) / (1.0 / members[0] - 1.0 / members[1]) / members[1]
