"""Commands of ``vessel-gym``: parse, call, print. One file a command.

A command imports what takes time within its functions; no other part of `agents` imports a command.
"""

import sys
from importlib import import_module

from agents.commands.console import command, one_sentence_errors
from agents.refusal import Refusal

COMMANDS = ("list", "watch", "evaluate", "tune", "train", "plot", "ablate", "budget", "reproduce")


def main() -> int | None:
    """Call the command that the first word names.

    Returns:
        Its exit status, if it has one.
    """
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in COMMANDS:
        module = import_module(f"agents.commands.{name}")
        return command(module.main, arguments, f"vessel-gym {name}")
    with one_sentence_errors():
        if name not in ("-h", "--help", "--version"):
            from estimators.factory import unknown

            raise Refusal(unknown("command", name, COMMANDS))
        from vessel_gym import __version__

        print(f"vessel-gym {__version__}" if name == "--version" else _listing())
    return 0


def _listing() -> str:
    """List of the commands, each with the first sentence of its help."""
    lines = ["usage: vessel-gym COMMAND ...", ""]
    for name in COMMANDS:
        summary = import_module(f"agents.commands.{name}").main.__doc__.splitlines()[0]
        lines.append(f"  {name:10} {summary}")
    last = (
        "vessel-gym COMMAND --help prints what a command takes, vessel-gym --version the version."
    )
    return "\n".join([*lines, "", last])
