"""Console command: ``vessel-gym watch PunaUAV-v0`` or ``python -m vessel_gym watch PunaUAV-v0``."""

import sys
from importlib import import_module, metadata

from vessel_gym import FOLDER, clashing_file  # type: ignore[attr-defined]  # not public


def main() -> int | None:
    """Run the command that the command line names, and return its exit status, if it has one.

    The commands are in ``agents``, a package above this one, and are imported by name. The
    package's ``agents`` takes precedence over a user's folder of that name.
    """
    if clashing_file("agents"):
        sys.path.insert(0, FOLDER)
    try:
        return import_module("agents.commands").main()
    except ImportError:
        others = set(metadata.packages_distributions().get("agents", ())) - {"vessel-gym"}
        if not others:
            raise
        print(
            f"error: {', '.join(sorted(others))} has written over vessel-gym's package agents: "
            "install vessel-gym into an environment of its own (python -m venv)",
            file=sys.stderr,
        )
        return 2


if __name__ == "__main__":
    sys.exit(main())
