"""Say what there is: ``vessel-gym list environments``."""

from importlib import import_module
from typing import Any

from agents.commands.console import asked, print_table

OPTIONS = {"what": "environments, estimators, sensors or studies"}


def main(what: str = "environments", env_id: str = "SigmaCorvette-v0", /) -> None:
    """List the environments and studies, or the estimators and sensors of an environment."""
    from vessel_gym.checks import one_of

    lists = {
        "environments": lambda: (("environment", "estimator", ""), _environments()),
        "estimators": lambda: (("estimator", "", "variants"), _estimators(env_id)),
        "sensors": lambda: (("sensor", "grades, the best first"), _sensors(env_id)),
        "studies": lambda: (("study", ""), _studies()),
    }
    with asked():
        header, rows = lists[one_of("list", what, lists)]()
    print_table(what if what in ("environments", "studies") else env_id, header, [rows])


def _environments() -> list[list[str]]:
    """Names, default estimators and first sentences."""
    from agents.studies.worlds import ours, system_of

    rows = []
    for name, place in ours().items():
        module, _, entry = place.partition(":")
        summary = (getattr(import_module(module), entry).__doc__ or "").strip().splitlines()[0]
        rows.append([name, system_of(name).estimator, summary])
    return rows


def _estimators(env_id: str) -> list[list[str]]:
    """Estimators that an environment's model can carry, and their variants."""
    from agents.studies.worlds import estimated_world
    from vessel_gym.estimation import VARIANTS, accepted, chosen_disturbance

    system: Any = estimated_world(env_id)
    world = system.sensors_of("nominal"), chosen_disturbance(system, "moderate")
    plain = accepted(system, *world)
    rows = []
    for name in plain:
        variants = accepted(system, *world, tuple(f"{name}-{last}" for last in VARIANTS))
        rows.append([name, "default" if name == system.estimator else "", ", ".join(variants)])
    return rows


def _sensors(env_id: str) -> list[list[str]]:
    """Sensors of an environment, and their grades."""
    from agents.studies.worlds import estimated_world
    from vessel_gym.sensors.grades import grades_of

    return [
        [name, ", ".join(grades)] for name, grades in grades_of(estimated_world(env_id)).items()
    ]


def _studies() -> list[list[str]]:
    """Names and titles of the studies that come with the package."""
    from agents.commands.ablate import STUDIES
    from vessel_gym.toml_file import TomlFile

    return [[name, TomlFile(path).data["title"]] for name, path in STUDIES.items()]
