"""Underwater vehicles in surge, heave and pitch, such as the ITSUNUSA (data/itsunusa.toml).

Frames: x along the course, z down; body x forward and z down, origin at the centre of buoyancy. A
positive stern plane makes the vehicle dive, as in Prestero (2001).

Sources: the EnKF-SR paper on this vehicle (eqs. 1-3) for dimensions and structure, with its
misprints corrected: ``u^2 u^2`` is u^2 delta_s, ``z_C(q)``, ``x_C(-q)`` and ``z_C(u + wq)`` have
lost the dots of q and u, and the pitch moment is a difference, no fraction. The paper prints no
hydrodynamic coefficient. Prestero (2001) for the symbols; Fossen (2011) for Kirchhoff's equations
and the kinematics.
"""

from collections import namedtuple
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from estimators.engine import compiled, sincos
from vessel_gym.sensors import Sensor, plain
from vessel_gym.vehicles.auv import AUV, VERTICAL, AUVParameters, vertical_accelerations
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.simulated import root
from vessel_gym.vehicles.vehicle import Trims

STATE = ("u", "w", "q", "x", "z", "theta")
"""Components of the state.

They are velocities through the water [m/s], pitch rate [rad/s], position [m] and pitch [rad].
"""

Coefficients = namedtuple("Coefficients", (
    "surge_mass", "heave_mass", "pitch_inertia", "mass_z_g", "heave_pitch",
    "inverse_uu", "inverse_uw", "inverse_uq", "inverse_ww", "inverse_wq", "inverse_qq",
    "X_uu", "Z_ww", "Z_qq", "M_ww", "M_qq", "Z_uw", "Z_uq", "M_uw", "M_uq", "Z_uuds", "M_uuds",
    "net_weight", "righting_moment",
))  # fmt: skip
"""Coefficients of the equations of motion, in the order of their vector."""

COEFFICIENTS = Coefficients._fields


@dataclass(frozen=True)
class ItsunusaParameters(AUVParameters):
    """Particulars of a vehicle in the vertical plane, SI units."""

    names = COEFFICIENTS


@compiled
def itsunusa_rates(
    state: np.ndarray, control: np.ndarray, current: np.ndarray, coefficients: np.ndarray
) -> np.ndarray:
    """Rates ``(..., 6)`` by eqs. (1)-(3).

    Args:
        state: ``(..., 6)``, `STATE`.
        control: Stern plane [rad] and thrust [N] ``(..., 2)``.
        current: ``(..., 1)`` m/s.
        coefficients: ``(..., k)``, `COEFFICIENTS`.
    """
    u, w, q, _, _, theta = np.moveaxis(state, -1, 0)
    (stern, thrust), c = (
        np.moveaxis(control, -1, 0),
        Coefficients(*np.moveaxis(coefficients, -1, 0)),
    )
    sin_theta, cos_theta = sincos(theta)
    # Kirchhoff: the momentum of body and water contains the brackets and all added-mass terms of
    # the printed equations.
    Px = c.surge_mass * u + c.mass_z_g * q
    Pz = c.heave_mass * w + c.heave_pitch * q
    inertial = -Pz * q, Px * q, Pz * u - Px * w
    return np.stack([
        *vertical_accelerations(inertial, (u, w, q), (sin_theta, cos_theta), stern, thrust, c),
        u * cos_theta + w * sin_theta + current[..., 0], w * cos_theta - u * sin_theta, q,
    ], -1)  # fmt: skip


@compiled
def _over_ground(state: np.ndarray, exogenous: np.ndarray) -> np.ndarray:
    """Velocity over ground in body axes ``(..., 2)``."""
    current, (sin_theta, cos_theta) = exogenous[..., 3], sincos(state[..., 5])
    return state[..., :2] + np.stack([current * cos_theta, current * sin_theta], -1)


_STEEPEST, _TRIMS = np.deg2rad(45.0), 91
"""Steepest path of the linear model [rad], and number of steady motions from -45 to 45 degrees."""


@compiled
@dataclass(frozen=True)
class Itsunusa(AUV):
    """The ITSUNUSA in the vertical plane.

    The known input of filters is ``u = (actuators before, actuators after, commanded path angle,
    1)``. Linear filters use the steady dive along the commanded path, whose angle counts upwards.
    """

    body: ItsunusaParameters = field(default_factory=lambda: load("itsunusa", ItsunusaParameters))

    kinds = ("nonlinear", "steady dives")
    linear_kinds = ("steady dives",)
    state_names = STATE
    equations = staticmethod(itsunusa_rates)
    parameter_names = COEFFICIENTS
    action_names = ("stern plane", "thrust")
    angles = ("theta",)
    incremented = STATE[:3]
    ambient_flows = ("current",)
    rates = {"q": "theta"}
    sensors = (
        Sensor(
            "Doppler log", ("u over ground", "w over ground"), _over_ground, (0.01, 0.01),
            dropout=0.10, scale=(0.5, 0.25), gives=("u", "w"),
        ),
        Sensor("depth gauge", ("z",), plain((4,)), (0.02,), scale=(10.0,), gives=("z",)),
        Sensor(
            "inclinometer", ("theta",), plain((5,)), (0.01,),
            angles=(0,), scale=(0.5,), gives=("theta",),
        ),
        Sensor("gyroscope", ("q",), plain((2,)), (0.005,), scale=(0.5,), gives=("q",)),
        Sensor(
            "acoustic position", ("x",), plain((3,)), (0.5,), rate=0.5, dropout=0.10,
            scale=(20.0,), gives=("x",),
        ),
    )  # fmt: skip
    grades = "auv"
    normals = VERTICAL

    @cached_property
    def cruise(self) -> tuple[np.ndarray, np.ndarray]:
        """Level at cruise speed, with centred fins."""
        x, u = super().cruise
        return x, np.concatenate([u, [0.0, 1.0]])

    def known_input(
        self, before: np.ndarray, after: np.ndarray, commanded: np.ndarray | None
    ) -> np.ndarray:
        """Actuators at the start and the end of a step, commanded path angle, and 1.

        Without a command the path angle is 0.
        """
        level = np.zeros_like(before[..., :1])
        return np.concatenate(
            [before, after, level if commanded is None else commanded, level + 1.0], -1
        )

    def linear(self, kind: str) -> Trims:
        """Steady dives along straight paths, at cruise speed."""
        return self._dives

    @cached_property
    def _dives(self) -> Trims:
        speed, c = self.body.cruise_speed, self.body.vector()
        angles = np.linspace(-_STEEPEST, _STEEPEST, _TRIMS)

        def state(z: np.ndarray) -> np.ndarray:
            zero = np.zeros_like(z[..., 0])
            return np.stack([zero + speed, z[..., 0], zero, zero, zero, z[..., 1]], -1)

        def residual(z: np.ndarray, angle: np.ndarray) -> np.ndarray:
            """Accelerations, and error of the path angle; ``z``: heave, pitch, actuators."""
            rates = itsunusa_rates(state(z), z[..., 2:], np.zeros(1), c)
            error = z[..., 1:2] - np.arctan2(z[..., :1], speed) - angle
            return np.concatenate([rates[..., :3], error], -1)

        level = np.array([0.0, 0.0, 0.0, self.body.cruise_thrust])
        dives = root(residual, np.tile(level, (_TRIMS, 1)), angles[:, None])
        x = state(dives)
        u = np.column_stack([dives[:, 2:], dives[:, 2:], angles, np.ones(_TRIMS)])
        return Trims(x, u, 4, (_TRIMS - 1) / (2.0 * _STEEPEST), 0.5 * _TRIMS)
