"""Check for modules of the user that have the name of a package of this project."""

import os
from importlib.util import find_spec

FOLDER = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
"""Folder of this project's packages."""


def clashing_file(package: str) -> str | None:
    """File that is imported instead of this project's package; None for the package itself."""
    spec = find_spec(package)
    if spec is None:
        return None
    place = spec.origin or next(iter(spec.submodule_search_locations or ()), None)
    ours = os.path.join(FOLDER, package, "")
    return place if place and not os.path.realpath(place).startswith(ours) else None
