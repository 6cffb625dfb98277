"""Study files, read from TOML and checked before anything runs."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from agents.controllers import AUTOPILOT, PPO, controller_names, is_controller, make_controller
from agents.seeds import evaluation_seeds
from agents.studies.plan import plan
from agents.studies.records import (
    DEFAULT,
    EACH,
    FLOOR,
    ORACLE,
    RAW,
    Agent,
    Condition,
    Estimator,
    Study,
    Tuning,
)
from agents.studies.worlds import (
    environment_id,
    environment_options,
    estimated_world,
    refusal,
    registered_id,
    system_of,
)
from agents.training.algorithms import describe
from agents.tuning.arm import LIKELIHOOD, SCORE
from agents.tuning.tune import seeds_of_tuning
from estimators.checks import short_repr
from estimators.factory import unknown
from vessel_gym.checks import all_are
from vessel_gym.models.estimation import estimator_names
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.simulation.configuration import TERMINATIONS
from vessel_gym.toml_file import TomlError, TomlFile


class StudyError(ValueError):
    """Everything that is wrong with a study file, a line each."""

    def __init__(self, path: Path | str, mistakes: Sequence[tuple[int, str]]) -> None:
        self.mistakes = list(mistakes)
        many = f" has {len(mistakes)} mistakes:\n" if len(mistakes) > 1 else ": "
        lines = [f"line {line}: {text}" if line else text for line, text in sorted(self.mistakes)]
        super().__init__(f"{path}{many}" + "\n".join(lines))


def read_study(path: Path | str) -> Study:
    """Read a study file.

    Raises:
        StudyError: if it is not TOML or not a study, with every mistake and its line.
        OSError: if it cannot be read.
    """
    try:
        reader = _Reader(TomlFile(Path(path)))
    except TomlError as error:
        raise StudyError(path, [(error.line, error.sentence)]) from None
    study = reader.study()
    if reader.mistakes:
        raise StudyError(path, list(dict.fromkeys(reader.mistakes)))
    return study


_SECTIONS = ("environments", "estimators", "agents", "conditions", "tune")
_OBSERVED = ("mean", "mean+std", "measurement")
_LEARNED = {"observe", "memory", "trained_on", "flown_on", "steps", "settings"}
"""Keys of agents that learn."""
_MOST = 2**31 - 1


def _names(value: list[Any]) -> bool:
    return all_are(str, value) and 0 < len(value) == len(set(value))


def _suite(value: str | dict[str, Any]) -> bool:
    return isinstance(value, str) or all_are(str, [*value.values()])


_LIST: Any = list, "a list of names, one or more, each once", _names
_KEYS: dict[str, tuple[Any, ...]] = {
    "episodes": (int, "a whole number of at least 2", lambda value: value >= 2),
    "training_seeds": (int, "a whole number from 1 to 1000", lambda value: 1 <= value <= 1000),
    "first_seed": (int, "a whole number of at least 0", lambda value: value >= 0),
    "margin": (int | float, "a share between 0 and 1", lambda value: 0 < value < 1),
    "termination": (str, " or ".join(TERMINATIONS), TERMINATIONS.__contains__),
    "environments": _LIST,
    "options": (dict, "a table"),
    "sensors": (str | dict, "a name, or a table of grades by sensor", _suite),
    "mismatch": (int | float, "a number"),
    "latency": (dict, "a table of seconds by sensor"),
    "faults": (list, "a list of tables"),
    "observe": (str, f"one of {', '.join(_OBSERVED)}", _OBSERVED.__contains__),
    "trained_on": _LIST,
    "flown_on": _LIST,
    "steps": (
        dict,
        f"a table of whole numbers from 1 to {_MOST} by environment",
        lambda value: all(type(n) is int and 1 <= n <= _MOST for n in value.values()),
    ),
    "settings": (dict, "a table"),
    "evaluations": (int, "a whole number of at least 1", lambda value: value >= 1),
    "tunings": (int, "a whole number from 1 to 1000", lambda value: 1 <= value <= 1000),
    "conditions": _LIST,
    "by": (str, f"{SCORE} or {LIKELIHOOD}", (SCORE, LIKELIHOOD).__contains__),
}
"""Type in TOML of each key, its description, and perhaps a test; other keys take a name."""


class _Reader:
    """Makes a study of parsed TOML and notes what is wrong with it.

    Attributes:
        mistakes: Line and sentence of each.
        place: Keys that lead to the entry that is being read.
        ids: Environments of the study.
        worlds: Those that can be used.
    """

    def __init__(self, file: TomlFile) -> None:
        self.file, self.data = file, file.data
        self.mistakes: list[tuple[int, str]] = []
        self.place: tuple[str, ...] = ()

    def study(self) -> Study:
        """The study; meaningless if there are mistakes."""
        self.ids, names = list[str](), dict[str, str]()
        for name, table in self.tables("environments"):
            self.known(f"key in environments.{name}", table, ())
            self.ids.append(name)
            if not self.accepts("", estimated_world, name):
                continue
            if (other := names.setdefault(registered_id(name), name)) != name:
                self.wrong(f"{other} and {name} are one environment: leave one of them out")
        if self.data.get("environments", {}) == {}:
            form = "a study needs environments: [environments] with a line 'name = {}' for each"
            self.wrong(form, "environments")
        self.worlds = list(names.values())
        conditions = self.conditions()
        estimators = self.estimators()
        agents = self.agents(estimators)
        tune = self.tuning(conditions)
        self.place = ()
        plain = {key: value for key, value in self.data.items() if key not in _SECTIONS}
        values = self.values("key", plain, Study)
        # Measurements contain no belief: where an agent sees them, the truth ends a mission.
        values.setdefault("termination", "task" if any(a.raw for a in agents) else "belief")
        title = values.pop("title", "What does the estimator cost?")
        found = tuple(estimators.values())
        study = Study(title, tuple(self.ids), found, agents, conditions, tune=tune, **values)
        if study.compare_to:
            self.known("filter of the study", [study.compare_to], study.filters, "compare_to")
        self.accepts("episodes", evaluation_seeds, study.episodes, study.first_seed)
        alone = plan(replace(study, environments=tuple(self.worlds), agents=()))
        for name, estimator in estimators.items():
            reasons = [skipped.reason for skipped in alone.skipped if skipped.what == name]
            if reasons and len(reasons) == len(self.here(estimator)):
                self.place = ("estimators", name)
                self.wrong(f"no environment of the study can carry {name}: {reasons[0]}")
        return study

    # --- sections ---------------------------------------------------------------------------------

    def conditions(self) -> tuple[Condition, ...]:
        """The conditions; those that an environment refuses without what is wrong."""
        found: list[Condition] = []
        for condition in self.records("conditions", Condition):
            worlds = self.here(condition)
            if condition.environments and not found:
                self.wrong(
                    "the first condition is that of trainings: no environments", "environments"
                )
            faults = tuple(f for f in condition.faults if self.accepts("faults", _fault, f))
            each = [self.accepts("sensors", _sensor_names, world, condition) for world in worlds]
            sensors = condition.sensors if all(each) else "nominal"
            names = dict.fromkeys(name for found in each for name in found or ())
            for key, named in (
                ("sensors", sensors if isinstance(sensors, dict) else {}),
                ("latency", condition.latency),
                ("faults", [fault["sensor"] for fault in faults]),
            ):
                self.known("sensor", named, names or named, key)
            condition = replace(condition, faults=faults, sensors=sensors)
            for world in worlds:
                if error := refusal(world, {"estimator": ORACLE} | condition.options):
                    self.wrong(f"{world} refuses the condition {condition.name}: {error}")
                    condition = Condition(condition.name)
            found.append(condition)
        return tuple(found) or (Condition("nominal"),)

    def estimators(self) -> dict[str, Estimator]:
        """The estimators by name, and before them the ends of the scale."""
        found = {name: Estimator(name, name) for name in (ORACLE, FLOOR)}
        for each in self.records("estimators", Estimator, "estimator"):
            given = {k: None if value == "none" else value for k, value in each.options.items()}
            name, estimator = each.name, replace(each, options=given)
            self.own_name(each.estimator, (DEFAULT, RAW, *estimator_names()))
            if estimator != found.setdefault(name, estimator):
                self.wrong(f"{name} is an end of the scale: leave it as it is, {name} = {{}}")
        return found

    def agents(self, estimators: Mapping[str, Estimator]) -> tuple[Agent, ...]:
        """The agents, and before them the autopilot if the file names none and there is one."""
        found = list[Agent]()
        for agent in self.records("agents", Agent, "kind"):
            found.append(agent)
            self.check_kind(agent)
            keys = _LEARNED & set(self.data["agents"][agent.name])
            if agent.learned:
                self.check_training(agent, estimators)
                text = "{} sees raw measurements: it is trained and flown on no estimator"
                keys &= {"trained_on", "flown_on"} if agent.raw else set()
            else:
                text = f"{{}} is of kind {agent.kind}: only agents that learn have such a key"
            for key in keys:
                self.wrong(text.format(agent.name), key)
        acts = not self.worlds or any(is_controller(AUTOPILOT, system_of(w)) for w in self.worlds)
        if acts and not any(agent.kind == AUTOPILOT for agent in found):
            found.insert(0, Agent(AUTOPILOT, AUTOPILOT))
        if all(agent.learned for agent in found):
            self.place = ("agents",)
            self.wrong(
                "no environment of the study has an autopilot: name a controller, module:object if"
                " it is your own"
            )
        return tuple(found)

    def check_kind(self, agent: Agent) -> None:
        """Note an agent that has the name of another kind, or is none in its environments."""
        systems = [system_of(world) for world in self.here(agent)]
        names = dict.fromkeys(name for system in systems for name in controller_names(system))
        self.own_name(agent.kind, (PPO, AUTOPILOT, *names))
        if ":" in agent.kind:
            for system in systems:
                self.accepts("kind", make_controller, agent.kind, system)
        else:
            self.known("kind of agent", [agent.kind], (*(names or (AUTOPILOT,)), PPO), "kind")

    def check_training(self, agent: Agent, estimators: Mapping[str, Estimator]) -> None:
        """Note estimators, steps and settings that a training cannot have."""
        here, name, schools = self.here(agent), agent.name, agent.trained_on
        self.known("estimator", schools, (*estimators, DEFAULT), "trained_on")
        self.known("estimator", agent.flown_on, estimators, "flown_on")
        self.known(f"environment of {name}", agent.steps, agent.environments or self.ids, "steps")
        for world in here:
            arguments = agent.steps.get(world), agent.memory, agent.settings
            key = "settings" if agent.settings else "steps"
            if env_id := self.accepts("kind", environment_id, world):
                self.accepts(key, describe, env_id, None, 0, *arguments)

    # --- tables -----------------------------------------------------------------------------------

    def wrong(self, text: str, key: str = "") -> None:
        """Note a mistake at a key of the entry, or at the nearest place that has a line."""
        self.mistakes.append((self.file.line((*self.place, key)) or 0, text))

    def accepts(self, key: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function and return what it does, or note its ValueError or TypeError."""
        try:
            return function(*arguments)
        except (ValueError, TypeError) as error:
            self.wrong(str(error), key)

    def known(self, kind: str, names: Iterable[str], known: Iterable[str], key: str = "") -> None:
        """Note those of some names that are not known, at a key or where they are keys."""
        for name in names:
            if name not in known:
                self.wrong(unknown(kind, name, known), key or name)

    def own_name(self, kind: str, known: Sequence[str]) -> None:
        """Note the name of an entry that something else has."""
        if (name := self.place[-1]) != kind and name in known:
            self.wrong(f"the name {name!r} is taken: give this {kind!r} another one")

    def here(self, record: Any) -> list[str]:
        """The environments of an estimator, agent or condition."""
        return [world for world in self.worlds if record.is_in(world)]

    def tuning(self, conditions: Sequence[Condition]) -> Tuning | None:
        """The table of tunings, if there is one."""
        self.place, table = ("tune",), self.data.get("tune")
        if table is None:
            return None
        if not isinstance(table, dict):
            self.wrong("tune must be a table: [tune] with evaluations, tunings and others")
            return None
        tuning = Tuning(**self.values("key in tune", table, Tuning))
        self.accepts("tunings", seeds_of_tuning, tuning.episodes, tuning.tunings - 1)
        if EACH in tuning.conditions and len(tuning.conditions) > 1:
            self.wrong('conditions must be names of conditions, or ["each"] alone', "conditions")
        names = (EACH, *(each.name for each in conditions))
        self.known("condition", tuning.conditions, names, "conditions")
        return tuning

    def tables(self, section: str) -> Iterator[tuple[str, dict[str, Any]]]:
        """Names and tables of a section, each while it is the entry."""
        self.place, tables = (section,), self.data.get(section, {})
        if not isinstance(tables, dict):
            self.wrong(f"{section} must be a table: [{section}] with a line 'name = {{}}' for each")
            return
        for name, table in tables.items():
            self.place = (section, name)
            if not isinstance(table, dict):
                self.wrong(f"{section}.{name} must be a table, e.g. {{}}, got {table!r}")
                continue
            if not name.isprintable() or not name.strip():
                self.wrong(f"names of {section} must be text in a line, got {name!r}")
            yield name, table

    def records(self, section: str, record: type, second: str = "name") -> Iterator[Any]:
        """Records of a section, each while its table is the entry.

        The attribute ``second`` is the name where the file lacks it.
        """
        for name, table in self.tables(section):
            values = self.values(f"key in {section}.{name}", table, record)
            each = record(**{"name": name, second: name} | values)
            self.known("environment", each.environments, self.ids, "environments")
            yield each

    def values(self, what: str, table: Mapping[str, Any], record: type) -> dict[str, Any]:
        """Values of a table for fields of a record; wrong ones are noted and left out."""
        keys = [each.name for each in fields(record) if each.name != "name"]
        self.known(what, table, keys)
        found = {}
        for key in [key for key in table if key in keys]:
            (kind, words, *tests), value = _KEYS.get(key, (str, "a name")), table[key]
            right = isinstance(value, kind) and not isinstance(value, bool)
            if right and all(test(value) for test in tests):
                found[key] = tuple(value) if isinstance(value, list) else value
            else:
                self.wrong(f"{key} must be {words}, got {short_repr(value)}", key)
        return found


def _sensor_names(environment: str, condition: Condition) -> list[str]:
    """Names of the sensors of an environment in a condition."""
    chosen = environment_options(environment, {"sensors": condition.sensors})
    sensors = system_of(environment).sensors_of(chosen.get("sensors", "nominal"))
    return [sensor.name for sensor in sensors.each]


def _fault(fault: Any) -> SensorFault:
    """A fault by its table."""
    try:
        return SensorFault(**fault)
    except TypeError:
        text = "faults must be tables of sensor, kind and perhaps size, begin, duration, got"
        raise TypeError(f"{text} {fault!r}") from None
