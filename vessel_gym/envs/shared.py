"""Parts of single and vector environments: spaces, and what Gymnasium asks of either."""

import re
from collections.abc import Mapping
from dataclasses import fields
from inspect import cleandoc, signature
from pathlib import Path
from string import Template
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box

from estimators.factory import unknown
from vessel_gym.checks import one_of
from vessel_gym.configuration import Options
from vessel_gym.core import Core

E = TypeVar("E", bound=type)
_MANUALS = Path(__file__).with_name("manuals")


def documented(environment: E) -> E:
    """Add its manual to an environment's docstring: the Markdown file with its system's name, in ``manuals``.

    ``$name`` in a manual is a passage that several share, ``shared/name.md``.
    """
    passages = {path.stem: path.read_text(encoding="utf-8").rstrip() for path in (_MANUALS / "shared").glob("*.md")}
    name = re.sub("(?<=[a-z])(?=[A-Z])", "_", environment.system.name.partition("-")[0]).lower()  # type: ignore[attr-defined]
    manual = (_MANUALS / f"{name}.md").read_text(encoding="utf-8")
    environment.__doc__ = f"{cleandoc(environment.__doc__ or '')}\n\n{Template(manual).substitute(passages)}"
    return environment


def observation_space(core: Core) -> Box:
    """Finite float32 bounds: observations are scaled to be of order 1 and clipped."""
    return Box(-core.task.BOUND, core.task.BOUND, (core.observation_size,), np.float32)


def action_space(core: Core) -> Box:
    """float32 in [-1, 1]: shares of what the actuators can do."""
    return Box(-1.0, 1.0, (core.action_size,), np.float32)


def check_arguments(env: Any, options: Mapping[str, Any], render_mode: str | None) -> None:
    """Refuse arguments that an environment does not have.

    Raises:
        TypeError: naming the first option that there is not, and those that there are.
        ValueError: for a mode of rendering that there is not.
    """
    known = [field.name for field in fields(Options)]
    for option in options:
        if option not in known:
            own = [each for base in type(env).__mro__ if "__init__" in vars(base)
                   for each in signature(vars(base)["__init__"]).parameters.values()]  # fmt: skip
            named = dict.fromkeys(each.name for each in own if each.kind is each.POSITIONAL_OR_KEYWORD)
            raise TypeError(unknown(f"argument of {env.system.name}", option, [*list(named)[1:], *known]))
    if render_mode is not None:
        one_of("render_mode", render_mode, env.metadata["render_modes"])


def first_seed(env: gym.Env | gym.vector.VectorEnv, core: Core) -> int | None:
    """The seed of a first episode that nobody seeds: the one that ``np_random_seed`` tells; None of later ones."""
    if core.seeds:
        return None
    seed = env.np_random_seed
    return None if seed == -1 else seed  # -1: somebody has set np_random
