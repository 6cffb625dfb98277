"""Remotely operated vehicles: rigid bodies in six degrees of freedom with thrusters.

Frames: north-east-down; body x forward, y starboard, z down, origin at the centre of gravity. Body,
added mass and damping are symmetric about the body's planes, so inertia and damping are diagonal.
Any attitude is possible: a step moves a quaternion, and states have Euler angles.

Sources: Fossen (2011), chapters 2 and 6 to 8, for the equations and the allocation of thrusters;
von Benzon et al. (2022) for the diagonal model of a BlueROV2 Heavy (data/bluerov2-heavy.toml).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from estimators.angles import ahead_and_aside
from estimators.engine import compiled, sincos
from vessel_gym.vehicles.files import Particulars, load
from vessel_gym.vehicles.segorogeni import STATE, Segorogeni, coriolis
from vessel_gym.vehicles.simulated import Actuator, SimulatedVehicle

ADDED_MASS = ("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot")
LINEAR = ("X_u", "Y_v", "Z_w", "K_p", "M_q", "N_r")
QUADRATIC = ("X_uu", "Y_vv", "Z_ww", "K_pp", "M_qq", "N_rr")
UNCERTAIN = ADDED_MASS + LINEAR + QUADRATIC
"""Coefficients that `mismatch` spreads, each by a factor of its own."""
_NOMINAL = np.ones(len(UNCERTAIN))
COEFFICIENTS = (
    *(f"inertia of {name}" for name in STATE[:6]),
    *LINEAR,
    *QUADRATIC,
    "net_weight",
    "righting_moment",
)
"""Components of the coefficients' vector; an inertia includes added mass."""


@dataclass(frozen=True, kw_only=True)
class ROVParameters(Particulars):
    """Particulars of a vehicle with thrusters in SI units: the content of a vehicle file.

    A file states a source for each number. Coefficients have the signs of SNAME (1950), so those
    that resist the motion are negative.
    """

    mass: float  # kg
    roll_inertia: float  # kg m2, this and the next two about the centre of gravity
    pitch_inertia: float
    yaw_inertia: float
    z_g: float  # m, centre of gravity below the centre of buoyancy
    buoyancy_excess: float = 0.0  # N, buoyancy minus weight
    gravity: float = 9.81  # m/s2
    positions: tuple[
        tuple[float, float, float], ...
    ]  # m, positions of the thrusters relative to the centre of gravity
    directions: tuple[
        tuple[float, float, float], ...
    ]  # directions of the thrusters' forces on the body, of any length
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

    @cached_property
    def allocation(self) -> np.ndarray:
        """Force and moment ``(6, n)`` of a unit of thrust of each thruster."""
        directions = np.array(self.directions)
        force = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.concatenate([force, np.cross(self.positions, force)], -1).T

    def vector(self, factors: np.ndarray = _NOMINAL) -> np.ndarray:
        """Coefficients of the equations of motion ``(..., 20)``, in the order of `COEFFICIENTS`.

        Args:
            factors: Factors ``(..., 18)`` on the `UNCERTAIN` ones; default: 1.
        """
        c = np.array([getattr(self, name) for name in UNCERTAIN]) * factors
        body = (self.mass,) * 3 + (self.roll_inertia, self.pitch_inertia, self.yaw_inertia)
        righting = (self.mass * self.gravity + self.buoyancy_excess) * self.z_g
        still = np.broadcast_to((-self.buoyancy_excess, righting), (*c.shape[:-1], 2))
        return np.concatenate([body - c[..., :6], c[..., 6:], still], -1)

    def mistakes(self) -> Iterator[tuple[str, str]]:
        """Errors in the particulars: the name of a number, and a sentence."""
        if len(self.positions) != len(self.directions):
            yield (
                "directions",
                f"{len(self.positions)} thrusters have no {len(self.directions)} directions",
            )
        if not all(map(any, self.directions)):
            yield "directions", "the direction of a thruster must not be (0, 0, 0)"
        if self.mass * self.gravity + self.buoyancy_excess <= 0.0:
            yield (
                "buoyancy_excess",
                f"{-self.buoyancy_excess:g} N are more than the weight: it displaces no water",
            )


def _rotation(quaternion: Sequence[np.ndarray]) -> tuple[tuple[np.ndarray, ...], ...]:
    """Rows of the rotation matrix ``(3, 3)`` from body axes to north-east-down.

    Args:
        quaternion: Unit quaternion as four arrays ``(...)``, the real part first.
    """
    e0, e1, e2, e3 = quaternion
    return (
        (1.0 - 2.0 * (e2 * e2 + e3 * e3), 2.0 * (e1 * e2 - e3 * e0), 2.0 * (e1 * e3 + e2 * e0)),
        (2.0 * (e1 * e2 + e3 * e0), 1.0 - 2.0 * (e1 * e1 + e3 * e3), 2.0 * (e2 * e3 - e1 * e0)),
        (2.0 * (e1 * e3 - e2 * e0), 2.0 * (e2 * e3 + e1 * e0), 1.0 - 2.0 * (e1 * e1 + e2 * e2)),
    )


@compiled
def with_quaternion(state: np.ndarray) -> np.ndarray:
    """State `STATE` ``(..., 12)`` with a unit quaternion instead of Euler angles ``(..., 13)``."""
    (s1, c1), (s2, c2), (s3, c3) = (sincos(0.5 * state[..., i]) for i in (9, 10, 11))
    quaternion = (
        c1 * c2 * c3 + s1 * s2 * s3, s1 * c2 * c3 - c1 * s2 * s3,
        c1 * s2 * c3 + s1 * c2 * s3, c1 * c2 * s3 - s1 * s2 * c3,
    )  # fmt: skip
    return np.concatenate([state[..., :9], np.stack(quaternion, -1)], -1)


@compiled
def with_euler_angles(state: np.ndarray, near: np.ndarray) -> np.ndarray:
    """State `STATE` ``(..., 12)`` from a state with a quaternion ``(..., 13)``.

    The pitch is within 90 degrees. Roll and yaw are within half a turn of those in ``near (...,
    12)``, so that they do not jump by whole turns. As the vehicle passes the pole, at 90 degrees of
    pitch, both jump by half a turn, while the attitude is continuous.
    """
    quaternion = [state[..., i] for i in range(9, 13)]
    norm = np.sqrt(sum(e * e for e in quaternion))
    (_, north_y, north_z), (_, east_y, east_z), (down_x, down_y, down_z) = _rotation(
        [e / norm for e in quaternion]
    )
    cos_change, sin_change = ahead_and_aside(down_z, down_y, near[..., 9])
    at_pole = np.abs(sin_change) + np.abs(cos_change) < 1e-12  # any roll serves there: the old one
    phi = near[..., 9] + np.arctan2(sin_change, np.where(at_pole, 1e-12, cos_change))
    sin, cos = sincos(phi)
    theta = np.arctan2(-down_x, down_y * sin + down_z * cos)
    # The body's y axis, with the roll removed, is horizontal.
    sin_psi, cos_psi = north_z * sin - north_y * cos, east_y * cos - east_z * sin
    cos_change, sin_change = ahead_and_aside(cos_psi, sin_psi, near[..., 11])
    psi = near[..., 11] + np.arctan2(sin_change, cos_change)
    return np.concatenate([state[..., :9], np.stack([phi, theta, psi], -1)], -1)


@compiled
def rov_rates(
    state: np.ndarray, force: np.ndarray, current: np.ndarray, c: np.ndarray
) -> np.ndarray:
    """Rates ``(..., 13)`` of velocities through the water, position and attitude.

    Kirchhoff's equations in body axes, with damping. The attitude is a unit quaternion, which has
    no pole (Fossen 2011, sec. 2.2.2).

    Args:
        state: ``(..., 13)``, as of `with_quaternion`.
        force: Force and moment of the thrusters ``(..., 6)``.
        current: North and east [m/s] ``(..., 2)``.
        c: ``(..., 20)``, `COEFFICIENTS`.
    """
    velocity = [state[..., i] for i in range(6)]
    u, v, w, p, q, r = velocity
    e0, e1, e2, e3 = (state[..., i] for i in range(9, 13))
    inertia = [c[..., i] for i in range(6)]
    north, east, down = _rotation((e0, e1, e2, e3))
    weight, righting = c[..., 18], c[..., 19]
    X, Y, Z, K, M, N = coriolis([m * x for m, x in zip(inertia, velocity, strict=True)], velocity)
    turning = (
        X + weight * down[0], Y + weight * down[1], Z + weight * down[2],
        K - righting * down[1], M + righting * down[0], N,
    )  # fmt: skip
    accelerations = [
        (turning[i] + (c[..., 6 + i] + c[..., 12 + i] * np.abs(x)) * x + force[..., i]) / inertia[i]
        for i, x in enumerate(velocity)
    ]
    over_ground = [x * u + y * v + z * w for x, y, z in (north, east, down)]
    return np.stack([
        *accelerations,
        over_ground[0] + current[..., 0], over_ground[1] + current[..., 1], over_ground[2],
        -0.5 * (e1 * p + e2 * q + e3 * r), 0.5 * (e0 * p - e3 * q + e2 * r),
        0.5 * (e3 * p + e0 * q - e1 * r), 0.5 * (e1 * q - e2 * p + e0 * r),
    ], -1)  # fmt: skip


@compiled
@dataclass(frozen=True)
class ROV(SimulatedVehicle):
    """A vehicle with thrusters in batches; state, sensors and water are those of `Segorogeni`.

    An action is the thrust of each thruster as a share of its limit. Filters estimate the whole
    state; their known input is the thrusts before and after a step.
    """

    body: ROVParameters = field(default_factory=lambda: load("bluerov2-heavy", ROVParameters))
    dt: float = 0.1  # s
    substeps: int = 2

    state_names = STATE
    equations = staticmethod(rov_rates)
    parameter_names = COEFFICIENTS
    angles = Segorogeni.angles
    incremented = STATE[:6]
    ambient_flows = Segorogeni.ambient_flows
    rates = Segorogeni.rates
    sensors = Segorogeni.sensors
    grades = "auv"
    normals = len(UNCERTAIN)

    @cached_property
    def action_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """Thrusters, numbered from 1."""
        return tuple(f"thruster {i + 1}" for i in range(len(self.body.positions)))

    @cached_property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """At rest without thrust."""
        return np.zeros(len(STATE)), np.zeros(2 * len(self.action_names))

    @cached_property
    def _actuators(self) -> np.ndarray:
        """Thrusts with a lag."""
        limit, lag = self.body.thrust_limit, np.exp(-self.dt / self.body.thrust_lag)
        return np.array([Actuator(limit, limit, lag=lag)] * len(self.action_names))

    def moved(
        self,
        state: np.ndarray,
        before: np.ndarray,
        after: np.ndarray,
        flow: np.ndarray,
        parameters: np.ndarray,
    ) -> np.ndarray:
        """State one step later, without increments; the attitude moves as a quaternion."""
        before, after = (np.matvec(self.body.allocation, thrusts) for thrusts in (before, after))
        return with_euler_angles(
            super().moved(with_quaternion(state), before, after, flow, parameters), state
        )
