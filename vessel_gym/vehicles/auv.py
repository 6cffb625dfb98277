"""Common part of torpedo-shaped underwater vehicles: particulars, coefficients and actuators.

The vehicles are bodies of revolution with four equal stern fins and a propeller. The centre of
gravity is below the centre of buoyancy, which is the origin. Body axes: x forward, y starboard, z
down; earth axes: north, east, down.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from estimators.engine import compiled
from vessel_gym.vehicles.files import Particulars
from vessel_gym.vehicles.hydrodynamics import (
    Coefficients,
    Fins,
    Spheroid,
    Torpedo,
    axial_drag_coefficient,
)
from vessel_gym.vehicles.simulated import Actuator, SimulatedVehicle

_FACTORS = {
    "surge added mass": ("X_udot",),
    "lateral added mass": ("Y_vdot", "Z_wdot"),
    "pitch and yaw added inertia": ("M_qdot", "N_rdot"),
    "axial drag": ("X_uu",),
    "cross-flow drag": ("Y_vv", "Y_rr", "Z_ww", "Z_qq", "M_ww", "M_qq", "N_vv", "N_rr"),
    "lift": ("Y_uv", "Y_ur", "Z_uw", "Z_uq", "M_uw", "M_uq", "N_uv", "N_ur", "K_up"),
    "stern planes": ("Z_uuds", "M_uuds"),
    "rudder": ("Y_uudr", "N_uudr"),
    "roll added inertia": ("K_pdot",),
    "roll drag": ("K_pp",),
}
UNCERTAIN = tuple(_FACTORS)
"""Parameters that `mismatch` spreads; the first `VERTICAL` act in the vertical plane.

One factor scales all coefficients of a kind. Cross-flow coefficients share one integral along the
hull, and so do those of lift: with one factor they remain dissipative. Coefficients of the vertical
and horizontal plane stay equal, as for any body of revolution.
"""
VERTICAL = 7
_NOMINAL = np.ones(len(UNCERTAIN))


@dataclass(frozen=True)
class AUVParameters(Particulars):
    """Particulars of a torpedo-shaped vehicle in SI units: the content of a vehicle file.

    A file states a source for each number, and may leave out numbers with a default. ``given``
    holds measured or computed coefficients by name, which replace estimates from the dimensions:
    any of `Coefficients`, and the body's mass and inertias.
    """

    length: float  # m
    diameter: float  # m
    fin_area: float  # m2, of each of four fins
    fin_position: float  # m, x of the middle of the fins' chord
    z_g: float  # m, centre of gravity below the centre of buoyancy
    thrust_limit: float  # N
    cruise_speed: float  # m/s
    axial_drag: float | None = None  # on the frontal area; None: of the bare hull at cruise speed
    buoyancy_excess: float = 0.0  # N, buoyancy minus weight
    fin_limit: float = float(np.deg2rad(20.0))  # rad, assumed: below stall
    fin_rate: float = 1.0  # rad/s, of a small servo, assumed
    thrust_lag: float = 0.5  # s, time constant of the thrust, assumed
    propeller_torque: float = 0.0  # m, torque per thrust
    fin_aspect: float = 2.21  # effective aspect ratio, REMUS'; Prestero (2001)
    fin_taper: float = 0.654  # chord at the tip / at the root, REMUS'; Prestero (2001)
    water_density: float = 1025.0  # kg/m3, sea water; Fossen (2011)
    gravity: float = 9.81  # m/s2
    given: tuple[tuple[str, float], ...] = ()  # coefficients by name

    GIVEN = ("mass", "roll_inertia", "pitch_inertia", *Coefficients._fields)
    names: ClassVar[tuple[str, ...]]
    """Coefficients of the equations of motion."""

    @cached_property
    def torpedo(self) -> Torpedo:
        """Shape: a prolate spheroid with fins."""
        span = np.sqrt(0.5 * self.fin_aspect * self.fin_area)  # the hull mirrors the fin
        fins = Fins(self.fin_area, span, self.fin_position, self.fin_taper)
        hull, drag = Spheroid(self.length, self.diameter), self.axial_drag
        if drag is None:
            drag = axial_drag_coefficient(self.length, self.diameter, self.cruise_speed)
        return Torpedo(hull, fins, drag, water_density=self.water_density)

    @cached_property
    def coefficients(self) -> Coefficients:
        """Hydrodynamic coefficients: given ones, and estimates from the dimensions."""
        given = {name: x for name, x in self.given if name in Coefficients._fields}
        return self.torpedo.coefficients()._replace(**given)

    @cached_property
    def buoyancy(self) -> float:
        """Weight [N] of the displaced water, from a given mass or else from the spheroid."""
        given = dict(self.given)
        if "mass" in given:
            return given["mass"] * self.gravity + self.buoyancy_excess
        return self.water_density * self.gravity * np.pi / 6.0 * self.length * self.diameter**2

    @cached_property
    def mass(self) -> float:
        """Mass [kg]; if not given, that of neutral buoyancy, apart from ``buoyancy_excess``."""
        return dict(self.given).get("mass", (self.buoyancy - self.buoyancy_excess) / self.gravity)

    @cached_property
    def roll_inertia(self) -> float:
        """Inertia in roll about the origin [kg m2]; if not given, of a homogeneous spheroid."""
        return dict(self.given).get("roll_inertia", 0.1 * self.mass * self.diameter**2)

    @cached_property
    def pitch_inertia(self) -> float:
        """Inertia in pitch and in yaw [kg m2]; if not given, of a homogeneous spheroid."""
        spheroid = 0.05 * self.mass * (self.length**2 + self.diameter**2)
        return dict(self.given).get("pitch_inertia", spheroid)

    @cached_property
    def cruise_thrust(self) -> float:
        """Thrust [N] that balances the axial drag at ``cruise_speed``."""
        return -self.coefficients.X_uu * self.cruise_speed**2

    def _with_body(self, c: dict[str, Any]) -> dict[str, Any]:
        """Coefficients by name, with masses and inertias of body and added mass together."""
        return c | {
            "surge_mass": self.mass - c["X_udot"],
            "sway_mass": self.mass - c["Y_vdot"],
            "heave_mass": self.mass - c["Z_wdot"],
            "roll_inertia": self.roll_inertia - c["K_pdot"],
            "pitch_inertia": self.pitch_inertia - c["M_qdot"],
            "yaw_inertia": self.pitch_inertia - c["N_rdot"],
            "mass_z_g": self.mass * self.z_g,
            "propeller_torque": self.propeller_torque,
            "sway_yaw": -c["Y_rdot"],
            "heave_pitch": -c["Z_qdot"],
            "net_weight": -self.buoyancy_excess,
            "righting_moment": self.mass * self.gravity * self.z_g,
        }

    def mistakes(self) -> Iterator[tuple[str, str]]:
        """Errors in the particulars: the name of a number, and a sentence."""
        L, D = self.length, self.diameter
        if D >= L:
            yield "diameter", f"a torpedo of {L:g} m is not {D:g} m thick"
            return  # no formula holds
        if abs(self.fin_position) > L:
            off = f"fins {self.fin_position:g} m from the origin"
            yield "fin_position", f"{off} are not on a hull of {L:g} m"
        if self.fin_area >= 0.25 * L * D:
            fin = f"a fin of {self.fin_area:g} m2"
            yield "fin_area", f"{fin} does not belong to a hull of {L:g} by {D:g} m"
        cylinder = 0.25 * np.pi * D**2 * L * self.water_density
        if not self.mass > 0.0 or self.buoyancy > cylinder * self.gravity:
            key = "mass" if "mass" in dict(self.given) else "buoyancy_excess"
            displaced = f"a cylinder round the hull displaces {cylinder:.4g} kg"
            yield key, f"{self.mass:.4g} kg do not float: {displaced}"
        if self.cruise_thrust > self.thrust_limit:
            drag = f"at cruising speed the drag is {self.cruise_thrust:.3g} N"
            yield "thrust_limit", f"{self.thrust_limit:g} N are too little: {drag}"
        c = self.coefficients._asdict()
        if any(np.linalg.eigvalsh(block).min() <= 0.0 for block in _inertia(self._with_body(c))):
            yield "coefficients", "the added masses leave an inertia that is not positive definite"
        elif (c["Y_rdot"], c["Z_qdot"]) != (c["N_vdot"], c["M_wdot"]):
            yield "coefficients", "added mass is symmetric: Y_rdot is N_vdot, and Z_qdot is M_wdot"

    def vector(self, factors: np.ndarray = _NOMINAL) -> np.ndarray:
        """Coefficients of the equations of motion ``(..., k)``, in the order of ``names``.

        Args:
            factors: Factors ``(..., f)`` on the first of `UNCERTAIN`; default: 1.
        """
        c: dict[str, Any] = self.coefficients._asdict()
        f = dict(zip(UNCERTAIN, np.moveaxis(factors, -1, 0), strict=False))
        for kind, factor in f.items():
            for name in _FACTORS[kind]:
                c[name] = c[name] * factor
        # The geometric mean keeps the added mass positive definite, however far its diagonal is
        # scaled.
        coupling = np.sqrt(f["lateral added mass"] * f["pitch and yaw added inertia"])
        for name in ("Y_rdot", "N_vdot", "Z_qdot", "M_wdot"):
            c[name] = c[name] * coupling
        c = self._with_body(c)
        vertical, lateral = _inertia(c)
        c |= _inverse("uwq", vertical) | _inverse("vpr", lateral)
        return np.stack(np.broadcast_arrays(*(c[name] for name in self.names)), -1)


def _inertia(c: dict[str, Any]) -> list[np.ndarray]:
    """Inertia blocks ``(..., 3, 3)`` of surge, heave and pitch, and of sway, roll and yaw."""
    S, e, d = c["mass_z_g"], c["sway_yaw"], c["heave_pitch"]
    blocks = (
        (c["surge_mass"], 0.0, S, 0.0, c["heave_mass"], d, S, d, c["pitch_inertia"]),
        (c["sway_mass"], -S, e, -S, c["roll_inertia"], 0.0, e, 0.0, c["yaw_inertia"]),
    )
    numbers = [np.stack(np.broadcast_arrays(*block), -1) for block in blocks]
    return [each.reshape(*each.shape[:-1], 3, 3) for each in numbers]


def _inverse(axes: str, inertia: np.ndarray) -> dict[str, np.ndarray]:
    """Inverse of an inertia block by axes: ``inverse_uw`` is surge acceleration per heave force."""
    inverse = np.linalg.inv(inertia)
    pairs = zip(*np.triu_indices(3), strict=True)
    return {f"inverse_{axes[i]}{axes[j]}": inverse[..., i, j] for i, j in pairs}


def vertical_accelerations(
    inertial: Sequence[Any], velocity: Sequence[Any], gravity: tuple[Any, Any], stern: Any,
    thrust: Any, c: Any,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Accelerations ``(...)`` of surge, heave [m/s2] and pitch [rad/s2].

    Lift is proportional to |u| and the fins' force to u |u|, so that both also brake a vehicle
    going astern.

    Args:
        inertial: Forces ahead and down [N] and pitch moment [N m] of the momentum in moving axes.
        velocity: Surge, heave [m/s] and pitch rate [rad/s].
        gravity: Components of a unit vector down: astern and down in body axes.
        stern: Stern plane [rad].
        thrust: Thrust [N].
        c: Coefficients of the equations of motion, by name.
    """
    (X, Z, M), (u, w, q), (astern, down) = inertial, velocity, gravity
    U, W, Q = np.abs(u), w * np.abs(w), q * np.abs(q)
    inflow = u * U
    X = X - c.net_weight * astern + c.X_uu * inflow + thrust
    Z = (
        Z + c.net_weight * down + c.Z_ww * W + c.Z_qq * Q
        + U * (c.Z_uw * w + c.Z_uq * q) + c.Z_uuds * inflow * stern
    )  # fmt: skip
    M = (
        M - c.righting_moment * astern + c.M_ww * W + c.M_qq * Q
        + U * (c.M_uw * w + c.M_uq * q) + c.M_uuds * inflow * stern
    )  # fmt: skip
    return (
        c.inverse_uu * X + c.inverse_uw * Z + c.inverse_uq * M,
        c.inverse_uw * X + c.inverse_ww * Z + c.inverse_wq * M,
        c.inverse_uq * X + c.inverse_wq * Z + c.inverse_qq * M,
    )


@compiled
@dataclass(frozen=True)
class AUV(SimulatedVehicle):
    """A torpedo-shaped vehicle in batches: actuators, state, sensors, and filters' model.

    The state is velocities through the water, then position and Euler angles. Increments [m/s,
    rad/s] change the velocities at the end of a step, and a current [m/s] carries the vehicle over
    the step. Actuators are fin angles [rad], then thrust [N]. Filters estimate the whole state;
    their known input is ``u = (actuators before, actuators after)``. Figures of the sensors are
    from public vehicle configurations.
    """

    body: AUVParameters
    dt: float = 0.1  # s, the papers' control rate
    substeps: int = 2

    @property
    def steering(self) -> tuple[int, ...]:
        """Indices of the fins among the actuators."""
        return tuple(range(len(self.action_names) - 1))

    @cached_property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """Level at cruise speed with centred fins, the start of a dive.

        The motion is steady only for a vehicle in trim.
        """
        x, still = np.zeros(len(self.state_names)), np.zeros(len(self.action_names))
        x[0], still[-1] = self.body.cruise_speed, self.body.cruise_thrust
        return x, np.concatenate([still, still])

    @cached_property
    def _actuators(self) -> np.ndarray:
        """Fins with rate limits, thrust with a lag; action -1 stops the propeller."""
        body = self.body
        fin = Actuator(body.fin_limit, body.fin_limit, turn=body.fin_rate * self.dt)
        half, lag = 0.5 * body.thrust_limit, np.exp(-self.dt / body.thrust_lag)
        thrust = Actuator(half, half, offset=1.0, lag=lag)
        return np.array([*[fin] * (len(self.action_names) - 1), thrust])
