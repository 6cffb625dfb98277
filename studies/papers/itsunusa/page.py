"""Tables of ITSUNUSA's dive."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from studies.papers.itsunusa.experiment import PRINTED, QUANTITIES, SYMMETRIC
from studies.papers.measures import (
    EXPLORATORY,
    Report,
    Results,
    Table,
    against_table,
    by_members,
    comparison_table,
    rows,
    spread,
)

FORMS = {
    "as printed": f"{PRINTED}, {{}}",
    "pitch measured": f"{SYMMETRIC}, {{}}, pitch",
    "symmetric": f"{SYMMETRIC}, {{}}",
}


def report(settings: Mapping[str, Any], results: Results) -> Report:
    """Tables and measures, from the values of every job."""
    members = settings["members"]
    units = [f"{name} [{unit}]" for name, unit in QUANTITIES.items()]
    forms: Table = [("form", "members", *units)]
    columns = {}
    for form, name in FORMS.items():
        errors = {size: np.asarray(results[name.format(size)]["rmse"]) for size in members}
        columns[form] = against_table("Table 2", settings["printed"], QUANTITIES, errors)
        forms += by_members(form, errors)
    believed = (spread(each, 5) for each in np.transpose(results["believed"]["rmse"]))
    forms.append(("believed: ekf", "none", *believed))
    plain, pitched, _ = columns
    published = comparison_table({form: columns[form] for form in (plain, pitched)})
    paper = settings["paper"]
    way = f"{paper}, {pitched} ({EXPLORATORY})"
    found = [*rows(paper, columns[plain]), *rows(way, columns[pitched])]
    return Report({"published": published, "forms": forms}, found)
