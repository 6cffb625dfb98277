"""Everything that is needed to run a study again."""

import platform
from dataclasses import asdict, is_dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

import vessel_gym
from agents.metrics import WITHOUT_COVARIANCE, metrics
from agents.page import Block, Facts, Section, listed
from agents.source import source_digest
from agents.studies.plan import options
from agents.studies.records import RAW, Agent, Condition
from agents.studies.results import Policy, Results
from agents.studies.wording import grouped
from agents.studies.worlds import environment_id, system_of
from agents.wrapped import Wrapped
from vessel_gym.estimation import tuning

_LIBRARIES = (
    "numpy",
    "scipy",
    "llvmlite",
    "gymnasium",
    "torch",
    "stable-baselines3",
    "sb3-contrib",
    "matplotlib",
)


def settings(results: Results, out: Path) -> Section:
    """Command, versions, and every setting of environments, conditions, agents, estimators and trainings."""
    study = results.plan.study
    run = [
        ("command", f"vessel-gym ablate {out}/study.toml --out {out}"),
        ("evaluation seeds", f"{study.seeds[0]} to {study.seeds[-1]}"),
        ("termination", study.termination),
        ("margin of equivalence", f"{study.margin:g} of the share kept"),
        (
            "machine",
            (
                f"{platform.system()} {platform.machine()}, Python {platform.python_version()}; CPU"
                f" {_cpu()}"
            ),
        ),
        (
            "CPU time",
            f"{sum(results.seconds.values()) / 60.0:.1f} min over {len(results.seconds)} jobs",
        ),
        *(
            (f"SHA-256 of {module} and what it imports", source_digest(module))
            for module in _modules(results)
        ),
    ]
    if study.learned:
        run.insert(2, ("training seeds", f"0 to {study.training_seeds - 1}"))
    versions = [
        ("vessel-gym", vessel_gym.__version__),
        *((n, v) for n in _LIBRARIES if (v := _version(n))),
    ]
    blocks: list[Block] = [
        Facts("Run", run),
        Facts("Versions", versions),
        Facts("Environments", [(name, _world(name)) for name in study.environments]),
        Facts("Conditions", [(c.name, _condition(c)) for c in study.conditions]),
        Facts("Agents", [(a.name, _agent_settings(a)) for a in study.agents]),
        Facts("Estimators", _tunings(results)),
    ]
    trained = _trainings(results)
    if trained:
        blocks.append(Facts("Trainings", trained))
    blocks.append(Facts("Columns of episodes.csv", _columns(results)))
    return Section("To run it again", blocks)


def _modules(results: Results) -> list[str]:
    """The modules that computed."""
    jobs = [each for job in results.plan.jobs for each in (job, *job.needs)]
    return sorted({job.function.partition(":")[0] for job in jobs})


def _condition(condition: Condition) -> str:
    return _plain(
        condition.options
        | ({"environments": condition.environments} if condition.environments else {})
    )


def _agent_settings(agent: Agent) -> str:
    given = {
        k: v
        for k, v in asdict(agent).items()
        if k != "name" and v and not (agent.raw and k == "trained_on")
    }
    return _plain(given if agent.learned else {"kind": agent.kind})


def _columns(results: Results) -> list[tuple[str, str]]:
    """Meaning of every metric; by environment, where tasks differ in that."""
    every = [
        (m, environment)
        for environment in results.environments
        for m in metrics(system_of(environment))
    ]
    rows = []
    for name, found in grouped(
        (f"{m.key} [{m.unit}]" if m.unit else m.key, (m.meaning, e)) for m, e in every
    ).items():
        each = grouped(found)
        text = " ".join(f"{listed(where)}: {meaning}" for meaning, where in each.items())
        rows.append((name, found[0][0] if len(each) == 1 else text))
    return rows


def _world(environment: str) -> str:
    """An environment in a line."""
    system = system_of(environment)
    facts = {
        "default estimator": system.estimator,
        "filter model": system.filter_model,
        "step": f"{system.vehicle.dt:g} s",
        "horizon": f"{system.task.horizon} steps",
    }
    return f"{_plain(facts)}; task: {_fields(system.task)}"


def _tunings(results: Results) -> list[tuple[str, str]]:
    """Model and options of every estimator, as they are in each disturbance of the study; alike ones together."""
    flown = [
        (e, name) for e in results.environments for name in results.estimators(e) if name != RAW
    ]
    rows = grouped(((e, _tuning(results, e, name)), name) for e, name in flown)
    return [
        (f"{listed(names)}, {environment}", text) for (environment, text), names in rows.items()
    ]


def _tuning(results: Results, environment: str, name: str) -> str:
    study, system = results.plan.study, system_of(environment)
    each: dict[str, list[str]] = {}
    for condition in (each for each in study.conditions if each.is_in(environment)):
        given = options(study, condition, study.estimator(name), environment)
        kind = given["estimator"]
        own = isinstance(system, Wrapped) or ":" in kind or ":" in condition.disturbance
        tuned = {} if own else tuning(system, kind, condition.disturbance)
        tuned = tuned | given.get("estimator_options", {})
        if kind not in WITHOUT_COVARIANCE:
            tuned = {"model": system.filter_models.get(kind, system.filter_model)} | tuned
        each.setdefault(_plain(tuned), []).append(condition.disturbance)
    if len(each) == 1:
        return next(iter(each))
    return "; ".join(
        f"{listed(list(dict.fromkeys(where)))}: {text}" for text, where in each.items()
    )


def _trainings(results: Results) -> list[tuple[str, str]]:
    """Training of each learned agent: on what, and for how long."""
    from agents.training.algorithms import hyperparameters

    rows: dict[str, str] = {}
    for flight in results.plan.flights:
        name = f"{Policy(flight.agent, flight.trained_on)}, {flight.environment}"
        for job in flight.job.needs if name not in rows else ():
            values = results.values.get(job.key)
            if values is not None:
                settings = hyperparameters(
                    environment_id(flight.environment), job.arguments["memory"]
                )
                rows[name] = f"{values['steps']} environment steps a run; {_plain(settings)}"
    return list(rows.items())


def _fields(record: Any) -> str:
    """A dataclass in one line, its nested ones left out."""
    if not is_dataclass(record) or isinstance(record, type):
        return type(record).__name__
    return (
        f"{type(record).__name__}:"
        f" {_plain({k: v for k, v in asdict(record).items() if not isinstance(v, dict)})}"
    )


def _plain(values: dict[str, Any]) -> str:
    """Settings in one line."""
    return (
        ", ".join(f"{key.replace('_', ' ')} {_value(value)}" for key, value in values.items())
        or "none"
    )


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_value(each)}" for key, each in value.items()) + "}"
    if isinstance(value, np.ndarray):
        return f"array of {' × '.join(map(str, value.shape))}"
    if isinstance(value, list | tuple):
        return "(" + ", ".join(map(_value, value)) + ")"
    return str(value)


def _version(library: str) -> str | None:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return None


def _cpu() -> str:
    """The processor's name, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
        platform.machine(),
    )
