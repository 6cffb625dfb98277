"""Sea trials: the figures of a track against tracks whose figures are known, and the ship against the standards."""

from dataclasses import replace

import numpy as np
import pytest

from vessel_gym.sea_trials import circle_geometry, fit_circle, initial_turning, simulate, turning_circle, zigzag
from vessel_gym.vehicles.corvette import steady_turns
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.files import load

SHIP = load("corvette-thesis")
SHIPS = {"thesis": SHIP, "corvette": load("corvette")}
each_ship = pytest.mark.parametrize("ship", SHIPS.values(), ids=SHIPS)
L = SHIP.length
DEG = np.pi / 180.0

both_sides = pytest.mark.parametrize("side", [1, -1], ids=["starboard", "port"])


# --- geometry of a track ----------------------------------------------------------------------------


def run_and_turn(radius: float, side: int, heading: float, step: float, straight: int = 10):
    """A straight run, then a circle sampled every ``step`` rad of heading."""
    arc = np.arange(round(2.5 * np.pi / step) + 1) * step
    ahead = np.concatenate([radius * step * np.arange(-straight, 0), radius * np.sin(arc)])
    aside = side * np.concatenate([np.zeros(straight), radius * (1.0 - np.cos(arc))])
    psi = heading + side * np.concatenate([np.zeros(straight), arc])
    x = 40.0 + ahead * np.cos(heading) - aside * np.sin(heading)
    y = -70.0 + ahead * np.sin(heading) + aside * np.cos(heading)
    return x, y, psi


@both_sides
@pytest.mark.parametrize("heading", [0.0, 1.0, -3.1, 3.1])
def test_a_circular_track_has_the_figures_of_its_radius(side, heading):
    step, dt = np.pi / 90, 0.5
    x, y, psi = run_and_turn(200.0, side, heading, step)
    wrapped = np.arctan2(np.sin(psi), np.cos(psi))
    reach = 10 * 200.0 * step
    for angles in (psi, wrapped):
        g = circle_geometry(x, y, angles, dt)
        np.testing.assert_allclose(
            [g.advance, g.transfer, g.tactical_diameter], [200.0 + reach, 200.0, 400.0], rtol=0, atol=1e-9
        )
        np.testing.assert_allclose(
            [g.time_to_90, g.time_to_180, g.time_to_360], np.array([55, 100, 190]) * dt, rtol=0, atol=1e-9
        )


def test_between_samples_the_position_is_interpolated_within_the_sagitta_of_the_chord():
    radius, step = 200.0, 0.07  # 90 and 180 deg fall between samples
    g = circle_geometry(*run_and_turn(radius, 1, 0.0, step, straight=1)[:3])
    reach, sagitta = radius * step, radius * step**2 / 8.0
    for figure, exact in ((g.advance, radius + reach), (g.transfer, radius), (g.tactical_diameter, 2.0 * radius)):
        assert 0.0 < abs(figure - exact) < 1.01 * sagitta


def test_figures_that_a_track_does_not_reach_are_none():
    x, y, psi = run_and_turn(200.0, 1, 0.5, np.pi / 90)
    whole = circle_geometry(x, y, psi, 0.5)
    before_90, before_180, before_360 = (circle_geometry(x[:k], y[:k], psi[:k], 0.5) for k in (50, 95, 180))
    assert before_90.advance is before_90.transfer is before_90.tactical_diameter is before_90.time_to_90 is None
    assert before_180 == replace(whole, tactical_diameter=None, time_to_180=None, time_to_360=None)
    assert before_360 == replace(whole, time_to_360=None)
    assert circle_geometry(x, y, psi) == replace(whole, time_to_90=None, time_to_180=None, time_to_360=None)


def test_the_geometry_leaves_its_inputs_alone():
    track = run_and_turn(200.0, -1, 3.0, 0.05)
    copies = [a.copy() for a in track]
    circle_geometry(*track, 0.5)
    fit_circle(*track[:2])
    for a, b in zip(track, copies, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(("arc", "offset"), [(0.5, 0.0), (np.pi, 1e5), (2.0 * np.pi, -1e5)])
def test_a_circle_is_fitted_exactly_to_points_on_it(arc, offset):
    angle = np.linspace(0.3, 0.3 + arc, 40)
    circle = fit_circle(offset + 200.0 * np.cos(angle), 30.0 + 200.0 * np.sin(angle))
    np.testing.assert_allclose([circle.x, circle.y, circle.radius], [offset, 30.0, 200.0], rtol=0, atol=1e-7)
    assert circle.rms < 1e-9


def test_the_residual_of_a_fitted_circle_is_the_noise_across_it():
    angle = np.linspace(0.0, 2.0 * np.pi, 401)[:-1]
    distance = 200.0 + 2.0 * np.cos(40.0 * angle)  # RMS sqrt 2, orthogonal to shift and size
    circle = fit_circle(distance * np.cos(angle), distance * np.sin(angle))
    assert circle.rms == pytest.approx(np.sqrt(2.0), rel=1e-3)
    assert circle.radius == pytest.approx(200.0, rel=1e-4)


@pytest.mark.parametrize(
    ("x", "y"), [([0.0, 1.0], [0.0, 1.0]), ([0.0, 1.0, 2.0, 3.0], [1.0, 3.0, 5.0, 7.0]), ([2.0] * 4, [3.0] * 4)]
)
def test_no_circle_is_fitted_to_a_line_or_to_a_point(x, y):
    with pytest.raises(ValueError, match="points"):
        fit_circle(x, y)


# --- running the ship -------------------------------------------------------------------------------


def test_the_rudder_moves_at_its_rate_to_its_limit():
    track = simulate(SHIP, 50 * DEG, 20.0, 0.3)
    np.testing.assert_allclose(track.rudder, np.minimum(SHIP.rudder_rate * track.time, SHIP.rudder_limit), atol=1e-12)
    back = simulate(SHIP, -4 * DEG, 4.0, 0.3, start=track.state[-1], rudder=track.rudder[-1])
    expected = np.maximum(SHIP.rudder_limit - SHIP.rudder_rate * back.time, -4 * DEG)
    np.testing.assert_allclose(back.rudder, expected, atol=1e-12)


def test_a_step_in_which_the_rudder_arrives_keeps_the_order_of_the_integration():
    exact = simulate(SHIP, 4 * DEG, 10.0, 0.005).state[-1]  # arrives after 0.8 s, inside a step of the others
    whole, half = (np.abs(simulate(SHIP, 4 * DEG, 10.0, dt).state[-1] - exact).max() for dt in (0.5, 0.25))
    assert whole < 1e-5
    assert whole / half > 12.0  # 16 for RK4, 4 or less if the ramp were stretched to the end of its step


def test_an_angle_a_schedule_and_a_function_command_alike():
    constant = simulate(SHIP, 0.2, 30.0)
    for command in (np.full(60, 0.2), [0.2] * 60, lambda t, state: 0.2):
        np.testing.assert_array_equal(simulate(SHIP, command, 30.0).state, constant.state)


def test_a_command_sees_the_time_and_the_state_at_the_start_of_its_step():
    seen = []
    track = simulate(SHIP, lambda t, state: seen.append((t, *state)) or 0.1, 5.0, 0.5)
    np.testing.assert_array_equal(np.array(seen), np.column_stack([track.time, track.state])[:-1])


@pytest.mark.parametrize(
    ("command", "duration", "dt"), [(0.1, 10.0, 0.0), (0.1, -1.0, 0.5), (np.zeros(5), 10.0, 0.5), (0.1, np.nan, 0.5)]
)
def test_a_run_that_makes_no_sense_is_refused(command, duration, dt):
    with pytest.raises(ValueError, match=r"positive|schedule"):
        simulate(SHIP, command, duration, dt)


def test_a_current_carries_the_track_and_changes_nothing_else():
    calm, carried = (simulate(SHIP, 0.3, 100.0, current=current) for current in ((0.0, 0.0), (0.7, -1.2)))
    drift = np.outer(calm.time, [0.7, -1.2])
    np.testing.assert_allclose(carried.state[:, :2], calm.state[:, :2] + drift, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(carried.state[:, 2:], calm.state[:, 2:])


def test_over_ground_a_current_adds_its_drift_to_advance_and_tactical_diameter():
    calm, carried = (simulate(SHIP, 0.5, 120.0, current=current) for current in ((0.0, 0.0), (0.7, 0.4)))
    g, over_ground = (circle_geometry(*track.state.T[:3], 0.5) for track in (calm, carried))
    assert over_ground.advance - g.advance == pytest.approx(0.7 * g.time_to_90, abs=1e-9)
    assert over_ground.transfer - g.transfer == pytest.approx(0.4 * g.time_to_90, abs=1e-9)
    assert over_ground.tactical_diameter - g.tactical_diameter == pytest.approx(0.4 * g.time_to_180, abs=1e-9)


# --- turning circle ---------------------------------------------------------------------------------


@both_sides
def test_the_turning_circle_is_a_frigate_s_and_meets_the_standard(side):
    trial = turning_circle(SHIP, side * 35 * DEG)
    assert trial.track.state[0, 3] == 15.4
    assert 3.0 * L < trial.advance < 4.5 * L  # MSC.137(76): at most 4.5 L
    assert 4.0 * L < trial.tactical_diameter < 5.0 * L  # at most 5 L
    assert 0.5 < trial.speed_ratio < 0.7
    assert trial.final_speed == pytest.approx(trial.speed_ratio * 15.4)
    assert side * trial.track.state[-1, 2] > 4.0 * np.pi  # positive rudder turns to starboard
    assert side * trial.track.state[-1, 5] > 0.0


def test_the_turning_circle_is_what_was_measured_when_the_ship_was_chosen():
    trial = turning_circle(SHIP, 35 * DEG)
    measured = np.array([trial.advance, trial.transfer, trial.tactical_diameter, trial.steady_radius]) / L
    np.testing.assert_allclose(measured, [3.222, 1.800, 4.348, 2.204], rtol=0, atol=5e-4)
    np.testing.assert_allclose([trial.speed_ratio, trial.time_to_360], [0.5972, 148.75], rtol=1e-4)


@each_ship
@pytest.mark.parametrize("rudder", [5 * DEG, 20 * DEG, 35 * DEG])
def test_port_and_starboard_mirror_each_other(ship: CorvetteParameters, rudder):
    starboard, port = turning_circle(ship, rudder), turning_circle(ship, -rudder)
    mirror = np.array([1, -1, -1, 1, -1, -1, -1, -1])
    np.testing.assert_allclose(port.track.state * mirror, starboard.track.state, rtol=0, atol=1e-9)
    for name in ("advance", "transfer", "tactical_diameter", "steady_radius", "speed_ratio", "time_to_360"):
        assert getattr(port, name) == pytest.approx(getattr(starboard, name), rel=0, abs=1e-9)


@each_ship
def test_halving_the_step_moves_the_tactical_diameter_by_less_than_a_hundredth_of_a_percent(ship: CorvetteParameters):
    for rudder in (10 * DEG, 20 * DEG, 35 * DEG):
        whole, half = (turning_circle(ship, rudder, dt=dt).tactical_diameter for dt in (0.5, 0.25))
        assert abs(half / whole - 1.0) < 1e-4


@each_ship
@pytest.mark.parametrize("k", [20, 80, 160])
def test_the_trial_settles_on_the_steady_turn_that_was_solved_for(ship: CorvetteParameters, k):
    turns = steady_turns(ship)
    trial = turning_circle(ship, turns.rudder[k], turns=3.0)
    assert trial.steady_radius == pytest.approx(turns.radius[k], rel=1e-6)
    assert trial.final_speed == pytest.approx(np.hypot(turns.speed[k], turns.sway[k]), rel=1e-6)


@each_ship
def test_steady_turns_are_similar_at_every_speed(ship: CorvetteParameters):
    # Every force goes with the square of the speed.
    fast, slow = turning_circle(ship, 0.4, turns=3.0), turning_circle(ship, 0.4, speed=7.0, turns=3.0)
    assert slow.track.state[0, 3] == 7.0
    assert slow.steady_radius == pytest.approx(fast.steady_radius, rel=1e-5)
    assert slow.speed_ratio == pytest.approx(fast.speed_ratio, rel=1e-5)
    assert slow.time_to_360 > 2.0 * fast.time_to_360


def test_a_turn_that_is_cut_short_has_no_steady_radius():
    trial = turning_circle(SHIP, 35 * DEG, longest=60.0)
    assert trial.steady_radius is trial.tactical_diameter is trial.time_to_360 is None
    assert trial.advance is not None


# --- zig-zag and initial turning --------------------------------------------------------------------


@each_ship
@both_sides
def test_the_zigzag_overshoots_meet_the_standard(ship: CorvetteParameters, side):
    assert L / ship.speed < 10.0  # s, the class of ships to which these limits belong
    ten, twenty = zigzag(ship, side * 10 * DEG), zigzag(ship, side * 20 * DEG)
    assert 0.0 < ten.first_overshoot <= 10 * DEG
    assert 0.0 < ten.second_overshoot <= 25 * DEG
    assert 0.0 < twenty.first_overshoot <= 25 * DEG


@each_ship
def test_a_zigzag_to_port_mirrors_one_to_starboard(ship: CorvetteParameters):
    starboard, port = zigzag(ship, 20 * DEG), zigzag(ship, -20 * DEG)
    mirror = np.array([1, -1, -1, 1, -1, -1, -1, -1])
    np.testing.assert_allclose(port.track.state * mirror, starboard.track.state, rtol=0, atol=1e-9)
    np.testing.assert_allclose(port.executes, starboard.executes, rtol=0, atol=1e-9)
    assert port.first_overshoot == pytest.approx(starboard.first_overshoot, abs=1e-9)


def test_the_rudder_is_reversed_when_the_heading_is_reached_and_the_overshoot_is_what_follows():
    trial = zigzag(SHIP, 20 * DEG, 15 * DEG, dt=0.02)
    time, psi = trial.track.time, trial.track.state[:, 2]
    np.testing.assert_allclose(np.interp(trial.executes[1:], time, psi), 15 * DEG * np.array([1, -1, 1]), atol=1e-6)
    assert psi.max() - 15 * DEG == pytest.approx(trial.first_overshoot, abs=1e-6)
    assert -psi.min() - 15 * DEG == pytest.approx(trial.second_overshoot, abs=1e-6)
    assert trial.period == trial.executes[3] - trial.executes[1]
    soon_after = np.interp(np.array(trial.executes[:3]) + 8.5, time, trial.track.rudder)
    np.testing.assert_allclose(soon_after, 20 * DEG * np.array([1, -1, 1]), atol=1e-12)


@each_ship
def test_overshoots_do_not_depend_on_where_the_samples_fall(ship: CorvetteParameters):
    fine, coarse = zigzag(ship, 20 * DEG, dt=0.02), zigzag(ship, 20 * DEG, dt=0.5)
    assert coarse.first_overshoot == pytest.approx(fine.first_overshoot, abs=0.002 * DEG)
    assert coarse.period == pytest.approx(fine.period, abs=1e-3)


def test_a_zigzag_that_runs_out_of_time_says_so():
    trial = zigzag(SHIP, 20 * DEG, longest=20.0)
    assert trial.first_overshoot is not None
    assert trial.second_overshoot is trial.period is None
    assert trial.track.time[-1] == 20.0


@each_ship
@both_sides
def test_ten_degrees_of_heading_take_less_than_two_and_a_half_lengths(ship: CorvetteParameters, side):
    distance = initial_turning(ship, side * 10 * DEG)
    assert 1.0 < distance < 2.5  # MSC.137(76)
    assert initial_turning(ship, side * 10 * DEG, dt=0.05) == pytest.approx(distance, rel=1e-4)
    assert initial_turning(ship, side * 10 * DEG, longest=5.0) is None
