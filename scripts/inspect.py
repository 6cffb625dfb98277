"""``python -m scripts.inspect``: `agents.commands.inspect`."""

import sys

from agents.commands.console import command
from agents.commands.inspect import main

if __name__ == "__main__":
    sys.exit(command(main))
