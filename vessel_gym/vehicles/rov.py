"""Remotely operated vehicles: a rigid body in six degrees of freedom, moved by thrusters alone (kind = "rov").

Frames: North-East-Down, body x forward, y starboard, z down, origin at the centre of gravity. Body, added mass and
damping are symmetric about the body's planes, so inertia and damping are diagonal.

Sources: Fossen (2011), chapters 6 to 8, for the equations and the allocation of thrusters; von Benzon et al. (2022)
for the diagonal model of a BlueROV2 Heavy (data/bluerov2-heavy.toml).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from estimators.engine import compiled
from vessel_gym.vehicles.actuators import Actuator, actuator_parameters
from vessel_gym.vehicles.files import FromFile, Particulars, load
from vessel_gym.vehicles.segorogeni import STATE, Segorogeni, attitude, kinematics
from vessel_gym.vehicles.whole_state import WholeState

ADDED_MASS = ("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot")
LINEAR = ("X_u", "Y_v", "Z_w", "K_p", "M_q", "N_r")
QUADRATIC = ("X_uu", "Y_vv", "Z_ww", "K_pp", "M_qq", "N_rr")
UNCERTAIN = ADDED_MASS + LINEAR + QUADRATIC
"""Coefficients that `mismatch` spreads, each on its own."""
COEFFICIENTS = (*(f"inertia of {name}" for name in STATE[:6]), *LINEAR, *QUADRATIC, "net_weight", "righting_moment")
"""Components of the coefficients' vector; an inertia is that of body and added mass."""


@dataclass(frozen=True, kw_only=True)
class ROVParameters(Particulars):
    """Particulars of a vehicle with thrusters, SI units: what a vehicle file gives, each number there with its source.

    Coefficients have the signs of SNAME (1950), so those that resist the motion are negative.
    """

    mass: float  # kg
    roll_inertia: float  # kg m2, this and the next two about the centre of gravity
    pitch_inertia: float
    yaw_inertia: float
    z_g: float  # m, centre of gravity below the centre of buoyancy
    buoyancy_excess: float = 0.0  # N, buoyancy less weight
    gravity: float = 9.81  # m/s2
    positions: tuple[tuple[float, float, float], ...]  # m, of each thruster from the centre of gravity
    directions: tuple[tuple[float, float, float], ...]  # of each thruster's force on the body, of any length
    thrust_limit: float  # N, of each thruster, either way
    thrust_lag: float = 0.1  # s, time constant of the thrust, assumed
    X_udot: float
    Y_vdot: float
    Z_wdot: float
    K_pdot: float
    M_qdot: float
    N_rdot: float
    X_u: float = 0.0
    Y_v: float = 0.0
    Z_w: float = 0.0
    K_p: float = 0.0
    M_q: float = 0.0
    N_r: float = 0.0
    X_uu: float
    Y_vv: float
    Z_ww: float
    K_pp: float
    M_qq: float
    N_rr: float

    TABLES: ClassVar = {
        "particulars": (
            "mass", "roll_inertia", "pitch_inertia", "yaw_inertia", "z_g", "buoyancy_excess", "gravity",
        ),
        "thrusters": ("positions", "directions", "thrust_limit", "thrust_lag"),
        "coefficients": UNCERTAIN,
    }  # fmt: skip

    @cached_property
    def allocation(self) -> np.ndarray:
        """Generalised force ``(6, n)`` of a unit of thrust of each thruster: the force, and its moment."""
        directions = np.array(self.directions)
        force = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.concatenate([force, np.cross(self.positions, force)], -1).T

    def vector(self, factors: np.ndarray | None = None) -> np.ndarray:
        """The coefficients of the equations of motion ``(..., 20)``, in the order of `COEFFICIENTS`.

        Args:
            factors: ``(..., 18)`` on the `UNCERTAIN` ones, 1 if not given.
        """
        factors = np.ones(len(UNCERTAIN)) if factors is None else factors
        c = np.array([getattr(self, name) for name in UNCERTAIN]) * factors
        body = (self.mass,) * 3 + (self.roll_inertia, self.pitch_inertia, self.yaw_inertia)
        righting = (self.mass * self.gravity + self.buoyancy_excess) * self.z_g
        still = np.broadcast_to((-self.buoyancy_excess, righting), (*c.shape[:-1], 2))
        return np.concatenate([body - c[..., :6], c[..., 6:], still], -1)

    def mistakes(self) -> Iterator[tuple[str, str]]:
        """Mistakes that no such vehicle has: the name of a number, and a sentence on it."""
        if len(self.positions) != len(self.directions):
            yield "directions", f"{len(self.positions)} thrusters have no {len(self.directions)} directions"
        if not all(map(any, self.directions)):
            yield "directions", "the direction of a thruster must not be (0, 0, 0)"
        if self.mass * self.gravity + self.buoyancy_excess <= 0.0:
            yield "buoyancy_excess", f"{-self.buoyancy_excess:g} N are more than the weight: it displaces no water"


@compiled
def rov_rates(state: np.ndarray, force: np.ndarray, current: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Rates ``(..., 12)`` of the velocities through the water, then of position and Euler angles.

    Kirchhoff's equations of the momentum of body and water, which is theirs in body axes, with damping.

    Args:
        state: ``(..., 12)``, `STATE`.
        force: Generalised force of the thrusters ``(..., 6)``.
        current: North and east ``(..., 2)``.
        c: ``(..., 20)``, `COEFFICIENTS`.
    """
    velocity, angles = [state[..., i] for i in range(6)], attitude(state)
    u, v, w, p, q, r = velocity
    inertia = [c[..., i] for i in range(6)]
    Px, Py, Pz, Lx, Ly, Lz = (m * x for m, x in zip(inertia, velocity, strict=True))
    (sin_phi, cos_phi), (sin_theta, cos_theta), _ = angles
    weight, righting = c[..., 18], c[..., 19]
    turning = (
        Py * r - Pz * q - weight * sin_theta,
        Pz * p - Px * r + weight * cos_theta * sin_phi,
        Px * q - Py * p + weight * cos_theta * cos_phi,
        Ly * r - Lz * q + Py * w - Pz * v - righting * cos_theta * sin_phi,
        Lz * p - Lx * r + Pz * u - Px * w - righting * sin_theta,
        Lx * q - Ly * p + Px * v - Py * u,
    )
    accelerations = [
        (turning[i] + (c[..., 6 + i] + c[..., 12 + i] * np.abs(x)) * x + force[..., i]) / inertia[i]
        for i, x in enumerate(velocity)
    ]
    return np.stack([*accelerations, *kinematics(velocity, angles, current)], -1)


@dataclass(frozen=True)
class ROV(FromFile, WholeState, verified=True):
    """A vehicle with thrusters in batches, with the state, the sensors and the water of `Segorogeni`.

    An action is the thrust of each thruster as a share of its limit. Filters estimate the whole state; their known
    input is the thrusts before and after a step.
    """

    body: ROVParameters = field(default_factory=lambda: load("bluerov2-heavy", ROVParameters))
    dt: float = 0.1  # s
    substeps: int = 2

    state_names: ClassVar = STATE
    equations: ClassVar = staticmethod(rov_rates)
    parameter_names: ClassVar = COEFFICIENTS
    angles: ClassVar = Segorogeni.angles
    incremented: ClassVar = STATE[:6]
    ambient_flows: ClassVar = Segorogeni.ambient_flows
    rates: ClassVar = Segorogeni.rates
    sensors: ClassVar = Segorogeni.sensors
    grades: ClassVar[str] = "auv"
    normals: ClassVar = len(UNCERTAIN)

    @cached_property
    def action_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """The thrusters, numbered from 1."""
        return tuple(f"thruster {i + 1}" for i in range(len(self.body.positions)))

    @cached_property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """At rest without thrust."""
        return np.zeros(len(STATE)), np.zeros(2 * len(self.action_names))

    @cached_property
    def _actuators(self) -> np.ndarray:
        """Thrusts with their lag."""
        lag = float(np.exp(-self.dt / self.body.thrust_lag))
        return actuator_parameters(*(Actuator(self.body.thrust_limit, lag=lag),) * len(self.action_names))

    def moved(
        self, state: np.ndarray, before: np.ndarray, after: np.ndarray, flow: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """The state one step later, without increments."""
        allocation = self.body.allocation
        return super().moved(state, np.matvec(allocation, before), np.matvec(allocation, after), flow, parameters)
