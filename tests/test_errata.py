"""The misprints of docs/errata.csv, recomputed; the page counts them.

Numbers marked as printed are transcribed from the papers. The file names the tests of each
misprint, some of which stand elsewhere.
"""

import csv
import re
from collections import Counter
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from agents.papers.puna.model import PlanarPuna, planar_derivative
from estimators import Gaussian, make, zero_order_hold
from tests.estimators.cases import random_covariance
from vessel_gym.envs import ThesisCorvetteEnv
from vessel_gym.guidance.dubins import lengths
from vessel_gym.simulation.core import Core
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.puna import trim

ROOT = Path(__file__).parents[1]
FILE = (ROOT / "docs/errata.csv").read_text(encoding="utf-8")
ROWS = {row["number"]: row for row in csv.DictReader(FILE.splitlines())}


def rounds_to(value: float, printed: str) -> bool:
    """Does a value have the printed digits?"""
    last_digit = 10.0 ** Decimal(printed).as_tuple().exponent
    return abs(value - float(printed)) <= 0.5 * last_digit + 1e-9 * abs(value)


def assert_says(number: str, *values: float) -> None:
    """The row of a misprint has each value, with its digits; one digit is no number."""
    texts = re.findall(r"-?\d[\d.]+\d(?:e[+-]?\d+)?|-?\d{2,}", str(ROWS[number]))
    for value in values:
        assert any(rounds_to(value, text) for text in texts), (number, value)


# --- C: the thesis on the corvette ----------------------------------------------------------------

SHIP = load("corvette")
L, B, T = SHIP.length, SHIP.beam, SHIP.draught
FIFTH = replace(SHIP, yaw_radius=0.2)  # as in the thesis
TABLE_4_2 = {
    "Nvdot": "1.1638e-5", "Yvdot": "-0.0055", "Nrdot": "-3.3426e-4", "Yrdot": "-0.0107",
    "Nv": "-0.0025", "Yv": "-0.0083", "Nr": "-0.0013", "Yr": "9.4906e-4",
}  # fmt: skip
# Eqs. 4.1 and 4.2.
M_PRINTED = np.array([[0.0100, 0.0109], [2.3780e-4, 2.0769e-6]])
N_PRINTED = np.array([[0.0083, 0.0036], [0.0025, 0.0016]])
AB_PRINTED = np.array([[0.8318, 0.3622, -5.2378e-7], [1.0959e-9, 7.2702e-10, 4.8150e-7]])


def printed_derivatives(pi: float) -> dict[str, float]:
    """Eqs. 2.18-2.25 with C_B = 0.65; 2.19 as printed, 2.23 with -1/2 and 0.008."""
    # The block coefficient of the package follows from the mass: this ship has the printed one.
    full = replace(SHIP, mass=0.65 * L * B * T * SHIP.water_density)
    slender = np.pi * (T / L) ** 2
    wrong = {
        "Yrdot": -slender * (0.67 * B / T - 0.0033 * (B / L) ** 2),
        "Yr": -slender * (-1 / 2 + 2.2 * B / L - 0.008 * B / T),
    }
    return {name: value * pi / np.pi for name, value in (full.clarke | wrong).items()}


def motion(c: dict[str, float], Iz: float = FIFTH.clarke["Iz"]) -> tuple[np.ndarray, np.ndarray]:
    """M' and N' of eq. 4.1 from derivatives."""
    m, moment = SHIP.clarke["m"], SHIP.clarke["m"] * SHIP.x_g / L
    M = [[m - c["Yvdot"], moment - c["Yrdot"]], [moment - c["Nvdot"], Iz - c["Nrdot"]]]
    return np.array(M), np.array([[-c["Yv"], m - c["Yr"]], [-c["Nv"], moment - c["Nr"]]])


def test_table_4_2_follows_from_the_misprints_and_pi_3_14():
    computed = printed_derivatives(3.14)
    assert all(rounds_to(computed[name], printed) for name, printed in TABLE_4_2.items())
    assert not rounds_to(printed_derivatives(np.pi)["Nvdot"], TABLE_4_2["Nvdot"])


def test_eq_2_13_lacks_the_fifth_power_of_the_length():
    fifth = FIFTH.clarke["Iz"]
    assert_says("C6", fifth * L**5, fifth)
    # the gyration radius as printed, less than the distance of the centre of gravity
    assert np.sqrt(2.0769e-6 / SHIP.clarke["m"]) * L < SHIP.x_g


def test_the_printed_inertia_matrix_has_a_negative_determinant():
    assert_says("C7", np.linalg.det(M_PRINTED), np.linalg.det(motion(SHIP.clarke)[0]))


def test_eq_4_2_follows_from_eq_4_1_with_ten_to_the_plus_six():
    rows = np.linalg.solve(M_PRINTED, np.column_stack([N_PRINTED, [0.0, 1.0]]))
    assert_says("C8", *rows.flat)
    M, N = motion(printed_derivatives(3.14), FIFTH.clarke["Iz"] * L**5)
    np.testing.assert_allclose([M[0], *N], [M_PRINTED[0], *N_PRINTED], rtol=0, atol=5e-5)
    found = np.linalg.solve(M, np.column_stack([N, [0.0, 1.0]]))  # without a minus sign
    assert (np.abs(found - AB_PRINTED) <= [[5e-5, 5e-5, 5e-12], [5e-14, 5e-15, 5e-12]]).all()


def test_the_sway_of_eq_4_2_diverges_without_its_minus_sign():
    assert_says("C9", np.linalg.eigvals(AB_PRINTED[:, :2]).max())
    M, N = motion(SHIP.clarke, SHIP.clarke["Iz"])
    assert np.linalg.eigvals(-np.linalg.solve(M, N)).real.max() < 0.0


def test_eq_4_2_counts_time_in_6_56_s_and_eq_4_3_in_seconds():
    assert_says("C11", L / SHIP.speed, 0.5 * SHIP.speed / L)


def test_the_printed_rudder_turns_the_ship_2000_times_too_hard():
    assert_says("C12", 1.0 / replace(SHIP, rudder_area=5.5).clarke["Ndelta"])


def test_a12_and_a21_have_a_wrong_letter_each():
    m, mx, Yvdot, Nvdot, Yv, Yr, Nv, Nr, m12, m22 = np.random.default_rng(0).uniform(-1, 1, 10)
    M = np.array([[m - Yvdot, m12], [mx - Nvdot, m22]])
    A = np.linalg.solve(M, [[Yv, Yr - m], [Nv, Nr - mx]]) * np.linalg.det(M)  # u0 = 1
    right = m22 * (Yr - m) - m12 * (Nr - mx), M[0, 0] * Nv - (mx - Nvdot) * Yv
    np.testing.assert_allclose([A[0, 1], A[1, 0]], right, rtol=1e-12)
    printed = m22 * (Yv - m) - m12 * (Nr - mx), M[0, 0] * Nv - (mx - Yvdot) * Nv
    assert (np.abs(np.subtract(printed, right)) > 0.1).all()


def test_i_xy_and_i_yz_vanish_for_a_hull_mirrored_in_xz():
    points = np.random.default_rng(1).normal(size=(50, 3))
    for mirror, symmetric in (([1, -1, 1], True), ([1, 1, -1], False)):  # printed: the xy plane
        x, y, z = np.concatenate([points, points * mirror]).T
        assert (abs(x @ y) + abs(y @ z) < 1e-12) == symmetric


def test_the_printed_covariance_prediction_lacks_sign_gain_and_s():
    core = Core(ThesisCorvetteEnv.system, estimator_options={"model": "as_printed"})
    noise = 1e-3 * np.eye(3)  # eq. 4.6
    model = replace(core.config.estimation.filter.model, Q=noise, R=noise[:2, :2])
    A, C, G, H = (np.asarray(getattr(model, name)) for name in "ACGH")
    filter = make("kf-umv-ui", model)
    prior = Gaussian(np.zeros(3), np.diag([0.02, 3e-4, 2e-3]))
    belief = filter.update(filter.init(prior), np.zeros(2))
    cross = A @ C.T @ np.linalg.inv(model.R) @ H @ G.T
    printed = A @ belief.cov @ A.T + cross + cross.T + G @ belief.input_cov @ G.T + noise
    assert printed[2, 2] > 2000.0  # rad2
    assert filter.predict(belief, np.zeros(3)).cov[2, 2] < 0.01


def test_the_text_on_simulation_ii_gives_simulation_i_s_mean():
    # RMSE of the heading in Simulations I to III: Tables 4.4 to 4.6
    first, second, third = np.array([[47, 46, 48], [48, 49, 47], [95, 53, 57]]) * 1e-4
    assert_says("C29", first.mean(), second.mean(), third.mean())
    assert min(third) > max(first)  # "no significant change"


def test_the_larger_input_of_simulation_v_is_ten_times_smaller():
    k = np.arange(195)
    first, fifth = ((k >= 0) - 2.0 * (k >= lag) for lag in (1.0, 0.1))
    np.testing.assert_array_equal(fifth, first)  # each of them times 0.1 in V
    assert_says("C31", 0.0057 / 0.0006)  # Tables 4.4 and 4.8


# --- S: the paper on the Segorogeni ---------------------------------------------------------------

INVERSE = np.array([
    [0.162, -0.0024, 0.8989, 0.0011, 0.0980, 0.0001],
    [-0.0012, -0.8175, -0.0206, -0.0431, -0.0024, 0.0969],
    [1.8855, -0.0418, -1.0230, -0.0036, -0.2205, 0.0024],
    [-0.0518, 0.8865, 0.0511, 1.0468, 0.0088, -0.1050],
    [15.9131, -0.3634, -17.0743, -0.0425, -1.8611, 0.0213],
    [-0.0128, 15.7327, 0.1966, 0.8288, 0.0240, -0.8641],
])  # fmt: skip
"""The matrix after eq. 19."""
EQ_11 = np.linalg.inv(INVERSE)
"""Rows of the inertia, each over its diagonal."""
TABLE_III = np.array([
    [0.4702, 0.4674, 0.0823], [0.4636, 0.4666, 0.0819],
    [0.4648, 0.4657, 0.0814], [0.4632, 0.4644, 0.0820],
])  # fmt: skip


def test_the_printed_inverse_has_the_ones_and_zeros_of_eq_11():
    np.testing.assert_allclose(np.diag(EQ_11), 1.0, rtol=0, atol=1e-3)
    shape = ["x...xx", ".x.x.x", "..xxx.", ".xxx..", "x.x.x.", "xx...x"]
    zero = np.array([list(row) for row in shape]) == "."
    np.testing.assert_allclose(EQ_11[zero], 0.0, rtol=0, atol=4e-3)


def test_the_signs_of_roll_s_row_of_eq_11_are_turned():
    i, j = np.array([(0, 4), (0, 5), (2, 4), (1, 5), (1, 3), (2, 3)]).T
    # An inertia is symmetric: signs across are equal.
    np.testing.assert_array_equal(EQ_11[i, j] * EQ_11[j, i] > 0.0, [True] * 4 + [False] * 2)


def test_printed_pitch_and_yaw_inertia_are_an_eighth_of_roll_s():
    assert 7.5 < EQ_11[4, 0] / EQ_11[3, 1] < 8.5  # m z_G over each inertia; S3 has the sign
    body = load("segorogeni")
    assert_says("S4", np.sqrt(EQ_11[0, 4] / EQ_11[4, 0]), np.sqrt(body.pitch_inertia / body.mass))
    assert 8.0 * body.roll_inertia < body.pitch_inertia


def test_eq_11_is_an_inertia_with_roll_and_pitch_exchanged():
    ratio = -EQ_11[4, 0] / EQ_11[3, 1]
    factors = np.array([1.0, 1.0, 1.0, ratio, -1.0 / ratio, -1.0 / ratio])
    for rescale, negative in ((factors, 0), (np.sign(factors), 2), (np.ones(6), 2)):
        rows = np.where(np.eye(6, dtype=bool), EQ_11, EQ_11 * rescale[:, None])
        assert (np.linalg.eigvals(rows).real < 0.1).sum() == negative


def test_eq_17_has_the_wrong_sign_before_its_bracket():
    rng = np.random.default_rng(2)
    m, velocity, turn, centre, acceleration, angular = 15.0, *rng.normal(size=(5, 3))
    inertia, (u, v, w), (p, q, r) = rng.uniform(1.0, 2.0, 3), velocity, turn
    # Newton and Euler about the origin: the yaw moment that these motions take.
    moment = inertia * angular + np.cross(turn, inertia * turn)
    moment += m * np.cross(centre, acceleration + np.cross(turn, velocity))
    bracket = m * (centre[0] * (u * r - w * p) - centre[1] * (w * q - v * r))
    left = inertia[2] * angular[2] + m * np.cross(centre, acceleration)[2]
    rest = moment[2] - (inertia[1] - inertia[0]) * p * q
    assert left == pytest.approx(rest - bracket, rel=1e-12)
    assert abs(left - (rest + bracket)) > 1.0  # printed


def test_table_iii_has_errors_of_47_cm_and_no_accuracy():
    assert_says("S10", *TABLE_III.mean(0)[:2])
    assert_says("S11", *(100.0 * (1.0 - TABLE_III[[0, 3], [0, 0]])))
    assert (1.0 - TABLE_III / [10.0, 18.0, 6.0]).min() > 0.95  # of the dive


# --- I: the paper on the ITSUNUSA -----------------------------------------------------------------

TABLE_2 = np.array([
    [0.02568, 0.02079, 0.01582], [0.02344, 0.01872, 0.01269],
    [0.00539, 0.00465, 0.00415], [0.03541, 0.02875, 0.01938],
])  # fmt: skip
"""RMSE of surge, heave, pitch rate and position for 200, 300 and 400 members."""


def test_printed_errors_are_means_over_three_ensembles():
    assert_says("I9", 100.0 * 0.03 / 20.0)
    assert_says("I10", *TABLE_2.mean(1), *TABLE_2[:, 2])


def test_itsunusa_displaces_six_to_nine_times_its_printed_mass():
    body = load("itsunusa")
    cylinder = np.pi / 4.0 * 0.30**2 * 2.0 * body.water_density
    assert_says("I1", body.buoyancy / body.gravity, cylinder)


# --- R: the paper on the robust filter ------------------------------------------------------------

RNG = np.random.default_rng(10)
A, C, K = (RNG.normal(size=size) for size in ((3, 3), (2, 3), (3, 2)))
P, Q, R = (random_covariance(RNG, n) for n in (3, 3, 2))


def test_the_printed_derivative_of_the_trace_is_wrong():
    def cost(K: np.ndarray) -> float:
        rest = np.eye(3) - K @ C
        return np.trace(rest @ P @ rest.T + K @ R @ K.T)

    # The cost is a quadratic form, of which a central difference is exact.
    slopes = [0.5 * (cost(K + E) - cost(K - E)) for E in np.eye(6).reshape(6, 3, 2)]
    expected = -2.0 * P @ C.T + 2.0 * K @ (C @ P @ C.T + R)
    np.testing.assert_allclose(np.reshape(slopes, (3, 2)), expected, rtol=0, atol=1e-6)
    assert (C @ P).shape != K.shape  # printed: -2 C P


@pytest.mark.parametrize("seed", range(3))
def test_no_weight_and_no_known_input_moves_the_best_gain(seed: int):
    """The cost rises by ``tr(W D S D')`` when the gain moves by D from the Kalman filter's."""
    rng = np.random.default_rng(seed)
    W, D, u, S = (
        random_covariance(rng, 3),
        rng.normal(size=K.shape),
        rng.normal(size=2),
        C @ P @ C.T + R,
    )

    def cost(K: np.ndarray) -> float:
        rest = np.eye(3) - K @ C
        return np.trace(W @ (rest @ P @ rest.T + K @ R @ K.T)) + u @ R @ u

    best = P @ C.T @ np.linalg.inv(S)
    rise = cost(best + D) - cost(best)
    assert rise == pytest.approx(np.trace(W @ D @ S @ D.T), rel=1e-9)
    assert rise > 0.0


def test_noise_times_its_transpose_is_singular_its_mean_is_r():
    v = np.random.default_rng(9).multivariate_normal(np.zeros(2), R, 20_000)
    assert np.linalg.matrix_rank(np.outer(v[0], v[0])) == 1
    np.testing.assert_allclose(v.T @ v / len(v), R, rtol=0, atol=0.05 * np.trace(R))


def test_eq_11_lacks_a_on_either_side_of_the_gain():
    P = solve_discrete_are(A.T, C.T, Q, R)
    S = C @ P @ C.T + R
    K = P @ C.T @ np.linalg.inv(S)
    np.testing.assert_allclose(A @ (P - K @ S @ K.T) @ A.T + Q, P, rtol=1e-9, atol=1e-9)
    assert np.abs(A @ P @ A.T + Q - K @ S @ K.T - P).max() > 0.1  # printed


def test_eqs_12_to_14_use_one_p_for_prediction_and_update():
    before = solve_discrete_are(A.T, C.T, Q, R)
    K = before @ C.T @ np.linalg.inv(C @ before @ C.T + R)
    after = before - K @ C @ before
    np.testing.assert_allclose(A @ after @ A.T + Q, before, rtol=1e-9, atol=1e-9)
    for P in (before, after):  # neither solves eqs. 12 and 14 as printed
        assert min(np.abs(A @ P @ A.T + Q - P).max(), np.abs(K @ C @ P).max()) > 0.01


def test_a_of_a_step_is_not_a_of_the_differential_equation():
    B = np.ones((3, 1))
    step, push = zero_order_hold(A, B, 1e-4)
    np.testing.assert_allclose(step, np.eye(3) + 1e-4 * A, rtol=0, atol=1e-7)
    np.testing.assert_allclose(push, 1e-4 * B, rtol=0, atol=1e-7)


# --- P: the paper on the PUNA ---------------------------------------------------------------------

TURN, BEARING = 100.0, np.pi / 6
"""Case (a), from (-500, 100) to (0, 200); the heading counts from the y axis."""
PLANE, CRUISE = load("puna"), trim(20.0, load("puna"))
LEVEL = np.array([0.0, 20.0, 0.0, 100.0])


def test_g_sin_alpha_does_not_keep_the_energy():
    stone = replace(PLANE, lift=(0.0, 0.0), drag=(0.0, 0.0, 0.0))
    v, alpha = 20.0, 0.05
    state, control = np.array([0.3, v, 0.0, 100.0]), np.array([0, alpha])
    right, printed = (
        planar_derivative(state, control, stone.vector(), as_printed)
        for as_printed in (False, True)
    )
    powers = [v * rates[1] + stone.gravity * rates[3] for rates in (right, printed)]
    assert powers[0] == pytest.approx(0.0, abs=1e-12)
    assert powers[1] > 48.0  # W/kg


def test_lift_proportional_to_c_l_alpha_carries_a_fiftieth():
    pressure = 0.5 * PLANE.density[2] * 20.0**2 * PLANE.area
    share = pressure * np.polyval(PLANE.lift, CRUISE.alpha) / (PLANE.mass * PLANE.gravity)
    assert share == pytest.approx(1.0, abs=0.01)
    assert share * CRUISE.alpha == pytest.approx(0.023, abs=5e-4)


def test_eq_5_gives_the_left_circle_for_either_sign():
    theta, quarter = 0.7, np.array([1.0, -1.0]) * np.pi / 2
    towards = np.stack([np.cos(theta + quarter), np.sin(theta + quarter)])
    np.testing.assert_allclose(towards[:, 0], -towards[:, 1], rtol=1e-12)  # on either side
    printed = [1, -1] * towards
    np.testing.assert_allclose(printed[:, 0], printed[:, 1], rtol=1e-12)


def test_eq_7_excludes_the_equal_circles_of_both_cases():
    start, goal = np.array([-500.0, 100.0, np.pi / 3]), np.array([0.0, 200.0, np.pi / 2])
    # LSL, LSR, RSL and RSR: every tangent exists, though r_f > r_s does not hold.
    assert np.isfinite(lengths(start, goal, TURN)[:4]).all()


def test_eq_15_adds_an_angle_to_a_length():
    def printed(unit: float) -> float:
        line, r, theta, beta, gamma = 1000.0 * unit, 100.0 * unit, 0.4, 0.3, 0.2
        return line + r * np.pi + 2 * r * theta - 2 * r * beta - gamma

    assert abs(printed(2.0) - 2.0 * printed(1.0)) > 0.1


def test_eq_16_has_a_negative_line_and_a_sine_for_a_cosine():
    x0, r, chi = -500.0, TURN, BEARING
    first = (x0 + r * np.sin(chi) + r) + (np.pi / 2 - chi) * r + np.pi / (2 * r)
    second, mended = (-x0 - r * f(chi) - r + (np.pi - chi) * r for f in (np.sin, np.cos))
    assert_says("P15", first, second, mended)
    y = np.linspace(0.0, 500.0, 1001)
    goals = np.stack([np.zeros_like(y), y, np.full_like(y, np.pi / 2)], -1)
    found = lengths(np.array([x0, 100.0, np.pi / 2 - chi]), goals, r).min(-1)
    assert found.min() == pytest.approx(mended, abs=1e-9)
    assert_says("P16", y[found.argmin()])


def test_a_step_of_the_model_is_not_linear():
    step, control = PlanarPuna().step, np.array([4.0, 0.02])
    assert np.abs(step(2.0 * LEVEL, control) - 2.0 * step(LEVEL, control)).max() > 0.03


def test_eq_25_leaves_the_aircraft_where_it_is():
    moved = PlanarPuna().step(LEVEL, np.array([CRUISE.thrust, CRUISE.alpha]))
    assert moved[2] == pytest.approx(0.2)  # 20 m/s for 0.01 s; printed: nothing but noise


def test_members_that_start_from_the_mean_forget_the_covariance():
    rng, F = np.random.default_rng(11), np.array([[1.0, 0.5], [0.0, 1.0]])
    members, noise = rng.normal(size=(2, 20_000, 2)) * np.sqrt([[[2.0, 1.0]], [[0.1, 0.1]]])
    each, mean = (start @ F.T + noise for start in (members, members.mean(0)))
    forecast = F @ np.diag([2.0, 1.0]) @ F.T + 0.1 * np.eye(2)
    np.testing.assert_allclose(np.cov(each.T), forecast, rtol=0, atol=0.1)
    np.testing.assert_allclose(np.cov(mean.T), 0.1 * np.eye(2), rtol=0, atol=0.01)  # printed


# --- the page -------------------------------------------------------------------------------------


def test_misprints_are_numbered_and_complete():
    counts = Counter(number[0] for number in ROWS)
    assert [*ROWS] == [f"{paper}{i}" for paper in "CSIRP" for i in range(1, counts[paper] + 1)]
    for row in ROWS.values():
        assert all(row[column] for column in ("where", "printed", "should be")), row
        assert bool(row["evidence"]) == bool(row["tests"]), row


def test_misprints_name_their_tests():
    named = set(re.findall(r"`(tests/[^`]*)::(\w+)`", FILE))
    for file, name in named:
        assert f"\ndef {name}(" in (ROOT / file).read_text(encoding="utf-8"), name
    own = re.findall(r"^def (test_\w+)\(", Path(__file__).read_text(encoding="utf-8"), re.M)
    assert {("tests/test_errata.py", name) for name in own[:-3]} <= named  # the last: of the page


def test_the_page_counts_misprints_by_paper():
    page = (ROOT / "docs/errata.md").read_text(encoding="utf-8")
    recomputed = [number for number, row in ROWS.items() if row["tests"]]
    assert f"Of {len(ROWS)} misprints, {len(recomputed)} are recomputed" in " ".join(page.split())
    counts = re.findall(r"^\| \*\*([CSIRP])\*\*.*?\| (\d+) \| (\d+) \|", page, re.M)
    of = [Counter(number[0] for number in numbers) for numbers in (ROWS, recomputed)]
    assert counts == [(paper, *(str(each[paper]) for each in of)) for paper in "CSIRP"]
