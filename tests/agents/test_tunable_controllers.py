"""Parameters of controllers: what they do, what they cost, and what is refused."""

from inspect import signature
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from refusals import refused

from agents import load_agent
from agents.controllers import CONTROLLERS as REGISTERED
from agents.controllers import controller_names, make_controller
from agents.controllers.loops import regulator_gains
from agents.studies.worlds import system_of
from estimators import Log
from estimators.engine.program import Program
from vessel_gym.system import System

SHIP, THESIS, PUNA = "SigmaCorvette-v0", "ThesisCorvette-v0", "PunaUAV-v0"
ENVIRONMENTS = [SHIP, THESIS, "SegorogeniAUV-v0", "ItsunusaAUV-v0", PUNA]
TUNABLE = [
    (env_id, name)
    for env_id in ENVIRONMENTS
    for name in controller_names(system_of(env_id))
    if name != "constant-rudder"
]
every_controller = pytest.mark.parametrize(("env_id", "name"), TUNABLE)


def factory(env_id: str, name: str) -> Any:
    return REGISTERED.of(system_of(env_id).task)[name]


def defaults(env_id: str, name: str) -> dict[str, float]:
    """Defaults of the parameters, which the constructor takes after the system."""
    taken = signature(factory(env_id, name)).parameters
    return {each: taken[each].default for each in factory(env_id, name).tunable}


def observations(env_id: str, rows: int = 3, steps: int = 30) -> np.ndarray:
    size = gym.make(env_id).observation_space.shape
    assert size
    return np.random.default_rng(4).normal(0.0, 0.1, (steps, rows, *size)).astype(np.float32)


def acted(agent: Any, seen: np.ndarray) -> np.ndarray:
    agent.reset(seen.shape[1])
    return np.stack([agent.act(frame) for frame in seen])


@every_controller
def test_parameters_have_defaults_in_range_that_are_used(env_id: str, name: str):
    system, seen, found = system_of(env_id), observations(env_id), defaults(env_id, name)
    for each, value in found.items():
        assert 0.0 < factory(env_id, name).tunable[each].to_unit(value) < 1.0
    expected = acted(make_controller(name, system), seen)
    np.testing.assert_array_equal(acted(make_controller(name, system, **found), seen), expected)


@every_controller
def test_every_parameter_matters_and_disturbs_no_other(env_id: str, name: str):
    """Controllers act in turns as each of them alone."""
    system, found = system_of(env_id), defaults(env_id, name)
    seen = observations(env_id, rows=len(found) + 1)
    agents = [make_controller(name, system)]
    agents += [make_controller(name, system, **{each: 1.5 * found[each]}) for each in found]
    alone = [acted(agent, seen) for agent in agents]
    for agent in agents:
        agent.reset(seen.shape[1])
    turns = [[agent.act(frame) for agent in agents] for frame in seen]
    np.testing.assert_array_equal(np.swapaxes(turns, 0, 1), alone)
    for other in alone[1:]:
        assert np.abs(other - alone[0]).max() > 1e-4


@every_controller
def test_new_parameters_compile_nothing(env_id: str, name: str, monkeypatch: pytest.MonkeyPatch):
    system, seen = system_of(env_id), observations(env_id)
    acted(make_controller(name, system), seen)
    monkeypatch.setattr(Program, "__init__", None)  # what is traced becomes a program
    for each, value in defaults(env_id, name).items():
        acted(make_controller(name, system, **{each: 2.0 * value}), seen)


@every_controller
def test_any_parameters_in_range_give_a_finite_design_or_none(env_id: str, name: str):
    ranges, rng = factory(env_id, name).tunable, np.random.default_rng(0)
    for share in (0.0, 1.0, *rng.integers(0, 2, (6, len(ranges)))):
        shares = np.broadcast_to(share, len(ranges))
        parameters = {
            each: ranges[each].from_unit(at) for each, at in zip(ranges, shares, strict=True)
        }
        try:
            made = make_controller(name, system_of(env_id), **parameters)
        except np.linalg.LinAlgError:
            continue
        assert np.isfinite(acted(made, observations(env_id))).all()


def test_a_system_that_cannot_be_stabilised_has_no_regulator():
    eye = np.eye(1)
    for A, B in ((1.2 * eye, 0.0 * eye), (np.full((1, 1), np.nan), eye)):
        with refused(
            np.linalg.LinAlgError, "^no gains stabilise the system at these costs: choose"
        ):
            regulator_gains(A, B, eye, eye)


class Proportional:
    """A newcomer's own controller."""

    tunable = {"gain": Log(0.1, 10.0)}

    def __init__(self, system: System, gain: float = 1.0) -> None:
        self.gain, self.size = gain, len(system.vehicle.action_names)

    def reset(self, num_envs: int) -> None:
        pass

    def act(self, observations: np.ndarray) -> np.ndarray:
        return self.gain * observations[:, : self.size]


def test_an_own_controller_takes_its_parameters():
    env, name, seen = gym.make(SHIP), f"{__name__}:Proportional", np.eye(2, 11)
    doubled = load_agent(name, env, {"gain": 2.0})
    np.testing.assert_array_equal(doubled.act(seen), 2.0 * load_agent(name, env).act(seen))


@pytest.mark.parametrize("name", ["autopilot", f"{__name__}:Proportional", "random", "ppo"])
def test_unknown_parameters_are_refused(name: str):
    known = f"unknown parameter of {name} 'mass': choose from "
    none = f"{name} has no parameters: leave out 'mass'"
    with refused(ValueError, f"^{none if name in ('random', 'ppo') else known}"):
        load_agent(name, gym.make(SHIP), {"mass": 1.0})


def test_parameters_without_meaning_are_refused():
    env = gym.make(SHIP)
    for value in (0.0, -0.1, np.nan, np.inf, "small", None):
        with refused(ValueError, "^heading of autopilot must be a finite number above 0, got"):
            load_agent("autopilot", env, {"heading": value})  # type: ignore[dict-item]
    with refused(TypeError, "^parameters must be a dictionary of values by name"):
        load_agent("autopilot", env, [0.05])  # type: ignore[arg-type]
