"""Published vehicles given as files manoeuvre as their published equations do: a cargo ship and an underwater vehicle.

Trial figures measured on either are not in our sources in print. So the reference is the full
published model of each, written down here from print and integrated on its own: other terms,
another solver, nothing of the package but the geometry of a recorded track.
"""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from manoeuvres import (
    DEG,
    Rates,
    Turn,
    ahead,
    figures,
    helmed,
    overshoots,
    rates_of,
    turning_circle,
)
from nomoto_models import nomoto_linear
from scipy.integrate import solve_ivp
from stepping import segorogeni_step

from vessel_gym.vehicles.files import load

# --- the Mariner class ----------------------------------------------------------------------------

MARINER = load("mariner")
L, U0 = MARINER.length, MARINER.speed

PRINTED = {
    "m": 798, "Iz": 39.2, "Xudot": -42, "Yvdot": -748, "Yrdot": -9.354, "Nvdot": 4.646, "Nrdot": -43.8,
    "Xu": -184, "Xuu": -110, "Xuuu": -215, "Xvv": -899, "Xrr": 18, "Xrv": 798, "Xdd": -95, "Xudd": -190, "Xvd": 93,
    "Xuvd": 93,
    "Yv": -1160, "Yr": -499, "Yvvv": -8078, "Yvvr": 15356, "Yvu": -1160, "Yru": -499, "Yd": 278, "Yddd": -90,
    "Yud": 556, "Yuud": 278, "Yvdd": -4, "Yvvd": 1190, "Y0": -4, "Y0u": -8, "Y0uu": -4,
    "Nv": -264, "Nr": -166, "Nvvv": 1636, "Nvvr": -5483, "Nvu": -264, "Nru": -166, "Nd": -139, "Nddd": 45,
    "Nud": -278, "Nuud": -139, "Nvdd": 13, "Nvvd": -489, "N0": 3, "N0u": 6, "N0uu": 3,
}  # fmt: skip
"""Chislett & Strom-Tejsen (1965), times 1e5; x_g' is -0.023. Rudder to port positive."""
P = {name: 1e-5 * value for name, value in PRINTED.items()}

State = np.ndarray


def polynomial(state: State, rudder: float, instantaneous: bool) -> State:
    """The printed model: rates of (x, y, psi, u, v, r) with the rudder to starboard positive.

    The printed perturbations are made non-dimensional with the speed. That all terms in the change
    of speed are those of u v, u r and u^2 delta about U0 (Yvu = Yv, Yud = 2 Yd, Yuud = Yd, Y0u = 2
    Y0 ...) means the constant U0: then forces go with the square of the speed. Fossen's mariner.m
    takes the instantaneous speed and so counts a loss of speed twice.
    """
    _, _, psi, surge, sway, yaw = state
    speed = np.hypot(surge, sway) if instantaneous else U0
    u, v, r, d, x_g = (surge - U0) / speed, sway / speed, yaw * L / speed, -rudder, -0.023
    terms = {
        "u": u, "uu": u**2, "uuu": u**3, "v": v, "r": r, "vv": v**2, "rr": r**2, "rv": r * v, "dd": d**2,
        "udd": u * d**2, "vd": v * d, "uvd": u * v * d, "vvv": v**3, "vvr": v**2 * r, "vu": v * u, "ru": r * u, "d": d,
        "ddd": d**3, "ud": u * d, "uud": u**2 * d, "vdd": v * d**2, "vvd": v**2 * d, "0": 1.0, "0u": u, "0uu": u**2,
    }  # fmt: skip
    X, Y, N = (
        sum(P.get(axis + name, 0.0) * value for name, value in terms.items()) for axis in "XYN"
    )
    inertia = [
        [P["m"] - P["Yvdot"], P["m"] * x_g - P["Yrdot"]],
        [P["m"] * x_g - P["Nvdot"], P["Iz"] - P["Nrdot"]],
    ]
    sideways, turning = np.linalg.solve(inertia, [Y, N])
    unit = speed**2 / L
    return np.array([
        surge * np.cos(psi) - sway * np.sin(psi), surge * np.sin(psi) + sway * np.cos(psi), yaw,
        X / (P["m"] - P["Xudot"]) * unit, sideways * unit, turning * unit / L,
    ])  # fmt: skip


MIRROR = np.array([1, -1, -1, 1, -1, -1])


def symmetric(state: State, rudder: float) -> State:
    """The printed model, the mean of it and its mirror image: a ship of twin screws, as all of ours are."""
    mirrored = MIRROR * polynomial(MIRROR * state, -rudder, False)
    return 0.5 * (polynomial(state, rudder, False) + mirrored)


START = ahead(U0)
OURS = rates_of(MARINER)


@cache
def circle(rates: Rates, degrees: float) -> Turn:
    return turning_circle(rates, U0, degrees)[0]


@cache
def swings(rates: Rates, degrees: float) -> tuple[float, float]:
    """First and second overshoot of a zig-zag [deg]."""
    return overshoots(rates, U0, degrees)


def test_mariner_reference_gives_fossens_turning_circle():
    """Fossen (2011), section 12.2: mariner.m at -15 deg after 100 s ahead; radius 711 m, advance 943 m.

    Read as he reads it. It says that the coefficients here are the printed ones.
    """

    def as_fossen(state: State, rudder: float) -> State:
        return polynomial(state, rudder, True)

    straight, _ = helmed(as_fossen, START, 0.0, 0.0, 100.0)
    turn, _ = helmed(as_fossen, straight.y[:, -1], 0.0, -15.0 * DEG, 900.0)
    u, v, r = turn.y[3:, -1]
    assert np.hypot(u, v) / abs(r) == pytest.approx(711.0, abs=0.5)
    time = np.arange(0.0, 900.0, 0.1)
    x, _, psi = turn.sol(time)[:3]
    advance = x[np.argmax(psi <= -0.5 * np.pi)] - x[0]
    assert advance == pytest.approx(943.0, abs=5.0)  # his rudder moves otherwise, by Euler's method


def test_the_linear_mariner_is_the_published_one():
    """Fossen (1994): K = 0.185 1/s, T1 = 118, T2 = 7.8 and T3 = 18.5 s, from the same report."""
    nomoto = nomoto_linear(MARINER)
    unit = L / U0
    assert pytest.approx(0.185, abs=5e-4) == nomoto.K / unit
    assert nomoto.T1 * unit == pytest.approx(118.0, abs=0.5)
    assert nomoto.T2 * unit == pytest.approx(7.8, abs=0.05)
    assert nomoto.T3 * unit == pytest.approx(18.5, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [10, 15, 20, 35])
def test_the_mariner_turns_as_its_published_equations_do(degrees: int):
    published, radius, _ = turning_circle(symmetric, U0, degrees)
    ours, ours_radius, _ = turning_circle(OURS, U0, degrees)
    np.testing.assert_allclose(ours, published, rtol=0.10)
    assert ours_radius == pytest.approx(radius, rel=0.10)


@pytest.mark.parametrize("degrees", [10, 20])
def test_mariner_zigzags_as_its_published_equations(degrees: int):
    np.testing.assert_allclose(swings(OURS, degrees), swings(symmetric, degrees), rtol=0.20)


@pytest.mark.nightly
def test_page_shows_the_computed_mariner_table():
    text = (Path(__file__).parents[2] / "docs" / "vehicles.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| (turning circle|zig-zag), (\d+).*?\|.*?\| (.*?) \| (.*?) \|$", text, re.M
    )
    assert len(rows) == 6
    for trial, angle, *printed in rows:
        degrees = int(angle)
        if trial == "turning circle":
            circles = (circle(of, degrees) for of in (OURS, symmetric))
            computed = [f"{c.advance / L:.2f}; {c.tactical_diameter / L:.2f}" for c in circles]
        else:
            computed = ["{:.1f}; {:.1f}".format(*swings(of, degrees)) for of in (OURS, symmetric)]
        assert printed == computed


# --- REMUS ----------------------------------------------------------------------------------------

REMUS = load("remus-100")
STILL = np.zeros(2)  # no current
R = {
    "Xuu": -1.62, "Xudot": -0.93, "Xwq": -35.5, "Xqq": -1.93, "Xvr": 35.5, "Xrr": -1.93, "Xprop": 3.86,
    "Yvv": -1310.0, "Yrr": 0.632, "Yuv": -28.6, "Yvdot": -35.5, "Yrdot": 1.93, "Yur": 5.22, "Ywp": 35.5, "Ypq": 1.93,
    "Yuudr": 9.64,
    "Zww": -131.0, "Zqq": -0.632, "Zuw": -28.6, "Zwdot": -35.5, "Zqdot": -1.93, "Zuq": -5.22, "Zvp": -35.5,
    "Zrp": 1.93, "Zuuds": -9.64,
    "Kpp": -0.130, "Kpdot": -0.0704, "Kprop": -0.543,
    "Mww": 3.18, "Mqq": -188.0, "Muw": 24.0, "Mwdot": -1.93, "Mqdot": -4.88, "Muq": -2.0, "Mvp": -1.93, "Mrp": 4.86,
    "Muuds": -6.15,
    "Nvv": -3.18, "Nrr": -94.0, "Nuv": -24.0, "Nvdot": 1.93, "Nrdot": -4.88, "Nur": -2.0, "Nwp": -1.93, "Npq": -4.86,
    "Nuudr": -6.15,
}  # fmt: skip
"""Prestero (2001): the combined coefficients, SI units."""


def prestero(state: State, rudder: float, stern: float) -> State:
    """His equations of motion: rates of (u, v, w, p, q, r, x, y, z, phi, theta, psi)."""
    u, v, w, p, q, r = state[:6]
    phi, theta, psi = state[9:]
    W, B, z_g, Ixx, Iyy, Izz = 299.0, 306.0, 0.0196, 0.177, 3.45, 3.45
    m = W / 9.81
    sin_phi, cos_phi, sin_theta, cos_theta = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
    forces = [
        -(W - B) * sin_theta + R["Xuu"] * u * abs(u) + (R["Xwq"] - m) * w * q + R["Xqq"] * q * q
        + (R["Xvr"] + m) * v * r + R["Xrr"] * r * r - m * z_g * p * r + R["Xprop"],
        (W - B) * cos_theta * sin_phi + R["Yvv"] * v * abs(v) + R["Yrr"] * r * abs(r) + R["Yuv"] * u * v
        + (R["Ywp"] + m) * w * p + (R["Yur"] - m) * u * r - m * z_g * q * r + R["Ypq"] * p * q
        + R["Yuudr"] * u * u * rudder,
        (W - B) * cos_theta * cos_phi + R["Zww"] * w * abs(w) + R["Zqq"] * q * abs(q) + R["Zuw"] * u * w
        + (R["Zuq"] + m) * u * q + (R["Zvp"] - m) * v * p + m * z_g * (p * p + q * q) + R["Zrp"] * r * p
        + R["Zuuds"] * u * u * stern,
        -z_g * W * cos_theta * sin_phi + R["Kpp"] * p * abs(p) - (Izz - Iyy) * q * r + m * z_g * (u * r - w * p)
        + R["Kprop"],
        -z_g * W * sin_theta + R["Mww"] * w * abs(w) + R["Mqq"] * q * abs(q) + (R["Mrp"] - (Ixx - Izz)) * r * p
        + m * z_g * (v * r - w * q) + R["Muq"] * u * q + R["Mvp"] * v * p + R["Muw"] * u * w
        + R["Muuds"] * u * u * stern,
        R["Nvv"] * v * abs(v) + R["Nrr"] * r * abs(r) + R["Nuv"] * u * v + (R["Npq"] - (Iyy - Ixx)) * p * q
        + R["Nwp"] * w * p + R["Nur"] * u * r + R["Nuudr"] * u * u * rudder,
    ]  # fmt: skip
    inertia = np.diag([
        m - R["Xudot"], m - R["Yvdot"], m - R["Zwdot"], Ixx - R["Kpdot"], Iyy - R["Mqdot"], Izz - R["Nrdot"],
    ])  # fmt: skip
    inertia[0, 4], inertia[4, 0], inertia[1, 3], inertia[3, 1] = (
        m * z_g,
        m * z_g,
        -m * z_g,
        -m * z_g,
    )
    inertia[1, 5], inertia[5, 1], inertia[2, 4], inertia[4, 2] = (
        -R["Yrdot"],
        -R["Nvdot"],
        -R["Zqdot"],
        -R["Mwdot"],
    )
    along = u * cos_theta + (v * sin_phi + w * cos_phi) * sin_theta
    across = v * cos_phi - w * sin_phi
    turn = (q * sin_phi + r * cos_phi) / cos_theta
    return np.concatenate([np.linalg.solve(inertia, forces), [
        along * np.cos(psi) - across * np.sin(psi), along * np.sin(psi) + across * np.cos(psi),
        -u * sin_theta + (v * sin_phi + w * cos_phi) * cos_theta,
        p + turn * sin_theta, q * cos_phi - r * sin_phi, turn,
    ]])  # fmt: skip


def both(rudder: float, stern: float, duration: float) -> tuple[State, State]:
    """Tracks ``(k, 12)`` every 0.1 s of the published vehicle and of the file's, from cruising, fins over at once.

    Prestero's rudder is positive to port.
    """
    start, time = np.zeros(12), np.arange(0.0, duration, 0.1)
    start[0] = 1.54
    solution = solve_ivp(
        lambda _, s: prestero(s, -rudder, stern),
        (0.0, duration),
        start,
        t_eval=time,
        rtol=1e-9,
        atol=1e-10,
    )
    c, control = REMUS.vector(), np.array([rudder, stern, 3.86] * 2)
    states = [start]
    for _ in time[1:]:
        states.append(segorogeni_step(states[-1], control, STILL, c, 0.1, 4))
    return solution.y.T, np.array(states)


TURN, DIVE = (0, 1, 5, 8, 9, 10), (0, 2, 4, 8, 10)
"""Speed, drift, yaw rate, depth, roll and pitch; speed, heave, pitch rate, depth and pitch."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rudder", "stern", "duration", "moving"),
    [(4.0, 0.0, 60.0, TURN), (-8.0, 0.0, 60.0, TURN), (13.6, 0.0, 60.0, TURN), (0.0, 5.0, 30.0, DIVE),
     (0.0, -10.0, 30.0, DIVE)],
)  # fmt: skip
def test_remus_turns_and_dives_as_its_published_equations_do(
    rudder: float, stern: float, duration: float, moving: tuple[int, ...]
):
    published, ours = both(rudder * DEG, stern * DEG, duration)
    if rudder:
        assert np.sign(ours[-1, 11]) == np.sign(rudder)
    else:
        assert (ours[-1, 8] > 5.0) == (stern > 0.0)
    largest = np.abs(published).max(0)
    for i in moving:  # all the way
        np.testing.assert_allclose(ours[:, i], published[:, i], atol=0.01 * largest[i])
    if rudder:
        turns = [figures(*track[:, [6, 7, 11]].T) for track in (published, ours)]
        np.testing.assert_allclose(turns[1], turns[0], rtol=0.01)
