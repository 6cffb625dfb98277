"""``python -m scripts.reproduce``: `agents.commands.reproduce`."""

import sys

from agents.commands.console import command
from agents.commands.reproduce import main

if __name__ == "__main__":
    sys.exit(command(main))
