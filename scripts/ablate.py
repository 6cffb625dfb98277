"""``python -m scripts.ablate``: `agents.commands.ablate`."""

import sys

from agents.commands.ablate import main
from agents.commands.console import command

if __name__ == "__main__":
    sys.exit(command(main))
