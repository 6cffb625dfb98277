"""The table of an environment's options on a command line, and the parser of a command."""

import argparse
import inspect
import os
import re
import sys
import tomllib
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NoReturn, get_args, get_origin, get_type_hints

from agents.refusal import Refusal


def acting(agent: str, options: dict[str, Any]) -> str:
    """The agent of a command: with a tuned file its controller, unless another one is named."""
    return options.get("tuned", agent) if agent == "autopilot" else agent


def _assignment(word: str) -> tuple[str, Any]:
    """A word as name=value; the value is TOML, or else a text."""
    name, _, text = word.partition("=")
    if not (name and text):
        raise argparse.ArgumentTypeError(f"words must be name=value, got {word!r}")
    try:
        return name, tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return name, text


ENVIRONMENT: dict[str, tuple[Any, str]] = {
    "estimator": (
        str,
        "what the agent sees the world through; the environment's default if not given",
    ),
    "estimator_options": (dict[str, Any], "options of the estimator, e.g. members=50"),
    "sensors": (str, "clean, nominal (if not given), degraded, budget or denied"),
    "disturbance": (str, "calm, moderate (if not given) or rough"),
    "mismatch": (float, "relative spread of the truth's parameters, 0 (if not given) to 0.25"),
    "observe": (str, "mean (if not given), mean+std or measurement"),
    "termination": (
        str,
        "who ends a mission: belief or task; the environment's default if not given",
    ),
    "guidance": (bool, "observe the mission relative to the reference, or the state alone"),
    "tuned": (str, "file of vessel-gym tune, whose estimator and controller are used"),
    "vessel": (
        str,
        "vehicle file, or the name of one that comes with the package, for environments that take"
        " one",
    ),
}
"""Keywords of `gymnasium.make`, their types and help; only what is typed is passed on."""
SHARED = {
    "env_id": "registered environment, or your own: module:id",
    "agent": "a controller of the task (autopilot; ships: lqg, pid), ppo (comes with the package),"
    " random, the path of a checkpoint, or your own as module:object, whose code is run",
    "first_seed": "number of the first evaluation seed, counted from 0",
    "processes": "processes on this machine",
}
"""Help on parameters of several commands; each command has its own in ``OPTIONS``."""
_LEAST = dict.fromkeys(("episodes", "every", "processes", "rounds", "runs", "evaluations"), 1)
"""Least values of whole numbers that may not be 0."""
MOST = 2**31 - 1
"""No whole number that a command takes may be greater."""


def parsed(
    main: Callable[..., int | None], arguments: Sequence[str] | None, name: str | None
) -> Callable[[], int | None]:
    """The call of a command that a command line asks for.

    Options are the parameters of the command with their types and defaults, and the help of
    ``OPTIONS`` beside it; those before a ``/`` are positional. A command with keywords ``**`` takes
    those of `ENVIRONMENT`, too.

    Raises:
        Refusal: if it asks for none, or a whole number is out of range.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    if any(not word or (word.startswith("--") and word.endswith("=")) for word in words):
        raise Refusal("an argument is empty")  # it would be taken for the present folder
    if any(re.match(r"[A-Za-z_][\w.]*:", word) for word in words) and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # where a module:object of the user's own lies
    parser, positional = _parser(main, name)
    values, odd = parser.parse_known_intermixed_args(words)
    if odd:
        from estimators.factory import unknown

        flags = [flag for flag in parser._option_string_actions if flag.startswith("--")]
        raise Refusal(unknown("argument", odd[0], flags))
    given = vars(values)
    for key, value in given.items():
        least, each = _LEAST.get(key, 0), value if isinstance(value, list) else [value]
        if isinstance(value, list) and isinstance(value[0], tuple):
            given[key] = dict(value)
        for number in each:
            if type(number) is int and not least <= number <= MOST:
                raise Refusal(f"{_flag(key)} must be from {least} to {MOST}, got {number}")
    return partial(main, *[given.pop(each) for each in positional], **given)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise Refusal(f"{message}; --help tells what there is")


def _parser(main: Callable[..., Any], name: str | None) -> tuple[_Parser, list[str]]:
    """The parser of a command, and the names of its positional arguments."""
    parser = _Parser(
        prog=name,
        description=(inspect.getdoc(main) or "").partition("\n\nReturns:")[0],
        allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    helps, hints = SHARED | main.__globals__.get("OPTIONS", {}), get_type_hints(main)
    parameters, positional = inspect.signature(main).parameters, []
    for key, parameter in parameters.items():
        if parameter.kind is parameter.VAR_KEYWORD:
            group = parser.add_argument_group("options of the environment")
            for each, (kind, text) in ENVIRONMENT.items():
                if each not in parameters:
                    group.add_argument(_flag(each), **_keywords(kind, argparse.SUPPRESS, text))
            continue
        keywords = _keywords(hints[key], parameter.default, helps.get(key, ""))
        if "type" in keywords:
            keywords.setdefault("metavar", key.rstrip("_").upper())
        if parameter.kind is parameter.POSITIONAL_ONLY:
            if "default" in keywords:
                keywords["nargs"] = "*" if "nargs" in keywords else "?"
            parser.add_argument(key, **keywords)
            positional.append(key)
        else:
            parser.add_argument(_flag(key), dest=key, **keywords)
    return parser, positional


def _flag(name: str) -> str:
    return f"--{name.rstrip('_').replace('_', '-')}"


def _keywords(kind: Any, default: Any, help: str) -> dict[str, Any]:
    """Keywords of `argparse` for a parameter of a type, such as ``Path | None`` or a tuple."""
    keywords: dict[str, Any] = {"help": help}
    typed_only, several = default is argparse.SUPPRESS, get_origin(kind)
    if default is not inspect.Parameter.empty:
        keywords["default"] = default
        if default and kind is not bool and not typed_only:
            written = " ".join(map(str, default)) if several is tuple else default
            keywords["help"] = f"{help} (default: {written})"
    if kind is bool:
        action = argparse.BooleanOptionalAction if typed_only else "store_true"
        return {"action": action, **keywords}
    if several is dict:
        keywords |= {"type": _assignment, "action": "extend", "default": argparse.SUPPRESS}
        return {"metavar": "NAME=VALUE", "nargs": "+", **keywords}
    if several is tuple:
        keywords["nargs"] = "+"
    return {"type": (get_args(kind) or (kind,))[0], **keywords}
