"""The true world over a step: vehicle, disturbance and sensors as one function of a row."""

from typing import Any

import numpy as np
from scipy.linalg import block_diag

from estimators.engine import compiled
from vessel_gym.filter_models.exogenous import Forces
from vessel_gym.foreign import CheckedMethods
from vessel_gym.processes import advance, product
from vessel_gym.sensors import Sensors


class World:
    """The true world: vehicle, disturbance, sensors and the task's inputs.

    Methods are compiled unless they call a user's function.

    Args:
        vehicle: Vehicle of the forces; a user's has `CheckedMethods`.
        forces: Effect of the disturbance on the vehicle.
        disturbance: Disturbance of the forces; a user's has `CheckedMethods`.
        sensors: Sensors.
        task: Task; a user's has `CheckedMethods`.

    Attributes:
        own_parts: The user's own among vehicle, task and disturbance.
        parts: Normal numbers in a step, for the disturbance and each bias.
        start_roots: Roots of the initial covariances of the disturbance and each bias.
        size: Number of components of the disturbance's state.
    """

    def __init__(
        self,
        vehicle: Any,
        forces: Forces,
        disturbance: Any,
        sensors: Sensors,
        task: Any,
    ) -> None:
        self.vehicle, self.forces, self.sensors, self.task = vehicle, forces, sensors, task
        self.disturbance = disturbance
        self.own_parts = [
            part for part in (vehicle, task, disturbance) if isinstance(part, CheckedMethods)
        ]
        biases = [s.bias.process(sensors.dt) for s in sensors.each if s.bias is not None]
        self.size = disturbance.process.size
        flows = forces.vehicle.ambient_flows
        self.readable = np.array([float(name not in disturbance.averaged) for name in flows])
        self.parts = np.array([process.normals for process in (disturbance.process, *biases)])
        self.parts[0] += disturbance.white.shape[-1]
        self.start_roots = [process.start_root for process in (disturbance.process, *biases)]
        self.transition = block_diag(disturbance.process.transition, sensors.bias.transition)
        self.root = block_diag(disturbance.white, disturbance.process.root, sensors.bias.root)
        whole = sensors.verified and not self.own_parts
        acting = not isinstance(disturbance, CheckedMethods)
        verified = {
            "step": whole, "begin": whole, "move": forces.verified, "sense": sensors.verified,
            "draw": acting, "effect": acting,
        }  # fmt: skip
        for name, compilable in verified.items():
            if not compilable:
                setattr(self, name, getattr(self, name).function)

    @compiled(axes=(1, 1, 1, 1, 1, 1, 1, 2, 0, 1, 1, 1, 2))
    def step(
        self, action: np.ndarray, scenario: np.ndarray, reference: np.ndarray, state: np.ndarray,
        actuators: np.ndarray, exogenous: np.ndarray, parameters: np.ndarray, keys: np.ndarray,
        steps: np.ndarray, drifting: np.ndarray, noise: np.ndarray, drawn: np.ndarray,
        sensing: np.ndarray,
    ) -> tuple[np.ndarray, ...]:  # fmt: skip
        """Actuators and known input after an action, then the results of `move` and `sense`."""
        after = self.vehicle.actuate(actuators, action)
        commanding = self.task.commanding
        commanded = (
            self.task.commanded(scenario, steps - 1)
            if commanding is None
            else reference[..., commanding]
        )
        u = self.vehicle.known_input(actuators, after, commanded)
        ended = exogenous[..., : len(self.forces.vehicle.increments)]
        moved = self.move(
            state, actuators, after, exogenous, parameters, keys, steps, drifting, noise, drawn
        )
        state, drifting, noise, exogenous = moved
        exogenous = self._with_task(exogenous, scenario, steps)
        measured = self._measured(state, ended, exogenous, drifting)
        read = self.sense(*measured, steps, sensing)
        return after, u, state, drifting, noise, exogenous, *read

    @compiled(axes=(1, 1, 1, 1, 1, 2, 0, 1, 1, 1))
    def move(
        self, state: np.ndarray, before: np.ndarray, after: np.ndarray, exogenous: np.ndarray,
        parameters: np.ndarray, keys: np.ndarray, steps: np.ndarray, drifting: np.ndarray,
        noise: np.ndarray, drawn: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """States of vehicle, disturbance and biases, noise and exogenous input a step later.

        Args:
            state: ``(..., n)`` of the vehicle.
            before: Measured actuators ``(..., a)`` at the beginning of the step.
            after: Measured actuators ``(..., a)`` at the end of the step.
            exogenous: Exogenous input ``(..., f)`` over the step.
            parameters: ``(..., k)`` of the vehicle.
            keys: ``(..., parts, 2)`` of the random numbers of disturbance and biases.
            steps: ``(...)`` since the episode's start, including this step.
            drifting: States of disturbance and biases ``(..., s)``.
            noise: Noise ``(..., w + s)`` of the step.
            drawn: Constants of the disturbance for the episode ``(..., e)``.
        """
        measured = after
        if self.forces.faulty:
            offsets, _ = self.forces.of_actuators(exogenous)
            before, after = before + offsets, after + offsets
        left = state
        state = self.vehicle.step(
            state, before, after, exogenous[..., : self.forces.outside], parameters
        )
        drifting, *advanced = self._advanced(keys, steps, drifting, noise)
        if self.forces.meets:
            z = self.disturbance.met(drifting[..., : self.size], left, state)
            drifting = np.concatenate([z, drifting[..., self.size :]], -1)
        advanced = drifting, *advanced
        return state, *self._with_effect(advanced, drawn, steps, state, measured)

    @compiled(axes=(1, 1, 2, 1, 2, 0))
    def begin(
        self, scenario: np.ndarray, mean: np.ndarray, root: np.ndarray, numbers: np.ndarray,
        keys: np.ndarray, steps: np.ndarray,
    ) -> tuple[np.ndarray, ...]:  # fmt: skip
        """Initial actuators, known input, results of `move`, constants, measurements, score state.

        Args:
            scenario: Scenario ``(..., c)`` of the task.
            mean: Mean of the prior ``(..., n)``.
            root: Root of the prior's covariance ``(..., n, n)``.
            numbers: Random numbers ``(..., k)`` from `vessel_gym.start.draw`.
            keys: Keys ``(..., parts, 2)`` of disturbance, biases and sensors.
            steps: Zeros ``(...)``.
        """
        start_root, first, count = (
            block_diag(*self.start_roots),
            self.task.uniforms,
            len(self.parts),
        )
        last, normals = (
            numbers.shape[-1] - start_root.shape[-1],
            numbers[..., first : first + mean.shape[-1]],
        )
        uniforms = numbers[..., last - self.disturbance.uniforms : last]
        drawn = self.draw(uniforms) if self.disturbance.uniforms else uniforms
        drifting = product(
            start_root, numbers[..., last:], np.zeros((*mean.shape[:-1], len(start_root)))
        )
        x = mean + (root * normals[..., None, :]).sum(-1)
        if self.forces.carried is not None:
            x = product(self.forces.carried, drifting, x)
        state, actuators = self.vehicle.start(x)
        noise = np.zeros((*drifting.shape[:-1], len(self.root)))
        advanced = self._advanced(keys[..., :count, :], steps, drifting, noise, first=True)
        drifting, noise, exogenous = self._with_effect(advanced, drawn, steps, state, actuators)
        exogenous = self._with_task(exogenous, scenario, steps)
        u = self.vehicle.known_input(actuators, actuators, self.task.commanded(scenario, steps))
        ended = np.zeros((*steps.shape, len(self.forces.vehicle.increments)))
        read = self.sense(
            *self._measured(state, ended, exogenous, drifting), steps, keys[..., count:, :]
        )
        score_state = self.task.initial_score_state(state, scenario)
        return actuators, u, state, drifting, noise, exogenous, drawn, *read, score_state

    @compiled(axes=(1, 1, 1, 0, 2))
    def sense(
        self,
        state: np.ndarray,
        exogenous: np.ndarray,
        bias: np.ndarray,
        steps: np.ndarray,
        sensing: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Measurements ``(..., p)`` and the mask of those available."""
        return self.sensors.read(state, exogenous, bias, steps, sensing)

    def _measured(
        self, state: np.ndarray, ended: np.ndarray, coming: np.ndarray, drifting: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """State, exogenous input and biases that sensors read, without anything in the future.

        Args:
            state: Present state ``(..., n)`` of the vehicle.
            ended: Increments ``(..., increments)`` of the step that has ended, which the state
                includes.
            coming: Exogenous input ``(..., f)`` of the coming step; sensors read its flows, and
                zeros for means over the step.
            drifting: States of disturbance and biases ``(..., s)``.
        """
        flows = coming[..., ended.shape[-1] : self.forces.outside]
        if not self.readable.all():
            flows = flows * self.readable
        return state, np.concatenate([ended, flows], -1), drifting[..., self.size :]

    @compiled(axes=(2, 0, 1, 1))
    def _advanced(
        self,
        keys: np.ndarray,
        steps: np.ndarray,
        drifting: np.ndarray,
        noise: np.ndarray,
        *,
        first: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States of disturbance and biases, noise, and the linear part of the exogenous input."""
        transition = np.eye(len(self.transition)) if first else self.transition
        return advance(
            keys, steps, drifting, noise, self.parts, self.root, transition, self.forces.gains
        )

    def _with_task(
        self, exogenous: np.ndarray, scenario: np.ndarray, steps: np.ndarray
    ) -> np.ndarray:
        """Exogenous input plus the task's own."""
        if not hasattr(self.task, "exogenous"):
            return exogenous
        added, outside = self.task.exogenous(scenario, steps), self.forces.outside
        return np.concatenate([exogenous[..., :outside] + added, exogenous[..., outside:]], -1)

    def _with_effect(
        self, advanced: tuple[np.ndarray, np.ndarray, np.ndarray], drawn: np.ndarray,
        steps: np.ndarray, state: np.ndarray, actuators: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        drifting, noise, exogenous = advanced
        if self.forces.constant:
            return advanced
        effect = self.effect(drawn, steps, drifting[..., : self.size], state)
        return drifting, noise, self.forces.add(exogenous, effect, actuators)

    @compiled
    def draw(self, uniforms: np.ndarray) -> np.ndarray:
        """Constants ``(..., e)`` of the disturbance in an episode."""
        drawn: np.ndarray = self.disturbance.draw(uniforms)
        return drawn

    @compiled(axes=(1, 0, 1, 1))
    def effect(
        self, drawn: np.ndarray, steps: np.ndarray, z: np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Effect ``(..., forces)`` of the disturbance after ``steps (...)`` of an episode."""
        own = self.disturbance
        given: np.ndarray = (
            own.effect_at(drawn, self.sensors.dt * steps, z, state)
            if own.uniforms
            else own.effect(z, state)
        )
        return given
