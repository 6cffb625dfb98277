"""``python -m scripts``: ``vessel-gym`` in a checkout that is not installed."""

import sys

from vessel_gym.__main__ import main

if __name__ == "__main__":
    sys.exit(main())
