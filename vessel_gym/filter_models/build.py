"""A filter's model, composed of a vehicle, an assumed disturbance and sensors.

The filter's state is the vehicle's, then the assumed and relevant part of the disturbance's, then
the sensors' biases.
"""

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from estimators import LinearModel, NonlinearModel
from vessel_gym.checks import one_of
from vessel_gym.disturbances import Disturbance
from vessel_gym.filter_models.exogenous import Forces, change_of, cruising
from vessel_gym.filter_models.linear import linear_model
from vessel_gym.filter_models.nonlinear import linearised_model, nonlinear_model
from vessel_gym.filter_models.parts import Parts, check_estimated, relevant, seen, seen_anywhere
from vessel_gym.sensors import Sensors
from vessel_gym.vehicles.vehicle import Trims, Vehicle

ASSUMED = ("states", "unknown-input", "white-input", "process-noise")
"""Ways in which a filter assumes a disturbance.

``states``: the disturbance's state is part of the filter's state. ``unknown-input``: the
disturbance's ``inputs`` are the unknown input d, and further effective components are states.
``white-input``: the same model, and d is white noise of known variance. ``process-noise``: the
disturbance's increments are process noise, and flows are not modelled.
"""


OF_UNKNOWN_INPUTS = ("kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise")
"""Filters with a prior of the unknown input, which must be true where no measurement shows it."""
BESIDE_BIASES = 1e-6
"""Radius of `robust-kf` that suits slow biases.

The ball enlarges the largest standard deviation of a prediction by 0.07 % a step, which is less
than the slowest bias of a sensor returns to zero.
"""


def checked_assumption(how: object) -> str:
    """A value of `ASSUMED`.

    Raises:
        ValueError: for any other value.
    """
    return one_of("way to assume a disturbance", how, ASSUMED)


@dataclass(frozen=True, eq=False)
class Composition(Parts):
    """A filter's model and its parts, as `compose` returns them.

    Attributes:
        model: Model of the filter.
        names: Components of the filter's state: vehicle, disturbance, sensors' biases.
        inputs: Names of the components of the unknown input d.
        assumed_as: One of `ASSUMED`.
        late: Is the unknown input the last part of the filter's state? Measurements show it as it
            acts.
    """

    model: LinearModel | NonlinearModel
    names: tuple[str, ...]
    inputs: tuple[str, ...]
    assumed_as: str
    late: bool = False

    def adapted_to(self, filter_name: str) -> "Composition":
        """Composition with d as a state, if the filter cannot handle feedthrough of present d."""
        if self.model.delayed_feedthrough or filter_name not in (
            "kf-umv-ui-wdf",
            "ekf-ui-wdf",
            "ukf-umv",
        ):
            return self
        from estimators import stacked  # late, as few filters need it

        names = *self.names, *(f"{name} now" for name in self.inputs)
        return replace(self, model=stacked(self.model), names=names, late=True)

    def check_ambient_flows(self) -> None:
        """Refuse a sensor that reads a flow which the filter does not model.

        Raises:
            ValueError: naming the sensor and the flow.
        """
        vehicle, disturbance = self.vehicle, self.forces.disturbance
        for i, name in (
            enumerate(vehicle.ambient_flows, len(vehicle.increments))
            if self.assumed_as == "process-noise"
            else ()
        ):
            feedthrough = seen_anywhere(vehicle, self.sensors)[:, i]
            if name in disturbance.forces and feedthrough.any():
                raise ValueError(
                    f"{self.sensors.of_channel(np.argmax(feedthrough)).name} reads {name}, of which"
                    " a filter knows "
                    f'nothing that assumes {type(disturbance).__name__} as "{self.assumed_as}":'
                    " assume it with "
                    '{"as": "states"}, or leave it out'
                )

    def check_white_input(self, estimator: object) -> None:
        """Refuse a white input of known variance for every filter but the Kalman filter.

        Raises:
            ValueError: naming the estimator.
        """
        if self.assumed_as == "white-input" and estimator != "kf":
            name = estimator if isinstance(estimator, str) else "an estimator of one's own"
            raise ValueError(
                f'only kf can assume a white input of known variance, not {name}: say "as":'
                ' "process-noise"'
            )

    def flow(self, mean: np.ndarray, input_mean: np.ndarray | None = None) -> np.ndarray:
        """Ambient flow ``(..., f)`` from means of state and d ``(..., q)``; 0 if unknown."""
        names = self.vehicle.ambient_flows
        acting = self.acting(mean)[..., len(self.vehicle.increments) : self.forces.outside]
        flow = np.broadcast_to(acting, (*mean.shape[:-1], len(names)))
        if input_mean is None or not set(self.inputs) & set(names):
            return flow
        known = [self.inputs.index(name) if name in self.inputs else -1 for name in names]
        return np.stack(
            [flow[..., j] if i < 0 else input_mean[..., i] for j, i in enumerate(known)], -1
        )

    @cached_property
    def scale(self) -> np.ndarray:
        """Divisors of observed standard deviations, after those of the vehicle's state."""
        disturbance = self.forces.disturbance
        sizes = disturbance.scale or np.sqrt(np.diag(disturbance.process.start_cov))
        ended = np.sqrt(np.diag(self.forces.cov))[self.ended]
        inputs = np.sqrt(np.diag(self.forces.input_cov)) if self.late else np.zeros(0)
        return np.concatenate(
            [np.asarray(sizes, float)[self.estimated], self.sensors.bias_scale, ended, inputs]
        )


def unknown_inputs(forces: Forces, sensors: Sensors) -> tuple[str, ...]:
    """Names of the unknown inputs of a coming step, for filters that estimate none.

    The names are the increments that follow from the disturbance's state. Without such increments
    they are white increments and the changes of the disturbance's state and of biases.
    """
    disturbance = forces.disturbance
    if forces.has_increments:
        return tuple(forces.vehicle.increments[i] for i in forces.increments)
    return *disturbance.white_increments, *map(change_of, (*disturbance.names, *sensors.bias_names))


def compose(
    vehicle: Vehicle,
    kind: str,
    disturbance: Disturbance,
    sensors: Sensors,
    assumed_as: str | None = None,
) -> Composition:
    """Compose a filter's model.

    Args:
        vehicle: Vehicle.
        kind: Kind of model, one of the vehicle's ``kinds``.
        disturbance: Disturbance that the filter assumes.
        sensors: Sensors that the filter assumes.
        assumed_as: One of `ASSUMED`; None: the disturbance's default.

    Raises:
        ValueError: for an unknown kind, or a sensor that reads states which the filter does not
            estimate or is not linear while the model is.
    """
    assumed_as = checked_assumption(disturbance.assumed_as if assumed_as is None else assumed_as)
    forces, own = Forces(vehicle, disturbance), vehicle.estimated(kind)
    check_estimated(own, vehicle, sensors)
    for name in sensors.bias_names:
        if name in disturbance.names:
            raise ValueError(
                f"a bias is called {name!r}, as is a component of {type(disturbance).__name__}"
            )
    asked = assumed_as in ("unknown-input", "white-input")
    unknown = forces.unknown if asked else []
    changing = [i - forces.size for i in forces.inputs if asked and i >= forces.size]
    estimated = np.zeros(0, int)
    if assumed_as != "process-noise":
        estimated = relevant(forces, sensors, len(own), unknown, changing)
    observable: np.ndarray = np.any(seen_anywhere(vehicle, sensors), 0)
    ended = [i for i in forces.increments if observable[i] and i not in unknown]
    parts = Parts(forces, sensors, own, estimated, unknown, ended)
    assumed = (disturbance.names[i] for i in estimated)
    names = *own, *assumed, *sensors.bias_names, *parts.ended_names
    options: dict[str, Any] = {
        "state_angles": tuple(i for i, name in enumerate(own) if name in vehicle.angles),
        "measurement_angles": sensors.angles,
        "delayed_feedthrough": True,  # unless measurements show the present d
        **_noise(parts, assumed_as == "process-noise", changing),
    }  # fmt: skip
    inputs = forces.input_names if asked else ()
    if inputs:
        G, H = _input_effects(parts)
        options |= {"G": G, "H": H, "delayed_feedthrough": _delayed(parts, inputs, H)}
    model = _model(parts, kind, options)
    fixed: dict[str, Any] = {each.name: getattr(parts, each.name) for each in fields(Parts)}
    return Composition(**fixed, model=model, names=names, inputs=inputs, assumed_as=assumed_as)


def _model(parts: Parts, kind: str, options: dict[str, Any]) -> LinearModel | NonlinearModel:
    """Model of a kind: nonlinear, linearised or linear."""
    if kind not in parts.vehicle.linear_kinds:
        return nonlinear_model(parts, options)
    given = parts.vehicle.linear(kind)
    if isinstance(given, Trims):
        return linearised_model(parts, options, given)
    return linear_model(parts, kind, options)


def _input_effects(parts: Parts) -> tuple[np.ndarray, np.ndarray]:
    """G and H: effects of increments and changes in d on the state, and of d on measurements."""
    forces, incremented, inputs = parts.forces, parts.incremented, parts.forces.inputs
    feedthrough = seen(parts.sensors, cruising(parts.vehicle))
    G, H = np.zeros((len(incremented), len(inputs))), np.zeros((parts.sensors.size, len(inputs)))
    for j, i in enumerate(inputs):
        if i < len(parts.vehicle.increments):
            G[:, j] = incremented[:, i]
        elif i >= forces.size:
            G[parts.base + parts.estimated.tolist().index(i - forces.size), j] = 1.0
        if i < forces.outside:
            H[:, j] = feedthrough[:, i]
    return G, H


def _delayed(parts: Parts, inputs: tuple[str, ...], H: np.ndarray) -> bool:
    """Do measurements show the unknown input of the step that has ended, not the present one?

    Raises:
        ValueError: if the sensors show both, increments of the ended step and present flows.
    """
    increments = np.array([name in parts.vehicle.increments for name in inputs], bool)
    feedthrough: np.ndarray = np.any(H, 0)
    if feedthrough[increments].any() and feedthrough[~increments].any():
        raise ValueError(
            "sensors show increments of the step that has ended and flows as they are now, of"
            f" {', '.join(inputs)}: no filter can take both for its unknown input; assume them with"
            ' {"as": "states"}'
        )
    return not feedthrough[~increments].any()


def _noise(parts: Parts, as_noise: bool, changing: list[int]) -> dict[str, Any]:
    """Q and R.

    Args:
        parts: Parts of the model.
        as_noise: Are the disturbance's increments process noise?
        changing: Indices of the disturbance's states whose changes are the unknown input.
    """
    forces, sensors, estimated, n = parts.forces, parts.sensors, parts.estimated, parts.base
    process, bias = forces.disturbance.process, sensors.bias
    white, incremented, biases = forces.white.copy(), parts.incremented, n + len(estimated)
    first = white.shape[-1]
    root = np.zeros((len(incremented), first + process.normals + bias.normals))
    if not as_noise:
        white[parts.unknown] = 0.0
        fresh = process.root.copy()
        fresh[changing] = 0.0
        root[:, :first] = incremented @ white[: incremented.shape[-1]]
        root[n:biases, first : first + process.normals] = fresh[estimated]
    root[biases : biases + bias.size, first + process.normals :] = bias.root
    Q = root @ root.T
    Q[:n, :n] += np.diag(np.asarray(parts.vehicle.process_sd)[:n] ** 2)
    full = np.zeros(len(incremented))
    full[:n] = parts.vehicle.cruise[0][:n]
    R = sensors.noise(parts.expected, full, None)
    if as_noise:
        K = incremented[:, forces.increments]
        Q += K @ forces.increment_cov @ K.T
    noise: dict[str, Any] = {"Q": Q, "R": R}
    for name, table in getattr(parts.vehicle, "noise", {}).items():
        if (
            np.shape(noise[name]) == table.table.shape[1:]
        ):  # the vehicle's schedules hold for its own sensors and states alone
            noise[name] = table
    return noise
