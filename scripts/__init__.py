"""Command line: parse, call, print. One file a command."""

import sys

from vessel_gym.extras import require

try:  # before an import of one of them fails
    require("tyro", "rich")
except ModuleNotFoundError as error:
    print(f"error: {error}", file=sys.stderr)
    sys.exit(2)
