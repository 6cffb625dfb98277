"""Checks of filters before an episode, along a nominal trajectory.

A filter is refused if its measurements do not determine the unknown input, or if a user's own
filter fails in an ordinary step.
"""

from typing import TYPE_CHECKING

import numpy as np

from estimators import Filter, Gaussian, LinearModel, NonlinearModel
from estimators.unknown_input import UnknownInputFilter
from vessel_gym.models.state_space import StateSpace
from vessel_gym.models.structure import refuse_readers
from vessel_gym.vehicles.vehicle import Vehicle

if TYPE_CHECKING:
    from estimators import InputConditions

VAGUEST = 3.0
"""Largest standard deviation of an unknown input after one step, in units of its assumed size."""
_STEPS, _DEFLECTED = 30, 0.3
_NEAR = 1e-4
"""Variance of each initial state for the check of a filter, in SI units and radians."""


def check_causal(world: StateSpace) -> None:
    """Refuse a sensor that reads a mean over the coming step, which is not known yet.

    Raises:
        ValueError: naming the sensor and the mean.
    """
    refuse_readers(
        world,
        world.disturbance.averaged,
        "a mean over the coming step: let it read states, increments, currents or forces",
    )


def check_ambient_flows(space: StateSpace) -> None:
    """Refuse a sensor that reads a flow which the filter does not model.

    Raises:
        ValueError: naming the sensor and the flow.
    """
    if space.assumed_as == "process-noise":
        flows, who = space.vehicle.ambient_flows, type(space.disturbance).__name__
        refuse_readers(
            space,
            [name for name in space.disturbance.forces if name in flows],
            f'of which a filter knows nothing that assumes {who} as "{space.assumed_as}": assume'
            ' it with {"as": "states"}, or leave it out',
        )


def check_input(filter: Filter, space: StateSpace, model: LinearModel | NonlinearModel) -> None:
    """Refuse a filter of an unknown input d that the measurements do not determine.

    The check runs along a nominal trajectory, with the measurements of every step (between less
    frequent ones d keeps its prior). These measurements must determine each component of d to a
    standard deviation of at most `VAGUEST` times its assumed size, and the error of the estimate
    must not grow.

    Raises:
        ValueError: naming the condition that fails, and by how much.
    """
    if not space.inputs:
        return
    _check_timing(filter, model)
    if isinstance(filter, UnknownInputFilter) and (why := _undetermined(space, model)):
        acting = type(space.disturbance).__name__
        raise ValueError(
            f'{filter.name} cannot assume {acting} as "{space.assumed_as}", with the unknown input'
            f" {', '.join(space.inputs)}: {why}; assume it with "
            '{"as": "states"}, or add a sensor'
        )


def _undetermined(space: StateSpace, model: LinearModel | NonlinearModel) -> str:
    """Reason why measurements do not determine the unknown input; empty if they do."""
    from estimators import input_conditions  # late, as only filters of an unknown input need it

    often = np.flatnonzero(np.array(space.sensors.periods)[space.sensors.owner] == 1)
    if not len(often):
        return "no sensor reads in every step"
    own, u = nominal_flight(space.vehicle, space.vehicle_states)
    x = np.zeros((len(own), model.n))
    x[:, : own.shape[-1]] = own
    Q, R = (model.value(name, u[0]) for name in "QR")
    A, C = model.linearise_transition(x, u)[1], model.linearise_measurement(x, u)[1]
    G, H = model.input_matrix(x, u), model.value("H", u)
    given = (A, C, A @ G, C @ G + H) if model.delayed_feedthrough else (A, C, G, H)
    along = (np.broadcast_to(each, (len(x), *each.shape[-2:])) for each in given)
    noise = Q, R[np.ix_(often, often)]
    for A, C, G, H in zip(*along, strict=True):
        found = input_conditions(A, C[often], G, H[often], *noise, space.input_cov)
        if why := _failing(found, space.inputs):
            return why
    return ""


def _failing(found: "InputConditions", inputs: tuple[str, ...]) -> str:
    """Condition that fails at a point of the trajectory; empty if none does."""
    q = len(inputs)
    if found.rank < q:
        return f"the measurements of every step determine {found.rank} of its {q} directions"
    vague = int(np.argmax(found.sd))
    if found.sd[vague] > VAGUEST:
        size = f"{found.sd[vague]:.1f} times its assumed size ({VAGUEST:g} at most)"
        return f"one step determines {inputs[vague]} to a standard deviation of {size}"
    farthest = np.abs(found.zeros).max(initial=0.0)
    if farthest > 1.0 + 1e-6:
        where = f"of modulus {farthest:.3g}, outside the unit circle"
        return f"it adds a zero {where}, so that errors grow"
    return ""


def _check_timing(filter: Filter, model: LinearModel | NonlinearModel) -> None:
    """Refuse a filter whose unknown input acts in another step than the one that measurements show.

    Raises:
        ValueError: naming the step that measurements show.
    """
    fed = callable(model.H) or np.any(model.H)
    if (
        fed
        and filter.input_delay is not None
        and filter.model.delayed_feedthrough != model.delayed_feedthrough
    ):
        raise ValueError(
            f"{filter.name} takes its unknown input at another time than measurements show it: they"
            " contain that of the step that"
            f" {'has ended' if model.delayed_feedthrough else 'comes'}; build it on a model with"
            f" delayed_feedthrough={model.delayed_feedthrough}"
        )


def check_own(filter: Filter, space: StateSpace, model: LinearModel | NonlinearModel) -> None:
    """Refuse a user's filter that breaks the contract within a few ordinary steps of its model.

    Raises:
        ValueError: as `estimators.check.check_steps`.
    """
    if type(filter).__module__.startswith(("estimators.", "vessel_gym.")):
        return
    from estimators.check import check_steps  # late, as the package's own filters need none

    own, u = nominal_flight(space.vehicle, space.vehicle_states)
    mean = np.zeros(model.n)
    mean[: own.shape[-1]] = own[-1]
    check_steps(filter, Gaussian(mean, _NEAR * np.eye(len(mean))), u[-1])


def nominal_flight(vehicle: Vehicle, estimated: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Estimated states ``(k, n)`` and known inputs ``(k, m)`` at cruise and after deflections.

    The deflections are small and constant, for a number of steps.
    """
    cruising, actions = vehicle.cruise[0], len(vehicle.action_names)
    action = _DEFLECTED * np.vstack(
        [np.zeros(actions), np.random.default_rng(0).uniform(-1.0, 1.0, (2, actions))]
    )
    rows = len(action)
    state, after = vehicle.start(np.tile(cruising, (rows, 1)))
    parameters = np.tile(vehicle.nominal_parameters, (rows, 1))
    calm = np.zeros((rows, len(vehicle.increments + vehicle.ambient_flows)))
    for _ in range(_STEPS):
        before, after = after, vehicle.actuate(after, action)
        state = vehicle.step(state, before, after, calm, parameters)
    places = [vehicle.state_names.index(name) for name in estimated]
    return state[:, places], vehicle.known_input(after, vehicle.actuate(after, action), None)
