"""Say what there is: ``vessel-gym list environments``."""

from agents.commands.console import asked, print_table

OPTIONS = {
    "what": "environments, estimators, sensors or studies",
    "env_id": "environment of these estimators or sensors (SigmaCorvette-v0), or your own:"
    " module:id",
}


def main(what: str = "environments", env_id: str = "", /) -> None:
    """List the environments and studies, or the estimators and sensors of an environment."""
    from vessel_gym.checks import one_of

    of = env_id or "SigmaCorvette-v0"
    lists = {
        "environments": (("environment", "default estimator", "description"), _environments),
        "estimators": (("estimator", "default", "variants"), lambda: _estimators(of)),
        "sensors": (("sensor", "grades, the best first"), lambda: _sensors(of)),
        "studies": (("study", "question"), _studies),
    }
    with asked():
        header, rows = lists[one_of("list", what, lists)]
        whole = what in ("environments", "studies")
        if whole and env_id:
            raise ValueError(f"list {what} lists all: it takes no {env_id!r}")
        print_table(what if whole else of, header, rows())


def _environments() -> list[list[str]]:
    """Names, default estimators and first sentences."""
    from agents.named import loaded
    from agents.studies.worlds import OURS, environments, system_of

    rows = []
    for name, place in environments(OURS).items():
        summary = loaded(place).__doc__.strip().splitlines()[0]
        rows.append([name, system_of(name).estimator, summary])
    return rows


def _estimators(env_id: str) -> list[list[str]]:
    """Estimators that an environment can carry, and their variants."""
    from agents.studies.worlds import estimated_world, refusal
    from vessel_gym.models.estimation import VARIANTS, estimator_names

    default = estimated_world(env_id).estimator
    refused = {name: refusal(env_id, {"estimator": name}) for name in estimator_names()}
    rows = []
    for name in (name for name, reason in refused.items() if reason is None):
        variants = [f"{name}-{last}" for last in VARIANTS]
        variants = [each for each in variants if refusal(env_id, {"estimator": each}) is None]
        rows.append([name, "yes" if name == default else "", ", ".join(variants)])
    if not rows:
        raise ValueError(str(refused["truth"]))
    return rows


def _sensors(env_id: str) -> list[list[str]]:
    """Sensors of an environment, and their grades; those of an environment of others have one."""
    from agents.studies.worlds import estimated_world
    from agents.wrapped import Wrapped
    from vessel_gym.sensors.grades import NOMINAL, grades_of

    system = estimated_world(env_id)
    if isinstance(system, Wrapped):
        return [[sensor.name, NOMINAL] for sensor in system.sensors.each]
    return [[name, ", ".join(grades)] for name, grades in grades_of(system).items()]


def _studies() -> list[list[str]]:
    """Names and titles of the studies that come with the package."""
    from agents.commands.ablate import STUDIES
    from vessel_gym.toml_file import TomlFile

    return [[name, TomlFile(path).data["title"]] for name, path in STUDIES.items()]
