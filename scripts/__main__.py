"""The console command: ``vessel-gym watch PunaUAV-v0``, or ``python -m scripts watch PunaUAV-v0``."""

import sys
from importlib import import_module

from scripts.console import command, complain

COMMANDS = ("watch", "evaluate", "train", "ablate", "reproduce", "benchmark")
"""The files of scripts/ that users call; the others write pages of this repository."""


def main() -> int | None:
    """Call the command that the first word names.

    Returns:
        Its exit status, if it has one.
    """
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in COMMANDS:
        return command(import_module(f"scripts.{name}").main, arguments, f"vessel-gym {name}")
    if name in ("-h", "--help"):
        print(listing())
        return 0
    if name == "--version":
        from vessel_gym import __version__

        print(f"vessel-gym {__version__}")
        return 0
    from estimators.factory import unknown

    return complain(unknown("command", name, COMMANDS))


def listing() -> str:
    """What there is, each with the first sentence of its help."""
    lines = ["usage: vessel-gym COMMAND ...", ""]
    lines += [f"  {name:10} {import_module(f'scripts.{name}').main.__doc__.splitlines()[0]}" for name in COMMANDS]
    return "\n".join([*lines, "", "vessel-gym COMMAND --help tells what a command takes; --version, which this is."])


if __name__ == "__main__":
    sys.exit(main())
