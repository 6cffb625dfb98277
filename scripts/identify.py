"""``python -m scripts.identify``: `agents.commands.identify`."""

import sys

from agents.commands.console import command
from agents.commands.identify import main

if __name__ == "__main__":
    sys.exit(command(main))
