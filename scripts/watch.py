"""``python -m scripts.watch``: `agents.commands.watch`."""

import sys

from agents.commands.console import command
from agents.commands.watch import main

if __name__ == "__main__":
    sys.exit(command(main))
