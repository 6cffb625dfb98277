"""Draw the figure of docs/estimators/ensembles.md, and print its numbers: ``python docs/images/exact_draws.py``.

A slow state that no measurement shows, beside five states that are measured at every step and
independent of it: a Kalman filter leaves its variance as it is. The figure has the share of this
variance that ensembles keep after 150 s, by members and kind of draws, and the share that the
page's formula foretells.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from estimators import Gaussian, LinearModel, RandomKeys, make

HERE = Path(__file__).parent
DT, TAU, STEPS, BESIDE = 0.1, 300.0, 1500, 5
"""Step [s], correlation time of the slow state [s], steps, and states that are measured beside."""
MEMBERS, ROWS = (16, 32, 64, 128, 256, 512, 1024), 8


def system() -> LinearModel:
    """The slow state, then those beside, all of variance 1; measurements of variance 1."""
    kept = np.array([np.exp(-DT / TAU), *[0.9] * BESIDE])
    return LinearModel(
        np.diag(kept), np.eye(BESIDE, 1 + BESIDE, k=1), np.diag(1.0 - kept**2), np.eye(BESIDE)
    )


def variance(name: str, **options: object) -> np.ndarray:
    """Variance of the slow state ``(rows,)`` at the end, which depends on no measured value."""
    model = system()
    filter, keys = make(name, model, **options), RandomKeys.seeded(range(ROWS))
    belief = filter.init(Gaussian(np.zeros((ROWS, model.n)), np.eye(model.n)), rng=keys.at(0))
    for k in range(1, STEPS + 1):
        belief = filter.step(belief, np.zeros((ROWS, model.p)), rng=keys.at(k))
    return belief.cov[:, 0, 0]


def lost_share(perturbed: bool) -> float:
    """``g``: N - 1 times the share of an unmeasured variance that independent draws lose at each step.

    Of the steady filter of what is measured: ``g = tr(S^-1 C X C')`` with ``X = F X F' + Q``, ``F =
    A (I - K C)``; with perturbed measurements X is the predicted covariance, as ``A K R K' A'`` is
    drawn, too.
    """
    model = system()
    A, C, Q, R = model.A[1:, 1:], model.C[:, 1:], model.Q[1:, 1:], model.R
    P = solve_discrete_are(A.T, C.T, Q, R)
    S = C @ P @ C.T + R
    F = A @ (np.eye(BESIDE) - P @ C.T @ np.linalg.solve(S, C))
    X = P if perturbed else solve_discrete_lyapunov(F, Q)
    return float(np.trace(np.linalg.solve(S, C @ X @ C.T)))


def foretold(members: np.ndarray, perturbed: bool) -> np.ndarray:
    """Share of the variance kept after the run, by the formula: each step loses some and process noise adds some."""
    loss, supply = lost_share(perturbed) / (members - 1.0), 2.0 * DT / TAU
    steady = supply / (supply + loss)
    return steady + (1.0 - steady) * np.exp(-STEPS * (supply + loss))


def shares() -> dict[str, list[float]]:
    """Share of the variance, 1 in a Kalman filter, that is kept, by filter and draws, for each of `MEMBERS`."""
    kinds = [("enkf", "independent"), ("enkf-sr", "independent"), ("enkf", "exact")]
    return {
        f"{name}, {draws} draws": [
            float(variance(name, members=N, draws=draws).mean()) for N in MEMBERS
        ]
        for name, draws in kinds
    }


def draw() -> None:
    """Write the picture beside this file."""
    figure, axes = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
    fine, found = np.geomspace(MEMBERS[0], 10_000, 100), shares()
    for (label, values), colour in zip(found.items(), ("C3", "C1", "C0"), strict=True):
        axes.semilogx(MEMBERS, values, "o", color=colour, label=label)
        print(
            f"{label:28}", *(f"{N}: {value:.3f}" for N, value in zip(MEMBERS, values, strict=True))
        )
    for perturbed, colour in ((True, "C3"), (False, "C1")):
        axes.semilogx(fine, foretold(fine, perturbed), color=colour, linewidth=1.0)
        print(
            f"g {lost_share(perturbed):.2f}",
            *(f"{foretold(np.array([N]), perturbed)[0]:.3f}" for N in MEMBERS),
        )
    axes.axhline(1.0, color="C0", linewidth=1.0)
    axes.set(xlabel="members", ylabel="share of the variance kept", ylim=(0.0, 1.1))
    axes.set_title(
        "Variance of a state that no measurement shows, after 150 s; lines: the formula",
        fontsize=10,
    )
    axes.legend(loc="center left", fontsize=9)
    figure.savefig(HERE / "exact-draws.png", dpi=120)


if __name__ == "__main__":
    draw()
