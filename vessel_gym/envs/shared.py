"""Common parts of single and vector environments: manuals, spaces and checks of arguments."""

import re
from collections.abc import Mapping
from dataclasses import fields
from inspect import cleandoc, signature
from pathlib import Path
from string import Template
from textwrap import fill
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box

from estimators.factory import unknown
from vessel_gym.checks import one_of
from vessel_gym.configuration import Options
from vessel_gym.core import Core
from vessel_gym.system import System

E = TypeVar("E", bound=type)
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


def documented(environment: E) -> E:
    """Append the manual to an environment's docstring.

    The template manuals/common.md is filled in from the file named after the system. A section of
    that file fills the placeholder of its heading, and an item of ``Information`` the placeholder
    of its key. `Options` documents arguments, and an item of ``Arguments`` adds details of the
    environment. The files in manuals/shared are passages of several manuals.
    """
    system: System = environment.system  # type: ignore[attr-defined]
    passages = {
        path.stem: path.read_text(encoding="utf-8").rstrip()
        for path in (_MANUALS / "shared").glob("*.md")
    }
    name = re.sub("(?<=[a-z])(?=[A-Z])", "_", system.name.partition("-")[0]).lower()
    own = dict(_SECTION.findall(_filled(f"{name}.md", passages)))
    here, general = (
        dict(_ITEM.findall(own.pop("Arguments"))),
        cleandoc(Options.__doc__ or "").partition("Raises:")[0],
    )
    texts = dict(_ARGUMENT.findall(general))
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
    manual = _ITEM.sub(
        lambda item: _wrapped(" ".join(item[0].split())), _filled("common.md", values)
    )
    environment.__doc__ = f"{cleandoc(environment.__doc__ or '')}\n\n{manual}"
    return environment


def _wrapped(item: str) -> str:
    """An item in lines, of which none begins with %, as a comment of Markdown does."""
    return fill(item.replace(" %", "\0%"), **_WRAPPING).replace("\0", " ")


def _filled(file: str, values: Mapping[str, str]) -> str:
    """Text of a manual's file with ``$placeholders`` filled in."""
    return Template((_MANUALS / file).read_text(encoding="utf-8")).substitute(values)


def observation_space(core: Core) -> Box:
    """Finite float32 bounds of scaled, clipped observations."""
    bound = core.config.system.task.BOUND
    return Box(-bound, bound, (core.config.observation_size,), np.float32)


def action_space(core: Core) -> Box:
    """float32 in [-1, 1]: shares of the actuators' ranges."""
    return Box(-1.0, 1.0, (core.config.action_size,), np.float32)


def check_arguments(env: Any, options: Mapping[str, Any], render_mode: str | None) -> None:
    """Refuse unknown arguments of an environment.

    Raises:
        TypeError: naming the first unknown option and the known ones.
        ValueError: for an unknown render mode.
    """
    known = [field.name for field in fields(Options)]
    for option in options:
        if option not in known:
            own = [each for base in type(env).__mro__ if "__init__" in vars(base)
                   for each in signature(vars(base)["__init__"]).parameters.values()]  # fmt: skip
            named = dict.fromkeys(
                each.name for each in own if each.kind is each.POSITIONAL_OR_KEYWORD
            )
            # Python's words, which other libraries look for
            python = f"{type(env).__name__}.__init__() got an unexpected"
            raise TypeError(unknown("keyword argument", option, [*list(named)[1:], *known], python))
    if render_mode is not None:
        one_of("render_mode", render_mode, env.metadata["render_modes"])


def first_seed(env: gym.Env | gym.vector.VectorEnv, core: Core) -> int | None:
    """Seed of ``np_random_seed`` for a first episode without a seed; None for later episodes."""
    if core.seeds:
        return None
    seed = env.np_random_seed
    return None if seed == -1 else seed  # -1: np_random was set from outside
