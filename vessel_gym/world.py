"""The true world: vehicle, disturbance and sensors as two stages, the start and a step."""

from typing import Any

import numpy as np
from scipy.linalg import block_diag

from vessel_gym.filter_models.exogenous import Forces
from vessel_gym.foreign import CheckedMethods
from vessel_gym.processes import advance, product
from vessel_gym.sensors import Sensors
from vessel_gym.state import Changes, Stage, State


class World:
    """The true world: vehicle, disturbance and sensors.

    Args:
        vehicle: Vehicle of the forces; a user's has `CheckedMethods`.
        forces: Effect of the disturbance on the vehicle.
        disturbance: Disturbance of the forces; a user's has `CheckedMethods`.
        sensors: Sensors.

    Attributes:
        begin: Stage that starts episodes.
        step: Stage that moves the truth by a step, and samples the sensors.
        user_defined: The user's own among vehicle and disturbance.
        parts: Normal numbers in a step, for the disturbance and each bias.
        start_roots: Roots of the initial covariances of the disturbance and each bias.
        size: Number of components of the disturbance's state.
    """

    def __init__(self, vehicle: Any, forces: Forces, disturbance: Any, sensors: Sensors) -> None:
        self.vehicle, self.forces, self.sensors = vehicle, forces, sensors
        self.disturbance = disturbance
        self.user_defined = [p for p in (vehicle, disturbance) if isinstance(p, CheckedMethods)]
        processes = [disturbance.process]
        processes += [s.bias.process(sensors.dt) for s in sensors.each if s.bias is not None]
        self.size, self.increments = disturbance.process.size, len(forces.vehicle.increments)
        flows = forces.vehicle.ambient_flows
        self.readable = np.array([float(name not in disturbance.averaged) for name in flows])
        self.parts = np.array([process.normals for process in processes])
        self.parts[0] += disturbance.white.shape[-1]
        self.start_roots = [process.start_root for process in processes]
        self.transition = block_diag(disturbance.process.transition, sensors.bias.transition)
        self.root = block_diag(disturbance.white, disturbance.process.root, sensors.bias.root)
        compiled = sensors.verified and not self.user_defined
        self.step, self.begin = Stage(self._step, compiled), Stage(self._begin, compiled)

    def _step(self, now: State) -> Changes:
        """The truth a step later, and what sensors measure of it."""
        after = self.vehicle.actuate(now.actuators, now.action)
        u = self.vehicle.known_input(now.actuators, after, now.commanded)
        state = self._moved(now, after)
        slow, noise, linear = self._advanced(now, self.transition)
        slow = self._met(slow, now.state, state)
        exogenous = self._acting(now, slow, linear, state, after)
        increments = now.exogenous[..., : self.increments]  # of the step that ends
        return {
            "actuators": after, "u": u, "state": state, "slow": slow, "noise": noise,
            "exogenous": exogenous, **self._sampled(now, state, increments, exogenous, slow),
        }  # fmt: skip

    def _begin(self, now: State) -> Changes:
        """The truth at an episode's start, from random numbers and the prior."""
        root, zeros = block_diag(*self.start_roots), np.zeros((*now.steps.shape, self.increments))
        slow = product(root, now.slow_normals, np.zeros((*now.steps.shape, len(root))))
        x = now.prior_mean + (now.prior_root * now.prior_normals[..., None, :]).sum(-1)
        if self.forces.carried is not None:
            x = product(self.forces.carried, slow, x)
        state, actuators = self.vehicle.start(x)
        constants = now.constant_uniforms
        if self.disturbance.uniforms:
            constants = self.disturbance.draw(constants)
        quiet = np.zeros((*now.steps.shape, len(self.root)))
        now = now.but(episode_constants=constants, slow=slow, noise=quiet)
        slow, noise, linear = self._advanced(now, np.eye(len(self.transition)))
        exogenous = self._acting(now, slow, linear, state, actuators)
        u = self.vehicle.known_input(actuators, actuators, now.commanded)
        return {
            "actuators": actuators, "u": u, "state": state, "slow": slow, "noise": noise,
            "exogenous": exogenous, "episode_constants": constants,
            **self._sampled(now, state, zeros, exogenous, slow),
        }  # fmt: skip

    def _moved(self, now: State, after: np.ndarray) -> np.ndarray:
        """State of the vehicle a step later."""
        before, acting = now.actuators, now.exogenous
        if self.forces.faulty:
            offsets, _ = self.forces.of_actuators(acting)
            before, after = before + offsets, after + offsets
        outside = acting[..., : self.forces.outside]
        return self.vehicle.step(now.state, before, after, outside, now.parameters)

    def _advanced(self, now: State, transition: np.ndarray) -> tuple[np.ndarray, ...]:
        """States of disturbance and biases, noise, and the linear part of the exogenous input."""
        return advance(
            now.keys, now.steps, now.slow, now.noise, self.parts, self.root, transition,
            self.forces.gains,
        )  # fmt: skip

    def _met(self, slow: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """States of disturbance and biases, after the vehicle has moved through the disturbance."""
        if not self.forces.meets:
            return slow
        z = self.disturbance.met(slow[..., : self.size], before, after)
        return np.concatenate([z, slow[..., self.size :]], -1)

    def _acting(
        self, now: State, slow: np.ndarray, exogenous: np.ndarray, state: np.ndarray,
        actuators: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Exogenous input over the coming step: of white noise, the disturbance and the task."""
        own, z, outside = self.disturbance, slow[..., : self.size], self.forces.outside
        if not self.forces.constant:
            time = self.sensors.dt * now.steps
            effect = (
                own.effect_at(now.episode_constants, time, z, state)
                if own.uniforms
                else own.effect(z, state)
            )
            exogenous = self.forces.add(exogenous, effect, actuators)
        if now.imposed is None:
            return exogenous
        within = exogenous[..., :outside] + now.imposed
        return np.concatenate([within, exogenous[..., outside:]], -1)

    def _sampled(
        self, now: State, state: np.ndarray, increments: np.ndarray, coming: np.ndarray,
        slow: np.ndarray,
    ) -> Changes:  # fmt: skip
        """Measurements and their mask, which contain nothing in the future.

        Args:
            now: The record, for its random numbers.
            state: Present state ``(..., n)`` of the vehicle.
            increments: Those of the step that has ended, which the state includes.
            coming: Exogenous input ``(..., f)`` of the coming step; sensors read its flows, and
                zeros for means over the step.
            slow: States of disturbance and biases ``(..., s)``.
        """
        flows = coming[..., self.increments : self.forces.outside]
        if not self.readable.all():
            flows = flows * self.readable
        read, biases = np.concatenate([increments, flows], -1), slow[..., self.size :]
        y, available = self.sensors.read(state, read, biases, now.steps, now.sensing)
        return {"y": y, "available": available}
