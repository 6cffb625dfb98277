"""A filter's model, composed of a vehicle, a disturbance and sensors, as much as the filter is told of them.

The filter's state is the vehicle's, then the disturbance's as far as it is told and matters, then the sensors' biases.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from estimators import LinearModel, NonlinearModel, retimed, stacked
from estimators.checks import numbers, shown
from estimators.differences import central_differences, steps
from estimators.engine import compiled
from estimators.engine.arrays import TracedArray
from estimators.varying import Matrix, Schedule, StateMatrix, StateNoise, resolve
from vessel_gym.disturbances import Disturbance
from vessel_gym.foreign import Call, copied, copying, ours, repeated
from vessel_gym.processes import Process
from vessel_gym.sensors import Sensors, columns
from vessel_gym.system import Trims, Vehicle
from vessel_gym.vehicles.integration import kicked as with_kicks

TOLD = ("states", "input", "white", "noise")
"""How a filter is told of a disturbance: its state is part of the filter's (``states``); its `Disturbance.inputs` are
the unknown input d (``input``), perhaps with the variance that they have, and white (``white``), and what of its state
does something else is part of the filter's; or its kicks stand in Q and R alone (``noise``), and the filter knows
nothing of a flow."""


OF_UNKNOWN_INPUTS = ("kf-umv-ui", "kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv", "ulise")
"""The filters that take a prior of an unknown input, which is to be true where no reading shows it."""


def checked_told(how: object) -> str:
    """One of `TOLD`.

    Raises:
        ValueError: for anything else.
    """
    if isinstance(how, str) and how in TOLD:
        return how
    raise ValueError(f"a filter is told of a disturbance as one of {', '.join(TOLD)}, got {shown(how)}")


def _mistakes(vehicle: Vehicle, disturbance: Disturbance) -> Iterator[str]:
    """What is wrong with a disturbance of this vehicle."""
    who, known, process = type(disturbance).__name__, acting_on(vehicle), disturbance.process
    for what in ("forces", "shakes", "names", "inputs"):
        given: Any = getattr(disturbance, what) or ()
        if isinstance(given, str) or len(set(given)) < len(given):
            yield f"{what} of {who} must be a tuple of different names, got {shown(given)}"
    believed: Any = disturbance.believed
    if not isinstance(believed, Disturbance | None):
        yield f"believed of {who} must be a Disturbance, or None, got {shown(believed)}"
    for what, least, wanted in (("input_sd", 0.0, "of at least 0"), ("scale", 1e-300, "above 0")):
        sizes = numbers(getattr(disturbance, what) or ())
        if sizes is None or not ((sizes >= least) & np.isfinite(sizes)).all():
            yield f"{what} of {who} must be numbers {wanted}, got {shown(getattr(disturbance, what))}"
    if disturbance.told != "states" and process.normals < process.size:
        yield f"{who} needs as many normal numbers a step as its state has components to begin"
    for name in (*disturbance.forces, *disturbance.shakes):
        if name not in known:
            yield f"{who} gives {shown(name)}, but what acts on this vehicle is {', '.join(known)}"
    for name in disturbance.shakes:
        if name not in vehicle.kicks or name in disturbance.forces:
            kicks = ", ".join(vehicle.kicks)
            yield f"{who} shakes {name}, which must be a kick ({kicks}) that its effect does not give"
    possible = *disturbance.forces, *disturbance.shakes, *map(change_of, disturbance.names)
    for name in disturbance.inputs or ():
        if name not in possible:
            yield f"{who} has the unknown input {shown(name)}, which must be one of {', '.join(possible)}"
    ship = getattr(disturbance, "ship", None)
    flown = getattr(vehicle, "ship", ship)
    if any(getattr(ship, name) != getattr(flown, name) for name in ("length", "beam", "draught", "mass") if ship):
        yield f"{who} was made for another ship than the vehicle's: give it ship=vehicle.ship"
    if disturbance.dt not in (None, vehicle.dt):
        own, dt = disturbance.dt, vehicle.dt
        yield f"{who} was made for steps of {own} s, the vehicle's are {dt:g} s: give it dt={dt:g}"
    if process.size and (modulus := np.abs(np.linalg.eigvals(process.transition)).max()) > 1.0 + 1e-6:
        yield f"process of {who} grows by a factor of {modulus:.3g} a step: eigenvalues must be of modulus 1 at most"
    if len(disturbance.names) != process.size:
        yield f"{who} names {len(disturbance.names)} components of a state that has {process.size}"
    for name in disturbance.names:
        if name in vehicle.state_names:
            yield f"{who} calls a component {name!r}, as another is called"
    if len(disturbance.white) != len(disturbance.shakes):
        yield f"white of {who} must have {len(disturbance.shakes)} rows, got {len(disturbance.white)}"
    if disturbance.scale is not None and len(disturbance.scale) != process.size:
        yield f"scale of {who} must have {process.size} rows, got {len(disturbance.scale)}"
    z, state = np.zeros((2, process.size)), np.tile(_cruising(vehicle), (2, 1))
    try:
        given = repeated(f"effect of {who}", disturbance.effect, z, state)
    except Exception as error:
        if str(error).startswith("effect of"):
            raise
        raise ValueError(f"effect of {who} failed on z of shape {z.shape}: {shown(str(error))}") from error
    shape = given.shape if isinstance(given, np.ndarray) else f"a {type(given).__name__}"
    if shape != (2, len(disturbance.forces)):
        values = f"{len(disturbance.forces)} values a row, for {', '.join(disturbance.forces)}"
        yield f"effect of {who} must give {values}: z of shape {z.shape} gave {shape}"
    elif numbers(given) is None or not np.isfinite(given).all():
        gave = f"gave {shown(given[0].tolist())} for z = 0 and a vehicle that cruises"
        yield f"effect of {who} {gave}: it must be real and finite"


def _drifted(drift: Callable[..., np.ndarray], x: np.ndarray, u: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Result of a user's ``drift`` of copies."""
    after = drift(copied(x), copied(u), copied(flow))
    return after if isinstance(after, TracedArray) else np.asarray(after, float)


def _owned(method: Any) -> bool:
    """Is a method that of an object of this package?"""
    owner = getattr(method, "__self__", None)
    return ours(method if owner is None else owner)


def acting_on(vehicle: Vehicle) -> tuple[str, ...]:
    """All that can act on a vehicle: kicks, flows, what may be added to each actuator, the share of it that is lost."""
    faults: tuple[str, ...] = getattr(vehicle, "faults", ())  # which a vehicle need not have
    return *vehicle.kicks, *vehicle.flows, *faults, *(f"{name.removesuffix('fault')}loss" for name in faults)


def change_of(name: str) -> str:
    """What a step adds to a component of a state, by name."""
    return f"change of {name}"


class Forces:
    """What a disturbance does to a vehicle: its effect sorted into kicks and flows.

    Args:
        vehicle: What is acted on.
        disturbance: What acts.

    Raises:
        ValueError: for a force that the vehicle does not have, a white one that is no kick, or another time step.
    """

    def __init__(self, vehicle: Vehicle, disturbance: Disturbance) -> None:
        try:
            mistake = next(_mistakes(vehicle, disturbance), None)
        except (TypeError, AttributeError) as error:
            mistake = f"{type(disturbance).__name__} is not what a Disturbance must be: {shown(str(error))}"
        if mistake is not None:
            raise ValueError(mistake)
        self.vehicle, self.disturbance = vehicle, disturbance
        self._effect = copying(disturbance.effect, disturbance)
        self.drift: Callable[..., np.ndarray] = (
            vehicle.drift if _owned(vehicle.drift) else partial(_drifted, vehicle.drift)
        )
        """The vehicle's."""
        known = acting_on(vehicle)
        self.to = [known.index(name) for name in disturbance.forces]
        self.outside = len(vehicle.kicks + vehicle.flows)
        """How many kicks and flows there are: the first parts of a forcing,"""
        self.faulty = max(self.to, default=-1) >= self.outside
        """and whether faults of the actuators follow, and what is lost of each."""
        known = known if self.faulty else known[: self.outside]
        self.size = len(known)
        self._losses = (self.outside + self.size) // 2
        self.shaken = [known.index(name) for name in disturbance.shakes]
        kicks = len(vehicle.kicks)
        self.kicks = [i for i in range(kicks) if i in self.to + self.shaken]
        """The kicks that it gives."""
        self.kicking = min(self.to, default=kicks) < kicks
        """Whether some follow from its state, and are not white."""
        self._flows_only = self.to == list(range(kicks, self.outside))
        changes = [*known, *map(change_of, disturbance.names)]
        given = (known[i] for i in self.kicks) if disturbance.inputs is None else disturbance.inputs
        self.input_names = tuple(given)
        """What the unknown input d is by name,"""
        self.inputs = [changes.index(name) for name in self.input_names]
        """and by place: in the forcing, and behind it in the changes of the disturbance's state."""
        self.unknown = [i for i in self.inputs if i < self.size]
        """The parts of the forcing that nobody knows who is told of d: a fault is with what is lost."""
        self.unknown += [i + len(known) - self._losses for i in self.unknown if self.outside <= i < self._losses]
        self.constant = getattr(disturbance.effect, "linear", False) and not self.faulty
        """Is its effect declared to be `gains` times its state, wherever the vehicle is?"""

    @cached_property
    def gains(self) -> np.ndarray:
        """What a unit of each white kick gives, and of z as far as that is `constant`, ``(f, s + k)``."""
        white = np.eye(self.size)[:, self.shaken]
        z = self.linear if self.constant else np.zeros((self.size, self.disturbance.process.size))
        return np.ascontiguousarray(np.hstack([white, z]))

    def add(self, forcing: np.ndarray, effect: np.ndarray, actuators: np.ndarray) -> np.ndarray:
        """A forcing ``(..., f)`` with an effect that is not `constant`; faults include what is lost of actuators."""
        columns = list(np.moveaxis(forcing, -1, 0))
        for j, i in enumerate(self.to):
            columns[i] = effect[..., j]
        if self.faulty:
            for j, lost in enumerate(range(self._losses, self.size)):
                columns[self.outside + j] = columns[self.outside + j] - columns[lost] * actuators[..., j]
        return np.stack(columns, -1)

    def users(self, state: np.ndarray) -> list[Call]:
        """The effect if it is a user's, to be called in states ``(B, n)``."""
        if ours(self.disturbance):
            return []
        z = np.zeros((len(state), self.disturbance.process.size))
        return [(self.disturbance.effect, (z, state), [(len(self.to),)])]

    def whole(self, z: np.ndarray, held: np.ndarray) -> np.ndarray:
        """The disturbance's state ``(..., k)`` out of the components that a filter estimates, others 0."""
        return _spread(z, held, self.disturbance.process.size)

    def of_actuators(self, forcing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What a forcing ``(..., f)`` adds to the actuators, and the share of each that is lost, ``(..., a)`` each."""
        return forcing[..., self.outside : self._losses], forcing[..., self._losses :]

    def on(self, z: np.ndarray, state: np.ndarray, unknown: Sequence[int] = ()) -> np.ndarray:
        """What acts ``(..., f)``, without the white noise and what is ``unknown``, which is 0."""
        known = [j for j, i in enumerate(self.to) if i not in unknown]
        return _spread(self._effect(z, state)[..., columns(known)], [self.to[j] for j in known], self.size)

    def flow(self, z: np.ndarray, state: np.ndarray, unknown: Sequence[int] = ()) -> np.ndarray:
        """The flows alone."""
        if self._flows_only and not unknown:
            return self._effect(z, state)
        return self.on(z, state, unknown)[..., len(self.vehicle.kicks) : self.outside]

    def moved(self, x: np.ndarray, u: np.ndarray, forcing: np.ndarray) -> np.ndarray:
        """What filters estimate of the vehicle a step on, under flows and faults of a forcing, without its kicks."""
        if self.faulty:
            u = self.vehicle.faulty(u, *self.of_actuators(forcing))  # type: ignore[attr-defined]
        return self.drift(x, u, forcing[..., len(self.vehicle.kicks) : self.outside])

    @cached_property
    def linear(self) -> np.ndarray:
        """What a unit of each component of z gives while cruising, ``(f, k)``."""
        k, state = self.disturbance.process.size, _cruising(self.vehicle)
        still = self.on(np.zeros((1, k)), state[None])
        return (self.on(np.eye(k), np.tile(state, (k, 1))) - still).T

    @property
    def kick_cov(self) -> np.ndarray:
        """Stationary covariance of the kicks that it gives."""
        return self._cov[np.ix_(self.kicks, self.kicks)]

    @cached_property
    def input_cov(self) -> np.ndarray:
        """Stationary covariance of the unknown input d, unless the disturbance says otherwise."""
        if self.disturbance.input_sd is not None:
            return np.diag(np.square(self.disturbance.input_sd))
        root = self.disturbance.process.root
        return block_diag(self._cov, root @ root.T)[np.ix_(self.inputs, self.inputs)]

    @cached_property
    def _cov(self) -> np.ndarray:
        """That of the forcing."""
        white = np.zeros((self.size, self.disturbance.white.shape[-1]))
        white[self.shaken] = self.disturbance.white
        E = self.linear
        return E @ self.disturbance.process.start_cov @ E.T + white @ white.T


@dataclass(frozen=True, eq=False)
class Composition:
    """What a filter knows of the world, as `compose` makes it.

    Attributes:
        model: The filter's model.
        names: The components of its state: of the vehicle, of the disturbance, of the sensors' biases.
        base: How many of them are the vehicle's.
        held: Which components of the disturbance's state are part of the filter's.
        inputs: What its unknown input d is, by name.
        forces: What it is told that acts.
        sensors: What it is told of them.
        told: One of `TOLD`.
        late: Whether the unknown input that acts now is the last part of the filter's state.
    """

    model: LinearModel | NonlinearModel
    names: tuple[str, ...]
    base: int
    held: np.ndarray
    inputs: tuple[str, ...]
    forces: Forces
    sensors: Sensors
    told: str
    late: bool = False

    def suiting(self, filter_name: str) -> "Composition":
        """With the unknown input when a filter of that name needs it: in the readings at once, or one step later."""
        model = self.model
        fed = model.q > 0 and (callable(model.H) or bool(np.any(model.H)))
        if fed and filter_name in ("kf-umv-ui-wdf", "ekf-ui-wdf", "ukf-umv"):
            names = *self.names, *(f"{name} now" for name in self.inputs)
            return replace(self, model=stacked(model), names=names, late=True)
        if filter_name == "kf-umv-ui" and model.q > 0 and not fed and isinstance(model, LinearModel):
            return replace(self, model=retimed(model))
        return self

    @property
    def vehicle(self) -> Vehicle:
        """What moves."""
        return self.forces.vehicle

    def check_flows(self) -> None:
        """Refuse a sensor that reads a flow of which the filter is told nothing, and which it would take to be 0.

        Raises:
            ValueError: naming both.
        """
        if self.told != "noise":
            return
        vehicle, sensors, disturbance = self.vehicle, self.sensors, self.forces.disturbance
        shown = _shown_anywhere(vehicle, sensors)
        for i, name in enumerate(vehicle.flows, len(vehicle.kicks)):
            readers = sensors.owner[np.flatnonzero(shown[:, i])]
            if name in disturbance.forces and len(readers):
                raise ValueError(
                    f"{sensors.each[readers[0]].name} reads {name}, of which a filter knows nothing that is told of "
                    f'{type(disturbance).__name__} as "{self.told}": tell it with {{"as": "states"}}, or leave it out'
                )

    def flow(self, mean: np.ndarray, input_mean: np.ndarray | None = None) -> np.ndarray:
        """The flow that means ``(..., n)``, and of d ``(..., q)``, imply ``(..., f)``; 0 where nothing is known."""
        if not len(self.held):
            flow = np.zeros(mean.shape[:-1] + (len(self.vehicle.flows),))
        else:
            z = self.forces.whole(mean[..., self.base : self.base + len(self.held)], self.held)
            flow = self.forces.flow(z, self._place(mean[..., : self.base]), self._unknown)
        if input_mean is None or not self._unknown_flows:
            return flow
        flows = list(np.moveaxis(flow, -1, 0))
        for i, j in self._unknown_flows:
            flows[j] = input_mean[..., i]
        return np.stack(flows, -1)

    @cached_property
    def _unknown(self) -> list[int]:
        """Which parts of the forcing are d."""
        return self.forces.unknown if self.inputs else []

    @cached_property
    def _unknown_flows(self) -> list[tuple[int, int]]:
        """Which component of d each flow is that d holds."""
        flows = self.vehicle.flows
        return [(i, flows.index(name)) for i, name in enumerate(self.inputs) if name in flows]

    @cached_property
    def _place(self) -> "Placed":
        return _placed(self.vehicle, self.names[: self.base])

    @cached_property
    def scale(self) -> np.ndarray:
        """Sizes of what comes after the vehicle's state that count as 1 in an observation of standard deviations."""
        disturbance = self.forces.disturbance
        sizes = disturbance.scale or np.sqrt(np.diag(disturbance.process.start_cov))
        inputs = np.sqrt(np.diag(self.forces.input_cov)) if self.late else np.zeros(0)
        return np.concatenate([np.asarray(sizes, float)[self.held], self.sensors.bias_scale, inputs])

    @cached_property
    def localisation(self) -> np.ndarray:
        """Which reading may correct which state of an ensemble ``(n, p)``, see `vessel_gym.sensors.Sensor`."""
        return self.sensors.informed(self.names, lambda: self._depends)

    @cached_property
    def _depends(self) -> np.ndarray:
        """The mask ``(n, p)`` of the states on which readings depend at once or within two steps, while cruising.

        It cruises at places of no consequence to how it moves: at the origin a range or a bearing from there says
        nothing, or anything.
        """
        x, u = self.vehicle.cruise
        full = np.zeros(len(self.names))
        full[: self.base] = x[: self.base]
        A = self.model.linearise_transition(full, u)[1]
        free = [i for i in range(self.base) if np.abs(A[:, i] - np.eye(len(A))[i]).max() < 1e-9]
        mask = np.zeros((len(self.names), self.sensors.size), bool)
        for place in np.random.default_rng(0).uniform(-30.0, 30.0, (3, len(free))):
            full[free] = x[free] + place
            A, C = self.model.linearise_transition(full, u)[1], self.model.linearise_measurement(full, u)[1]
            depends = np.abs(C)
            for _ in range(2):
                C = C @ A
                depends = np.maximum(depends, np.abs(C))
            mask |= (depends > 1e-6 * depends.max(-1, keepdims=True)).T
        return mask.astype(float)


def unknown_inputs(forces: Forces, sensors: Sensors) -> tuple[str, ...]:
    """What nobody is told of a coming step where no filter is told of an unknown input.

    Kicks, if they follow from the disturbance's state; otherwise all that is new: white kicks, changes of that and of
    biases.
    """
    disturbance = forces.disturbance
    if forces.kicking:
        return tuple(forces.vehicle.kicks[i] for i in forces.kicks)
    return *disturbance.shakes, *map(change_of, (*disturbance.names, *sensors.bias_names))


def compose(
    vehicle: Vehicle, kind: str, disturbance: Disturbance, sensors: Sensors, told: str | None = None
) -> Composition:
    """A filter's model.

    Args:
        vehicle: What moves.
        kind: One of the vehicle's ``kinds`` of model.
        disturbance: What the filter is told that acts.
        sensors: What it is told of them.
        told: One of `TOLD`; None: the disturbance's own.

    Raises:
        ValueError: if there is no such model, or it cannot be composed of these: a sensor reads what its filters do not
            estimate, or is not linear where the model is.
    """
    told = checked_told(disturbance.told if told is None else told)
    forces = Forces(vehicle, disturbance)
    base = vehicle.estimated(kind)
    placed = _placed(vehicle, base)
    _check_seen(vehicle, base, sensors)
    n = len(base)
    asked = told in ("input", "white")
    unknown = forces.unknown if asked else []
    changing = [i - forces.size for i in forces.inputs if asked and i >= forces.size]
    held = np.zeros(0, int) if told == "noise" else _held(vehicle, n, forces, sensors, unknown, changing)
    process = disturbance.process
    drift = Process.joined(_part(process, held), sensors.bias)
    names = (*base, *(disturbance.names[i] for i in held), *sensors.bias_names)
    for name in sensors.bias_names:
        if name in disturbance.names:
            raise ValueError(f"a bias is called {name!r}, as is a component of {type(disturbance).__name__}")
    angles = tuple(i for i, name in enumerate(base) if name in vehicle.angles)
    kicked = np.zeros((len(names), len(vehicle.kicks)))  # K: what kicks do to the state
    for j, name in enumerate(vehicle.kicked):
        if name in base:
            kicked[base.index(name), j] = 1.0
    root = np.zeros((len(names), disturbance.white.shape[-1] + process.normals + sensors.bias.normals))
    shown = _shown(vehicle, sensors, _cruising(vehicle))
    if told != "noise":
        white = np.zeros((forces.size, disturbance.white.shape[-1]))
        white[forces.shaken] = disturbance.white
        white[unknown] = 0.0
        white = white[: len(vehicle.kicks)]
        if shown[:, [i for i in forces.shaken if i not in unknown]].any():
            raise ValueError(
                f"a sensor reads the white kicks of {type(disturbance).__name__} as they come: a filter is told of "
                'them with {"as": "input"}, or {"as": "white"}'
            )
        fresh = process.root.copy()
        fresh[changing] = 0.0
        root[:, : white.shape[-1]] = kicked @ white
        root[n : n + len(held), white.shape[-1] : white.shape[-1] + process.normals] = fresh[held]
    if sensors.bias.normals:
        root[n + len(held) :, -sensors.bias.normals :] = sensors.bias.root
    Q = root @ root.T
    Q[:n, :n] += np.diag(np.asarray(vehicle.process_sd)[:n] ** 2)
    expected = partial(_expected, forces, sensors, held, placed, n, unknown)
    full = np.zeros(len(names))
    full[:n] = vehicle.cruise[0][:n]
    R = sensors.noise(expected, full, None)
    if told == "noise":
        K, S = kicked[:, forces.kicks], shown[:, forces.kicks]
        Q += K @ forces.kick_cov @ K.T
        kicks = S @ forces.kick_cov @ S.T
        R = R.changed(lambda noise: noise + kicks) if isinstance(R, StateNoise) else R + kicks
    inputs = forces.input_names if asked else ()
    options: dict[str, Any] = {"Q": Q, "R": R, "state_angles": angles, "measurement_angles": sensors.angles}
    G, H = np.zeros((len(names), len(inputs))), np.zeros((sensors.size, len(inputs)))
    for j, i in enumerate(forces.inputs if asked else ()):
        if i < len(vehicle.kicks):
            G[:, j] = kicked[:, i]
        elif i >= forces.size:
            G[n + held.tolist().index(i - forces.size), j] = 1.0
        if i < forces.outside:
            H[:, j] = shown[:, i]
    parts = _Parts(forces, sensors, base, held, drift, placed, kicked, unknown, G, H)
    if kind not in vehicle.linear_kinds:
        model: LinearModel | NonlinearModel = _nonlinear(parts, options)
    elif isinstance(given := vehicle.linear(kind), Trims):
        model = _straightened(parts, options, given)
    else:
        model = _linear(parts, kind, options, given)
    return Composition(model, names, n, held, inputs, forces, sensors, told)


Placed = Callable[[np.ndarray], np.ndarray]


def _expected(
    forces: Forces, sensors: Sensors, held: np.ndarray, placed: Placed, n: int, unknown: list[int], x: np.ndarray,
    u: np.ndarray | None, biased: bool = True,
) -> np.ndarray:  # fmt: skip
    """Measurements without noise ``(..., p)`` in states ``(..., m)`` of a filter, with their biases or without."""
    k, state, acting = len(held), placed(x[..., :n]), np.zeros(forces.outside)
    if k:
        acting = forces.on(forces.whole(x[..., n : n + k], held), state, unknown)[..., : forces.outside]
    acting = np.broadcast_to(acting, x.shape[:-1] + (forces.outside,))
    return sensors.exact(state, acting, x[..., n + k : n + k + sensors.bias.size] if biased else None)


class _Parts(NamedTuple):
    """What a model is composed of."""

    forces: Forces
    sensors: Sensors
    base: tuple[str, ...]  # what is estimated of the vehicle
    held: np.ndarray  # which components of the disturbance's state are
    drift: Process  # how these move, then the sensors' biases
    placed: Placed
    kicked: np.ndarray  # (n, kicks) what kicks do to the state
    unknown: list[int]  # parts of the forcing that are d
    G: np.ndarray  # (n, q) what d does to the state, but for its flows,
    H: np.ndarray  # (p, q) and to the readings


def _placed(vehicle: Vehicle, base: tuple[str, ...]) -> Placed:
    """What puts a filter's components of the vehicle's state where the vehicle has them, others 0."""
    where = [vehicle.state_names.index(name) for name in base]
    if where == list(range(len(vehicle.state_names))):
        return lambda x: x

    return partial(_spread, where=where, size=len(vehicle.state_names))


def _cruising(vehicle: Vehicle) -> np.ndarray:
    """The state ``(n,)`` of a vehicle that cruises."""
    return vehicle.start(vehicle.cruise[0][None])[0][0]


def _spread(x: np.ndarray, where: Iterable[int], size: int) -> np.ndarray:
    """Vectors ``(..., size)`` that have ``x (..., k)`` at the components ``where`` and 0 elsewhere."""
    columns = [np.zeros(x.shape[:-1])] * size
    for j, i in enumerate(where):
        columns[i] = x[..., j]
    return np.stack(columns, -1)


def _part(process: Process, held: np.ndarray) -> Process:
    square = np.ix_(held, held)
    return Process(process.transition[square], process.root[held], process.start_cov[square])


def _moving(forces: Forces, n: int) -> np.ndarray:
    """Which parts of a forcing, kicks aside, move the first ``n`` components that filters estimate ``(f,)``."""
    x, u = forces.vehicle.cruise
    still = forces.moved(x, u, np.zeros(forces.size))[:n]
    return np.array([(forces.moved(x, u, unit)[:n] != still).any() for unit in np.eye(forces.size)])


def _held(
    vehicle: Vehicle, n: int, forces: Forces, sensors: Sensors, unknown: list[int], changing: list[int]
) -> np.ndarray:
    """Which components of a disturbance's state a filter of ``n`` components of the vehicle's holds.

    Those that come to move what it estimates, or show, at once or later, otherwise than as what is ``unknown`` in the
    forcing; and those ``changing`` in ways that are unknown.
    """
    kicks, process = len(vehicle.kicks), forces.disturbance.process
    counts = _moving(forces, n)
    counts[:kicks] = True
    counts[: forces.outside] |= _shown_anywhere(vehicle, sensors).any(0)
    counts[unknown] = False
    # An effect may depend on z and on where the vehicle is in any way: it is looked at in several places.
    rng, matters = np.random.default_rng(0), np.isin(np.arange(process.size), changing)
    for size in (0.0, 1.0, 10.0, 100.0):
        z = 0.5 * rng.standard_normal(process.size) * (size > 0.0)
        near = size * rng.standard_normal((2, len(vehicle.state_names)))
        for place in _cruising(vehicle) + np.vstack([near, np.full((1, len(vehicle.state_names)), size)]):
            rows = np.tile(place, (process.size + 1, 1))
            with np.errstate(all="ignore"):
                given = forces.on(np.vstack([z, z + np.eye(process.size)]), rows)
            matters = matters | ((given[1:] != given[0]) & counts).any(-1)
    transition = process.transition
    for _ in transition:
        matters = matters | (transition[matters] != 0.0).any(0)
    return np.flatnonzero(matters)


def _shown(vehicle: Vehicle, sensors: Sensors, state: np.ndarray) -> np.ndarray:
    """How a unit of each kick and flow shows in the readings ``(p, f)`` of a vehicle in a state; 0 where none comes."""
    size = len(vehicle.kicks + vehicle.flows)
    with np.errstate(all="ignore"):
        readings = sensors.exact(np.tile(state, (size + 1, 1)), np.eye(size + 1, size, -1))
        return np.nan_to_num(readings[1:] - readings[0]).T


def _shown_anywhere(vehicle: Vehicle, sensors: Sensors) -> np.ndarray:
    """Whether it shows at all ``(p, f)``: a current need not show in the log of a ship that heads across it."""
    near = np.random.default_rng(0).standard_normal((8, len(vehicle.state_names)))
    return np.any([_shown(vehicle, sensors, _cruising(vehicle) + place) for place in near], 0)


def _check_seen(vehicle: Vehicle, base: tuple[str, ...], sensors: Sensors) -> None:
    """Refuse a sensor that reads a part of the vehicle's state that the filter does not estimate."""
    state = _cruising(vehicle)
    forcing = np.zeros((2, len(vehicle.kicks + vehicle.flows)))
    for i, name in enumerate(vehicle.state_names):
        if name in base:
            continue
        moved = np.stack([state, state])
        moved[1, i] += 1.0
        readings = sensors.exact(moved, forcing)
        changed = np.flatnonzero(readings[1] != readings[0])
        if len(changed):
            sensor = sensors.each[sensors.owner[changed[0]]]
            raise ValueError(
                f"{sensor.name} reads {name}, which filters of this model do not estimate (they estimate "
                f"{', '.join(base)}): leave it out, or choose another model"
            )


def _nonlinear(parts: _Parts, options: dict[str, Any]) -> NonlinearModel:
    forces, sensors, base, held, drift, placed, _, unknown, constant, H = parts
    vehicle = forces.vehicle
    n, k, kicks = len(base), len(held), len(vehicle.kicks)
    nothing = np.zeros(forces.size)
    moves = [base.index(name) for name in vehicle.kicked if name in base]
    kicking = k > 0 and forces.kicking

    def forcing(x: np.ndarray) -> np.ndarray:
        """What a state ``(..., n)`` implies that acts, ``(..., f)`` or ``(f,)``."""
        return forces.on(forces.whole(x[..., n : n + k], held), placed(x[..., :n]), unknown) if k else nothing

    def moved(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        assert u is not None
        acting = forcing(x)
        after = forces.moved(x[..., :n], u, acting)
        return with_kicks(after, acting[..., :kicks], moves) if kicking else after

    def transition(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        assert u is not None
        if u.size > u.shape[-1] and u.shape[:-1] != x.shape[:-1]:
            x = np.broadcast_to(x, np.broadcast_shapes(x.shape[:-1], u.shape[:-1]) + x.shape[-1:])
        return np.concatenate([moved(x, u), drift.advance(x[..., n:])], -1)

    measurement = partial(_expected, forces, sensors, held, placed, n, unknown)
    flowing = [(j, i) for j, i in enumerate(forces.inputs) if i in unknown and i >= kicks]
    for _, i in flowing:
        if i < forces.outside and not _alike(vehicle, sensors, i):
            raise ValueError(
                f"how readings show {vehicle.flows[i - kicks]} depends on where the vehicle is, which a nonlinear "
                f"model cannot have of an unknown input: let it be {change_of('a component')!r} instead, or leave the "
                "sensor out"
            )

    def pushed(x: np.ndarray, u: np.ndarray | None) -> np.ndarray:
        """G at a state: what d's flows and faults do is differenced about none of them."""
        own, acting = x[..., None, :n], forcing(x)[..., None, :]

        def after(d: np.ndarray, u: np.ndarray | None) -> np.ndarray:
            assert u is not None
            with_d = np.broadcast_to(acting, d.shape[:-1] + nothing.shape).copy()
            with_d[..., [i for _, i in flowing]] = d
            return forces.moved(np.broadcast_to(own, d.shape[:-1] + (n,)), u, with_d)

        none = np.zeros(x.shape[:-1] + (len(flowing),))
        columns = central_differences("drift", after, none, u, n, options["state_angles"], steps(none, None))[1]
        G = np.empty(x.shape[:-1] + constant.shape)
        G[...] = constant
        G[..., :n, [j for j, _ in flowing]] = columns
        return G

    G: StateMatrix | None = pushed if flowing else constant
    parts_of_others = forces.disturbance, *(sensor.reads for sensor in sensors.each)
    if _owned(vehicle.drift) and all(map(ours, parts_of_others)):
        transition, measurement = compiled(transition), compiled(measurement)
    return NonlinearModel(transition, measurement, **options, G=G if H.size else None, H=H if H.size else None)


def _alike(vehicle: Vehicle, sensors: Sensors, i: int) -> bool:
    """Whether readings show a part of the forcing alike wherever the vehicle is."""
    rng, cruising = np.random.default_rng(0), _cruising(vehicle)
    places = cruising + rng.standard_normal((5, len(cruising)))
    once, *others = (_shown(vehicle, sensors, place)[:, i] for place in (cruising, *places))
    return all(np.allclose(shown, once, rtol=1e-9, atol=1e-9) for shown in others)


def _straightened(parts: _Parts, options: dict[str, Any], trims: Trims) -> LinearModel:
    """The nonlinear model made straight about each of some steady motions."""
    bent, n = _nonlinear(parts, options), trims.x.shape[-1]
    x = np.zeros((len(trims.x), bent.n))
    x[:, :n], u = trims.x, trims.u
    after, A = bent.linearise_transition(x, u)
    readings, C = bent.linearise_measurement(x, u)
    wrong = np.abs(readings - np.matvec(C, x)).max(0) > 1e-6 * (1.0 + np.abs(readings).max(0))
    if wrong.any():
        sensor = parts.sensors.each[parts.sensors.owner[np.argmax(wrong)]]
        raise ValueError(
            f"{sensor.name} is not linear about the vehicle's steady motions: choose a filter for nonlinear models"
        )

    def moved(u: np.ndarray, _: np.ndarray | None) -> np.ndarray:
        return bent.transition(np.broadcast_to(x[:, None, :], u.shape[:-1] + (bent.n,)), u)

    B = central_differences("transition", moved, u, None, bent.n, bent.state_angles, steps(np.zeros(u.shape), None))[1]
    B[..., -1] += after - np.matvec(A, x) - np.matvec(B, u)

    def scheduled(table: np.ndarray) -> Schedule:
        return Schedule(np.ascontiguousarray(table), *trims[2:])

    G = None if bent.G is None else scheduled(np.broadcast_to(bent.input_matrix(x, u), (*x.shape, bent.q)))
    return LinearModel(scheduled(A), scheduled(C), B=scheduled(B), G=G, H=bent.H, **options)


def _linear(parts: _Parts, kind: str, options: dict[str, Any], given: tuple[Any, ...]) -> LinearModel:
    forces, sensors, base, held, drift, placed, kicked, unknown, constant, H = parts
    vehicle = forces.vehicle
    n, k = len(base), len(held)
    size, f = n + drift.size, forces.size
    kicks = len(vehicle.kicks)
    effect = np.zeros((f, size))  # E: what the filter's state gives of the forcing
    effect[:, n : n + k] = forces.linear[:, held]
    effect[unknown] = 0.0
    shown = effect[: forces.outside].T
    nothing = sensors.exact(placed(np.zeros(n)), np.zeros(forces.outside), np.zeros(sensors.bias.size))

    def read(x: np.ndarray) -> np.ndarray:
        return sensors.exact(placed(x[..., :n]), x @ shown, x[..., n + k :]) - nothing

    C = read(np.eye(size)).T
    x = np.linspace(-1.0, 2.0, size)
    wrong = np.flatnonzero(np.abs(read(x) - C @ x) > 1e-9 * (1.0 + np.abs(C) @ np.abs(x)))
    if len(wrong):
        raise ValueError(
            f"{sensors.each[sensors.owner[wrong[0]]].name} is not linear in what the filter estimates: choose a filter "
            "for nonlinear models"
        )
    A, B, flowed = given if len(given) == 3 else (*given, np.zeros((n, len(vehicle.flows))))
    moving = [i for i in np.flatnonzero(_moving(forces, n)) if i in unknown or effect[i].any()]
    for i in moving:
        if len(given) == 2 or i >= forces.outside:
            what = acting_on(vehicle)[i]
            raise ValueError(f"the {kind} model does not say what {what} does to it: choose a nonlinear one")
    flowing = [(j, i - kicks) for j, i in enumerate(forces.inputs) if i in unknown and i in moving]
    kick = kicked[:n] @ effect[:kicks]  # what the disturbance's part of the state adds to the vehicle's
    carry = effect[kicks : forces.outside]  # and what of flows

    def whole(u: np.ndarray | None) -> np.ndarray:
        own = resolve(A, u)
        matrix = np.zeros(own.shape[:-2] + (size, size))
        matrix[..., :n, :n] = own
        matrix[..., :n, :] += kick
        if carry.any():
            matrix[..., :n, :] += resolve(flowed, u) @ carry
        matrix[..., n:, n:] = drift.transition
        return matrix

    def known(u: np.ndarray | None) -> np.ndarray:
        own = resolve(B, u)
        matrix = np.zeros(own.shape[:-2] + (size, own.shape[-1]))
        matrix[..., :n, :] = own
        return matrix

    def pushed(u: np.ndarray | None) -> np.ndarray:
        own = resolve(flowed, u)
        matrix = np.zeros(own.shape[:-2] + constant.shape)
        matrix[...] = constant
        for j, i in flowing:
            matrix[..., :n, j] = own[..., i]
        return matrix

    G: Matrix = constant if not flowing else pushed if callable(flowed) else pushed(None)
    if H.size:
        options |= {"G": G, "H": H}
    if size == n:
        return LinearModel(A, C, B=B, **options)
    return LinearModel(whole, C, B=known, **options)
