"""``python -m scripts.budget``: `agents.commands.budget`."""

import sys

from agents.commands.budget import main
from agents.commands.console import command

if __name__ == "__main__":
    sys.exit(command(main))
