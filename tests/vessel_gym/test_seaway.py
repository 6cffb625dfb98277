"""A sea that knows the ship: encounter, loads, first-order motion, wind and drift, and the ship that answers them."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from manoeuvres import sailed
from nomoto_models import nomoto_linear
from scipy.stats import chi2
from stepping import corvette_step

from vessel_gym.disturbances.seaway import Seaway
from vessel_gym.disturbances.spectrum import WaveSpectrum, WaveSystem, jonswap
from vessel_gym.disturbances.waves import WaveField
from vessel_gym.envs import SigmaCorvetteEnv
from vessel_gym.envs.ship import ship_system
from vessel_gym.simulation.core import Core
from vessel_gym.vehicles.corvette_equations import (
    COEFFICIENTS,
    STATE,
    CorvetteParameters,
    corvette_rates,
)
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.seakeeping import (
    StripTheory,
    encounter_frequency,
    sway_yaw_matrices,
)
from vessel_gym.vehicles.vehicle import GRAVITY

SHIP = load("corvette", CorvetteParameters)
MARINER = load("mariner", CorvetteParameters)
C = dict(zip(COEFFICIENTS, SHIP.vector(), strict=True))
CORVETTE = SigmaCorvetteEnv.system
MODERATE, ROUGH = CORVETTE.disturbances["moderate"], CORVETTE.disturbances["rough"]
COMPONENTS = WaveField.components
DEG = np.pi / 180.0
AROUND = np.linspace(0.0, 2.0 * np.pi, 25)


def sea_toward(sea: Seaway, direction: float, **changes: Any) -> Seaway:
    """The sea with waves and wind to another direction."""
    system = WaveSystem(sea.spectrum.height, sea.spectrum.period, direction, **changes)
    spectrum = WaveSpectrum.of_systems(system)
    return replace(sea, spectrum=spectrum, wind_direction=direction)


# --- waves as a ship meets them -------------------------------------------------------------------


@pytest.mark.parametrize(("beta", "met"), [(np.pi, 1.805), (0.5 * np.pi, 0.800), (0.0, -0.205)])
def test_waves_are_met_at_the_frequency_that_the_books_have(beta, met):
    assert encounter_frequency(0.8, beta, 15.4) == pytest.approx(met, abs=5e-4)


def loads(ship: CorvetteParameters, w: Any, beta: Any, speed: float = 0.0) -> np.ndarray:
    """Loads of strip theory ``(..., 3)`` per metre of amplitude, which move the ship as it moves."""
    inertia, _, moving = sway_yaw_matrices(ship, speed)
    met = encounter_frequency(np.asarray(w), np.asarray(beta), speed)[..., None, None]
    moved = motions(ship, w, beta, speed)
    pushed = np.matvec(moving + 1j * met * inertia, moved[..., :2])
    return np.concatenate([pushed, moved[..., 2:]], -1)


def motions(ship: CorvetteParameters, w: Any, beta: Any, speed: float) -> np.ndarray:
    """Motions by strip theory ``(..., 3)`` per metre of amplitude."""
    return StripTheory(ship).motion(np.asarray(w), np.asarray(beta), speed)


def drawn_seas(sea: Any, episodes: int, seed: int = 0) -> np.ndarray:
    return sea.draw(np.random.default_rng(seed).uniform(size=(episodes, sea.uniforms)))


def response(sea: Seaway, w: np.ndarray, beta: np.ndarray, speed: float) -> np.ndarray:
    """Sway velocity and yaw rate per metre of waves, means over a step, and the roll moment to hold ``(..., 3)``."""
    half = 0.5 * sea.dt * encounter_frequency(w, beta, speed)
    mean, motion = np.sinc(half / np.pi), motions(SHIP, w, beta, speed)
    return np.stack([mean, mean, 1.0 / mean], -1) * np.exp(1j * half)[..., None] * motion


@pytest.mark.parametrize("speed", [7.0, 15.4])
@pytest.mark.parametrize("psi", DEG * np.array([0.0, 57.0, 90.0, 143.0, 180.0]))
def test_ship_answers_each_wave_at_its_encounter_frequency(psi, speed):
    """Against the sum over the waves drawn of the motions of strip theory, in a current that carries ship and waves."""
    sea, t, current = sea_toward(ROUGH, 0.4), np.linspace(0.0, 60.0, 241), np.array([1.1, -0.7])
    drawn = np.repeat(drawn_seas(sea, 1), len(t), 0)
    z, state = np.zeros((len(t), 4)), np.zeros((len(t), len(STATE)))
    z[:, :2], z[:, 2:] = current, t[:, None] * current
    state[:, :2] = np.outer(speed * t, [np.cos(psi), np.sin(psi)]) + z[:, 2:] + [30.0, -80.0]
    state[:, 2], state[:, 3] = psi, speed
    w, phase, kx, ky = (each[0] for each in sea.waves.constants(drawn))
    theta = np.arctan2(ky, kx)
    turned = phase - w**2 / GRAVITY * (30.0 * np.cos(theta) - 80.0 * np.sin(theta))
    turned = turned + np.outer(t, encounter_frequency(w, theta - psi, speed))
    amplitude = sea.spectrum.height / np.sqrt(8.0 * COMPONENTS)
    waves = np.exp(1j * turned)[..., None] * response(sea, w, theta - psi, speed)
    expected = amplitude * waves.sum(1).real
    seen = (sea.effect_at(drawn, t, z, state) - sea.effect(z, state))[:, [7, 0, 6]]
    seen = seen / [1.0, sea.dt, 1.0]
    assert (np.abs(seen - expected).max(0) < 1e-4 * np.array([1.0, 0.01, 1e6])).all()


@pytest.mark.parametrize("speed", [0.0, 15.4])
def test_waves_from_the_other_side_mirror_the_response(speed):
    w, beta = np.linspace(0.2, 3.0, 60)[:, None], np.linspace(0.0, np.pi, 37)
    for answer in (motions, loads):
        one, other = answer(SHIP, w, beta, speed), answer(SHIP, w, -beta, speed)
        assert (np.abs(one + other) <= 1e-12 * np.abs(one).max((0, 1))).all()


# RMS yaw rate [mrad/s] at 15.4 m/s in a moderate sea, by direction of the waves minus heading.
_YAW = {"cos2": (6.10, 6.17, 5.29, 3.41, 2.49), "long-crested": (0.0, 7.96, 0.0, 3.62, 0.0)}


@pytest.mark.parametrize("spreading", _YAW)
def test_a_spread_sea_yaws_a_ship_on_every_course(spreading):
    sea = sea_toward(MODERATE, 0.0, spreading=spreading)
    rates = 1e3 * sea.yaw_rate(-DEG * np.array([0.0, 45.0, 90.0, 135.0, 180.0]), 15.4)
    assert rates == pytest.approx(_YAW[spreading], abs=0.02)


def test_wave_field_is_a_function_of_place_and_time():
    """Two cores of one seed, with different estimators, sensors and helms, meet the same sea where they are."""
    chosen = (
        {"estimator": "ekf"},
        {"estimator": "truth", "sensors": "budget", "disturbance": "rough", "mismatch": 0.1},
    )
    cores = [Core(CORVETTE, 3, **{"disturbance": "rough"} | each) for each in chosen]
    for core, helm in zip(cores, (0.0, 0.7), strict=True):
        core.start(11)
        for _ in range(40):
            core.step(np.full((3, 1), helm))
    one, other = (core.now for core in cores)
    constants = one.episode_constants
    assert (constants == other.episode_constants).all()
    assert np.abs(one.state[:, :2] - other.state[:, :2]).min() > 0.1
    for now in (one, other):
        acting = ROUGH.effect_at(constants, ROUGH.dt * now.steps, now.slow[:, :4], now.state)
        assert (np.abs(now.exogenous - acting) <= 1e-9 * np.abs(acting).max(0)).all()


def test_waves_wind_and_current_are_of_one_frame():
    """In a current along the wind a ship moves through the water as without it in what is left of the wind."""
    for speed, toward in ((1.3, 0.8), (-2.0, 3.0)):
        still = sea_toward(replace(ROUGH, wind=ROUGH.wind - speed), toward)
        sea, c = sea_toward(ROUGH, toward), SHIP.vector()
        drift, drawn, motions = (
            speed * np.array([np.cos(toward), np.sin(toward)]),
            drawn_seas(ROUGH, 8),
            [],
        )
        for where, current in ((still, 0.0 * drift), (sea, drift)):
            state, vehicle = np.zeros((8, len(STATE))), CORVETTE.vehicle
            state[:, 2], state[:, 3] = np.linspace(0.0, 6.0, 8), 12.0
            for step in range(120):
                time = np.full(8, sea.dt * step)
                z = np.tile(np.concatenate([current, sea.dt * step * current]), (8, 1))
                helm = np.full((8, 1), 0.05)
                state = vehicle.step(
                    state, helm, helm, where.effect_at(drawn, time, z, state), np.tile(c, (8, 1))
                )
            state[:, :2] -= 120 * sea.dt * current
            motions.append(state)
        assert (np.abs(motions[1] - motions[0]) <= 1e-9 * np.abs(motions[0]).max(0)).all()


def test_a_current_carries_the_water():
    core = Core(CORVETTE, 3, disturbance="rough")
    core.start(0)
    way = np.zeros((3, 2))
    for _ in range(20):
        way += ROUGH.dt * core.now.slow[:, : core.config.world.size][:, :2]
        core.step(np.zeros((3, 1)))
    np.testing.assert_allclose(
        core.now.slow[:, : core.config.world.size][:, 2:], way, rtol=1e-12, atol=1e-14
    )
    assert np.abs(way).min() > 0.01


def test_filter_wave_bands_keep_their_variance_everywhere():
    """Z stays standard normal as it rotates, and so does what a ship sees of it from wherever she is."""
    sea = MODERATE.modelled
    process, waves = sea.process, slice(0, 8)
    cov = (
        process.transition @ process.start_cov @ process.transition.T
        + process.root @ process.root.T
    )
    assert np.abs(cov - process.start_cov).max() < 1e-12
    assert (process.start_cov[waves, waves] == np.eye(8)).all()
    # Astern the frequency of encounter passes through zero between these speeds.
    z = np.random.default_rng(0).standard_normal((20_000, 10))
    for speed in (6.0, GRAVITY / sea.bands.frequencies[0], 16.0):
        state = np.zeros((len(z), len(STATE)))
        state[:, :2] = np.random.default_rng(1).uniform(-2e3, 2e3, (len(z), 2))
        state[:, 3] = speed
        d = sea.effect(z, state)[:, 0]
        expected = sea.dt * sea.yaw_rate(np.array(0.0), speed, sea.dt)
        # chi-square band, false alarms 1e-6 each; the kernel interpolates responses between tabled
        # ones, to 4 %, and the cells of the bands are few
        low, high = chi2.ppf([5e-7, 1.0 - 5e-7], len(z)) / len(z)
        assert 0.90 * low < d.var() / expected**2 < 1.05 * high


def test_bands_carry_the_yaw_of_the_whole_spectrum():
    for sea in (MODERATE, ROUGH):
        w, theta, energy = sea.spectrum.cells
        for psi in AROUND[::4]:
            yaw = np.abs(response(sea, w, theta - psi, 12.0)[..., 1])
            whole = np.sqrt((energy * yaw**2).sum())
            assert sea.yaw_rate(psi, 12.0, sea.dt) == pytest.approx(whole, rel=1e-9)
            bands = np.abs(sea.modelled.loadings(psi, 12.0)[..., 1])
            assert np.sqrt((bands**2).sum()) == pytest.approx(whole, rel=0.03)


@pytest.mark.parametrize("beta", [0.3, 1.2, 0.5 * np.pi, 2.4])
def test_wave_loads_average_water_motion_along_the_hull(beta):
    """Against quadrature of the velocity of the water and of its gradient (least squares) along the hull."""
    w, half = 0.9, 0.5 * SHIP.length
    k = w**2 / GRAVITY
    side = np.sin(beta) * np.exp(-0.5 * k * SHIP.draught)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    velocity = w * side * np.exp(-1j * k * half * nodes * np.cos(beta))
    v, r = weights @ velocity / 2.0, weights @ (nodes * velocity) / (half * weights @ nodes**2)
    inertia = np.array(
        [[C["sway_inertia"], C["sway_yaw_inertia"]], [C["yaw_sway_inertia"], C["yaw_inertia"]]]
    )
    bare = replace(
        SHIP, rudder_area=1e-9
    )  # whose propellers' race does not load the rudders at rest
    assert loads(bare, w, beta)[:2] == pytest.approx(1j * w * inertia @ [v, r], rel=1e-6)


@pytest.mark.parametrize("ship", [SHIP, MARINER], ids=["corvette", "mariner"])
@pytest.mark.parametrize("beta", DEG * np.array([20.0, 45.0, 75.0, 105.0, 150.0]))
def test_long_waves_carry_a_ship_as_they_carry_the_water(ship, beta):
    """In sway and yaw at rest, in sway at speed, and in roll she lies along the surface."""
    k = 2.0 * np.pi / (60.0 * ship.length)
    w = np.sqrt(GRAVITY * k)
    sway = w * np.sin(beta)
    water = np.array([sway, -1j * k * np.cos(beta) * sway])
    assert np.abs(motions(ship, w, beta, 0.0)[:2] / water - 1.0).max() < 0.03
    still = 1e-3 * w  # of waves 60 million ship lengths long, in which she is slow to nothing
    carried = motions(ship, still, beta, ship.speed)[0] / (still * sway / w)
    assert abs(carried - 1.0) < 0.03
    c, slope = (
        ship.vector(),
        1j * k * sway / w,
    )  # starboard down where the surface is lower to starboard
    for phase in (1.0 - 1j, -1j):
        state, around = np.zeros(len(STATE)), np.zeros(7)
        state[6] = 1e-3 * (phase * slope).real
        around[5] = 1e-3 * (phase * loads(ship, w, beta)[2]).real
        lying = corvette_rates(state, np.zeros(1), around, c)[7]
        around[5] = 0.0
        assert abs(lying) < 0.03 * abs(corvette_rates(state, np.zeros(1), around, c)[7])


# A naval vessel of 51.5 m by 8.6 m by 2.3 m, 357 m3, at rest: forces in waves by strip theory
# (ShipX VERES), from the Marine Systems Simulator of T. I. Fossen and T. Perez (MIT licence). The
# directions printed there are 15 degrees less: at rest in long waves sway goes with the sine of the
# directions below, from 30 to 165 degrees, to 0.2 %.
_VERES_FREQUENCIES = np.array(
    [0.25, 0.5464, 0.6444, 0.6981, 0.816, 0.9106, 0.9448, 1.14, 1.571, 2.094]
)
_VERES = {  # direction [deg]: sway [kN/m], yaw [MN m/m]
    45.0: ([26.2, 120, 160, 182, 224, 247, 251, 221, 76.2, 65.3],
           [0.0636, 0.458, 0.776, 1.01, 1.68, 2.35, 2.61, 3.96, 1.54, 0.587]),
    60.0: ([32.1, 149, 201, 232, 297, 343, 357, 388, 99.3, 65.8],
           [0.0768, 0.478, 0.777, 0.998, 1.65, 2.34, 2.63, 4.46, 5.38, 2.18]),
    75.0: ([35.9, 168, 229, 266, 351, 419, 442, 552, 499, 31.7],
           [0.0847, 0.45, 0.676, 0.834, 1.29, 1.78, 1.99, 3.49, 7.18, 5.01]),
}  # fmt: skip
_MASS = 2.0 * 357.0 / 51.5**3
VERES_VESSEL = CorvetteParameters(
    length=51.5, beam=8.6, draught=2.3, mass=357.0 * 1025.0, speed=8.75, resistance=1e5, rudder_area=1e-9,
    given=(("Yvdot", -0.633 * _MASS), ("Yrdot", -0.0744 * _MASS), ("Nvdot", -0.0744 * _MASS),
           # from its longest waves: 1.633 m, .0744 m L, .0848 m L^2 with the ship's own
           ("Nrdot", -0.0223 * _MASS)),
)  # fmt: skip


@pytest.mark.parametrize("period", [6.28, 6.92])  # of the moderate and rough seas, Froude-scaled
@pytest.mark.parametrize("direction", _VERES)
def test_wave_loads_are_as_large_as_those_of_strip_theory(direction, period):
    w = np.linspace(0.25, 2.09, 400)
    spectrum = jonswap(w, 1.0, period)
    ours = np.abs(loads(VERES_VESSEL, w, DEG * direction)[:, :2])
    for i, (theirs, unit) in enumerate(zip(_VERES[direction], (1e3, 1e6), strict=True)):
        theirs = unit * np.interp(w, _VERES_FREQUENCIES, theirs)
        ratio = np.sqrt(
            np.trapezoid(ours[:, i] ** 2 * spectrum, w) / np.trapezoid(theirs**2 * spectrum, w)
        )
        assert ratio == pytest.approx(1.0, abs=0.3)


def test_beam_waves_roll_in_phase_with_sway_and_yaw():
    """Strip theory for the naval vessel at rest: sway, roll, yaw 90, 90, 90 to 84, 88, 77 degrees up to 1.14 rad/s."""
    for ship in (VERES_VESSEL, SHIP, MARINER):
        sway, yaw, roll = loads(ship, np.sqrt(GRAVITY / ship.length), 0.5 * np.pi)
        assert abs(np.angle(roll / sway)) < 20.0 * DEG
        if ship is VERES_VESSEL:
            assert abs(np.angle(roll / yaw)) < 20.0 * DEG


@pytest.mark.parametrize("ship", [SHIP, MARINER], ids=["corvette", "mariner"])
def test_wave_motion_does_not_depend_on_the_step(ship):
    """A calm head sea, which the Mariner meets at 3.8 rad a step; its waves here are regular.

    A roll moment that is held loses sinc(w_e dt / 2) of a wave that is met less than half a time a
    step.
    """
    sea = ship_system(ship).disturbances["calm"]
    t = sea.dt * np.arange(4000.0)
    for w in 2.0 * np.pi / sea.spectrum.period * np.array([0.8, 1.0, 1.35]):
        drawn, state = np.zeros((len(t), 5 * COMPONENTS)), np.zeros((len(t), len(STATE)))
        k, beta = w**2 / GRAVITY, 0.8 * np.pi
        # to the north, of the sea's amplitude
        one = [w, 0.0, k, 0.0, w / k * np.exp(-0.5 * k * ship.draught)]
        drawn[:, ::COMPONENTS] = one
        state[:, 2], state[:, 3] = -beta, ship.speed
        state[:, :2] = np.outer(ship.speed * t, [np.cos(beta), -np.sin(beta)])
        answer = motions(ship, w, beta, ship.speed)
        met = encounter_frequency(w, beta, ship.speed)
        acting = sea.effect_at(drawn, t, np.zeros((len(t), 4)), state) / sea.waves.amplitude
        heading, moved = np.cumsum(acting[:, 0]), sea.dt * np.cumsum(acting[:, -1])
        assert heading.var() == pytest.approx(0.5 * abs(answer[1] / met) ** 2, rel=0.02)
        assert moved.var() == pytest.approx(0.5 * abs(answer[0] / met) ** 2, rel=0.02)
        if sea.dt * met < np.pi:
            rolled = np.sinc(0.5 * sea.dt * met / np.pi) * acting[:, 6].std()
            assert rolled == pytest.approx(
                abs(loads(ship, w, beta)[..., 2]) / np.sqrt(2.0), rel=0.02
            )


# --- wind and drift -------------------------------------------------------------------------------


def slow_loads(sea: Seaway, beta: float, speed: float) -> dict[str, float]:
    state = np.zeros(len(STATE))
    state[2], state[3] = -beta, speed
    return dict(zip(sea.forces, sea.effect(np.zeros(len(sea.names)), state), strict=True))


def test_wind_and_drift_push_to_leeward_and_not_from_ahead():
    for beta in (0.5, 1.5, 2.5):
        assert (
            slow_loads(ROUGH, beta, 12.0)["sway force"]
            > 0.0
            > slow_loads(ROUGH, -beta, 12.0)["sway force"]
        )
    for beta in (0.0, np.pi):
        loads = slow_loads(ROUGH, beta, 12.0)
        assert abs(loads["sway force"]) < 1.0
        assert abs(loads["yaw moment"]) < 1.0
    calm = sea_toward(replace(ROUGH, wind=0.0), 0.0, spreading="long-crested")
    for beta in (0.25 * np.pi, 0.5 * np.pi):
        whole = SHIP.water_density * GRAVITY * SHIP.length * 3.25**2 / 16.0 * 0.25
        drift = slow_loads(calm, beta, 0.0)["sway force"]
        assert drift == pytest.approx(whole * np.sin(beta) ** 2, rel=0.02)


@pytest.mark.parametrize(
    ("sea", "leeway"), [(MODERATE, 0.182), (ROUGH, 0.320)], ids=["moderate", "rough"]
)
def test_assumed_leeway_is_that_of_a_held_ship_in_beam_wind(sea, leeway):
    """She sails for ten minutes under a heading autopilot in wind and drift alone."""
    c, heading, state, integral = SHIP.vector(), 0.5 * np.pi, np.zeros(len(STATE)), 0.0
    state[2], state[3] = heading, SHIP.speed
    for _ in range(600):
        off = state[2] - heading
        integral += off
        rudder = np.full(2, -1.0 * off - 10.0 * state[5] - 0.01 * integral)
        around = sea.effect(np.zeros(len(sea.names)), state)[1:]
        state = corvette_step(state, rudder, around, c, 1.0, 4)
    assert abs(state[2] - heading) < 1e-4
    assert sea.steady_sway(np.array(heading)) == pytest.approx(state[4], rel=1e-2)
    assert sea.leeway == pytest.approx(leeway, abs=1e-3)
    assert sea.believed.current == pytest.approx(np.hypot(sea.current, sea.leeway))


# --- the ship -------------------------------------------------------------------------------------


@cache
def hard_over(side: float) -> np.ndarray:
    time = 0.1 * np.arange(5001)
    return sailed(SHIP, side * np.minimum(SHIP.rudder_rate * time, 35.0 * DEG), 0.1)


def test_steady_turn_is_tighter_than_tactical_diameter():
    states = hard_over(1.0)
    turned = np.argmax(states[:, 2] >= np.pi)
    tactical = states[turned, 1] / SHIP.length
    u, v, r = states[-1, 3:6]
    steady = 2.0 * np.hypot(u, v) / r / SHIP.length
    assert tactical == pytest.approx(3.6, abs=0.1)
    assert steady < tactical - 0.05
    assert u / SHIP.speed == pytest.approx(0.65, abs=0.03)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_she_rolls_into_a_turn_at_first_and_then_out_of_it(side):
    roll = side * hard_over(side)[:, 6] / DEG
    first, then = roll[:200].max(), roll.argmin()
    assert first == pytest.approx(0.5, abs=0.1)
    assert roll.argmax() < then
    assert roll[-1] == pytest.approx(-6.0, abs=0.5)
    assert roll.min() < roll[-1] - 1.0  # overshoots on her way there


def test_nomotos_figures_lie_by_those_of_a_frigate_of_her_size():
    nomoto = nomoto_linear(SHIP)  # K' 2.0, T' 2.4 for van Amerongen's 100 m frigate
    assert 1.6 < nomoto.K < 2.6
    assert 1.8 < nomoto.T < 2.8
    printed = rf"Nomoto's K' (is )?{nomoto.K:.1f}(,| and) T' {nomoto.T:.1f}"
    for place in ("vessel_gym/vehicles/data/corvette.toml", "docs/seaway.md"):
        assert re.search(printed, (Path(__file__).parents[2] / place).read_text(encoding="utf-8"))


# --- in the loop ----------------------------------------------------------------------------------


def test_filters_assume_a_sea_without_direction():
    core = Core(CORVETTE, 2)
    space = core.config.estimation.space
    assert space.inputs == ("yaw increment",)
    assert space.names == ("x", "y", "psi", "u", "v", "r", "current north", "current east")
    assert space.disturbance == MODERATE.believed
    psi = np.linspace(0.0, 2.0 * np.pi, 18, endpoint=False)
    rms = np.sqrt((MODERATE.yaw_rate(psi, 0.8 * SHIP.speed) ** 2).mean())
    assert np.sqrt(space.cov[0, 0]) == pytest.approx(0.5 * rms, rel=0.05)
