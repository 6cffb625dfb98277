"""``python -m scripts.evaluate``: `agents.commands.evaluate`."""

import sys

from agents.commands.console import command
from agents.commands.evaluate import main

if __name__ == "__main__":
    sys.exit(command(main))
