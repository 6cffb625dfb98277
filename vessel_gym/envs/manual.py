"""Docstrings of the package's environments, from the files in manuals."""

import re
from collections.abc import Mapping
from inspect import cleandoc
from pathlib import Path
from string import Template
from textwrap import fill
from typing import Any

from vessel_gym.simulation.configuration import Options
from vessel_gym.system import System

_MANUALS = Path(__file__).with_name("manuals")
_SECTION = re.compile(r"^## ([^\n]+)\n\n(.*?)(?=\n+## |\n*\Z)", re.M | re.S)
_ITEM = re.compile(r"^- ``(\w+)``: (.*?)(?=\n- |\n\n|\Z)", re.M | re.S)
_ARGUMENT = re.compile(r"^    (\w+): (.*?)(?=\n    \w|\n\n)", re.M | re.S)
_WRAPPING: Any = {
    "width": 118,
    "subsequent_indent": "  ",
    "break_on_hyphens": False,
    "break_long_words": False,
}


def manual(system: System) -> str:
    """Docstring of a system's environment, from the file that is named after the system.

    The docstring begins with the text above the file's first heading. If there are headings, the
    template manuals/common.md follows. A section fills the placeholder of its heading, and an item
    of ``Information`` the placeholder of its key. `Options` documents arguments, and an item of
    ``Arguments`` adds details of the environment. The files in manuals/shared are passages of
    several manuals.
    """
    passages = {
        path.stem: path.read_text(encoding="utf-8").rstrip()
        for path in (_MANUALS / "shared").glob("*.md")
    }
    name = system.name.rpartition("/")[2].partition("-")[0]
    text = _filled(f"{re.sub('(?<=[a-z])(?=[A-Z])', '_', name).lower()}.md", passages)
    head, own = text.partition("## ")[0].rstrip(), dict(_SECTION.findall(text))
    return f"{head}\n\n{_sections(system, own)}" if own else head


def _sections(system: System, own: dict[str, str]) -> str:
    """The template, filled in with the sections of an environment's own file."""
    here = dict(_ITEM.findall(own.pop("Arguments")))
    texts = dict(_ARGUMENT.findall(cleandoc(Options.__doc__ or "").partition("Raises:")[0]))
    texts |= dict.fromkeys({"termination"} & here.keys(), "")  # it has no effect there
    items = [f"- ``{name}``: {text} {here.get(name, '')}" for name, text in texts.items()]
    values = {
        "id": system.name,
        "estimator": system.estimator,
        "arguments": "\n".join(items),
        "version_history": "- v0: first version.",
    }
    values |= dict(_ITEM.findall(own.pop("Information")))
    values |= {title.lower().replace(" ", "_"): text for title, text in own.items()}
    return _ITEM.sub(lambda item: _wrapped(" ".join(item[0].split())), _filled("common.md", values))


def _wrapped(item: str) -> str:
    """An item in lines, of which none begins with %, as a comment of Markdown does."""
    return fill(item.replace(" %", "\0%"), **_WRAPPING).replace("\0", " ")


def _filled(file: str, values: Mapping[str, str]) -> str:
    """Text of a manual's file with ``$placeholders`` filled in."""
    return Template((_MANUALS / file).read_text(encoding="utf-8")).substitute(values)
