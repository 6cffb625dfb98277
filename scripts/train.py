"""``python -m scripts.train``: `agents.commands.train`."""

import sys

from agents.commands.console import command
from agents.commands.train import main

if __name__ == "__main__":
    sys.exit(command(main))
