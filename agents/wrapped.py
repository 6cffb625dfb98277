"""Registered environments of others, in the place of a `vessel_gym.simulation.core.Core`.

Studies, commands and metrics find estimator, sensors and state there. Most such environments have
an `EstimatedObservation`; one without has no estimates, and its metrics are return and length.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from inspect import Parameter, signature
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np

from agents.named import loaded
from vessel_gym.wrappers import EstimatedObservation
from vessel_gym.wrappers.watch import Watch, time_step

_IMPLIED = {
    "sensors": ("nominal",),
    "disturbance": ("moderate",),
    "mismatch": (0.0,),
    "observe": ("mean",),
    "termination": ("task", "belief"),
}
"""Values of options with which commands and studies leave an environment of others as it is."""
_OURS = ("disturbance", "mismatch", "termination", "latency", "faults", "guidance")
"""Options that `EstimatedObservation` does not take: they need a keyword of their own."""


@dataclass(frozen=True)
class Episodes:
    """Task of an environment of others: its rewards, until it terminates or its time is over."""

    horizon: int
    success: str = ""


class Wrapped:
    """An environment of others in the place of a core, its configuration and its system.

    It has the attributes of all three that `agents` needs.

    Args:
        env: One registered environment.
    """

    def __init__(self, env: Any) -> None:
        watch = watch_of(env)
        self.name, self.env, self.config, self.system = env.spec.id, env, self, self
        self.task = Episodes(env.spec.max_episode_steps)
        self.vehicle = SimpleNamespace(dt=time_step(env), steering=())
        self.estimator = "" if watch is None else watch.filter.name
        names = () if watch is None else watch.sensors.state_names
        filter = SimpleNamespace(name=self.estimator, model=getattr(watch, "model", None))
        self.estimation = SimpleNamespace(filter=filter, space=SimpleNamespace(names=names))
        self.true_state = SimpleNamespace(in_filter_order=np.asarray)  # all of it is estimated
        self.sensors: Any = getattr(watch, "sensors", None)

    def sensors_of(self, suite: Any) -> Any:
        """Its sensors as registered; it has no suites."""
        return self.sensors


def watch_of(env: Any) -> Watch | None:
    """The estimation of the `EstimatedObservation` within an environment; None without one."""
    while isinstance(env, gym.Wrapper):
        if isinstance(env, EstimatedObservation):
            return env.watch
        env = env.env
    return None


def core_of(env: Any) -> Any:
    """The core of an environment or of a batch, or the `Wrapped` that stands for it."""
    if hasattr(env.unwrapped, "core"):
        return env.unwrapped.core
    return Wrapped(getattr(env.unwrapped, "envs", [env])[0])


def taken_options(env_id: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of commands and studies as an environment of others takes them.

    Raises:
        TypeError: for a value other than the implied one of an option that the environment does not
            take.
    """
    parameters = signature(loaded(gym.spec(env_id).entry_point)).parameters
    every = any(each.kind is Parameter.VAR_KEYWORD for each in parameters.values())
    taken = {}
    for key, value in options.items():
        if value in (None, {}, [], *_IMPLIED.get(key, ())):
            continue
        if key not in parameters and (key in _OURS or not every):
            raise TypeError(
                f"{env_id} takes no option {key!r}: leave it out, or give the registered function a"
                f" keyword {key}="
            )
        taken[key] = value
    return taken
