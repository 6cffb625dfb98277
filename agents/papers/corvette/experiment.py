"""Hermawan's five simulations: KF-UMV-UI follows a turn with an unknown input in measurements."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from agents import rollout
from agents.metrics import scores
from agents.papers.figures import figure, over_time
from agents.papers.measures import EXPLORATORY, Comparison, comparison_table, means, row, rows
from estimators import Gaussian, LinearModel, Series, make, run
from vessel_gym.envs import ThesisCorvetteEnv
from vessel_gym.tasks.turning import SAMPLES
from vessel_gym.vehicles.corvette_thesis import SIMULATIONS, A, B, Simulation

MODELS = ("as_printed", "corrected")
WAYS = ("eq. 4.3", "corrected model", "eq. 4.3 and Table 2.5")
"""Filter models and, last, filter and model as printed with the believed choices."""
QUANTITIES = ("heading", "unknown input")
TRIAL: Any = ThesisCorvetteEnv.system.task
RECORD = TRIAL.record[:SAMPLES, 2]
"""Our ship's heading in the trial [rad]."""
RUDDER = np.deg2rad(35.0)
"""Constant rudder angle u [rad] of the thesis, Section 4.3.1."""
C, G, H = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]), np.eye(3)[:, 2:], np.ones((2, 1))
"""Matrices of the measurement and of d, eqs. 4.4 and 4.5."""


def simulate(simulation: str, model: str, runs: int, seed: int) -> np.ndarray:
    """One of the five simulations with one filter model, as it was set up before the search.

    Returns:
        RMSE ``(2, runs)`` of updated heading and unknown input in ``ThesisCorvette-v0``.
    """
    options, asked = {"estimator_options": {"model": model}}, {"simulation": simulation}
    seeds = range(seed, seed + runs)
    of = scores(rollout("constant-rudder", "ThesisCorvette-v0", seeds, options, asked))
    return 1e-3 * np.stack([of["heading_rmse"], of["input_rmse"]])


def follow(
    s: Simulation,
    prior: float,
    start: np.ndarray,
    heading: np.ndarray,
    d: np.ndarray,
    noise: np.ndarray,
    as_printed: bool = False,
) -> Series:
    """KF-UMV-UI from ``start (runs, 3)`` on measurements ``(psi + d, d)`` with noise, eq. 4.5.

    The filter is the one that the thesis cites or, ``as_printed``, Table 2.5.
    """
    model = LinearModel(A, C, s.Q * np.eye(3), s.R * np.eye(2), B, G, H)
    y = np.stack([heading + d, d], -1)[:, None] + noise.swapaxes(0, 1)
    belief = Gaussian(start, prior * np.eye(3))
    filter_ = make("kf-umv-ui", model, as_printed=as_printed)
    return run(filter_, belief, y, np.full((SAMPLES, 1), RUDDER))


def errors(series: Series, heading: np.ndarray, d: np.ndarray, scored: str) -> Any:
    """RMSE ``(2, runs)`` of heading and d; of the predicted heading the first is not counted."""
    estimate = series.mean if scored == "updated" else series.predicted.mean[1:]
    of_heading = estimate[..., 2] - heading[-len(estimate) :, None]
    of_input = series.input_mean[..., 0] - d[:, None]  # type: ignore[index]
    return np.stack([np.sqrt(np.mean(of**2, 0)) for of in (of_heading, of_input)])


def simulated(
    choices: Mapping[str, Any], runs: int, seed: int
) -> dict[str, tuple[Any, np.ndarray, np.ndarray]]:
    """The five simulations under one combination of choices.

    Of those that are the same before and after the search there is no alternative. With 1 for
    ``drives`` d drives the true heading, too (eq. 4.4).

    Returns:
        The filter's series of all runs, and true heading and d ``(T,)`` [rad], by simulation.
    """
    rng = np.random.default_rng(seed)
    shape = runs, SAMPLES, 2
    drawn = {"normal": rng.standard_normal(shape), "uniform": rng.random(shape)}
    kind, scale = choices["noise"].split()
    noise = float(scale) * drawn[kind]
    start = float(choices["start_sd"]) * rng.standard_normal((runs, 3))
    turn = RECORD if choices["record"] == "ship" else np.linspace(0.0, 2.0 * np.pi, SAMPLES)
    switched = np.where(np.arange(SAMPLES) < choices["switch"], 1.0, choices["after_switch"])
    found = {}
    for name, s in SIMULATIONS.items():
        d = (s.size if name == "V" else choices["size"]) * switched
        heading = turn + choices.get("drives", 0.0) * np.append(0.0, np.cumsum(d[:-1]))
        as_printed = choices["recursion"] == "Table 2.5"
        series = follow(s, choices["prior"], start, heading, d, noise, as_printed)
        found[name] = series, heading, d
    return found


def explain(choices: Mapping[str, Any], runs: int, seed: int) -> dict[str, np.ndarray]:
    """RMSE ``(2, runs)`` of heading and d in each simulation under one combination of choices."""
    return {
        name: errors(*of, choices["scored"]) for name, of in simulated(choices, runs, seed).items()
    }


# --- tables ---------------------------------------------------------------------------------------


def report(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Tables and measures."""
    sizes = settings["runs"], settings["seed"]
    rmse = {model: {s: simulate(s, model, *sizes) for s in SIMULATIONS} for model in MODELS}
    former, choices = (
        {name: choice[way] for name, choice in settings["open"].items()}
        for way in ("first", "believed")
    )
    first = rmse[MODELS[0]]
    before = _comparisons(settings["printed"], first, circular=True)
    after = _comparisons(settings["printed"], explain(choices, *sizes))
    letter = explain(choices | {"recursion": "Table 2.5"}, *sizes)
    driven = explain(former | {"drives": 1.0}, *sizes)
    tables: dict[str, Any] = {
        "published": comparison_table({"before the search": before, "believed": after}),
        "choices": [("choice", "before the search", "believed", "where")],
        "models": [("simulation", *(f"{q}, {model} [rad]" for model in WAYS for q in QUANTITIES))],
        "changes": [("simulations", *(f"{q}, second less first [mrad]" for q in QUANTITIES))],
    }
    for name, choice in settings["open"].items():
        cells = (str(choice[key]) for key in ("first", "believed", "where"))
        tables["choices"].append((name.replace("_", " "), *cells))
    for s in SIMULATIONS:
        ways = *(rmse[model][s] for model in MODELS), letter[s]
        tables["models"].append((s, *means(np.concatenate(ways).T)))
    changes = {f"I, {s}": (first["I"], first[s]) for s in [*SIMULATIONS][1:]}
    changes |= {f"driven, {s}": (first[s], driven[s]) for s in ("I", "V")}
    for label, (one, other) in changes.items():
        tables["changes"].append((label, *means(1e3 * (other - one).T, 3)))
    paper, combinations = settings["paper"], settings["search"]["combinations"]
    way = f"{paper}, likely choices ({EXPLORATORY}, of {combinations:,} combinations)"
    return {
        "tables": tables,
        "figures": _figures(choices, settings["seed"]),
        "rows": [*rows(paper, before), row(way, "simulations I to V", after)],
    }


def _figures(choices: Mapping[str, Any], seed: int) -> list[Any]:
    """Figures 4.1 to 4.10: heading and unknown input in a run of each simulation."""
    found: list[Any] = []
    steps = np.arange(SAMPLES)
    for name, (series, heading, d) in simulated(choices, 1, seed).items():
        belief = series if choices["scored"] == "updated" else series.predicted
        yaw = {"real": heading, "estimate": belief.mean[:, 0, 2]}
        unknown = {"real": d, "estimate": series.input_mean[:, 0, 0]}
        sd = np.sqrt(belief.cov[:, 0, 2, 2])
        panels = {
            "yaw angle": over_time(steps, "yaw angle [rad]", yaw, sd, "time step")
            | {"ylim": [0.0, 7.0]},  # as printed
            "unknown input": over_time(steps, "unknown input [rad]", unknown, x="time step"),
        }
        for what, panel in panels.items():
            caption = f"Estimate of the {what}, simulation {name}."
            found.append(figure(f"4.{len(found) + 1}", caption, panel))
    return found


def _comparisons(
    printed: Mapping[str, Any], ours: Mapping[str, np.ndarray], circular: bool = False
) -> list[Comparison]:
    """The ten means of Table 4.9 beside ours ``(2, runs)``; the d of II gave the noise."""
    return [
        Comparison(
            f"simulation {s}", quantity, "rad", printed[s]["means"][i], printed[s]["where"],
            ours[s][i], averaged=3,
            reason="the noise was taken from it" if circular and (s, i) == ("II", 1) else "",
        )
        for s in SIMULATIONS for i, quantity in enumerate(QUANTITIES)
    ]  # fmt: skip
