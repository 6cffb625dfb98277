"""The estimator of an environment: chosen by name, with its assumptions and its model."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from estimators import Delayed, Filter, Model, factory
from estimators.checks import number, short_repr
from estimators.robust import RobustKalmanFilter
from vessel_gym import checks
from vessel_gym.acceptance import check_input, check_own
from vessel_gym.disturbances import Disturbance
from vessel_gym.filter_models.build import Composition, checked_assumption, compose, unknown_inputs
from vessel_gym.filter_models.exogenous import Forces, input_channels
from vessel_gym.reference_filters import DeadReckoning, Oracle, ZeroOrderHold
from vessel_gym.sensors import Sensors
from vessel_gym.sharing import shared
from vessel_gym.system import System

LATE = ("fused", "as new", "discarded")
"""What is done with measurements that come late: fused where they belong, taken for new ones, or thrown away."""
ENVIRONMENT_ONLY = ("truth", "measurement", "dead-reckoning")
WITHOUT_COVARIANCE = ("truth", "measurement")
"""Estimators that claim no uncertainty of their own: their NEES means nothing."""


def estimator_names() -> tuple[str, ...]:
    """Every name that an environment's ``estimator`` accepts."""
    return factory.names() + ENVIRONMENT_ONLY


VARIANTS: dict[str, dict[str, Any]] = {
    "linear": {"model": "linear"},
    "nonlinear": {"model": "nonlinear"},
    "waves": {"assume": {"disturbance": "moderate", "as": "states"}},
    "white": {"assume": {"as": "white-input"}},
}
"""Options of an estimator by the last word of its name, as in ``"huber-kf-nonlinear"``.

A filter of ``-waves`` estimates moderate waves as states; one of ``-white`` takes what acts for white
noise of known variance.
"""


def variant(name: str) -> tuple[str, dict[str, Any]]:
    """The estimator that a name stands for, and its options: those of `VARIANTS`, or none."""
    base, _, last = name.rpartition("-")
    known = name not in factory.names() and base in factory.names() and last in VARIANTS
    return (base, VARIANTS[last]) if known else (name, {})


EstimatorChoice = str | Callable[..., Filter]
"""A name of `estimator_names`, perhaps with one of `VARIANTS`, or your own.

Your own is a `Filter` subclass, or any function of a model that returns a filter.
"""


@dataclass(frozen=True)
class Assumptions:
    """Assumptions of a filter that differ from the world: ``estimator_options={"assume": {...}}``.

    Attributes:
        disturbance: What acts, by name or as an object; None: what does.
        how: One of `vessel_gym.filter_models.build.ASSUMED` (``"as"`` in the options); None: as
            that disturbance has it.
        Q: Factor on the covariance of what enters in a step, a white input's too,
        R: of the measurements,
        prior: and of what is known at the start.
    """

    disturbance: str | Disturbance | None = None
    how: str | None = None
    Q: float = 1.0
    R: float = 1.0
    prior: float = 1.0

    @classmethod
    def of(cls, options: object) -> "Assumptions":
        """From the options of an estimator.

        Raises:
            TypeError: for what is no dictionary, or has keys that there are not.
            ValueError: for a factor that is not positive, or an unknown way to assume a
                disturbance.
        """
        given = checks.options("assume", options)
        known = ("disturbance", "as", "Q", "R", "prior")
        for key in given:
            if key not in known:
                raise TypeError(factory.unknown("key of assume", key, known))
        for key in ("Q", "R", "prior"):
            if key in given:
                given[key] = number(
                    f"{key} of assume", given[key], low=0.0, what="a factor above 0"
                )
        if "as" in given:
            given["how"] = checked_assumption(given.pop("as"))
        return cls(**given)


@dataclass(frozen=True, eq=False)
class Estimation:
    """Filter of an environment, and its assumptions.

    Attributes:
        filter: The filter.
        composition: What its model is composed of.
        prior: Factor on the covariance of what is known at the start.
        inputs: What is kept of the unknown input for scoring: the filter's d; if it has none, see
            `unknown_inputs`.
        late: What is done with measurements that come late: one of `LATE`.
        horizon: Steps by which measurements may be late.
    """

    filter: Filter
    composition: Composition
    prior: float
    inputs: tuple[str, ...]
    late: str = LATE[0]
    horizon: int = 0

    @cached_property
    def input_delay(self) -> int:
        """Steps by which an estimate of the unknown input is later than the true one that `Core.unknown_input` has."""
        vehicle = self.composition.vehicle
        levels = set(input_channels(vehicle)) - set(
            vehicle.increments
        )  # of these it has what is now
        as_it_acts = self.composition.late or levels.isdisjoint(self.inputs)
        return 0 if as_it_acts else self.filter.input_delay or 0

    @cached_property
    def tells_truth(self) -> bool:
        """Is it the declared exception, whose measurement is the truth?"""
        return isinstance(self.filter, Oracle)

    @cached_property
    def fuses(self) -> bool:
        """Are late measurements fused where they belong?"""
        return self.late == "fused" and self.horizon > 0 and not self.tells_truth

    @cached_property
    def delayed(self) -> Any:
        """The filter, or one that fuses late measurements."""
        return Delayed(self.filter, self.horizon) if self.fuses else self.filter


@shared
def build(
    system: System,
    estimator: EstimatorChoice,
    options: dict[str, Any] | None,
    sensors: Sensors,
    disturbance: Disturbance,
) -> Estimation:
    """The estimator of an environment.

    Args:
        system: The environment's system.
        estimator: One of `estimator_names`, or a function of the model (and options) that returns a
            filter.
        options: The filter's own options, over the system's tuning; ``model`` chooses the kind of
            the filter's model, ``assume`` its assumptions (`Assumptions`), ``late`` one of `LATE`.
        sensors: The sensors, which the filter knows.
        disturbance: What acts.

    Raises:
        ValueError: for an unknown name or way with late measurements, or a filter that cannot work
            with the model.
        TypeError: for an unknown option, options that are no dictionary, or a function that returns
            no filter.

    Warns:
        UserWarning: for a radius of ``robust-kf`` that is too large beside the sensors' biases.
    """
    options = checks.options("estimator_options", options)
    own = is_own(estimator)
    if isinstance(estimator, str):
        estimator, chosen = variant(estimator)
        options = chosen | options
    if not own and (not isinstance(estimator, str) or estimator not in estimator_names()):
        advice = (
            ". A filter of your own is passed as its class, in a study as module:class"
            if ":" in str(estimator)
            else f"; a filter's name may end in {', '.join(f'-{last}' for last in VARIANTS)}"
        )
        raise ValueError(
            factory.unknown("estimator", estimator, accepted(system, sensors, disturbance)) + advice
        )
    assumptions = Assumptions.of(options.pop("assume", None))
    late = checks.one_of("value of late", options.pop("late", LATE[0]), LATE)
    if estimator == "truth":  # its assumptions are the world's
        assumptions = Assumptions()
    default = system.filter_models.get(str(estimator), system.filter_model)
    composition = _composed(
        system, options.pop("model", default), assumptions, sensors, disturbance
    )
    if not own:
        composition = composition.adapted_to(str(estimator))
    nature = (
        composition.forces
        if assumptions.disturbance is None
        else Forces(system.vehicle, disturbance)
    )
    inputs = composition.inputs or unknown_inputs(nature, sensors)
    if (
        assumptions.how is None and estimator not in ENVIRONMENT_ONLY
    ):  # these do without a model of measurements
        composition.check_ambient_flows()
    if composition.assumed_as == "white-input" and estimator not in ("kf", *ENVIRONMENT_ONLY):
        name = estimator if isinstance(estimator, str) else "an estimator of one's own"
        raise ValueError(
            f'only kf can assume a white input of known variance, not {name}: say "as":'
            ' "process-noise"'
        )
    made = _filter(system, estimator, options, composition, inputs, assumptions.Q)
    check_input(made, composition)
    if isinstance(made, RobustKalmanFilter):
        _warn_of_biases(made, sensors, system.task.horizon)
    return Estimation(made, composition, assumptions.prior, inputs, late, sensors.horizon)


def is_own(estimator: object) -> bool:
    """Is an estimator a function that returns one? A filter that is built already is refused."""
    if isinstance(estimator, Filter) or (
        isinstance(estimator, type) and not issubclass(estimator, Filter)
    ):
        kind = (
            f"an instance of {type(estimator).__name__}"
            if isinstance(estimator, Filter)
            else short_repr(estimator)
        )
        raise TypeError(
            "estimator must be a name, a Filter class or a function of the model that returns a"
            f" filter, got {kind}"
        )
    return callable(estimator)


def _filter(
    system: System,
    estimator: Any,
    options: dict[str, Any],
    composition: Composition,
    inputs: tuple[str, ...],
    factor: float,
) -> Filter:
    """The package's filter of a name, or one's own; where it needs a linear model, the error names the option."""
    try:
        if callable(estimator):
            made = own_filter(estimator, options, composition.model)
            check_own(made, composition)
            return made
        return _made(system, estimator, options, composition, inputs, factor)
    except ValueError as error:
        linear = system.vehicle.linear_kinds
        if not linear or "needs a LinearModel" not in str(error):
            raise
        raise ValueError(f'{error}, or give the option "model": "{linear[0]}"') from None


def own_filter(estimator: Any, options: dict[str, Any], model: Model) -> Filter:
    """A filter of one's own."""
    made: Filter = estimator(model, **options)
    if not isinstance(made, Filter):
        raise TypeError(f"estimator must return an estimators.Filter, got {type(made).__name__}")
    return made


def _made(
    system: System,
    name: str,
    options: dict[str, Any],
    composition: Composition,
    inputs: tuple[str, ...],
    factor: float,
) -> Filter:
    """One of the package's filters, tuned for its assumptions; ``inputs`` are those of the oracle and others."""
    makers: dict[str, Callable[[], Filter]] = {
        "truth": lambda: Oracle(composition.model.n, len(inputs)),
        "measurement": lambda: ZeroOrderHold(composition, inputs),
        "dead-reckoning": lambda: DeadReckoning(composition.model),
    }
    if name in makers:
        if options:
            raise TypeError(
                f"{name} has no option {next(iter(options))!r}: it takes model, assume and late"
            )
        return makers[name]()
    tuned = {**system.tuning(name, composition), **options}
    if composition.assumed_as == "white-input":
        tuned = {"input_cov": factor * composition.forces.input_cov, **tuned}
    try:
        return factory.make(name, composition.model, **tuned)
    except ValueError as error:
        if "needs an unknown input" not in str(error):
            raise
        acting = type(composition.forces.disturbance).__name__
        raise ValueError(
            f'{name} needs an unknown input, but assumes {acting} as "{composition.assumed_as}":'
            ' assume one with increments, with {"as": "unknown-input"}, or choose another'
            " estimator"
        ) from None


def _warn_of_biases(filter: RobustKalmanFilter, sensors: Sensors, horizon: int) -> None:
    """Warn where a ball enlarges variances by far more a step than the slowest bias returns towards zero.

    A ball of radius c multiplies the largest eigenvalue of a covariance by about ``1 + sqrt(2 c)``
    at every step. The difference of a state and its sensor's bias, which no measurement shows, is
    brought back by the bias alone, by dt / tau a step. A bias that lasts for the whole episode
    counts as one that returns over its ``horizon`` [steps].
    """
    if not sensors.bias.size or filter.radius == 0.0:
        return
    returns = max(-np.log(np.diagonal(sensors.bias.transition).max()), 1.0 / horizon)
    if np.sqrt(2.0 * filter.radius) > 10.0 * returns:
        warnings.warn(
            f"{filter.name} with radius {filter.radius:g} enlarges variances by"
            f" {np.sqrt(2.0 * filter.radius):.2g} of themselves a step, and the sensors' slowest"
            f" bias returns by {returns:.2g} of itself: position minus bias runs away; take a"
            f" radius of at most {50.0 * returns**2:.1g}",
            UserWarning,
            stacklevel=3,
        )


def accepted(
    system: System,
    sensors: Sensors,
    disturbance: Disturbance,
    among: tuple[str, ...] | None = None,
) -> tuple[str, ...]:
    """Names of estimators that a system's models can carry, of all `estimator_names` or of some."""
    names = []
    for name in among or estimator_names():
        try:
            build(system, name, None, sensors, disturbance)
        except ValueError:
            continue
        names.append(name)
    return tuple(names)


def _composed(
    system: System,
    kind: object,
    assumptions: Assumptions,
    sensors: Sensors,
    disturbance: Disturbance,
) -> Composition:
    """Compose a filter's model of a kind under its assumptions."""
    if not isinstance(kind, str):
        raise TypeError(
            f"model must be the name of a filter model, such as {system.filter_model!r}, got"
            f" {short_repr(kind)}"
        )
    if kind not in system.vehicle.kinds:
        raise ValueError(factory.unknown("filter model", kind, system.vehicle.kinds))
    if assumptions.disturbance is not None:
        disturbance = chosen_disturbance(system, assumptions.disturbance)
    elif disturbance.believed is not None:
        disturbance = disturbance.believed
    disturbance = disturbance.modelled or disturbance
    composition = compose(system.vehicle, kind, disturbance, sensors, assumptions.how)
    if assumptions.Q == assumptions.R == 1.0:
        return composition
    model: Any = composition.model
    Q, R = (
        noise.changed(partial(np.multiply, factor)) if callable(noise) else factor * noise
        for factor, noise in ((assumptions.Q, model.Q), (assumptions.R, model.R))
    )
    return replace(composition, model=replace(model, Q=Q, R=R))


def chosen_disturbance(system: System, choice: object) -> Disturbance:
    """A disturbance of a system by its name, or somebody's own.

    Raises:
        ValueError: for a name that there is not.
        TypeError: for what is neither a name nor a `Disturbance`.
    """
    if isinstance(choice, Disturbance):
        return choice
    if not isinstance(choice, str):
        names = ", ".join(system.disturbances)
        raise TypeError(
            f"disturbance must be one of {names}, or a Disturbance object, got {short_repr(choice)}"
        )
    return system.disturbances[checks.one_of("disturbance", choice, system.disturbances)]
