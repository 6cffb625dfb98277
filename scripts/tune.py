"""``python -m scripts.tune``: `agents.commands.tune`."""

import sys

from agents.commands.console import command
from agents.commands.tune import main

if __name__ == "__main__":
    sys.exit(command(main))
