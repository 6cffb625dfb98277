"""Gymnasium environments with a state estimator in the loop.

Importing this package registers the environments; ``gymnasium.make("vessel_gym:SigmaCorvette-v0")``
imports the package itself. An agent observes a filter's belief. The true state moves underneath and
is kept for scoring.
"""

import os
from importlib.util import find_spec

from gymnasium.envs.registration import register

FOLDER = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
"""Folder of this project's packages."""


def clashing_file(package: str) -> str | None:
    """File that is imported instead of this project's package; None for the package itself."""
    spec = find_spec(package)
    if spec is None:
        return None
    place = spec.origin or next(iter(spec.submodule_search_locations or ()), None)
    ours = os.path.join(FOLDER, package, "")
    return place if place and not os.path.realpath(place).startswith(ours) else None


if _file := clashing_file("estimators"):
    raise ImportError(
        f"vessel_gym needs its own package estimators, but {_file} is found first: rename that file"
        " or folder, or start your script by python -P or from a subfolder",
        name=__name__,  # so that python -m vessel_gym prints the sentence alone
    )

from estimators.lazy import public_names  # noqa: E402, as another package is refused first

__version__ = "1.0.0"

for _where, _name, _steps in (
    ("", "SigmaCorvette", 600), ("", "SegorogeniAUV", 500), ("", "ItsunusaAUV", 600),
    ("", "PunaUAV", 900), ("", "SigmaChannel", 600), ("", "ThesisCorvette", 194),
    ("vessel_gym/", "Ship", 600), ("vessel_gym/", "AUV", 500), ("vessel_gym/", "FixedWing", 900),
):  # fmt: skip
    register(
        id=f"{_where}{_name}-v0",
        entry_point=f"vessel_gym.envs:{_name}Env",
        vector_entry_point=f"vessel_gym.envs:{_name}VectorEnv",
        max_episode_steps=_steps,
    )

__getattr__, __dir__, __all__ = public_names(__name__)
