"""Tables about filters alone: simulated linear systems and Lorenz-96, no environment."""

from dataclasses import replace
from typing import Any

import numpy as np

from agents.statistics import share_interval
from estimators import input_conditions
from studies.lorenz.benchmarks import BENCHMARKS, analysis_rmse
from studies.papers.robust.experiment import Condition, StateSpace, simulate, track
from studies.tables.markdown import WITHOUT, shown, table

RUNS, STEPS, SKIPPED = 1000, 200, 20
"""Runs, steps, and steps that are not scored, of the tables of robust filters."""
OUTLIERS = {
    "Gaussian": {},
    "10 % at 10 σ": {"rate": 0.1, "size": 10.0},
    "10 % at 100 σ": {"rate": 0.1, "size": 100.0},
}


def _constant_velocity(intensity: float, process: float = 1.0, measurement: float = 1.0) -> Any:
    """Constant velocity under white acceleration [m2/s3], with factors on Q and R; position measured at 1 Hz."""
    A, B, C = np.array([[1.0, 1.0], [0.0, 1.0]]), np.zeros((2, 1)), np.array([[1.0, 0.0]])
    Q = process * intensity * np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]])
    return StateSpace(
        A[None, None], B[None, None], C[None, None], Q[None, None], np.array([[measurement]])
    )


def _squared_errors(name: str, model: Any, record: Any, **options: Any) -> np.ndarray:
    """Squared error of the state after each update, mean over time, one number a run ``(RUNS,)``."""
    beliefs = track({"kind": name, **options}, model, record.y)
    squares = [
        ((after.mean - x) ** 2).sum(-1) for (_, after), x in zip(beliefs, record.x, strict=True)
    ]
    return np.mean(squares[SKIPPED:], axis=0)[0]


def _ratio(errors: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """RMSE over that of the reference on the same runs, and half of its 95 % interval, by linearisation."""
    ratio = float(np.sqrt(errors.mean() / reference.mean()))
    influence = 0.5 * ratio * (errors / errors.mean() - reference / reference.mean())
    return ratio, 1.96 * float(influence.std(ddof=1)) / np.sqrt(len(errors))


def huber_iterations() -> str:
    """RMSE of `huber-kf` over that of `kf`, by the number of times that the weights are computed."""
    counts, rows = (1, 2, 3, 5, 10, 100), []
    for intensity in (0.01, 0.1, 1.0):
        model = _constant_velocity(intensity)
        for label, condition in OUTLIERS.items():
            record = simulate(model, model, Condition(**condition), STEPS, RUNS, 0)
            reference = _squared_errors("kf", model, record)
            ratios = [
                _ratio(_squared_errors("huber-kf", model, record, iterations=n), reference)
                for n in counts
            ]
            widest = max(half for _, half in ratios)
            rows.append(
                (f"{intensity:g}", label, *(f"{ratio:.2f}" for ratio, _ in ratios), f"{widest:.3f}")
            )
    return table(("q", "measurements", *map(str, counts), "widest half interval"), rows)


def robust_losses() -> str:
    """RMSE of robust filters over that of `kf` where the model is right, and where it is wrong in six ways."""
    model = _constant_velocity(0.01)
    cases = {
        "as the model says": (model, {}),
        "10 % of measurements at 10 σ": (model, OUTLIERS["10 % at 10 σ"]),
        "least-favourable model, 0.01": (model, {"tolerance": 0.01}),
        "least-favourable model, 0.1": (model, {"tolerance": 0.1}),
        "true Q ten times as large": (_constant_velocity(0.01, process=10.0), {}),
        "true R four times as large": (_constant_velocity(0.01, measurement=4.0), {}),
    }
    filters: Any = ("huber-kf", {}), ("robust-kf", {"radius": 0.01}), ("robust-kf", {"radius": 0.1})
    rows = []
    for label, (world, condition) in cases.items():
        record = simulate(model, world, Condition(**condition), STEPS, RUNS, 1)
        reference = _squared_errors("kf", model, record)
        ratios = (
            _ratio(_squared_errors(name, model, record, **options), reference)
            for name, options in filters
        )
        rows.append(
            (
                label,
                f"{np.sqrt(reference.mean()):.2f}",
                *(f"{r:.3f} ± {half:.3f}" for r, half in ratios),
            )
        )
    return table(("data", "`kf` RMSE", "`huber-kf`", "`robust-kf`, 0.01", "`robust-kf`, 0.1"), rows)


def unstable_zeros(systems: int = 400) -> str:
    """Share of random systems in which an unknown input adds a zero on or outside the unit circle.

    Four states and one input; A has normal entries and a spectral radius of 0.98, C, G and H have
    normal entries.
    """
    rows = []
    for label, gain in (
        ("at once, `kf-umv-ui`", 1.0),
        ("at once, H ten times as large", 10.0),
        ("one step late", 0.0),
    ):
        cells = []
        for p in (1, 2, 3):
            rng, hits = np.random.default_rng([p, round(gain)]), 0
            for _ in range(systems):
                A, C, G, H = (rng.normal(size=shape) for shape in ((4, 4), (p, 4), (4, 1), (p, 1)))
                A *= 0.98 / np.abs(np.linalg.eigvals(A)).max()
                zeros = input_conditions(A, C, G, gain * H, np.eye(4), np.eye(p), 1.0).zeros
                hits += bool((np.abs(zeros) >= 1.0).any())
            of = share_interval(hits, systems)
            cells.append(f"{100.0 * of.mean:.1f} % [{100.0 * of.low:.1f}, {100.0 * of.high:.1f}]")
        rows.append((label, *cells))
    return table(("d reaches the measurements", "1 measurement", "2", "3"), rows)


def published_scores(runs: int = 20) -> str:
    """Analysis RMSE of ensemble and particle filters on the Lorenz systems, beside what is published.

    Filters that are the same transform share a row and are run once, under the first name. Exact
    draws are beside them, with as many members as these need; without process noise only `enkf` has
    other numbers after the start.
    """
    rows = []
    for row in BENCHMARKS:
        scores = analysis_rmse(row, row.filters[0], runs)
        published = f"{row.published:g}{' (reported only)' if row.reported_only else ''}"
        name = row.setting.name, ", ".join(row.filters), str(row.members), row.described
        members, beside = (
            max(row.members, len(row.setting.start) + len(row.setting.read) + 2),
            WITHOUT,
        )
        if "pf" not in row.filters:
            exact = analysis_rmse(
                replace(row, draws="exact", members=members), row.filters[0], runs
            )
            beside = f"{np.median(exact):.3f}, N = {members}"
        rows.append((*name, shown(scores), f"{np.median(scores):.3f}", beside, published))
    return table(
        ("system", "filter", "N", "options", "ours", "median", "exact draws, median", "published"),
        rows,
    )
