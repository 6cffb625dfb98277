"""Gymnasium environments with a state estimator in the loop.

Importing this package registers the environments; ``gymnasium.make("vessel_gym:SigmaCorvette-v0")``
imports the package itself. An agent observes a filter's belief. The true state moves underneath and
is kept for scoring.
"""

from typing import Any

from gymnasium.envs.registration import register

from vessel_gym.shadowing import shadowing

if _file := shadowing("estimators"):
    raise ImportError(
        f"vessel_gym needs its own package estimators, but {_file} is found first: rename that file"
        " or folder, or start your script by python -P or from a subfolder",
        name=__name__,  # so that python -m vessel_gym prints the sentence alone
    )

__version__ = "1.0.0"
__all__ = ["__version__", "check_system"]

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


def __getattr__(name: str) -> Any:
    """`vessel_gym.contract.check_system`, imported when it is first asked for."""
    if name != "check_system":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from vessel_gym.contract import check_system

    return check_system


def __dir__() -> list[str]:
    """Public names."""
    return __all__
