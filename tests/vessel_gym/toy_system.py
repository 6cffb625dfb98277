"""A cart that pushes against a breeze to a post: the smallest system with a part of each kind."""

from typing import Any

import numpy as np

from vessel_gym.disturbances import Disturbance
from vessel_gym.processes import Process
from vessel_gym.sensors import Sensor, plain
from vessel_gym.system import System
from vessel_gym.tasks.task import Task
from vessel_gym.vehicles.vehicle import Vehicle


class Cart(Vehicle):
    """Place and speed on a line."""

    dt, angles, rates = 0.1, (), {}
    state_names = "x", "u"
    action_names = ("push",)
    incremented = ("u",)
    ambient_flows = ("breeze",)
    normals, parameter_names = 1, ("mass",)
    cruise = np.array([0.0, 1.0]), np.array([0.2, 0.2])
    sensors = (Sensor("log", ("place [m]",), plain((0,)), (0.1,)),)

    def parameters(self, mismatch: float, normals: Any) -> Any:
        return 1.0 + mismatch * normals

    def actuate(self, actuators: Any, action: Any) -> Any:
        return actuators + 0.5 * (action - actuators)

    def moved(self, state: Any, before: Any, after: Any, flow: Any, parameters: Any) -> Any:
        x, u = np.moveaxis(state, -1, 0)
        push = (before + after)[..., 0] / (2.0 * parameters[..., 0])
        return np.stack([x + self.dt * (u + flow[..., 0]), u + self.dt * (push - 0.2 * u)], -1)


class Breeze(Disturbance):
    """A breeze whose strength an episode draws."""

    names = forces = ("breeze",)
    process = Process.wandering((0.1,), time=10.0, dt=0.1)
    uniforms = 1

    def effect_at(self, drawn: Any, time: Any, z: Any, state: Any) -> Any:
        return drawn * z


class Post(Task):
    """Stay at a post."""

    vehicle, horizon, uniforms, prior_sd = Cart(), 20, 1, (0.1, 0.1)
    end_reasons, success = ("", "away"), ""

    def commanded(self, scenario: Any, step: Any, reference: Any) -> Any:
        return scenario

    def exogenous(self, scenario: Any, step: Any) -> Any:
        return 0.01 * np.concatenate([scenario, scenario], -1)

    def initial_score_state(self, state: Any, scenario: Any) -> Any:
        return state[..., :1]

    def score(
        self, state: Any, exogenous: Any, scenario: Any, reference: Any, over: Any,
        actuators: Any, action: Any, score_state: Any,
    ) -> Any:  # fmt: skip
        miss = np.abs(state[..., 0] - scenario[..., 0])
        return 1.0 / (1.0 + miss), np.where(miss > 100.0, 1, 0), state[..., :1]


def read(state: Any, exogenous: Any) -> Any:
    """The speed through the air."""
    return state[..., 1:] - exogenous[..., 1:]


def spread(y: Any) -> Any:
    """Noise that grows with the speed."""
    return 0.1 + 0.1 * np.abs(y)


POD = Sensor("pod", ("airspeed [m/s]",), read, spread)
SYSTEM = System(
    "Cart-v0", Cart(), Post(), {"moderate": Breeze(), "calm": Disturbance()}, "ekf", "nonlinear",
    lambda name, space: {}, sensors=(*Cart.sensors, POD),
)  # fmt: skip
