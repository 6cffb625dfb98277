"""A sea that knows the ship: encounter, loads, first-order motion, wind and drift, and the ship that answers them."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from nomoto_models import nomoto_linear
from scipy.stats import chi2
from stepping import corvette_step

from vessel_gym.core import Core
from vessel_gym.envs.ship import SEAS, SIGMA_CORVETTE, ship_system
from vessel_gym.sea_trials import simulate
from vessel_gym.seaway import Seaway
from vessel_gym.vehicles.corvette import steady_turns
from vessel_gym.vehicles.corvette_equations import COEFFICIENTS, STATE, CorvetteParameters, corvette_rates
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.seakeeping import SHORT_CREST, wave_loads, wave_response
from vessel_gym.waves import GRAVITY, encounter_frequency, jonswap

SHIP = load("corvette", CorvetteParameters)
MARINER = load("mariner", CorvetteParameters)
C = dict(zip(COEFFICIENTS, SHIP.vector(), strict=True))
MODERATE, ROUGH = SEAS["moderate"], SEAS["rough"]
DEG, KNOT = np.pi / 180.0, 1852.0 / 3600.0
AROUND_BETAS = np.linspace(0.0, 2.0 * np.pi, 25)


def heading_for(beta: float) -> float:
    """With waves that run to the north."""
    return -beta


# --- waves as a ship meets them ----------------------------------------------------------------------


@pytest.mark.parametrize(("beta", "met"), [(np.pi, 1.805), (0.5 * np.pi, 0.800), (0.0, -0.205)])
def test_waves_are_met_at_the_frequency_that_the_books_have(beta, met):
    assert encounter_frequency(0.8, beta, 15.4) == pytest.approx(met, abs=5e-4)


@pytest.mark.parametrize("beta", [0.0, 1.0, 0.5 * np.pi, 2.5, np.pi])
def test_a_ship_that_sails_through_the_field_meets_it_at_that_frequency(beta):
    """What is seen of a wave that does not change turns by the frequency of encounter, whatever the heading."""
    sea = Seaway(SHIP, height=2.0, period=2.0 * np.pi / 0.8, wind=0.0, current=0.0, dt=0.5)
    t, speed, band = np.linspace(0.0, 4.0, 81), 15.4, 1
    w, psi = sea.waves.frequencies[band], heading_for(beta)
    z = np.zeros((len(t), 8))
    phase = np.exp(1j * w * t)
    z[:, 2 * band], z[:, 2 * band + 1] = phase.real, phase.imag
    state = np.zeros((len(t), len(STATE)))
    state[:, 0], state[:, 1] = speed * t * np.cos(psi), speed * t * np.sin(psi)
    state[:, 2], state[:, 3] = psi, speed
    seen = sea.effect(z, state)
    response = sea.mean_response(np.array(beta), speed)[band]
    expected = response * np.exp(1j * encounter_frequency(w, beta, speed) * t)[:, None]
    scale = np.abs(response)
    # The kernel interpolates responses between tabled speeds.
    assert np.abs(seen[:, 0] / sea.dt - expected[:, 1].real).max() < 0.02 * scale[1]
    assert np.abs(seen[:, -1] - expected[:, 0].real).max() < 0.02 * scale[0]
    assert np.abs(seen[:, -2] - expected[:, 2].real).max() < 0.02 * scale[2]


def test_the_waves_keep_their_variance_at_any_frequency_of_encounter():
    """Z stays standard normal as it rotates, and so does what a ship sees of it from wherever she is."""
    process = MODERATE.process
    bands = slice(0, 6)
    cov = process.transition @ process.start_cov @ process.transition.T + process.root @ process.root.T
    assert np.abs(cov - process.start_cov).max() < 1e-12
    assert (process.start_cov[bands, bands] == np.eye(6)).all()
    # Astern the frequency of encounter passes through zero between these speeds.
    sea, z = MODERATE, np.random.default_rng(0).standard_normal((20_000, 8))
    for speed in (6.0, GRAVITY / sea.waves.frequencies[1], 16.0):
        state = np.zeros((len(z), len(STATE)))
        state[:, :2] = np.random.default_rng(1).uniform(-2e3, 2e3, (len(z), 2))
        state[:, 3] = speed
        d = sea.effect(z, state)[:, 0]
        expected = sea.dt * sea.yaw_rate(np.array(0.0), speed)
        # chi-square band, false alarms 1e-6 each; the kernel interpolates responses between tabled ones, to 4 %
        low, high = chi2.ppf([5e-7, 1.0 - 5e-7], len(z)) / len(z)
        assert 0.92 * low < d.var() / expected**2 < 1.02 * high


def test_bands_carry_the_yaw_of_the_whole_spectrum():
    beta, w = AROUND_BETAS[:, None], np.linspace(0.25, 2.8, 2000)
    for sea in (MODERATE, ROUGH):
        spectrum = jonswap(w, sea.height, sea.period)
        whole = np.abs(wave_response(SHIP, w, beta, 12.0)[..., 1]) ** 2 * spectrum
        assert sea.yaw_rate(AROUND_BETAS, 12.0) == pytest.approx(np.sqrt(np.trapezoid(whole, w)), rel=0.02)


def test_a_sea_has_its_significant_height_and_peak():
    w = np.linspace(0.2, 6.0, 20_000)
    spectrum = jonswap(w, 3.25, 9.7)
    assert 4.0 * np.sqrt(np.trapezoid(spectrum, w)) == pytest.approx(3.25, rel=1e-12)
    assert w[spectrum.argmax()] == pytest.approx(2.0 * np.pi / 9.7, rel=1e-3)


@pytest.mark.parametrize("beta", [0.3, 1.2, 0.5 * np.pi, 2.4])
def test_wave_loads_are_those_of_the_water_s_motion_averaged_along_the_hull(beta):
    """Against quadrature of the velocity of the water and of its gradient (least squares) along the hull."""
    w, half = 0.9, 0.5 * SHIP.length
    k = w**2 / GRAVITY
    side = (np.sin(beta) + 1j * SHORT_CREST) * np.exp(-0.5 * k * SHIP.draught)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    velocity = w * side * np.exp(-1j * k * half * nodes * np.cos(beta))
    v, r = weights @ velocity / 2.0, weights @ (nodes * velocity) / (half * weights @ nodes**2)
    inertia = np.array([[C["sway_inertia"], C["sway_yaw_inertia"]], [C["yaw_sway_inertia"], C["yaw_inertia"]]])
    bare = replace(SHIP, rudder_area=1e-9)  # whose propellers' race does not load the rudders at rest
    assert wave_loads(bare, w, beta)[:2] == pytest.approx(1j * w * inertia @ [v, r], rel=1e-6)


@pytest.mark.parametrize("ship", [SHIP, MARINER], ids=["corvette", "mariner"])
@pytest.mark.parametrize("beta", DEG * np.array([20.0, 45.0, 75.0, 105.0, 150.0]))
def test_long_waves_carry_a_ship_as_they_carry_the_water(ship, beta):
    """In sway and yaw at rest, in sway at speed, and in roll she lies along the surface."""
    k = 2.0 * np.pi / (60.0 * ship.length)
    w = np.sqrt(GRAVITY * k)
    sway = w * (np.sin(beta) + 1j * SHORT_CREST)
    water = np.array([sway, -1j * k * np.cos(beta) * sway])
    assert np.abs(wave_response(ship, w, beta, 0.0) / water - 1.0).max() < 0.03
    still = 1e-3 * w  # of waves 60 million ship lengths long, in which she is slow to nothing
    carried = wave_response(ship, still, beta, ship.speed)[0] / (still * sway / w)
    assert abs(carried - 1.0) < 0.03
    c, slope = ship.vector(), 1j * k * sway / w  # starboard down where the surface is lower to starboard
    for phase in (1.0, -1j):
        state, around = np.zeros(len(STATE)), np.zeros(7)
        state[6] = 1e-3 * (phase * slope).real
        around[5] = 1e-3 * (phase * wave_loads(ship, w, beta)[2]).real
        lying = corvette_rates(state, np.zeros(1), around, c)[7]
        around[5] = 0.0
        assert abs(lying) < 0.03 * abs(corvette_rates(state, np.zeros(1), around, c)[7])


# A naval vessel of 51.5 m by 8.6 m by 2.3 m, 357 m3, at rest: forces in waves by strip theory (ShipX VERES), from the
# Marine Systems Simulator of T. I. Fossen and T. Perez (MIT licence). The directions printed there are 15 degrees less:
# at rest in long waves sway goes with the sine of the directions below, from 30 to 165 degrees, to 0.2 %.
_VERES_FREQUENCIES = np.array([0.25, 0.5464, 0.6444, 0.6981, 0.816, 0.9106, 0.9448, 1.14, 1.571, 2.094])
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
           ("Nrdot", -0.0223 * _MASS)),  # from its longest waves: 1.633 m, .0744 m L, .0848 m L^2 with the ship's own
)  # fmt: skip


@pytest.mark.parametrize("period", [6.28, 6.92])  # of the moderate and rough seas, Froude-scaled
@pytest.mark.parametrize("direction", _VERES)
def test_wave_loads_are_as_large_as_those_of_strip_theory(direction, period):
    w = np.linspace(0.25, 2.09, 400)
    spectrum = jonswap(w, 1.0, period)
    ours = np.abs(wave_loads(VERES_VESSEL, w, DEG * direction)[:, :2])
    for i, (theirs, unit) in enumerate(zip(_VERES[direction], (1e3, 1e6), strict=True)):
        theirs = unit * np.interp(w, _VERES_FREQUENCIES, theirs)
        ratio = np.sqrt(np.trapezoid(ours[:, i] ** 2 * spectrum, w) / np.trapezoid(theirs**2 * spectrum, w))
        assert ratio == pytest.approx(1.0, abs=0.3)


def test_abeam_the_waves_roll_the_ship_in_the_phase_in_which_they_push_and_yaw_her():
    """Strip theory for the naval vessel at rest: sway, roll, yaw 90, 90, 90 to 84, 88, 77 degrees up to 1.14 rad/s."""
    for ship in (VERES_VESSEL, SHIP, MARINER):
        sway, yaw, roll = wave_loads(ship, np.sqrt(GRAVITY / ship.length), 0.5 * np.pi)
        assert abs(np.angle(roll / sway)) < 20.0 * DEG
        if ship is VERES_VESSEL:
            assert abs(np.angle(roll / yaw)) < 20.0 * DEG


@pytest.mark.parametrize("ship", [SHIP, MARINER], ids=["corvette", "mariner"])
def test_however_long_a_step_is_the_waves_swing_the_heading_as_far_as_in_continuous_time(ship):
    """A calm head sea, which the Mariner meets at 3.8 rad a step; its waves here are regular."""
    sea = ship_system(ship).disturbances["calm"]
    t = sea.dt * np.arange(4000.0)
    for band, w in enumerate(sea.waves.frequencies):
        z, state = np.zeros((len(t), len(sea.names))), np.zeros((len(t), len(STATE)))
        z[:, 2 * band], z[:, 2 * band + 1] = np.cos(w * t), np.sin(w * t)
        state[:, 0], state[:, 2], state[:, 3] = -ship.speed * t, np.pi, ship.speed
        response = sea.response(np.array(np.pi), ship.speed)[band]
        met = encounter_frequency(w, np.pi, ship.speed)
        acting = sea.effect(z, state)
        heading, moved = np.cumsum(acting[:, 0]), sea.dt * np.cumsum(acting[:, -1])
        assert heading.var() == pytest.approx(0.5 * abs(response[1] / met) ** 2, rel=0.02)
        assert moved.var() == pytest.approx(0.5 * abs(response[0] / met) ** 2, rel=0.02)


def test_yaw_is_largest_off_the_stern_and_small_ahead():
    rates = MODERATE.yaw_rate(DEG * np.arange(0.0, 181.0, 5.0), 15.4)
    assert 30.0 <= 5.0 * rates.argmax() <= 75.0
    assert rates[-1] < 0.1 * rates.max()
    assert 0.05 * rates.max() < rates[0] < 0.5 * rates.max()  # short crests leave something


# --- wind and drift ----------------------------------------------------------------------------------


def slow_loads(sea: Seaway, beta: float, speed: float) -> dict[str, float]:
    state = np.zeros(len(STATE))
    state[2], state[3] = heading_for(beta), speed
    return dict(zip(sea.forces, sea.effect(np.zeros(len(sea.names)), state), strict=True))


def test_the_wind_of_a_rough_sea_needs_about_a_degree_of_rudder():
    wind = Seaway(SHIP, height=1e-3, period=9.7, wind=24.5 * KNOT, current=0.0, dt=0.5)
    c, helm = SHIP.vector(), []
    for beta in DEG * np.arange(0.0, 181.0, 10.0):
        moment = slow_loads(wind, beta, SHIP.speed)["yaw moment"]
        still = np.zeros(8)
        still[3] = SHIP.speed
        around = np.zeros(7)
        lever = 1e-3
        push = corvette_rates(still, np.array([lever]), around, c)[5] / lever
        around[4] = moment
        helm.append(abs(corvette_rates(still, np.zeros(1), around, c)[5] / push))
    assert 0.3 * DEG < max(helm) < 1.1 * DEG


def test_wind_and_drift_push_to_leeward_and_not_at_all_from_ahead():
    for beta in (0.5, 1.5, 2.5):
        assert slow_loads(ROUGH, beta, 12.0)["sway force"] > 0.0 > slow_loads(ROUGH, -beta, 12.0)["sway force"]
    for beta in (0.0, np.pi):
        loads = slow_loads(ROUGH, beta, 12.0)
        assert abs(loads["sway force"]) < 1.0
        assert abs(loads["yaw moment"]) < 1.0
    beam = Seaway(SHIP, height=3.25, period=9.7, wind=0.0, current=0.0, dt=0.5)
    drift = slow_loads(beam, 0.5 * np.pi, 0.0)["sway force"]
    assert drift == pytest.approx(SHIP.water_density * GRAVITY * SHIP.length * 3.25**2 / 16.0 * 0.25, rel=1e-9)


@pytest.mark.parametrize(("sea", "leeway"), [(MODERATE, 0.195), (ROUGH, 0.360)], ids=["moderate", "rough"])
def test_filters_are_told_the_leeway_of_a_ship_that_her_rudder_holds_across_the_wind(sea, leeway):
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
    assert sea.leeway == pytest.approx(-state[4], rel=1e-2)
    assert sea.leeway == pytest.approx(leeway, abs=1e-3)
    assert sea.believed.current == pytest.approx(np.hypot(sea.current, sea.leeway))


# --- the ship ----------------------------------------------------------------------------------------


def hard_over(side: float) -> np.ndarray:
    return simulate(SHIP, side * 35.0 * DEG, 500.0, dt=0.1).state


def test_at_constant_revolutions_the_steady_turn_is_tighter_than_the_tactical_diameter():
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


def test_roll_swings_with_its_own_period_and_dies_away():
    state = np.zeros(8)
    state[6] = 2.0 * DEG
    c, dt = SHIP.vector().copy(), 0.02
    c[COEFFICIENTS.index("thrust")] = 0.0
    rolls = []
    for _ in range(2000):
        state = corvette_step(state, np.zeros(2), np.zeros(7), c, dt, 1)
        rolls.append(state[6])
    rolls = np.array(rolls)
    crossings = np.flatnonzero((rolls[:-1] > 0.0) & (rolls[1:] <= 0.0))
    damped = SHIP.roll_period / np.sqrt(1.0 - 0.071**2)
    assert np.diff(crossings).mean() * dt == pytest.approx(damped, rel=5e-3)
    assert np.abs(rolls[-400:]).max() < 0.2 * 2.0 * DEG


def test_nomotos_figures_lie_by_those_of_a_frigate_of_her_size():
    nomoto = nomoto_linear(SHIP)  # K' 2.0, T' 2.4 for van Amerongen's 100 m frigate
    assert 1.6 < nomoto.K < 2.6
    assert 1.8 < nomoto.T < 2.8
    printed = rf"Nomoto's K' (is )?{nomoto.K:.1f}(,| and) T' {nomoto.T:.1f}"
    for place in ("vessel_gym/vehicles/data/corvette.toml", "docs/seaway.md"):
        assert re.search(printed, (Path(__file__).parents[2] / place).read_text(encoding="utf-8"))


def test_constant_thrust_is_the_limit_of_propellers_without_slope():
    """A ship file that says nothing of propellers has constant thrust, and a slipstream in proportion to the speed."""
    thesis = load("corvette-thesis", CorvetteParameters)
    turns = steady_turns(thesis)
    c, i = thesis.vector(), 80
    state = np.array([0.0, 0.0, 0.0, turns.speed[i], turns.sway[i], turns.yaw_rate[i], 0.0, 0.0])
    rates = corvette_rates(state, turns.rudder[i : i + 1], np.zeros(7), c)
    assert np.abs(rates[3:6]).max() < 1e-8
    assert c[COEFFICIENTS.index("thrust_rise")] == c[COEFFICIENTS.index("race")] == 0.0


# --- in the loop -------------------------------------------------------------------------------------


def test_a_current_shifts_the_ship_and_the_reward():
    """What it could not do where no position counts."""
    rewards = []
    for current in (0.0, 0.6):
        sea = Seaway(SHIP, height=1.88, period=8.8, wind=0.0, current=current, dt=0.5)
        core = Core(SIGMA_CORVETTE, 4, disturbance=sea)
        core.start(0)
        for _ in range(60):
            core.step(np.zeros((4, 1)))
        rewards.append(core.total.copy())
    assert np.abs(rewards[0] - rewards[1]).min() > 0.1


def test_filters_are_told_of_a_sea_of_no_direction_and_hold_its_current():
    core = Core(SIGMA_CORVETTE, 2)
    composition = core.composition
    assert composition.inputs == ("yaw increment",)
    assert composition.names == ("x", "y", "psi", "u", "v", "r", "current north", "current east")
    assert composition.forces.disturbance == MODERATE.believed
    beta = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
    rms = np.sqrt((MODERATE.yaw_rate(beta, 0.8 * SHIP.speed) ** 2).mean())
    assert np.sqrt(composition.forces.increment_cov[0, 0]) == pytest.approx(0.5 * rms, rel=0.05)


@pytest.mark.parametrize("sea", SEAS)
@pytest.mark.parametrize("length", [101.07, 160.93, 320.0])
def test_a_slow_ship_s_unknown_input_filter_flies_in_every_sea(length, sea):
    """Long, slow ships hardly yaw in a calm sea: d is told to be no smaller than what shows in a compass."""
    ship = SHIP if length < 160.0 else replace(MARINER, length=length, beam=length / 7.0, mass=4.089 * length**3)
    core = Core(ship_system(ship), 2, disturbance=sea)
    core.start(0)
    core.step(np.zeros((2, 1)))
    assert not np.any(core.belief.recovery)
    assert core.composition.forces.input_cov[0, 0] >= 1e-6 * (1.0 - 1e-9)


def test_the_ship_s_own_jacobian_is_that_of_her_model():
    """Against differences of the composed transition."""
    for chosen in ({}, {"assume": {"as": "states"}}):
        model = Core(SIGMA_CORVETTE, 1, "ekf", chosen).filter.model
        rng = np.random.default_rng(2)
        x = np.zeros((5, model.n))
        x[:, :6] = rng.standard_normal((5, 6)) * [300.0, 300.0, 2.0, 1.0, 1.0, 0.03] + [0.0, 0.0, 0.0, 12.0, 0.0, 0.0]
        x[:, 6:] = 0.3 * rng.standard_normal((5, model.n - 6))
        u = np.column_stack([0.2 * rng.standard_normal(5), np.full(5, 0.03), x[:, 2], np.ones(5)])
        mean, jacobian = model.linearise_transition(x, u)
        assert mean == pytest.approx(model.transition(x, u), rel=1e-12, abs=1e-12)
        h = 1e-4
        for j in range(model.n):
            step = h * np.eye(model.n)[j]
            column = (model.transition(x + step, u) - model.transition(x - step, u)) / (2.0 * h)
            assert jacobian[..., j] == pytest.approx(column, rel=1e-4, abs=1e-6)  # cross-flow bends sharply


def test_who_is_told_of_the_sea_itself_holds_its_waves():
    core = Core(SIGMA_CORVETTE, 2, "ekf", {"assume": {"disturbance": "moderate", "as": "states"}})
    assert core.composition.names[6:] == MODERATE.names


@pytest.mark.parametrize(
    "wrong",
    [{"height": 0.0}, {"period": -1.0}, {"wind": np.nan}, {"current": -0.1}, {"direction": np.inf}, {"dt": 0.0}],
)
def test_what_no_sea_has_is_refused_in_a_sentence(wrong):
    name = next(iter(wrong))
    with pytest.raises(ValueError, match=f"{name} of a seaway must be"):
        Seaway(SHIP, **({"height": 1.0, "period": 8.0, "wind": 5.0, "current": 0.1, "dt": 0.5} | wrong))
