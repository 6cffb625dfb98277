"""Check for modules of the user that shadow packages of this project."""

import os
from importlib.util import find_spec

FOLDER = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
"""Folder of this project's packages."""


def shadowing(package: str) -> str | None:
    """File that is imported instead of this project's package; None for the package itself."""
    spec = find_spec(package)
    place = (
        None
        if spec is None
        else spec.origin or next(iter(spec.submodule_search_locations or ()), None)
    )
    ours = os.path.join(FOLDER, package, "")
    return place if place is not None and not os.path.realpath(place).startswith(ours) else None
