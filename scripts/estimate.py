"""``python -m scripts.estimate``: `agents.commands.estimate`."""

import sys

from agents.commands.console import command
from agents.commands.estimate import main

if __name__ == "__main__":
    sys.exit(command(main))
