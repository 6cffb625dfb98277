"""The console command: ``vessel-gym watch PunaUAV-v0``, or ``python -m scripts watch PunaUAV-v0``."""

import sys
from importlib import import_module

from scripts.console import command, complain, one_sentence_errors

COMMANDS = ("watch", "evaluate", "train", "ablate", "budget", "reproduce")
"""The files of scripts/ that users call; the others write pages of this repository."""


def main() -> int | None:
    """Call the command that the first word names.

    Returns:
        Its exit status, if it has one.
    """
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in COMMANDS:
        return command(import_module(f"scripts.{name}").main, arguments, f"vessel-gym {name}")
    if name in ("-h", "--help", "--version"):
        with one_sentence_errors():
            print(version() if name == "--version" else listing())
        return 0
    from estimators.factory import unknown

    return complain(unknown("command", name, COMMANDS))


def version() -> str:
    """Name and version of this package."""
    from vessel_gym import __version__

    return f"vessel-gym {__version__}"


def listing() -> str:
    """List of the commands, each with the first sentence of its help."""
    lines = ["usage: vessel-gym COMMAND ...", ""]
    lines += [f"  {name:10} {import_module(f'scripts.{name}').main.__doc__.splitlines()[0]}" for name in COMMANDS]
    return "\n".join([*lines, "", "vessel-gym COMMAND --help tells what a command takes; --version, which this is."])


if __name__ == "__main__":
    sys.exit(main())
