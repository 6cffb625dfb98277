"""The estimator of an environment: chosen by name, with its assumptions and its model."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

from estimators import Filter, Model, factory
from estimators.checks import short_repr
from vessel_gym import checks
from vessel_gym.caching import cached
from vessel_gym.disturbances import Disturbance
from vessel_gym.models.assumed import Assumptions, assumed_space
from vessel_gym.models.input_conditions import check_ambient_flows, check_input, check_own
from vessel_gym.models.linear import filter_model
from vessel_gym.models.reference_filters import DeadReckoning, Oracle, ZeroOrderHold
from vessel_gym.models.state_space import StateSpace
from vessel_gym.sensors import Sensors
from vessel_gym.system import System

LATE = ("fused", "as new", "discarded")
"""Uses of late measurements: fused at their own time, taken for new ones, or discarded."""
ENVIRONMENT_ONLY = ("truth", "measurement", "dead-reckoning")
WITHOUT_COVARIANCE = ("truth", "measurement")
"""Estimators without a covariance of their own, so that their NEES means nothing."""
_STACKED = ("kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv")
"""Filters that cannot handle feedthrough of the present d, which is appended to their state."""


def estimator_names() -> tuple[str, ...]:
    """All names that an environment's ``estimator`` accepts."""
    return factory.names() + ENVIRONMENT_ONLY


VARIANTS: dict[str, dict[str, Any]] = {
    "linear": {"model": "linear"},
    "nonlinear": {"model": "nonlinear"},
    "waves": {"assume": {"disturbance": "moderate", "as": "states"}},
    "white": {"assume": {"as": "white-input"}},
}
"""Options of an estimator by the ending of its name, as in ``"huber-kf-nonlinear"``.

A filter with ``-waves`` estimates moderate waves as states. A filter with ``-white`` assumes that
the disturbance is white noise of known variance.
"""


def variant(name: str) -> tuple[str, dict[str, Any]]:
    """Estimator and options that a name stands for: those of `VARIANTS`, or none."""
    base, _, last = name.rpartition("-")
    known = name not in factory.names() and base in factory.names() and last in VARIANTS
    return (base, VARIANTS[last]) if known else (name, {})


EstimatorChoice = str | Callable[..., Filter]
"""A name of `estimator_names`, with or without an ending of `VARIANTS`, or a user's estimator.

A user's estimator is a `Filter` subclass, or a function of the model that returns a filter.
"""


@dataclass(frozen=True, eq=False)
class Estimation:
    """Filter of an environment, and its assumptions.

    Attributes:
        filter: The filter.
        space: State space of the filter's model.
        inputs: Names of the unknown inputs kept for scoring: the filter's d or, if it has none,
            `vessel_gym.models.state_space.StateSpace.scored_inputs`.
        late: Use of late measurements, one of `LATE`.
        horizon: Largest delay of measurements in steps.
    """

    filter: Filter
    space: StateSpace
    inputs: tuple[str, ...]
    late: str
    horizon: int

    @cached_property
    def input_delay(self) -> int:
        """Steps by which the estimate of the unknown input lags behind the true one in ``info``."""
        # ``info`` has the present values of flows and faults
        levels = self.space.channels[self.space.increments :]
        as_it_acts = self.space.stacked or {*levels}.isdisjoint(self.inputs)
        return 0 if as_it_acts else self.filter.input_delay or 0

    @cached_property
    def tells_truth(self) -> bool:
        """Is the filter the oracle, whose measurement is the truth?"""
        return isinstance(self.filter, Oracle)

    @cached_property
    def fuses(self) -> bool:
        """Are late measurements fused at the time when they were taken?"""
        return self.late == "fused" and self.horizon > 0 and not self.tells_truth

    @cached_property
    def delayed(self) -> Any:
        """The filter, wrapped in `Delayed` if it fuses late measurements."""
        if not self.fuses:
            return self.filter
        from estimators import Delayed  # late, as most measurements arrive in time

        return Delayed(self.filter, self.horizon)


def build(
    system: System,
    estimator: EstimatorChoice,
    options: dict[str, Any] | None,
    sensors: Sensors,
    disturbance: Disturbance,
) -> Estimation:
    """Build the estimator of an environment.

    Args:
        system: The environment's system.
        estimator: One of `estimator_names`, or a function of the model (and options) that returns a
            filter.
        options: Options of the filter, which override the system's tuning. ``model`` is the kind of
            the filter's model, ``assume`` its assumptions (`Assumptions`), ``late`` one of `LATE`.
            Each assumption overrides that of the name's ending in `VARIANTS`; the others stay.
        sensors: Sensors, which the filter knows.
        disturbance: True disturbance.

    Raises:
        ValueError: for an unknown estimator or value of ``late``, or a filter that cannot work with
            the model.
        TypeError: for an unknown option, options that are no dictionary, or a function that returns
            no filter.
    """
    options = checks.options("estimator_options", options)
    built = _built  # a user's function may change
    if not is_own(estimator):
        built = _cached
        name, chosen = variant(str(estimator))
        if name not in estimator_names():
            advice = f"; a filter's name may end in {', '.join(f'-{last}' for last in VARIANTS)}"
            if ":" in str(estimator):
                advice = ". A filter of your own is passed as its class, in a study as module:class"
            raise ValueError(factory.unknown("estimator", estimator, estimator_names()) + advice)
        assume = checks.options("assume", options.get("assume"))
        options = chosen | options | {"assume": chosen.get("assume", {}) | assume}
        estimator = name
    assumptions = Assumptions.of(options.pop("assume", None))
    items = (*((name, value, type(value)) for name, value in options.items()),)  # 1.0 is no 1
    return built(system, estimator, items, assumptions, sensors, disturbance)


def _built(
    system: System, estimator: EstimatorChoice, items: tuple[tuple[str, Any, type], ...],
    assumptions: Assumptions, sensors: Sensors, disturbance: Disturbance,
) -> Estimation:  # fmt: skip
    """Estimator of an environment, under assumptions and with the items of its options."""
    options = {name: value for name, value, _ in items}
    late = checks.one_of("value of late", options.pop("late", LATE[0]), LATE)
    if estimator == "truth":  # its assumptions are the world's
        assumptions = Assumptions()
    kind = options.pop("model", system.filter_models.get(str(estimator), system.filter_model))
    space = _space(system, kind, assumptions, sensors, disturbance)
    model = assumptions.scaled(filter_model(space), sensors)
    if estimator in _STACKED and not model.delayed_feedthrough:
        from estimators import stacked  # late, as few filters need it

        space, model = replace(space, stacked=True), stacked(model)
    true = StateSpace.of_world(system.vehicle, disturbance, sensors)
    inputs = space.inputs or (space if assumptions.disturbance is None else true).scored_inputs
    made: Filter
    if estimator in ENVIRONMENT_ONLY and options:
        option = next(iter(options))
        raise TypeError(f"{estimator} has no option {option!r}: it takes model, assume and late")
    if estimator == "truth":
        made = Oracle(model.n, len(inputs))
    elif estimator == "dead-reckoning":
        made = DeadReckoning(model)
    elif estimator == "measurement":
        made = ZeroOrderHold(space, model, inputs)
    else:
        if assumptions.how is None:
            check_ambient_flows(space)
        made = _filter(system, estimator, options, space, model, assumptions.Q)
    check_input(made, space, model)
    return Estimation(made, space, inputs, late, sensors.horizon)


_cached = cached(_built)


def is_own(estimator: object) -> bool:
    """Is an estimator a user's class or function?

    Raises:
        TypeError: for a filter that is built already, or a class that is no filter.
    """
    built = isinstance(estimator, Filter)
    if built or (isinstance(estimator, type) and not issubclass(estimator, Filter)):
        kind = f"an instance of {type(estimator).__name__}" if built else short_repr(estimator)
        raise TypeError(
            "estimator must be a name, a Filter class or a function of the model that returns a"
            f" filter, got {kind}"
        )
    return callable(estimator)


def _filter(
    system: System, estimator: Any, options: dict[str, Any], space: StateSpace, model: Model,
    factor: float,
) -> Filter:  # fmt: skip
    """A filter of the package, tuned, or of the user; ``factor`` is that on covariances.

    Raises:
        ValueError: for a filter that cannot work with the model, naming what to assume or choose.
    """
    name = estimator if isinstance(estimator, str) else "an estimator of one's own"
    if space.assumed_as == "white-input":
        if estimator != "kf":
            raise ValueError(
                f'only kf can assume a white input of known variance, not {name}: say "as":'
                ' "process-noise"'
            )
        options = {"input_cov": factor * space.input_cov} | options
    try:
        if callable(estimator):
            made = own_filter(estimator, options, model)
            check_own(made, space, model)
            return made
        own = {}
        if estimator == "steady-kf":
            from vessel_gym.models.steady import steady_options  # late, as no other filter needs it

            own = steady_options(space, model)
        return factory.make(estimator, model, **own | system.tuning(estimator, space) | options)
    except ValueError as error:
        text, linear = str(error), system.vehicle.linear_kinds
        if linear and "needs a LinearModel" in text:
            raise ValueError(f'{text}, or give the option "model": "{linear[0]}"') from None
        if "needs an unknown input" in text:
            raise ValueError(
                f"{name} needs an unknown input, but assumes {type(space.disturbance).__name__} as"
                f' "{space.assumed_as}": assume one with increments, with'
                ' {"as": "unknown-input"}, or choose another estimator'
            ) from None
        raise


def own_filter(estimator: Any, options: dict[str, Any], model: Model) -> Filter:
    """Filter that a user's class or function builds."""
    made: Filter = estimator(model, **options)
    if not isinstance(made, Filter):
        raise TypeError(f"estimator must return an estimators.Filter, got {type(made).__name__}")
    return made


def _space(
    system: System, kind: object, assumptions: Assumptions, sensors: Sensors,
    disturbance: Disturbance,
) -> StateSpace:  # fmt: skip
    """State space of a filter under its assumptions."""
    kind = checks.one_of("filter model", kind, system.vehicle.kinds)
    if assumptions.disturbance is not None:
        disturbance = chosen_disturbance(system, assumptions.disturbance)
    elif disturbance.believed is not None:
        disturbance = disturbance.believed
    disturbance, vehicle = disturbance.modelled or disturbance, cast(Any, system.vehicle)
    if kind == "as_printed" and kind not in vehicle.linear_kinds:
        vehicle = replace(vehicle, as_printed=True)
    return assumed_space(vehicle, kind, disturbance, sensors, assumptions.how)


def chosen_disturbance(system: System, choice: object) -> Disturbance:
    """Disturbance of a system by its name, or a user's own.

    Raises:
        ValueError: for an unknown name.
        TypeError: for anything but a name or a `Disturbance`.
    """
    if isinstance(choice, Disturbance):
        return choice
    if not isinstance(choice, str):
        names = ", ".join(system.disturbances)
        raise TypeError(
            f"disturbance must be one of {names}, or a Disturbance object, got {short_repr(choice)}"
        )
    return system.disturbances[checks.one_of("disturbance", choice, system.disturbances)]


BESIDE_BIASES = 1e-6
"""Radius of `robust-kf` that suits slow biases.

The ball enlarges the largest standard deviation of a prediction by 0.07 % a step, which is less
than the slowest bias of a sensor returns to zero.
"""
_OF_UNKNOWN_INPUTS = ("kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise")
"""Filters with a prior of the unknown input, which must be true where no measurement shows it."""


def tuning(name: str, space: StateSpace) -> dict[str, Any]:
    """Options of filters: the variance of the unknown input, and the radius of `robust-kf`."""
    if name == "robust-kf":
        return {"radius": BESIDE_BIASES}
    if name in _OF_UNKNOWN_INPUTS and space.inputs:
        return {"input_prior": space.input_cov}
    return {}
