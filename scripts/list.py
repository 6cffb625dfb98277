"""``python -m scripts.list``: `agents.commands.list`."""

import sys

from agents.commands.console import command
from agents.commands.list import main

if __name__ == "__main__":
    sys.exit(command(main))
