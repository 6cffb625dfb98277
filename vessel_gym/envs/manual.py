"""Docstrings of the package's environments, from the files in manuals."""

import re
from pathlib import Path
from string import Template
from textwrap import dedent

from vessel_gym.simulation.configuration import Options
from vessel_gym.system import System

_MANUALS = Path(__file__).with_name("manuals")


def manual(system: System) -> str:
    """Docstring of a system's environment: the file that is named after the system, filled in.

    The placeholder ``$arguments`` is the documentation of `Options`. The others are passages of
    several manuals, the files in manuals/shared.
    """
    values = {
        path.stem: path.read_text(encoding="utf-8").rstrip()
        for path in (_MANUALS / "shared").glob("*.md")
    }
    arguments = dedent((Options.__doc__ or "").partition("Args:\n")[2].partition("\n\n")[0])
    values["arguments"] = re.sub(r"^(\w+)", r"- ``\1``", arguments, flags=re.M)
    name = system.name.rpartition("/")[2].partition("-")[0]
    file = _MANUALS / f"{re.sub('(?<=[a-z])(?=[A-Z])', '_', name).lower()}.md"
    return Template(file.read_text(encoding="utf-8")).substitute(values)
