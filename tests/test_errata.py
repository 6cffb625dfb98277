"""The misprints of docs/errata.csv, recomputed; the page counts them.

Numbers marked as printed are transcribed from the papers. The file names the tests of each
misprint, some of which stand elsewhere.
"""

import csv
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from estimators import Gaussian, LinearModel, make, zero_order_hold
from studies.papers.puna.model import PlanarPuna, planar_derivative
from vessel_gym.core import Core
from vessel_gym.envs import ThesisCorvetteEnv
from vessel_gym.guidance.dubins import lengths
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.puna import trim

ROOT = Path(__file__).parents[1]

# --- C: the thesis on the corvette ----------------------------------------------------------------

SHIP = load("corvette")
L, B, T = SHIP.length, SHIP.beam, SHIP.draught
PRINTED = {
    "Nvdot": 1.1638e-5, "Yvdot": -0.0055, "Nrdot": -3.3426e-4, "Yrdot": -0.0107,
    "Nv": -0.0025, "Yv": -0.0083, "Nr": -0.0013, "Yr": 9.4906e-4,
}  # fmt: skip
"""Table 4.2."""
# Eqs. 4.1 and 4.2.
M_PRINTED = np.array([[0.0100, 0.0109], [2.3780e-4, 2.0769e-6]])
N_PRINTED = np.array([[0.0083, 0.0036], [0.0025, 0.0016]])
A_PRINTED = np.array([[0.8318, 0.3622], [1.0959e-9, 7.2702e-10]])
B_PRINTED = np.array([-5.2378e-7, 4.8150e-7])
RMSE_OF_INPUT = {
    "I": [0.0006, 0.0006, 0.0006], "II": [0.0006, 0.0006, 0.0006], "III": [0.0063, 0.0028, 0.0026],
    "IV": [0.0057, 0.0039, 0.0053], "V": [0.0057, 0.0057, 0.0057],
}  # fmt: skip
"""Tables 4.4 to 4.8, three runs each."""


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


def motion(
    c: dict[str, float], x_g: float, Iz: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """M' and N' of eq. 4.1 from derivatives."""
    m, Iz = c["m"], c["Iz"] if Iz is None else Iz
    M = np.array([[m - c["Yvdot"], m * x_g - c["Yrdot"]], [m * x_g - c["Nvdot"], Iz - c["Nrdot"]]])
    return M, np.array([[-c["Yv"], m - c["Yr"]], [-c["Nv"], m * x_g - c["Nr"]]])


def half_a_digit(printed: float, digits: int) -> float:
    """Half a unit in the last of the significant digits."""
    return 0.5 * 10.0 ** (np.floor(np.log10(abs(printed))) + 1 - digits)


def test_table_4_2_follows_from_the_misprints_and_pi_3_14() -> None:
    digits = {"Nvdot": 5, "Nrdot": 5, "Yr": 5, "Yrdot": 3}
    computed = printed_derivatives(3.14)
    for name, printed in PRINTED.items():
        assert computed[name] == pytest.approx(
            printed, abs=half_a_digit(printed, digits.get(name, 2))
        )
    assert abs(printed_derivatives(np.pi)["Nvdot"] - PRINTED["Nvdot"]) > half_a_digit(
        PRINTED["Nvdot"], 5
    )


def test_eq_2_13_lacks_the_fifth_power_of_the_length() -> None:
    fifth = replace(SHIP, yaw_radius=0.2).clarke["Iz"]
    assert fifth * L**5 == pytest.approx(2.0769e6, rel=5e-5)  # printed 2.0769e-6
    assert fifth == pytest.approx(1.969e-4, abs=5e-8)
    radius = (
        np.sqrt(2.0769e-6 / SHIP.clarke["m"]) * L
    )  # of what is printed, and the centre of gravity is 5.5 m away
    assert radius == pytest.approx(2.15, abs=5e-3)
    assert radius < SHIP.x_g


def test_the_printed_inertia_matrix_has_a_negative_determinant() -> None:
    assert np.linalg.det(M_PRINTED) == pytest.approx(-2.57e-6, abs=5e-9)
    M, _ = motion(replace(SHIP, yaw_radius=0.2).clarke, SHIP.x_g / L)
    assert np.linalg.det(M) == pytest.approx(4.45e-6, abs=5e-9)


def test_eq_4_2_follows_from_eq_4_1_with_ten_to_the_plus_six() -> None:
    as_printed = np.linalg.solve(M_PRINTED, np.column_stack([N_PRINTED, [0.0, 1.0]]))
    np.testing.assert_allclose(
        as_printed, [[10.59, 6.78, 4239.0], [-8.96, -5.89, -3889.0]], rtol=1e-3
    )

    Iz = replace(SHIP, yaw_radius=0.2).clarke["Iz"] * L**5  # 2.0769e6, as in the test above
    M, N = motion(printed_derivatives(3.14) | {"m": SHIP.clarke["m"]}, SHIP.x_g / L, Iz)
    np.testing.assert_allclose(M[0], M_PRINTED[0], rtol=0, atol=5e-5)
    np.testing.assert_allclose(N, N_PRINTED, rtol=0, atol=5e-5)
    to_the_digit = [[5e-5, 5e-5, 5e-12], [5e-14, 5e-15, 5e-12]]
    reproduced = np.linalg.solve(
        M, np.column_stack([N, [0.0, 1.0]])
    )  # without the minus of A = -M^-1 N
    assert (np.abs(reproduced - np.column_stack([A_PRINTED, B_PRINTED])) <= to_the_digit).all()


def test_the_sway_of_eq_4_2_diverges_without_its_minus_sign() -> None:
    assert np.linalg.eigvals(A_PRINTED).max() == pytest.approx(0.83, abs=5e-3)
    assert 1.0 + 0.5 * A_PRINTED[0, 0] > 1.4  # a step of eq. 4.3 with the identity that it drops
    M, N = motion(SHIP.clarke, SHIP.x_g / L)
    assert np.linalg.eigvals(-np.linalg.solve(M, N)).real.max() < 0.0


def test_eq_4_2_counts_time_in_6_56_s_and_eq_4_3_in_seconds() -> None:
    assert L / SHIP.speed == pytest.approx(6.56, abs=5e-3)
    assert 0.5 / (L / SHIP.speed) == pytest.approx(
        0.0762, abs=5e-5
    )  # the step of 0.5 s in the units of eq. 4.2


def test_the_printed_rudder_turns_the_ship_2000_times_too_hard() -> None:
    rudder = replace(SHIP, rudder_area=5.5).clarke  # A_delta, Table 4.1
    assert 1.0 / rudder["Ndelta"] == pytest.approx(2365.0, abs=5.0)
    assert rudder["Ydelta"] == -2.0 * rudder["Ndelta"] != 0.0


def test_a12_and_a21_have_a_wrong_letter_each() -> None:
    rng = np.random.default_rng(0)
    m, mx, Iz, u0, Yvdot, Yrdot, Nvdot, Nrdot, Yv, Yr, Nv, Nr = rng.uniform(0.5, 2.0, 12) * (
        [1] * 4 + [-1] * 8
    )
    M = np.array([[m - Yvdot, mx - Yrdot], [mx - Nvdot, Iz - Nrdot]])
    A = -np.linalg.inv(M) @ np.array([[-Yv, m * u0 - Yr], [-Nv, mx * u0 - Nr]])
    det = np.linalg.det(M)
    a12 = ((Iz - Nrdot) * (Yr - m * u0) - (mx - Yrdot) * (Nr - mx * u0)) / det
    a12_printed = ((Iz - Nrdot) * (Yv - m * u0) - (mx - Yrdot) * (Nr - mx * u0)) / det
    a21 = ((m - Yvdot) * Nv - (mx - Nvdot) * Yv) / det
    a21_printed = ((m - Yvdot) * Nv - (mx - Yvdot) * Nv) / det
    np.testing.assert_allclose([a12, a21], [A[0, 1], A[1, 0]], rtol=1e-12)
    assert (np.abs([a12_printed - A[0, 1], a21_printed - A[1, 0]]) > 0.1).all()
    a11 = ((Iz - Nrdot) * Yv - (mx - Yrdot) * Nv) / det
    a22 = ((m - Yvdot) * (Nr - mx * u0) - (mx - Nvdot) * (Yr - m * u0)) / det
    np.testing.assert_allclose([a11, a22], np.diag(A), rtol=1e-12)  # these are right


def test_i_xy_and_i_yz_vanish_for_a_hull_mirrored_in_xz() -> None:
    points = np.random.default_rng(1).normal(size=(50, 3))

    def products(mirror: list[float]) -> np.ndarray:
        x, y, z = np.concatenate([points, points * mirror]).T
        return np.array([(x * y).sum(), (y * z).sum()])

    np.testing.assert_allclose(products([1.0, -1.0, 1.0]), 0.0, rtol=0, atol=1e-12)
    assert abs(products([1.0, 1.0, -1.0])[0]) > 0.5  # printed: the xy plane


def test_the_printed_covariance_prediction_lacks_sign_gain_and_s() -> None:
    noise = 1e-3 * np.eye(3)  # eq. 4.6
    printed = Core(
        ThesisCorvetteEnv.system, estimator_options={"model": "as-printed"}
    ).config.estimation.filter.model
    model = replace(printed, Q=noise, R=1e-3 * np.eye(2))
    A, C, G, H, Q, R = (
        np.asarray(matrix) for matrix in (model.A, model.C, model.G, model.H, model.Q, model.R)
    )
    prior = np.diag([0.02, 3e-4, 2e-3])
    filter = make("kf-umv-ui", model)
    belief = filter.update(filter.init(Gaussian(np.zeros(3), prior)), np.array([0.1, 0.02]))
    predicted = filter.predict(belief, np.zeros(3))

    weight, K = np.linalg.inv(R), prior @ C.T @ np.linalg.inv(R + C @ prior @ C.T)
    S = np.linalg.inv(H.T @ weight @ (np.eye(2) - C @ K) @ H)
    P = (np.eye(3) + K @ H @ S @ H.T @ weight @ C) @ (np.eye(3) - K @ C) @ prior
    assert belief.input_cov is not None
    np.testing.assert_allclose(
        belief.input_cov, S, rtol=1e-9
    )  # the correction of Table 2.5 is right
    np.testing.assert_allclose(belief.cov, P, rtol=1e-9, atol=1e-15)

    def prediction(cross: np.ndarray) -> np.ndarray:
        return A @ P @ A.T + cross + cross.T + G @ S @ G.T + Q

    np.testing.assert_allclose(
        predicted.cov, prediction(-A @ K @ H @ S @ G.T), rtol=1e-9, atol=1e-15
    )
    assert prediction(A @ C.T @ weight @ H @ G.T)[2, 2] > 2000.0  # rad2: as printed
    assert predicted.cov[2, 2] < 0.01


def test_the_text_on_simulation_ii_gives_simulation_i_s_mean() -> None:
    heading = {
        "I": [0.0047, 0.0046, 0.0048], "II": [0.0048, 0.0049, 0.0047], "III": [0.0095, 0.0053, 0.0057],
        "IV": [0.0087, 0.0071, 0.0067], "V": [0.0370, 0.0370, 0.0370],
    }  # fmt: skip
    table_4_9 = [0.0047, 0.0048, 0.0068, 0.0075, 0.0370], [0.0006, 0.0006, 0.0039, 0.0050, 0.0057]
    for runs, printed in zip((heading, RMSE_OF_INPUT), table_4_9, strict=True):
        np.testing.assert_array_equal(np.round(np.mean(list(runs.values()), 1), 4), printed)
    assert round(np.mean(heading["II"]), 4) != 0.0047  # the text
    assert min(heading["III"]) > max(heading["I"])  # "no significant change"


def test_the_larger_input_of_simulation_v_is_ten_times_smaller() -> None:
    k = np.arange(195)

    def unit_step(k: np.ndarray) -> np.ndarray:
        return (k >= 0).astype(float)

    first = unit_step(k) - 2.0 * unit_step(k - 1)
    fifth = 0.1 * unit_step(k) - 0.2 * unit_step(k - 0.1)
    np.testing.assert_allclose(
        fifth, 0.1 * first, rtol=0, atol=1e-15
    )  # k - 0.1 and k - 1 are one at whole k
    np.testing.assert_array_equal(first, [1.0] + 194 * [-1.0])
    growth = RMSE_OF_INPUT["V"][0] / RMSE_OF_INPUT["I"][0]
    assert growth == pytest.approx(9.5)  # as if the first had been a tenth of the fifth


# --- S: the paper on the Segorogeni ---------------------------------------------------------------

INVERSE = np.array([
    [0.162, -0.0024, 0.8989, 0.0011, 0.0980, 0.0001],
    [-0.0012, -0.8175, -0.0206, -0.0431, -0.0024, 0.0969],
    [1.8855, -0.0418, -1.0230, -0.0036, -0.2205, 0.0024],
    [-0.0518, 0.8865, 0.0511, 1.0468, 0.0088, -0.1050],
    [15.9131, -0.3634, -17.0743, -0.0425, -1.8611, 0.0213],
    [-0.0128, 15.7327, 0.1966, 0.8288, 0.0240, -0.8641],
])  # fmt: skip
"""The matrix after eq. 19: the inverse of eq. 11's, whose rows are those of the inertia, each over its diagonal."""
TABLE_III = np.array([
    [0.4702, 0.4674, 0.0823, 0.1003],
    [0.4636, 0.4666, 0.0819, 0.1003],
    [0.4648, 0.4657, 0.0814, 0.1003],
    [0.4632, 0.4644, 0.0820, 0.1003],
])  # fmt: skip


def test_the_printed_inverse_has_the_ones_and_zeros_of_eq_11() -> None:
    rows = np.linalg.inv(INVERSE)
    np.testing.assert_allclose(np.diag(rows), 1.0, rtol=0, atol=1e-3)
    eq_11 = ["x...xx", ".x.x.x", "..xxx.", ".xxx..", "x.x.x.", "xx...x"]
    zero = np.array([list(row) for row in eq_11]) == "."
    np.testing.assert_allclose(rows[zero], 0.0, rtol=0, atol=4e-3)
    np.testing.assert_allclose(
        rows[[0, 1, 4, 5], [4, 5, 0, 1]], [0.0526, 0.1184, 8.552, 19.23], rtol=1e-3
    )


def test_the_signs_of_roll_s_row_of_eq_11_are_turned() -> None:
    rows = np.linalg.inv(INVERSE)
    coupled = [
        (0, 4),
        (0, 5),
        (2, 4),
        (1, 5),
        (1, 3),
        (2, 3),
    ]  # an inertia is symmetric: equal signs across
    agree = [rows[i, j] * rows[j, i] > 0.0 for i, j in coupled]
    assert agree == [True, True, True, True, False, False]


def test_printed_pitch_and_yaw_inertia_are_an_eighth_of_roll_s() -> None:
    rows = np.linalg.inv(INVERSE)
    coupling = {"roll": -rows[3, 1], "pitch": rows[4, 0]}  # m z_G / inertia, with added mass
    assert coupling["pitch"] / coupling["roll"] == pytest.approx(
        -7.90, abs=5e-3
    )  # the sign: see the test above
    mass_per_inertia = coupling["pitch"] / rows[0, 4]
    assert np.sqrt(1.0 / mass_per_inertia) == pytest.approx(
        0.078, abs=5e-4
    )  # m, of a body 0.98 m long
    body = load("segorogeni")
    roll, pitch = (
        body.roll_inertia - body.coefficients.K_pdot,
        body.pitch_inertia - body.coefficients.M_qdot,
    )
    assert roll < 0.05 * pitch
    assert np.sqrt(body.pitch_inertia / body.mass) == pytest.approx(0.223, abs=5e-4)


def test_eq_11_is_an_inertia_with_roll_and_pitch_exchanged() -> None:
    rows, others = np.linalg.inv(INVERSE), ~np.eye(6, dtype=bool)
    ratio = -rows[4, 0] / rows[3, 1]
    factors = np.array(
        [1.0, 1.0, 1.0, ratio, -1.0 / ratio, -1.0 / ratio]
    )  # ratio is negative: row 4 changes its signs
    mended = np.where(others, rows * factors[:, None], rows)
    assert (np.linalg.eigvals(mended).real > 0.1).all()
    assert (np.linalg.eigvals(rows).real < 0.0).sum() == 2
    signs_alone = np.where(others, rows * np.sign(factors)[:, None], rows)
    assert (np.linalg.eigvals(signs_alone).real < 0.0).sum() == 2


def test_eq_17_has_the_wrong_sign_before_its_bracket() -> None:
    rng = np.random.default_rng(2)
    m, velocity, turn, centre, acceleration, angular = 15.0, *rng.normal(size=(5, 3))
    inertia = np.diag(rng.uniform(1.0, 2.0, 3))
    u, v, w = velocity
    p, q, r = turn
    x_G, y_G, _ = centre
    Ix, Iy, Iz = np.diag(inertia)
    # Newton and Euler about the origin: the yaw moment that these motions take.
    moment = inertia @ angular + np.cross(turn, inertia @ turn)
    moment = (moment + m * np.cross(centre, acceleration + np.cross(turn, velocity)))[2]
    moved = m * (x_G * (-w * p + u * r) - y_G * (-v * r + w * q))
    left = Iz * angular[2] + m * (x_G * acceleration[1] - y_G * acceleration[0])
    assert left == pytest.approx(moment - (Iy - Ix) * p * q - moved, rel=1e-12)
    assert abs(left - (moment - (Iy - Ix) * p * q + moved)) > 1.0  # printed


def test_the_mean_errors_of_table_iii_are_47_cm_in_x_as_in_y() -> None:
    np.testing.assert_array_equal(
        np.round(TABLE_III.mean(0), 2), [0.47, 0.47, 0.08, 0.10]
    )  # text: 0.4 and 0.46


def test_table_iii_gives_no_accuracy_of_55_percent() -> None:
    of_a_metre = 1.0 - TABLE_III[:, :2]
    assert 0.525 < of_a_metre.min() < of_a_metre.max() < 0.54
    of_the_dive = 1.0 - TABLE_III[:, :3] / [10.0, 18.0, 6.0]
    assert of_the_dive.min() > 0.95


# --- I: the paper on the ITSUNUSA -----------------------------------------------------------------

TABLE_2 = np.array([
    [0.02568, 0.02079, 0.01582],
    [0.02344, 0.01872, 0.01269],
    [0.00539, 0.00465, 0.00415],
    [0.03541, 0.02875, 0.01938],
])  # fmt: skip
"""RMSE of surge, heave, pitch rate and position for 200, 300 and 400 members."""


def test_three_centimetres_are_a_hundred_times_the_printed_share() -> None:
    share = round(TABLE_2[3].mean(), 2) / 20.0  # 3 cm: the mean over the three ensembles
    assert share == pytest.approx(0.0015)  # printed: 0.0015 per cent


def test_printed_errors_are_means_over_three_ensembles() -> None:
    means = TABLE_2.mean(1)
    assert [round(means[0], 2), round(means[1], 2), round(means[2], 3), round(means[3], 2)] == [
        0.02,
        0.02,
        0.005,
        0.03,
    ]
    assert [round(TABLE_2[0, 2], 3), round(TABLE_2[1, 2], 3), round(TABLE_2[3, 2], 2)] == [
        0.016,
        0.013,
        0.02,
    ]


def test_itsunusa_displaces_six_to_nine_times_its_printed_mass() -> None:
    body = load("itsunusa")
    cylinder = np.pi / 4.0 * 0.30**2 * 2.0 * body.water_density
    np.testing.assert_allclose(
        [body.buoyancy / body.gravity, cylinder], [96.6, 144.9], rtol=0, atol=0.05
    )
    assert 6.0 < body.buoyancy / body.gravity / 16.0 < cylinder / 16.0 < 9.1


# --- R: the paper on the robust filter ------------------------------------------------------------


def random_system(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A ``(3, 3)``, C ``(2, 3)``, Q and R."""
    rng = np.random.default_rng(seed)
    Q, R = (
        root @ root.T + 0.1 * np.eye(len(root))
        for root in (rng.normal(size=(3, 3)), rng.normal(size=(2, 2)))
    )
    return rng.normal(size=(3, 3)), rng.normal(size=(2, 3)), Q, R


def test_the_printed_algorithm_is_the_kalman_filter() -> None:
    """Eqs. 6-9 and the covariance of the summary: no uncertainty of the model and no Huber loss enters."""
    (A, C, Q, R), rng = random_system(3), np.random.default_rng(4)
    B = rng.normal(size=(3, 1))
    filter = make("kf", LinearModel(A, C, Q, R, B=B))
    belief = filter.init(Gaussian(np.zeros(3), np.eye(3)))
    x, P = np.zeros(3), np.eye(3)
    for u, y in zip(rng.normal(size=(8, 1)), rng.normal(size=(8, 2)) * 10.0, strict=True):
        belief = filter.update(filter.predict(belief, u), y)
        x, P = A @ x + B @ u, A @ P @ A.T + Q
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        x, P = x + K @ (y - C @ x), (np.eye(3) - K @ C) @ P
        np.testing.assert_allclose(belief.mean, x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(belief.cov, P, rtol=1e-9, atol=1e-9)


def test_the_printed_derivative_of_the_trace_is_wrong() -> None:
    (_, C, P, R), K = random_system(5), np.random.default_rng(6).normal(size=(3, 2))

    def cost(K: np.ndarray) -> float:
        rest = np.eye(3) - K @ C
        return float(np.trace(rest @ P @ rest.T + K @ R @ K.T))

    h, units = 1e-5, np.eye(6).reshape(6, 3, 2)
    slopes = np.array([(cost(K + h * E) - cost(K - h * E)) / (2.0 * h) for E in units]).reshape(
        3, 2
    )
    np.testing.assert_allclose(
        slopes, -2.0 * P @ C.T + 2.0 * K @ (C @ P @ C.T + R), rtol=0, atol=1e-6
    )
    assert (C @ P).shape != K.shape  # printed: -2 C P


def test_noise_times_its_transpose_is_singular_its_mean_is_r() -> None:
    R = random_system(8)[3]
    v = np.random.default_rng(9).multivariate_normal(np.zeros(2), R, 20_000)
    assert np.linalg.matrix_rank(np.outer(v[0], v[0])) == 1
    np.testing.assert_allclose(v.T @ v / len(v), R, rtol=0, atol=0.05 * np.trace(R))


def test_eq_11_lacks_a_on_either_side_of_the_gain() -> None:
    A, C, Q, R = random_system(10)
    P = solve_discrete_are(A.T, C.T, Q, R)
    S = C @ P @ C.T + R
    K = P @ C.T @ np.linalg.inv(S)
    np.testing.assert_allclose(A @ P @ A.T + Q - A @ K @ S @ K.T @ A.T, P, rtol=1e-9, atol=1e-9)
    above = A @ P @ A.T + Q - A @ P @ C.T @ np.linalg.inv(S) @ C @ P @ A.T
    np.testing.assert_allclose(above, P, rtol=1e-9, atol=1e-9)  # the line above eq. 11 is right
    assert np.abs(A @ P @ A.T + Q - K @ S @ K.T - P).max() > 0.1  # printed


def test_eqs_12_to_14_use_one_p_for_prediction_and_update() -> None:
    A, C, Q, R = random_system(10)
    before = solve_discrete_are(A.T, C.T, Q, R)
    K = before @ C.T @ np.linalg.inv(C @ before @ C.T + R)
    after = (np.eye(3) - K @ C) @ before
    np.testing.assert_allclose(A @ after @ A.T + Q, before, rtol=1e-9, atol=1e-9)
    for P in (before, after):  # neither solves eqs. 12 and 14 as printed
        assert np.abs(A @ P @ A.T + Q - P).max() > 0.01
        assert np.abs(K @ C @ P).max() > 0.01


def test_a_of_a_step_is_not_a_of_the_differential_equation() -> None:
    A, B = np.array([[0.0, 1.0], [-2.0, -0.5]]), np.array([[0.0], [1.0]])
    step, push = zero_order_hold(A, B, 1e-4)
    np.testing.assert_allclose(step, np.eye(2) + 1e-4 * A, rtol=0, atol=1e-7)
    np.testing.assert_allclose(push, 1e-4 * B, rtol=0, atol=1e-7)


# --- P: the paper on the PUNA ---------------------------------------------------------------------

START, GOAL = (-500.0, 100.0), (0.0, 200.0)
TURN, BEARING = 100.0, np.pi / 6
"""Case (a); the heading counts from the y axis."""


def test_g_sin_alpha_does_not_keep_the_energy() -> None:
    stone = replace(load("puna"), lift=(0.0, 0.0), drag=(0.0, 0.0, 0.0))
    g, gamma, v, alpha = stone.gravity, 0.3, 20.0, 0.05
    rates = planar_derivative(
        np.array([gamma, v, 0.0, 100.0]), np.array([0.0, alpha]), stone.vector()
    )
    assert v * rates[1] + g * rates[3] == pytest.approx(0.0, abs=1e-12)
    assert v * (-g * np.sin(alpha)) + g * rates[3] == pytest.approx(48.2, abs=0.05)  # W/kg, printed


def test_lift_proportional_to_c_l_alpha_carries_a_fiftieth() -> None:
    body = load("puna")
    cruise = trim(20.0, body)
    lift = 0.5 * body.density[2] * 20.0**2 * body.area * np.polyval(body.lift, cruise.alpha)
    weight = body.mass * body.gravity
    assert lift / weight == pytest.approx(1.0, abs=0.01)
    assert lift * cruise.alpha / weight == pytest.approx(0.023, abs=5e-4)


def test_eq_5_gives_the_left_circle_for_either_sign() -> None:
    x, y, theta, r = 3.0, -2.0, 0.7, TURN
    printed = [
        (x + s * r * np.cos(theta + s * np.pi / 2), y + s * r * np.sin(theta + s * np.pi / 2))
        for s in (1, -1)
    ]
    np.testing.assert_allclose(printed[0], printed[1], rtol=1e-12)
    mended = np.array(
        [(x + r * np.cos(theta + a), y + r * np.sin(theta + a)) for a in (np.pi / 2, -np.pi / 2)]
    )
    np.testing.assert_allclose(mended[0], printed[0], rtol=1e-12)
    np.testing.assert_allclose(mended.mean(0), [x, y], rtol=1e-12)  # on either side of the vehicle


def test_eq_7_excludes_the_equal_circles_of_both_cases() -> None:
    r_s = r_f = TURN
    found = lengths(np.array([*START, np.pi / 3]), np.array([*GOAL, np.pi / 2]), r_s)[:4]
    assert np.isfinite(found).all()  # LSL, LSR, RSL and RSR: every tangent exists
    centres = np.hypot(
        GOAL[0] - START[0] - r_f - r_s * np.cos(BEARING), GOAL[1] - START[1] + r_s * np.sin(BEARING)
    )
    outside, inside = (centres + r_s > r_f) and (r_f > r_s), (centres > r_s + r_f) and (r_f > r_s)
    assert not outside
    assert not inside


def test_eq_15_adds_an_angle_to_a_length() -> None:
    def printed(line: float, r: float) -> float:
        theta, beta, gamma = 0.4, 0.3, 0.2
        return line + r * np.pi + 2 * r * theta - 2 * r * beta - gamma

    assert printed(2000.0, 200.0) != pytest.approx(
        2.0 * printed(1000.0, 100.0), abs=0.1
    )  # in other units


def test_eq_16_has_a_negative_line_and_a_sine_for_a_cosine() -> None:
    x0, r, chi = START[0], TURN, BEARING
    first = (x0 + r * np.sin(chi) + r) + (np.pi / 2 - chi) * r + np.pi / (2 * r)
    second = -x0 - r * np.sin(chi) - r + (np.pi - chi) * r
    assert first == pytest.approx(-245.3, abs=0.05)
    assert second == pytest.approx(611.8, abs=0.05)
    mended = -x0 - r * np.cos(chi) - r + (np.pi - chi) * r
    y = np.linspace(0.0, 500.0, 1001)
    goals = np.stack([np.zeros_like(y), y, np.full_like(y, np.pi / 2)], -1)
    found = lengths(np.array([*START, np.pi / 2 - chi]), goals, r).min(-1)
    assert found.min() == pytest.approx(mended, abs=1e-9)  # 575.2 m
    assert y[found.argmin()] == pytest.approx(250.0)  # printed: 200


def test_a_step_of_the_model_is_not_linear() -> None:
    plane, control = PlanarPuna(), np.array([4.0, 0.02])
    state = np.array([0.1, 20.0, 0.0, 100.0])
    rise = plane.step(2.0 * state, control) - 2.0 * plane.step(state, control)
    assert np.abs(rise).max() > 0.03


def test_eq_25_leaves_the_aircraft_where_it_is() -> None:
    state, cruise = np.array([0.0, 20.0, 0.0, 100.0]), trim(20.0, load("puna"))
    moved = PlanarPuna().step(state, np.array([cruise.thrust, cruise.alpha])) - state
    assert moved[2] == pytest.approx(0.2)  # 20 m/s for 0.01 s; printed: nothing but noise


def test_members_that_start_from_the_mean_forget_the_covariance() -> None:
    rng, members = np.random.default_rng(11), 20_000
    A, P, Q = np.array([[1.0, 0.5], [0.0, 1.0]]), np.diag([2.0, 1.0]), 0.1 * np.eye(2)
    noise = rng.normal(size=(members, 2)) * np.sqrt(0.1)
    ensemble = rng.normal(size=(members, 2)) * np.sqrt([2.0, 1.0])
    each, mean = ensemble @ A.T + noise, ensemble.mean(0) @ A.T + noise
    np.testing.assert_allclose(np.cov(each.T), A @ P @ A.T + Q, rtol=0, atol=0.1)
    np.testing.assert_allclose(np.cov(mean.T), Q, rtol=0, atol=0.01)  # eqs. 10 and 25 as printed


# --- the page -------------------------------------------------------------------------------------

ROWS = list(csv.DictReader((ROOT / "docs/errata.csv").read_text(encoding="utf-8").splitlines()))
PAGE = (ROOT / "docs/errata.md").read_text(encoding="utf-8")


def test_misprints_are_numbered_and_complete() -> None:
    numbers = [row["number"] for row in ROWS]
    counts = Counter(number[0] for number in numbers)
    assert numbers == [f"{paper}{i}" for paper in "CSIRP" for i in range(1, counts[paper] + 1)]
    for row in ROWS:
        assert row["where"], row
        assert row["printed"], row
        assert row["should be"], row
        assert bool(row["evidence"]) == bool(row["tests"]), row


def test_misprints_name_their_tests() -> None:
    named = {test.strip("`") for row in ROWS for test in row["tests"].split()}
    for file, name in (test.split("::") for test in named):
        source = (ROOT / file).read_text(encoding="utf-8")
        assert re.search(rf"^def {name}\(", source, re.M), name
    misprints = Path(__file__).read_text(encoding="utf-8").partition("# --- the page ---")[0]
    own = re.findall(r"^def (test_\w+)\(", misprints, re.M)
    assert len(own) > 30
    assert {f"tests/test_errata.py::{name}" for name in own} <= named


def test_the_page_counts_misprints_by_paper() -> None:
    recomputed = [row["number"] for row in ROWS if row["tests"]]
    assert f"Of {len(ROWS)} misprints, {len(recomputed)} are recomputed" in PAGE
    counts = re.findall(r"^\| \*\*([CSIRP])\*\*.*?\| (\d+) \| (\d+) \|", PAGE, re.M)
    printed, tested = (
        Counter(number[0] for number in numbers)
        for numbers in ([row["number"] for row in ROWS], recomputed)
    )
    assert counts == [(paper, str(printed[paper]), str(tested[paper])) for paper in "CSIRP"]
