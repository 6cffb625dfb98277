"""Manoeuvring model of a measured ship: surge, sway and yaw, in four quadrants and at low speed.

Its form is that of the MMG (Manoeuvring Modelling Group).

Frames: x0 north, y0 east, psi clockwise from x0; body x forward, y starboard, origin amidships; positive rudder turns
the ship to starboard. Velocities are over ground. The state is `STATE`, the control `CONTROL`, what is around `AIR`.

Sources: Yasukawa & Yoshimura (2015), J. Mar. Sci. Technol. 20:37, for the structure (the MMG standard method), and for
a rudder of which the propeller's slipstream meets a part; Hirano (1980), J. Soc. Nav. Archit. Jpn. 147:144, for a wake
that shrinks with the drift at the stern. Here only the rudder's wake does, and ``eps`` is the share of the ship's speed
at the rudder instead of the ratio of both wakes, so that it does not scale the slipstream. Further:
Yoshimura, Nakao & Ishibashi (2009), MARSIM, for the cross-flow drag of the hull at any drift angle; Clarke, Gedling &
Hine (1983) for what is assumed of the linear derivatives; Fujii & Tuda (1961) for the rudder; Motora (1959), as read by
Clarke's regression, for added masses; Fujiwara, Ueno & Nimura (1998) for the harmonics of the wind loads.
"""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from estimators.engine import compiled, jacobian, sincos

STATE = ("x", "y", "psi", "u", "v", "r")
"""Position [m], heading [rad], velocity over ground forward and to starboard [m/s], yaw rate [rad/s]."""
CONTROL = ("rudder", "revolutions")
"""Rudder [rad], propeller revolutions [1/s], negative astern."""
AIR = ("wind x", "wind y", "slow wind x", "slow wind y")
"""Where the true wind comes from [m/s], along x0 and y0; the slow wind is its mean over minutes, which moves the
surface of the water."""

_WATER, _AIR = 1000.0, 1.2
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(7)


class Coefficient(NamedTuple):
    """Symbol, what is assumed of it before any log (mean and standard deviation), meaning."""

    symbol: str
    mean: float
    sd: float
    meaning: str


_NAN = float("nan")
_TABLE = (
    Coefficient("mx", 0.05, 0.03, "added mass in surge, share of the mass"),
    Coefficient("my", _NAN, 0.3, "added mass in sway, share of the mass"),
    Coefficient("Jz", _NAN, 0.5, "added moment of inertia in yaw, share of the moment of inertia"),
    Coefficient("ma", 0.0, 0.02, "added mass between sway and yaw, share of mass times length"),
    Coefficient("R0", 0.022, 0.01, "resistance ahead"),
    Coefficient("Ra", 0.03, 0.02, "resistance astern"),
    Coefficient("Rl", 0.0, 0.002, "resistance linear in the speed, over 1 m/s"),
    Coefficient("Xvv", 0.0, 0.1, "surge force of drift"),
    Coefficient("Xvr", 0.0, 0.15, "surge force of drift and turning, beyond the centripetal one"),
    Coefficient("Xrr", 0.0, 0.05, "surge force of turning"),
    Coefficient("Yv", _NAN, 0.4, "sway force of drift"),
    Coefficient("Yr", _NAN, 1.4, "sway force of turning"),
    Coefficient("Nv", _NAN, 0.4, "yaw moment of drift"),
    Coefficient("Nr", _NAN, 0.6, "yaw moment of turning"),
    Coefficient("CD", 0.6, 0.4, "cross-flow drag"),
    Coefficient("CrY", 1.0, 0.5, "share of turning in the cross flow of the sway force"),
    Coefficient("CrN", 1.0, 0.5, "share of turning in the cross flow of the yaw moment"),
    Coefficient("k0", 0.3, 0.1, "thrust ahead at rest, thrust deduction included"),
    Coefficient("k1", -0.18, 0.14, "thrust ahead, linear in the advance ratio"),
    Coefficient("k2", -0.03, 0.06, "thrust, quadratic in the advance ratio"),
    Coefficient("kb0", 0.2, 0.1, "thrust astern at rest"),
    Coefficient("kb1", 0.14, 0.14, "thrust astern, linear in the advance ratio"),
    Coefficient("Yn", 0.0, 0.03, "sway force of the propeller ahead"),
    Coefficient("Nn", 0.0, 0.015, "yaw moment of the propeller ahead"),
    Coefficient("Ynb", 0.0, 0.1, "sway force of the propeller astern"),
    Coefficient("Nnb", 0.0, 0.05, "yaw moment of the propeller astern"),
    Coefficient("Ynub", 0.0, 0.1, "sway force of the propeller astern, linear in the advance ratio"),
    Coefficient("Nnub", 0.0, 0.05, "yaw moment of the propeller astern, linear in the advance ratio"),
    Coefficient("eps", 0.7, 0.3, "share of the speed that reaches the rudder on a straight course"),
    Coefficient("kappa", 0.5, 0.25, "acceleration of the slipstream at the rudder, share of that far behind"),
    Coefficient("kapb", 0.0, 0.03, "flow that the propeller astern adds at the rudder"),
    Coefficient("gp", 0.4, 0.2, "flow straightening, side flow from starboard"),
    Coefficient("gm", 0.4, 0.2, "flow straightening, side flow from port"),
    Coefficient("lr", 0.7, 0.3, "lever of the yaw rate in the rudder's side flow, share of the length"),
    Coefficient("tR", 0.3, 0.15, "share of the rudder's drag that the hull recovers"),
    Coefficient("aH", 0.3, 0.2, "sway force of the hull over that of the rudder"),
    Coefficient("xN", 0.55, 0.15, "lever of the rudder's yaw moment, share of the length"),
    Coefficient("d0", 0.0, 0.03, "rudder angle that is not recorded [rad]"),
    Coefficient("kc", 0.0, 0.03, "drift of the water's surface over the slow wind"),
    Coefficient("cx0", 0.0, 0.3, "surge load of the wind, constant"),
    Coefficient("cx1", 0.6, 0.4, "surge load of the wind, first harmonic"),
    Coefficient("cx3", 0.0, 0.3, "surge load of the wind, third harmonic"),
    Coefficient("cy1", 0.8, 0.4, "sway load of the wind, first harmonic"),
    Coefficient("cy3", 0.0, 0.3, "sway load of the wind, third harmonic"),
    Coefficient("cn1", 0.0, 0.1, "yaw load of the wind, first harmonic"),
    Coefficient("cn2", 0.1, 0.1, "yaw load of the wind, second harmonic"),
    Coefficient("cn3", 0.0, 0.05, "yaw load of the wind, third harmonic"),
)
"""Where the mean is NaN, it follows from the particulars (Clarke et al. 1983), and the deviation is a share of it."""
COEFFICIENTS = tuple(each.symbol for each in _TABLE)
C: Any = SimpleNamespace(**{symbol: i for i, symbol in enumerate(COEFFICIENTS)})
"""Index of each coefficient."""


@dataclass(frozen=True)
class Particulars:
    """Particulars of a ship, known without a trial, SI units.

    Attributes:
        length: Between perpendiculars [m].
        beam: [m].
        draught: [m].
        mass: [kg].
        x_g: Centre of gravity forward of amidships [m].
        yaw_radius: Radius of gyration in yaw, as a share of the length.
        propeller_diameter: [m].
        rudder_area: [m2].
        rudder_aspect: Height over chord of the rudder.
        rudder_limit: Largest rudder angle [rad].
        frontal_area: Above the water [m2].
        lateral_area: Likewise [m2].
        water_density: [kg/m3].
    """

    length: float
    beam: float
    draught: float
    mass: float
    propeller_diameter: float
    rudder_area: float
    x_g: float = 0.0
    yaw_radius: float = 0.25
    rudder_aspect: float = 1.5
    rudder_limit: float = np.deg2rad(35.0)
    frontal_area: float = 0.0
    lateral_area: float = 0.0
    water_density: float = _WATER

    def vector(self) -> np.ndarray:
        """In the order of `_P`, the constants of the equations of motion."""
        lift = 6.13 * self.rudder_aspect / (self.rudder_aspect + 2.25)  # Fujii & Tuda (1961)
        hull = 0.5 * self.water_density * self.length * self.draught
        rudder = 0.5 * self.water_density * self.rudder_area * lift
        inertia = self.mass * (self.yaw_radius * self.length) ** 2
        air = 0.5 * _AIR
        return np.array([
            self.length, self.mass, self.x_g, inertia, hull, self.water_density * self.propeller_diameter**4,
            self.propeller_diameter, rudder, air * self.frontal_area, air * self.lateral_area,
            min(1.0, self.propeller_diameter / np.sqrt(self.rudder_area * self.rudder_aspect)),
        ])  # fmt: skip

    @cached_property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """The coefficients of the model, with what is assumed of them for a ship of these particulars.

        Hull coefficients are made non-dimensional with rho / 2 L d (moments with L more) and velocities, propeller
        coefficients with rho D^4 and velocities n D, wind loads with the areas and the length.
        """
        slender, deep = np.pi * (self.draught / self.length) ** 2, self.draught / self.length
        block = self.mass / (self.water_density * self.length * self.beam * self.draught)
        wide, fine = self.beam / self.draught, self.beam / self.length
        prime = self.mass / (0.5 * self.water_density * self.length**3)
        sway = slender * (1 + 0.16 * block * wide - 5.1 * fine**2) / prime
        yaw = slender * (1 / 12 + 0.017 * block * wide - 0.33 * fine) / (prime * self.yaw_radius**2)
        Yv = -slender * (1 + 0.40 * block * wide) / deep
        Yr = -slender * (-1 / 2 + 2.2 * fine - 0.080 * wide) / deep
        Nv = -slender * (1 / 2 + 2.4 * deep) / deep
        Nr = -slender * (1 / 4 + 0.039 * wide - 0.56 * fine) / deep
        known = {"my": sway, "Jz": yaw, "Yv": Yv, "Yr": Yr, "Nv": Nv, "Nr": Nr}
        return tuple(
            each._replace(mean=known[each.symbol], sd=each.sd * abs(known[each.symbol]))
            if each.symbol in known
            else each
            for each in _TABLE
        )


_P = IntEnum("_P", (
    "length", "mass", "x_g", "inertia", "hull", "propeller", "diameter", "rudder", "frontal", "lateral", "slipstream",
), start=0)  # fmt: skip
WIND = (C.kc, C.cx0, C.cx1, C.cx3, C.cy1, C.cy3, C.cn1, C.cn2, C.cn3)
"""The coefficients that only a log with the wind can determine."""


def _hull(u: np.ndarray, v: np.ndarray, r: np.ndarray, c: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, ...]:
    """Surge and sway force, yaw moment of the hull; cross-flow drag by Gauss' quadrature along the length."""
    speed, turning = np.abs(u), p[_P.length] * r
    resistance = np.where(u > 0.0, c[C.R0], c[C.Ra])
    X = (
        -resistance * u * speed - c[C.Rl] * u
        + c[C.Xvv] * v * v + c[C.Xvr] * v * turning + c[C.Xrr] * turning * turning
    )  # fmt: skip
    sway = yaw = 0.0
    for node, weight in zip(0.5 * _NODES, 0.5 * _WEIGHTS, strict=True):
        flow_Y, flow_N = v + c[C.CrY] * turning * node, v + c[C.CrN] * turning * node
        sway = sway + weight * np.abs(flow_Y) * flow_Y
        yaw = yaw + weight * node * np.abs(flow_N) * flow_N
    Y = c[C.Yv] * speed * v + c[C.Yr] * u * turning - c[C.CD] * sway
    N = c[C.Nv] * u * v + c[C.Nr] * speed * turning - c[C.CD] * yaw
    return p[_P.hull] * X, p[_P.hull] * Y, p[_P.hull] * p[_P.length] * N


def _propeller(
    u: np.ndarray, n: np.ndarray, c: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Thrust, sway force, yaw moment, and the thrust ahead over rho D^2 [m2/s2]."""
    square, advance = n * n, u / p[_P.diameter]
    drag = c[C.k2] * advance * np.abs(advance)
    ahead, forward = n > 0.0, c[C.k0] * square + c[C.k1] * n * advance + drag
    astern = -c[C.kb0] * square + c[C.kb1] * n * advance + drag
    sway = np.where(ahead, c[C.Yn] * square, c[C.Ynb] * square + c[C.Ynub] * n * advance)
    yaw = np.where(ahead, c[C.Nn] * square, c[C.Nnb] * square + c[C.Nnub] * n * advance)
    k = p[_P.propeller]
    race = np.maximum(forward, 0.0) * p[_P.diameter] * p[_P.diameter]
    return k * np.where(ahead, forward, astern), k * sway, k * p[_P.length] * yaw, race


def _rudder(
    u: np.ndarray, v: np.ndarray, r: np.ndarray, control: tuple[np.ndarray, np.ndarray], race: np.ndarray,
    c: np.ndarray, p: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Surge and sway force, yaw moment of a rudder that stands partly in the slipstream."""
    rudder, n = control
    stern = v - 0.5 * p[_P.length] * r
    wake = (1.0 - c[C.eps]) * np.exp(-4.0 * stern * stern / (u * u + v * v + 1e-4))  # finite at rest
    along, share = (1.0 - wake) * u, p[_P.slipstream]
    outside, far = along * along, np.sqrt(along * along + (8.0 / np.pi) * race + 1e-8)
    jet = np.abs(along) + c[C.kappa] * (far - np.abs(along))
    astern = c[C.kapb] * n * n * p[_P.diameter] * p[_P.diameter] + outside
    square = np.where(n > 0.0, share * jet * jet + (1.0 - share) * outside, astern)
    inflow = np.sqrt(np.maximum(square, 0.0) + 1e-8)  # the derivative at rest is finite
    across = v - c[C.lr] * p[_P.length] * r
    side = np.where(across > 0.0, c[C.gp], c[C.gm]) * across
    sin, cos = sincos(rudder + c[C.d0])
    force = p[_P.rudder] * np.sqrt(inflow * inflow + side * side) * (inflow * sin + side * cos)
    lateral = (1.0 + c[C.aH]) * force * cos
    return -(1.0 - c[C.tR]) * force * sin, -lateral, c[C.xN] * p[_P.length] * lateral


def _wind(ahead: np.ndarray, abeam: np.ndarray, c: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, ...]:
    """Surge and sway force, yaw moment of the relative wind, which comes from ahead and abeam (to starboard)."""
    square = ahead * ahead + abeam * abeam
    speed = np.sqrt(square + 1e-6)  # the derivative in a calm is finite
    cos3 = 4.0 * ahead * ahead * ahead / speed - 3.0 * ahead * speed
    sin3 = 3.0 * abeam * speed - 4.0 * abeam * abeam * abeam / speed
    X = c[C.cx0] * square + c[C.cx1] * ahead * speed + c[C.cx3] * cos3
    Y = c[C.cy1] * abeam * speed + c[C.cy3] * sin3
    N = c[C.cn1] * abeam * speed + c[C.cn2] * 2.0 * ahead * abeam + c[C.cn3] * sin3
    return -p[_P.frontal] * X, -p[_P.lateral] * Y, -p[_P.lateral] * p[_P.length] * N


def _rates(state: np.ndarray, control: np.ndarray, air: np.ndarray, c: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Rates ``(..., 6)`` of `STATE`; see `rates`."""
    (_, _, psi, u, v, r), (rudder, n) = np.moveaxis(state, -1, 0), np.moveaxis(control, -1, 0)
    (wind_x, wind_y, slow_x, slow_y), c, p = (np.moveaxis(a, -1, 0) for a in (air, c, p))
    sin, cos = sincos(psi)
    carried, across = -c[C.kc] * (slow_x * cos + slow_y * sin), -c[C.kc] * (slow_y * cos - slow_x * sin)
    u_w, v_w = u - carried, v - across  # through the water
    X, Y, N = _hull(u_w, v_w, r, c, p)
    thrust, side, twist, race = _propeller(u_w, n, c, p)
    steering = _rudder(u_w, v_w, r, (rudder, n), race, c, p)
    load = _wind(u + wind_x * cos + wind_y * sin, v + wind_y * cos - wind_x * sin, c, p)
    X, Y, N = X + thrust + steering[0] + load[0], Y + side + steering[1] + load[1], N + twist + steering[2] + load[2]
    m, off = p[_P.mass], p[_P.mass] * p[_P.x_g]
    surge, sway, coupled = m * (1.0 + c[C.mx]), m * (1.0 + c[C.my]), off + c[C.ma] * m * p[_P.length]
    yaw = p[_P.inertia] * (1.0 + c[C.Jz]) + off * p[_P.x_g]
    X, Y, N = X + sway * v_w * r + coupled * r * r, Y - surge * u_w * r, N - off * u_w * r
    determinant = sway * yaw - coupled * coupled
    return np.stack([
        u * cos - v * sin, u * sin + v * cos, r,
        X / surge + r * across, (yaw * Y - coupled * N) / determinant - r * carried,
        (sway * N - coupled * Y) / determinant,
    ], -1)  # fmt: skip


def _rates_and_slopes(
    state: np.ndarray, control: np.ndarray, air: np.ndarray, c: np.ndarray, p: np.ndarray
) -> np.ndarray:
    """``(..., 6, 1 + 6 + k)``: rates, their derivatives by the state, and by the coefficients."""
    rate = _rates(state, control, air, c, p)
    return np.concatenate([rate[..., None], jacobian(rate, state), jacobian(rate, c)], -1)


rates = compiled(_rates)
"""Rates ``(..., 6)`` of `STATE` from state ``(..., 6)``, control ``(..., 2)``, air ``(..., 4)``, coefficients
``(..., k)`` and `Particulars.vector` ``(..., 11)``."""
rates_and_slopes = compiled(_rates_and_slopes)
"""Those ``(..., 6, 1 + 6 + k)`` with the exact derivatives by the state and by the coefficients."""
