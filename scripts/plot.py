"""``python -m scripts.plot``: `agents.commands.plot`."""

import sys

from agents.commands.console import command
from agents.commands.plot import main

if __name__ == "__main__":
    sys.exit(command(main))
