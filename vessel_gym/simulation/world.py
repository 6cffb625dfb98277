"""The true world: vehicle, disturbance and sensors as two stages, the start and a step."""

from typing import Any

import numpy as np

from estimators.engine import as_word
from estimators.randomness import normals
from vessel_gym.checks import is_compiled
from vessel_gym.models.state_space import StateSpace
from vessel_gym.processes import block_diagonal, product
from vessel_gym.simulation.state import Changes, Stage, State, in_turn


class World:
    """The true world: vehicle, disturbance and sensors.

    Args:
        space: State space of the world.

    Attributes:
        begin: Stage that starts episodes.
        step: Stage that moves the truth by a step, and samples the sensors.
        parts: Normal numbers in a step, for the disturbance and each bias.
        start_roots: Roots of the initial covariances of the disturbance and each bias.
        size: Number of components of the disturbance's state.
    """

    def __init__(self, space: StateSpace) -> None:
        vehicle, disturbance, sensors = space.vehicle, space.disturbance, space.sensors
        self.space, self.vehicle, self.sensors = space, vehicle, sensors
        self.disturbance: Any = disturbance
        processes = [disturbance.process]
        processes += [s.bias.process(sensors.dt) for s in sensors.each if s.bias is not None]
        self.size, self.white = disturbance.process.size, len(disturbance.white)
        flows = vehicle.ambient_flows
        self.readable = np.array([float(name not in disturbance.averaged) for name in flows])
        self.parts = np.array([process.normals for process in processes])
        self.parts[0] += disturbance.white.shape[-1]
        self.start_roots = [process.start_root for process in processes]
        self.root = block_diagonal(disturbance.white, disturbance.process.root, sensors.bias.root)
        moves = is_compiled(vehicle) and is_compiled(disturbance)
        sense = Stage(self._sense, sensors.reads_compiled)
        self.step = in_turn(Stage(self._move, moves), sense)
        self.begin = in_turn(Stage(self._place, moves), sense)

    def _move(self, now: State) -> Changes:
        """The truth a step later."""
        before, outside = now.actuators, self.space.increments_and_flows
        after = self.vehicle.actuate(before, now.action)
        u = self.vehicle.known_input(before, after, now.commanded)
        acting, faults = now.exogenous[..., :outside], now.exogenous[..., outside:]
        ends = (before + faults, after + faults) if self.space.faulty else (before, after)
        state = self.vehicle.step(now.state, *ends, acting, now.parameters)
        slow, noise = self._advanced(now, self.space.slow.transition)
        z = self.disturbance.met(slow[..., : self.size], now.state, state)
        slow = np.concatenate([z, slow[..., self.size :]], -1)
        return self._acting_on(now, actuators=after, u=u, state=state, slow=slow, noise=noise)

    def _place(self, now: State) -> Changes:
        """The truth at an episode's start, from random numbers and the prior."""
        root = block_diagonal(*self.start_roots)
        slow = product(root, now.slow_normals, np.zeros((*now.steps.shape, len(root))))
        x = now.prior_mean + (now.prior_root * now.prior_normals[..., None, :]).sum(-1)
        if self.space.start_effect is not None:
            x = product(self.space.start_effect, slow, x)
        state, actuators = self.vehicle.start(x)
        constants = self.disturbance.draw(now.constant_uniforms)
        quiet = np.zeros((*now.steps.shape, len(self.root)))
        now = now.but(slow=slow, noise=quiet)
        slow, noise = self._advanced(now, np.eye(self.space.slow.size))
        u = self.vehicle.known_input(actuators, actuators, now.commanded)
        return self._acting_on(
            now, actuators=actuators, u=u, state=state, slow=slow, noise=noise,
            episode_constants=constants,
        )  # fmt: skip

    def _advanced(self, now: State, transition: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States of disturbance and biases a step later, and the noise of the coming step.

        The states ``(..., k)`` move by a transition ``(k, k)``, without an effect of the vehicle.
        """
        slow = product(transition, now.slow, now.noise[..., self.white :])
        step, noise, drawn = as_word(now.steps), np.zeros_like(now.noise), list[np.ndarray]()
        for part, count in enumerate(self.parts):
            drawn += normals(now.keys[..., part, :], step, count)
        return slow, product(self.root, np.stack(drawn, -1), noise) if drawn else noise

    def _acting_on(self, now: State, **changes: Any) -> Changes:
        """Changes, with the exogenous input over the coming step that then acts.

        It is that of white noise, the disturbance and the task.
        """
        now, outside = now.but(**changes), self.space.increments_and_flows
        time, z = self.sensors.dt * now.steps, now.slow[..., : self.size]
        effect = self.disturbance.effect_at(now.episode_constants, time, z, now.state)
        exogenous = self.space.exogenous(effect, now.actuators, now.noise[..., : self.white])
        if now.imposed is not None:
            within = exogenous[..., :outside] + now.imposed
            exogenous = np.concatenate([within, exogenous[..., outside:]], -1)
        return changes | {"exogenous": exogenous}

    def _sense(self, now: State) -> Changes:
        """Measurements and their mask, which contain nothing in the future.

        Sensors read the increments of the step that has ended, which the state includes, and the
        flows of the coming step; zeros stand for means over that step.
        """
        flows = now.exogenous[..., self.space.flows]
        if not self.readable.all():
            flows = flows * self.readable
        read = np.concatenate([now.exogenous_before[..., : self.space.increments], flows], -1)
        biases = now.slow[..., self.size :]
        y, available = self.sensors.read(now.state, read, biases, now.steps, now.sensing)
        return {"y": y, "available": available}
