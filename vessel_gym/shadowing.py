"""Packages of the user that have the name of one of ours and are found first."""

import os
from importlib.util import find_spec

FOLDER = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
"""Folder of our packages."""


def shadowing(package: str) -> str | None:
    """The file that is imported in place of our package of this name; None if it is ours."""
    spec = find_spec(package)
    place = (
        None
        if spec is None
        else spec.origin or next(iter(spec.submodule_search_locations or ()), None)
    )
    ours = os.path.join(FOLDER, package, "")
    return place if place is not None and not os.path.realpath(place).startswith(ours) else None
