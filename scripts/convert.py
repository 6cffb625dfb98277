"""``python -m scripts.convert``: `agents.commands.convert`."""

import sys

from agents.commands.console import command
from agents.commands.convert import main

if __name__ == "__main__":
    sys.exit(command(main))
