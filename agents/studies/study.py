"""Study files, read from TOML and checked before anything runs."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

from agents.controllers import AUTOPILOT, PPO, controller_names, is_controller, make_controller
from agents.named import named_object
from agents.seeds import evaluation_seeds
from agents.studies.plan import options
from agents.studies.records import DEFAULT, FLOOR, ORACLE, RAW, Agent, Condition, Estimator, Study
from agents.studies.toml_reader import Place, StudyError, TomlReader, keys_of
from agents.studies.worlds import (
    check_estimator_name,
    environment_id,
    estimated_world,
    refusal,
    registered_id,
    system_of,
)
from agents.training.algorithms import MEMORIES, describe, hyperparameters
from estimators.checks import short_repr
from vessel_gym.configuration import TERMINATIONS
from vessel_gym.estimation import estimator_names
from vessel_gym.sensor_faults import SensorFault
from vessel_gym.sensors import SUITE_NAMES
from vessel_gym.toml_file import TomlError, TomlFile


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
        raise StudyError(path, reader.mistakes)
    return study


_SECTIONS = ("environments", "estimators", "agents", "conditions")
_LEARNED = ("observe", "memory", "trained_on", "flown_on", "steps", "guidance", "settings")
"""Keys of agents that learn."""
_LEAST = {"episodes": 2, "training_seeds": 1, "first_seed": 0}
"""Least values of numbers of a study."""
_MOST_TRAINING_SEEDS, _MOST_STEPS = 1000, 2**31 - 1


class _Reader(TomlReader):
    """Makes a study of parsed TOML and notes what is wrong with it."""

    WORDS = {
        "title": "a text",
        "steps": "a table of numbers by environment",
        "settings": "a table of hyperparameters",
        "latency": "a table of seconds by sensor",
    }
    CHOICES = {
        "observe": ("mean", "mean+std", "measurement"),
        "memory": MEMORIES,
        "termination": TERMINATIONS,
    }

    def study(self) -> Study:
        """The study; meaningless if there are mistakes."""
        plain = [key for key in keys_of(Study) if key not in _SECTIONS]
        for key in self.data:
            self.name("key", key, (*plain, *_SECTIONS), (key,))
        values = self.values(
            Study, {key: value for key, value in self.data.items() if key in plain}, ()
        )
        values["title"] = values.get("title") or "What does the estimator cost?"
        ids = tuple(self.section("environments", (), required=True))
        worlds = [
            name for name in ids if self.accepts(("environments", name), estimated_world, name)
        ]
        estimators, agents = self.estimators(ids), self.agents(ids, worlds)
        # Measurements contain no belief: where any agent is shown them, the truth ends a mission.
        values.setdefault("termination", "task" if any(agent.raw for agent in agents) else "belief")
        sections = {
            "environments": ids,
            "estimators": estimators,
            "agents": agents,
            "conditions": self.conditions(ids),
        }
        study = Study(**values | sections)
        self.check_numbers(study)
        self.check(study, worlds)
        return study

    def check_numbers(self, study: Study) -> None:
        """Seeds are at least as many as needed, and the margin is a share."""
        for key, least in _LEAST.items():
            if (value := getattr(study, key)) < least:
                self.wrong((key,), f"{key} must be at least {least}, got {value}")
        self.accepts(
            ("episodes",), evaluation_seeds, max(study.episodes, 1), max(study.first_seed, 0)
        )
        if not 0.0 < study.margin < 1.0:
            self.wrong(("margin",), f"margin must be a share between 0 and 1, got {study.margin:g}")
        if study.training_seeds > _MOST_TRAINING_SEEDS:
            text = (
                f"training_seeds must be at most {_MOST_TRAINING_SEEDS}, got {study.training_seeds}"
            )
            self.wrong(("training_seeds",), text)

    # --- what only the environments can tell ------------------------------------------------------

    def check(self, study: Study, worlds: Sequence[str]) -> None:
        """Note names and options that no environment knows."""
        for one, other in combinations(worlds, 2):
            if registered_id(one) == registered_id(other):
                self.wrong(
                    ("environments", other),
                    f"{one} and {other} are one environment: leave one of them out",
                )
        for condition in study.conditions:
            here = [world for world in worlds if condition.is_in(world)]
            for world in here if ":" not in condition.disturbance else ():
                seas = system_of(world).disturbances
                self.name(
                    "disturbance",
                    condition.disturbance,
                    seas,
                    ("conditions", condition.name, "disturbance"),
                )
            self.check_condition(condition, here)
        for estimator in study.estimators:
            place = ("estimators", estimator.name)
            known = estimator.estimator == DEFAULT
            if known or self.accepts(
                (*place, "estimator"), check_estimator_name, estimator.estimator
            ):
                self.check_estimator(
                    place,
                    study,
                    estimator,
                    [w for w in worlds if w in (estimator.environments or worlds)],
                )
        for agent in study.agents:
            place = ("agents", agent.name)
            here = [w for w in worlds if w in (agent.environments or worlds)]
            controllers = dict.fromkeys(
                name for w in here for name in controller_names(system_of(w))
            )
            self.own_name(place, agent.kind, (PPO, AUTOPILOT, *controllers))
            if ":" in agent.kind:
                for world in here:
                    self.accepts((*place, "kind"), make_controller, agent.kind, system_of(world))
            elif not agent.learned and not any(
                is_controller(agent.kind, system_of(w)) for w in here
            ):
                self.name(
                    "kind of agent",
                    agent.kind,
                    (*(controllers or (AUTOPILOT,)), PPO),
                    (*place, "kind"),
                )
            if not agent.learned:
                continue
            here = [
                world for world in here if self.accepts((*place, "kind"), environment_id, world)
            ]
            for world in here if agent.memory in MEMORIES else ():
                described = (environment_id(world), None, 0, agent.steps.get(world), agent.memory)
                if self.accepts(
                    (*place, "settings"),
                    hyperparameters,
                    described[0],
                    agent.memory,
                    agent.settings,
                ):
                    self.accepts((*place, "steps"), describe, *described, agent.settings)
            flown = [
                w
                for name in agent.trained_on
                for w in here
                if w in (study.estimator(name).environments or here)
            ]
            if here and agent.trained_on and not flown and not agent.raw:
                text = f"{agent.name} is in no environment of an estimator that it is trained on"
                self.wrong((*place, "trained_on"), text)

    def check_condition(self, condition: Condition, worlds: Sequence[str]) -> None:
        """Note own sensors and disturbances, and late or failing sensors, that an environment refuses."""
        place = ("conditions", condition.name)
        own = {
            key: name
            for key in ("sensors", "disturbance")
            if ":" in (name := getattr(condition, key))
        }
        found = [self.accepts((*place, key), named_object, name) for key, name in own.items()]
        if not (own or condition.latency or condition.faults) or not all(found):
            return
        plain = {"sensors": condition.sensors, "disturbance": condition.disturbance}
        if own and self.refused(condition, plain, worlds):
            return
        sensors = named_object(own["sensors"]) if "sensors" in own else "nominal"
        known = dict.fromkeys(
            s.name for world in worlds for s in system_of(world).sensors_of(sensors).each
        )
        named = [
            *(("latency", name) for name in condition.latency),
            *(("faults", f["sensor"]) for f in condition.faults),
        ]
        for key, name in named if worlds else ():
            self.name("sensor", name, known, (*place, key))
        if all(name in known for _, name in named):
            self.refused(condition, condition.options, worlds)

    def refused(
        self, condition: Condition, chosen: Mapping[str, Any], worlds: Sequence[str]
    ) -> bool:
        """Note environments that refuse the options of a condition, and return whether there are any."""
        errors = {world: refusal(world, {"estimator": ORACLE, **chosen}) for world in worlds}
        for world, error in errors.items():
            if error is not None:
                self.wrong(
                    ("conditions", condition.name),
                    f"{world} refuses the condition {condition.name}: {error}",
                )
        return any(error is not None for error in errors.values())

    def check_estimator(
        self, place: Place, study: Study, estimator: Estimator, worlds: Sequence[str]
    ) -> None:
        """An estimator may be refused by some environments, but not by all, and not for its options."""
        reasons = []
        for world in worlds:
            first = study.conditions[0]
            if refusal(world, {"estimator": ORACLE} | first.options):
                first = Condition("nominal")
            error = refusal(world, options(study, first, estimator, world))
            if error is None:
                continue
            plain = replace(estimator, options={})
            if estimator.options and not refusal(world, options(study, first, plain, world)):
                text = f"{world} refuses the options of {estimator.name}: {error}"
                self.wrong((*place, "options"), text)
            else:
                reasons.append(str(error))
        if worlds and len(reasons) == len(worlds):
            text = f"no environment of the study can carry {estimator.name}: {reasons[0]}"
            self.wrong(place, text)

    # --- sections ---------------------------------------------------------------------------------

    def estimators(self, ids: Sequence[str]) -> tuple[Estimator, ...]:
        found = []
        for name, table in self.section("estimators", keys_of(Estimator)).items():
            place = ("estimators", name)
            estimator = Estimator(
                **{"name": name, "estimator": name} | self.values(Estimator, table, place)
            )
            plain = {
                key: None if value == "none" else value for key, value in estimator.options.items()
            }
            estimator = replace(estimator, options=plain)
            self.own_name(place, estimator.estimator, (DEFAULT, RAW, *estimator_names()))
            self.names("environment", estimator.environments, ids, (*place, "environments"))
            if (
                name == estimator.estimator
                and name in (ORACLE, FLOOR)
                and estimator != Estimator(name, name)
            ):
                self.wrong(
                    place, f"{name} is an end of the scale: leave it as it is, {name} = {{}}"
                )
            found.append(estimator)
        names = [e.name for e in found]
        return tuple(
            Estimator(name, name) for name in (ORACLE, FLOOR) if name not in names
        ) + tuple(found)

    def agents(self, ids: Sequence[str], worlds: Sequence[str]) -> tuple[Agent, ...]:
        named = self.data.get("estimators", {})
        estimators = [ORACLE, FLOOR, DEFAULT, *(named if isinstance(named, dict) else ())]
        found = []
        for name, table in self.section("agents", keys_of(Agent)).items():
            place = ("agents", name)
            agent = Agent(**{"name": name, "kind": name} | self.values(Agent, table, place))
            for key in (key for key in _LEARNED if key in table):
                if not agent.learned:
                    self.wrong(
                        (*place, key),
                        f"{key} is for agents that learn; {name} is of kind {agent.kind}",
                    )
                if agent.raw and key in ("trained_on", "flown_on"):
                    self.wrong(
                        (*place, key),
                        f"{name} sees raw measurements: it is trained and flown on no estimator",
                    )
            self.names("estimator", agent.trained_on, estimators, (*place, "trained_on"))
            self.names(
                "estimator",
                agent.flown_on,
                [e for e in estimators if e != DEFAULT],
                (*place, "flown_on"),
            )
            self.names("environment", agent.environments, ids, (*place, "environments"))
            self.names("environment", agent.steps, ids, (*place, "steps"))
            for number in agent.steps.values():
                if (
                    isinstance(number, bool)
                    or not isinstance(number, int)
                    or not 1 <= number <= _MOST_STEPS
                ):
                    text = (
                        f"steps must be whole numbers of at least 1 and at most {_MOST_STEPS}, got"
                        f" {number!r}"
                    )
                    self.wrong((*place, "steps"), text)
                    agent = replace(agent, steps={})
            if agent.environments:
                self.names(
                    f"environment of {name}", agent.steps, agent.environments, (*place, "steps")
                )
            found.append(agent)
        if worlds and not any(is_controller(AUTOPILOT, system_of(world)) for world in worlds):
            if all(agent.learned for agent in found):
                text = (
                    "no environment of the study has an autopilot: name a controller, module:object"
                    " if it is your own"
                )
                self.wrong(("agents",), text)
            return tuple(found)
        if any(agent.kind == AUTOPILOT for agent in found):
            return tuple(found)
        return (Agent(AUTOPILOT, AUTOPILOT), *found)

    def conditions(self, ids: Sequence[str]) -> tuple[Condition, ...]:
        found: list[Condition] = []
        for name, table in self.section("conditions", keys_of(Condition)).items():
            place = ("conditions", name)
            values = self.values(Condition, table, place)
            values["faults"] = self.faults(place, values.get("faults", ()))
            condition = Condition(name, **values)
            if not 0.0 <= condition.mismatch <= 0.25:
                text = f"mismatch must be between 0 and 0.25, got {short_repr(condition.mismatch)}"
                self.wrong((*place, "mismatch"), text)
                condition = replace(condition, mismatch=0.0)
            self.names("environment", condition.environments, ids, (*place, "environments"))
            if condition.environments and not found:
                self.wrong(
                    (*place, "environments"),
                    "the first condition is that of trainings: no environments",
                )
            if ":" not in condition.sensors:
                self.name("sensor suite", condition.sensors, SUITE_NAMES, (*place, "sensors"))
            found.append(condition)
        return tuple(found) or (Condition("nominal"),)

    def faults(self, place: Place, faults: Sequence[Any]) -> tuple[dict[str, Any], ...]:
        """The faults of a condition that are some."""
        known = [each.name for each in fields(SensorFault)]
        good = []
        for fault in faults:
            if not isinstance(fault, dict) or not {"sensor", "kind"} <= set(fault) <= set(known):
                text = (
                    "faults must be tables of sensor, kind and perhaps size, begin, end, duration,"
                    f" got {fault!r}"
                )
                self.wrong((*place, "faults"), text)
            elif self.accepts((*place, "faults"), partial(SensorFault, **fault)):
                good.append(fault)
        return tuple(good)
