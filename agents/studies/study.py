"""Study files, read from TOML and checked before anything runs."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from math import inf
from pathlib import Path
from typing import Any

from agents.controllers import AUTOPILOT, PPO, controller_names, is_controller, make_controller
from agents.seeds import evaluation_seeds
from agents.studies.records import DEFAULT, FLOOR, ORACLE, RAW, Agent, Condition, Estimator, Study
from agents.studies.worlds import (
    environment_options,
    estimated_world,
    refusal,
    registered_id,
    system_of,
)
from agents.training.algorithms import describe
from estimators.checks import short_repr
from estimators.factory import unknown
from vessel_gym.configuration import TERMINATIONS
from vessel_gym.estimation import estimator_names
from vessel_gym.sensor_faults import SensorFault
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
        TypeError: for what is no path.
        StudyError: if it is not TOML or not a study, with every mistake and its line.
        OSError: if it cannot be read.
    """
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"path must be that of a study file, got {short_repr(path)}")
    try:
        reader = _Reader(TomlFile(Path(path)))
    except TomlError as error:
        raise StudyError(path, [(error.line, error.sentence)]) from None
    study = reader.study()
    if reader.mistakes:
        raise StudyError(path, list(dict.fromkeys(reader.mistakes)))
    return study


_SECTIONS = ("environments", "estimators", "agents", "conditions")
_LEARNED = {"observe", "memory", "trained_on", "flown_on", "steps", "guidance", "settings"}
"""Keys of agents that learn."""
_CHOICES = {"observe": ("mean", "mean+std", "measurement"), "termination": TERMINATIONS}
"""Values that there are, by key."""
_RANGES: dict[str, tuple[float, float, str]] = {
    "episodes": (2, inf, "at least 2"),
    "training_seeds": (1, 1000, "at least 1 and at most 1000"),
    "first_seed": (0, inf, "at least 0"),
    "margin": (1e-9, 1.0 - 1e-9, "a share between 0 and 1"),
    "mismatch": (0.0, 0.25, "between 0 and 0.25"),
    "steps": (1, 2**31 - 1, "whole numbers of at least 1 and at most 2147483647"),
}
"""Least and greatest value, and their description, by key."""
_NAMES, _GRADES = tuple[str, ...], str | dict[str, str]
_KINDS: dict[Any, tuple[Any, str]] = {
    str: (str, "a name"),
    int: (int, "a whole number"),
    float: (int | float, "a number"),
    bool | None: (bool, "true or false"),
    dict[str, Any]: (dict, "a table"),
    dict[str, int]: (dict, "a table of numbers by environment"),
    dict[str, float]: (dict, "a table of seconds by sensor"),
    tuple[dict[str, Any], ...]: (list, "a list of tables"),
    _GRADES: (str | dict, "a name, or a table of grades by sensor"),
    _NAMES: (list, "a list of names"),
}
"""Type in TOML of a record's attributes, by their annotation, and what it is called."""


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
        self.known("key", self.data, [each.name for each in fields(Study)])
        self.ids = tuple(self.section("environments"))
        if self.data.get("environments", {}) == {}:
            form = "a study needs environments: [environments] with a line 'name = {}' for each"
            self.wrong(form, "environments")
        names: dict[str, str] = {}
        for name in self.ids:
            self.place = ("environments", name)
            if not self.accepts("", estimated_world, name):
                continue
            if (other := names.setdefault(registered_id(name), name)) != name:
                self.wrong(f"{other} and {name} are one environment: leave one of them out")
        self.worlds = list(names.values())
        conditions = self.conditions()
        estimators = self.estimators(conditions[0])
        agents = self.agents(estimators)
        self.place = ()
        values = self.values(Study, {k: v for k, v in self.data.items() if k not in _SECTIONS})
        # Measurements contain no belief: where an agent sees them, the truth ends a mission.
        values.setdefault("termination", "task" if any(a.raw for a in agents) else "belief")
        title = values.pop("title", "What does the estimator cost?")
        found = tuple(estimators.values())
        study = Study(title, self.ids, found, agents, conditions, **values)
        self.accepts("episodes", evaluation_seeds, study.episodes, study.first_seed)
        return study

    # --- sections ---------------------------------------------------------------------------------

    def conditions(self) -> tuple[Condition, ...]:
        """The conditions without their mistakes."""
        found: list[Condition] = []
        for condition in self.records("conditions", Condition):
            if condition.environments and not found:
                self.wrong(
                    "the first condition is that of trainings: no environments", "environments"
                )
            faults = tuple(f for f in condition.faults if self.accepts("faults", _fault, f))
            found.append(self.checked(replace(condition, faults=faults)))
        return tuple(found) or (Condition("nominal"),)

    def checked(self, condition: Condition) -> Condition:
        """A condition, after a note of what no environment knows and what one refuses."""
        worlds, names = self.here(condition), dict[str, None]()
        for world in worlds:
            found = self.accepts("sensors", _sensor_names, world, condition)
            if found is None:
                return self.checked(replace(condition, sensors="nominal"))
            names |= found
        graded = condition.sensors if isinstance(condition.sensors, dict) else {}
        faults = [fault["sensor"] for fault in condition.faults]
        for key, named in (("sensors", graded), ("latency", condition.latency), ("faults", faults)):
            self.known("sensor", named, names or named, key)
        for world in worlds:
            if error := refusal(world, {"estimator": ORACLE} | condition.options):
                self.wrong(f"{world} refuses the condition {condition.name}: {error}")
                return Condition(condition.name)
        return condition

    def estimators(self, condition: Condition) -> dict[str, Estimator]:
        """The estimators by name, and before them the ends of the scale."""
        found = {name: Estimator(name, name) for name in (ORACLE, FLOOR)}
        for each in self.records("estimators", Estimator, "estimator"):
            given = {k: None if value == "none" else value for k, value in each.options.items()}
            name, estimator = each.name, replace(each, options=given)
            self.own_name(each.estimator, (DEFAULT, RAW, *estimator_names()))
            if estimator != found.setdefault(name, estimator):
                self.wrong(f"{name} is an end of the scale: leave it as it is, {name} = {{}}")
            self.check_estimator(estimator, condition)
        return found

    def check_estimator(self, estimator: Estimator, condition: Condition) -> None:
        """Note an estimator that all environments refuse, or one of them for its options."""
        reasons, name = [], estimator.name
        own = {"estimator_options": estimator.options} if estimator.options else {}
        for world in self.here(estimator):
            kind = estimator.estimator
            kind = system_of(world).estimator if kind == DEFAULT else kind
            plain = condition.options | {"estimator": kind}
            error = refusal(world, plain | own)
            suits = not error or not refusal(world, plain)
            reasons.append(None if suits else error)
            if error and suits:
                self.wrong(f"{world} refuses the options of {name}: {error}", "options")
        if reasons and all(reasons):
            self.wrong(f"no environment of the study can carry {name}: {reasons[0]}")

    def agents(self, estimators: Mapping[str, Estimator]) -> tuple[Agent, ...]:
        """The agents, and before them the autopilot if the file names none and there is one."""
        found = []
        for agent in self.records("agents", Agent, "kind"):
            found.append(agent)
            name = agent.name
            for key in _LEARNED & set(self.data["agents"][name]):
                if not agent.learned:
                    self.wrong(
                        f"{key} is for agents that learn; {name} is of kind {agent.kind}", key
                    )
                elif agent.raw and key in ("trained_on", "flown_on"):
                    text = f"{name} sees raw measurements: it is trained and flown on no estimator"
                    self.wrong(text, key)
            self.check_kind(agent)
            if agent.learned:
                self.check_training(agent, estimators)
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
            known = (*(names or (AUTOPILOT,)), PPO)
            self.known("kind of agent", [agent.kind], known, "kind")

    def check_training(self, agent: Agent, estimators: Mapping[str, Estimator]) -> None:
        """Note estimators, steps and settings that a training cannot have."""
        here, name, schools = self.here(agent), agent.name, agent.trained_on
        self.known("estimator", schools, (*estimators, DEFAULT), "trained_on")
        self.known("estimator", agent.flown_on, estimators, "flown_on")
        own = agent.environments or self.ids
        self.known(f"environment of {name}", agent.steps, own, "steps")
        for world in here:
            arguments = agent.steps.get(world), agent.memory, agent.settings
            key = "settings" if agent.settings else "steps"
            self.accepts(key, describe, registered_id(world), None, 0, *arguments)
        homes = [self.here(estimators.get(school, Estimator(school))) for school in schools]
        if here and not agent.raw and not any(set(here) & set(home) for home in homes):
            text = f"{name} is in no environment of an estimator that it is trained on"
            self.wrong(text, "trained_on")

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
        return [world for world in self.worlds if world in (record.environments or self.worlds)]

    def section(self, section: str, options: Sequence[str] = ()) -> Iterator[str]:
        """Names of the tables of a section, each while its table is the entry."""
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
            self.known(f"key in {section}.{name}", table, options)
            yield name

    def records(self, section: str, record: type, second: str = "") -> Iterator[Any]:
        """Records of a section, each while its table is the entry.

        The attribute ``second``, if there is one, is the name where the file lacks it.
        """
        options = [each.name for each in fields(record) if each.name != "name"]
        for name in self.section(section, options):
            named = {"name": name} | ({second: name} if second else {})
            each = record(**named | self.values(record, self.data[section][name]))
            self.known("environment", each.environments, self.ids, "environments")
            yield each

    def values(self, record: type, table: Mapping[str, Any]) -> dict[str, Any]:
        """Values of a table for the attributes of a record; wrong ones are noted and left out."""
        found = {}
        for each in fields(record):
            if (key := each.name) in table:
                value = table[key]
                if text := _mistake(each.type, key, value):
                    self.wrong(text, key)
                else:
                    found[key] = tuple(value) if isinstance(value, list) else value
        return found


def _mistake(kind: Any, key: str, value: Any) -> str:
    """Sentence about a value that is not as an attribute must be, or nothing."""
    types, words = _KINDS[kind]
    each = list(value.values()) if isinstance(value, dict) else [value]
    each = value if isinstance(value, list) else each
    right = isinstance(value, types) and isinstance(value, bool) == (types is bool)
    if kind in (_NAMES, _GRADES):
        right &= all(isinstance(name, str) for name in each)
    if not right:
        return f"{key} must be {words}, got {value!r}"
    if kind == _NAMES and not 0 < len(each) == len(set(each)):
        return f"{key} must name one or more, each once, or be left out, got {value!r}"
    if value not in (choices := _CHOICES.get(key, (value,))):
        return unknown(key, value, choices)
    least, most, words = _RANGES.get(key, (0, 0, ""))
    for number in each if words else ():
        if type(number) not in (int, float) or not least <= number <= most:
            return f"{key} must be {words}, got {short_repr(number)}"
    return ""


def _sensor_names(environment: str, condition: Condition) -> dict[str, None]:
    """Names of the sensors of an environment in a condition."""
    chosen = environment_options(environment, {"sensors": condition.sensors})
    sensors = system_of(environment).sensors_of(chosen.get("sensors", "nominal"))
    return dict.fromkeys(sensor.name for sensor in sensors.each)


def _fault(fault: Any) -> SensorFault:
    """A fault by its table."""
    try:
        return SensorFault(**fault)
    except TypeError:
        text = "faults must be tables of sensor, kind and perhaps size, begin, end, duration, got"
        raise TypeError(f"{text} {fault!r}") from None
