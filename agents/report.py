"""The ablation report: one HTML page that needs nothing but itself, and every word about numbers computed."""

import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict, is_dataclass
from importlib import metadata
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np

import vessel_gym
from agents.ablation import AGENTS, AUTOPILOT, PPO, TOLD, Cell, Results, Study
from agents.autopilot import Tolerances
from agents.figures import WINDOW, heading_figure, input_figure, score_figure, track_figure
from agents.files import replacing
from agents.metrics import WITHOUT_COVARIANCE
from agents.page import Claim, Entry, Table, entry, listed, number, words
from agents.statistics import Interval, mean_interval, paired_difference
from agents.turning_scores import METRICS, metric
from vessel_gym.sensors import nominal_sd

RANKING = ("kf-umv-ui", "kf", "dead-reckoning")
"""Estimators in the order in which the task should rank them."""
MARGIN = -0.02
"""How far PPO may fall below the autopilot, at the lower end of the interval, and still be its equal."""

PERFORMANCE = ("score", "return", "heading_error", "yaw_rate_error", "radius_error", "out_of_round", "rudder_rate")
ESTIMATION = ("heading_rmse", "yaw_rate_rmse", "sway_rmse", "input_rmse", "raw_input_rmse", "nees")
_LIBRARIES = ("numpy", "scipy", "numba", "gymnasium", "stable-baselines3", "torch", "matplotlib")


# --- the answer, and the claims ---------------------------------------------------------------------


def answer(results: Results) -> list[str]:
    """What the estimator costs and which to fly: the sentences of one paragraph, the advice first."""
    study = results.study
    hardest = study.seas[-1]
    candidates = [name for name in study.estimators if name != "truth"]
    places = list(product(study.seas, AGENTS))
    best = [_best(results, sea, agent, candidates) for sea, agent in places]
    pick = max(candidates, key=best.count)
    others = [name for name in candidates if name != pick]
    beaten, level = [], []
    for (sea, agent), name in product(places, others):
        gap = results.difference(Cell(sea, agent, name), Cell(sea, agent, pick), "score")
        place = f"{name} for {_who(agent)} in {sea} seas"
        if gap is not None and gap.low > 0.0:
            beaten.append(f"{place} (by {_gap(gap)})")
        elif gap is None or not gap.excludes_zero:
            level.append(place)
    if beaten:
        sentences = [
            f"Fly {pick}, which has the highest mean score in {best.count(pick)} of {len(places)} cases of agent and "
            f"sea, but is beaten by {listed(beaten)}."
        ]
    else:
        sentences = [
            f"Fly {pick}: of all estimators but the truth itself none scores higher beyond chance, "
            f"neither for the autopilot nor for PPO, in {listed(study.seas)} seas."
        ]
    if level:
        sentences.append(f"Within chance of {pick}: {listed(level)}.")
    for agent in AGENTS:
        ours = Cell(hardest, agent, pick)
        truth = ours._replace(estimator="truth")
        losses = [
            f"{_gap(results.difference(ours, ours._replace(estimator=name), 'score'))} on {name}" for name in others
        ]
        sentences.append(
            f"In {hardest} seas {_who(agent)} scores {words(results.mean(ours, 'score'), 3)} on {pick}, "
            f"{_gap(results.difference(truth, ours, 'score'))} less than on the truth"
            + (f"; against {pick} it loses {listed(losses)}." if losses else ".")
        )
    if {"kf-umv-ui", "kf"} <= set(study.estimators):
        ours, kf = (Cell(hardest, AUTOPILOT, name) for name in ("kf-umv-ui", "kf"))
        sentences.append(
            f"The heading that kf-umv-ui believes is {words(results.mean(ours, 'heading_rmse'), 2)} mrad off (RMS), "
            f"that of a kf which ignores the unknown input {words(results.mean(kf, 'heading_rmse'), 2)} mrad."
        )
    sentences.append(
        f"PPO minus autopilot, on the {study.trained_on} estimates and in the {study.trained_in} seas of the training: "
        f"{_gap(_learning(results, None), signed=True)}."
    )
    sentences.append(
        f"(Means over {study.episodes} paired seeds with 95 % intervals; PPO: mean of "
        f"{study.training_seeds} training run{'s' if study.training_seeds > 1 else ''}.)"
    )
    return sentences


def claims(results: Results) -> list[Claim]:
    """What the study set out to show, each decided by the data."""
    study = results.study
    hardest, found = study.seas[-1], []
    ranking = [name for name in RANKING if name in study.estimators]
    for agent, (upper, lower) in product(AGENTS, pairwise(ranking)):
        gap = results.difference(Cell(hardest, agent, upper), Cell(hardest, agent, lower), "score")
        text = f"In {hardest} seas {_who(agent)} scores higher on {upper} than on {lower}."
        found.append(Claim(text, _verdict(gap), f"difference {words(gap, 4)}"))
    for agent, sea in product(AGENTS, study.seas):
        gap = results.difference(Cell(sea, agent, "truth"), Cell(sea, agent, study.trained_on), "score")
        text = f"In {sea} seas {_who(agent)} does not score higher on {study.trained_on} than on the truth."
        found.append(Claim(text, _ceiling(gap), f"truth − {study.trained_on} {words(gap, 4)}"))
    for seed in range(study.training_seeds):
        gap = _learning(results, seed)
        text = (
            f"PPO of training seed {seed} is at least the autopilot's equal on {study.trained_on} in "
            f"{study.trained_in} seas (lower end of the interval not below {number(MARGIN, 2)})."
        )
        verdict = "undecided" if gap is None else "true" if gap.low >= MARGIN else "false"
        found.append(Claim(text, verdict, f"PPO − autopilot {words(gap, 4)}"))
    for text, unit, gap in _estimation_gaps(results):
        if text.startswith("kf-umv-ui"):
            found.append(Claim(f"In {hardest} seas: {text} (autopilot).", _verdict(gap), f"{words(gap, 3)} {unit}"))
    return found


def _best(results: Results, sea: str, agent: str, estimators: Sequence[str]) -> str:
    """The estimator with the highest mean score."""
    return max(estimators, key=lambda name: float(results.values(Cell(sea, agent, name), "score").mean()))


def _learning(results: Results, run: int | None) -> Interval | None:
    """PPO minus autopilot where PPO was trained: of one training run, or of their mean."""
    study = results.study
    ppo, autopilot = (Cell(study.trained_in, agent, study.trained_on) for agent in (PPO, AUTOPILOT))
    return paired_difference(results.values(ppo, "score", run), results.values(autopilot, "score"))


def _estimation_gaps(results: Results, agent: str = AUTOPILOT) -> list[tuple[str, str, Interval | None]]:
    """Paired comparisons of estimation errors in the hardest sea: what is said, unit, by how much less."""
    study = results.study
    comparisons = (
        ("kf-umv-ui", "heading_rmse", "kf", "heading_rmse", "has a lower heading error than kf"),
        ("kf-umv-ui", "heading_rmse", TOLD, "heading_rmse", f"has a lower heading error than {TOLD}"),
        (TOLD, "heading_rmse", "kf", "heading_rmse", "has a lower heading error than kf"),
        ("kf-umv-ui", "yaw_rate_rmse", "kf", "yaw_rate_rmse", "has a lower yaw-rate error than kf"),
        ("kf-umv-ui", "yaw_rate_rmse", TOLD, "yaw_rate_rmse", f"has a lower yaw-rate error than {TOLD}"),
        ("kf-umv-ui", "input_rmse", "kf-umv-ui", "raw_input_rmse", "has a lower error of d than the raw channel"),
    )
    gaps = []
    for ours, key, theirs, their_key, text in comparisons:
        if {ours, theirs} <= set(study.estimators):
            mine, other = (Cell(study.seas[-1], agent, name) for name in (ours, theirs))
            gaps.append((f"{ours} {text}", metric(key).unit, results.difference(other, mine, their_key, key)))
    return gaps


def _verdict(gap: Interval | None) -> str:
    if gap is None or not gap.excludes_zero:
        return "undecided"
    return "true" if gap.low > 0.0 else "false"


def _ceiling(gap: Interval | None) -> str:
    if gap is None:
        return "undecided"
    if gap.mean >= 0.0:
        return "true"
    return "false" if gap.high < 0.0 else "false, within chance"


# --- tables -----------------------------------------------------------------------------------------


def tables(results: Results) -> list[Table]:
    """Every table of the report."""
    study = results.study
    without = listed([name for name in study.estimators if name in WITHOUT_COVARIANCE])
    silent = [name for name in study.estimators if np.isnan(results.values(_any(study, name), "input_rmse")).all()]
    differences = [key for key in PERFORMANCE if key != "return"]
    gap_columns = [_estimation_gaps(results, agent) for agent in AGENTS]
    gap_rows = [
        (f"{text} [{unit}]", [entry(column[i][2], 3, signed=True) for column in gap_columns])
        for i, (text, unit, _) in enumerate(gap_columns[0])
    ]
    return [
        Table(
            "How the ship was steered",
            "Mean ± half the 95 % interval over seeds. " + _meanings(PERFORMANCE) + _missing(results, PERFORMANCE),
            "Estimator",
            _head(PERFORMANCE),
            _sections(results, lambda cell: [entry(results.mean(cell, k), metric(k).decimals) for k in PERFORMANCE]),
        ),
        Table(
            "What the estimator costs: paired differences against truth",
            "Value on the estimator minus value on truth at the same seed, ± half the 95 % interval; bold where the "
            "interval excludes zero. Higher is better for the score, lower for all else.",
            "Estimator",
            _head(differences),
            _sections(
                results,
                lambda cell: [
                    entry(
                        results.difference(cell, cell._replace(estimator="truth"), key),
                        metric(key).decimals + 1,
                        signed=True,
                    )
                    for key in differences
                ],
                skip="truth",
            ),
        ),
        Table(
            "How well the state was estimated",
            "RMS estimation errors along the track that each agent flew, mean ± half the 95 % interval. "
            + _meanings(("raw_input_rmse", "nees"))
            + " In band: share of times at which the mean NEES over all seeds lies in its 95 % chi-square band "
            "(0.95 for an estimator that is as good as it says; a cautious one falls outside, too). "
            f"A dash: {without} claim no covariance of their own, so their NEES means nothing"
            + (f"; {listed(silent)} estimate no unknown input." if silent else "."),
            "Estimator",
            [*_head(ESTIMATION), ("In band", "")],
            _sections(
                results,
                lambda cell: [
                    *(entry(results.mean(cell, key), metric(key).decimals) for key in ESTIMATION),
                    Entry("–" if results.in_band[cell] is None else f"{results.in_band[cell]:.2f}"),
                ],
            ),
        ),
        Table(
            f"Estimators against each other, {study.seas[-1]} seas",
            "How much lower the first error is than the second at the same seed (positive: the statement holds), ± "
            f"half the 95 % interval; bold where the interval excludes zero. {TOLD}: the Kalman filter that is told "
            "the variance of d and takes it for white noise, the fair rival.",
            "Statement",
            [(f"{agent[0].upper()}{agent[1:]}", "") for agent in AGENTS],
            [("", gap_rows)],
        ),
        Table(
            f"PPO against the autopilot, {study.trained_on}, {study.trained_in} seas",
            f"Scores over the {study.episodes} evaluation seeds, which no training and no tuning has used.",
            "Training seed",
            [("PPO", ""), ("Autopilot", ""), ("PPO − autopilot", ""), ("Lower end", "")],
            [("", [(str(seed), _learning_row(results, seed)) for seed in range(study.training_seeds)])],
        ),
    ]


def _learning_row(results: Results, seed: int) -> list[Entry]:
    study = results.study
    ppo, autopilot = (Cell(study.trained_in, agent, study.trained_on) for agent in (PPO, AUTOPILOT))
    gap = _learning(results, seed)
    return [
        entry(mean_interval(results.values(ppo, "score", seed)), 3),
        entry(results.mean(autopilot, "score"), 3),
        entry(gap, 4, signed=True),
        Entry("–" if gap is None else number(gap.low, 4, signed=True)),
    ]


def _sections(
    results: Results, entries: Callable[[Cell], list[Entry]], skip: str = ""
) -> list[tuple[str, list[tuple[str, list[Entry]]]]]:
    """A section for each sea and agent, a row for each estimator."""
    study = results.study
    names = [name for name in study.estimators if name != skip]
    return [
        (f"{sea} sea, {agent}", [(name, entries(Cell(sea, agent, name))) for name in names])
        for sea, agent in product(study.seas, AGENTS)
    ]


def _head(keys: Sequence[str]) -> list[tuple[str, str]]:
    return [(metric(key).label, metric(key).unit) for key in keys]


def _meanings(keys: Sequence[str]) -> str:
    return " ".join(f"{metric(key).label}: {metric(key).meaning}" for key in keys)


def _missing(results: Results, keys: Sequence[str]) -> str:
    """Where a figure exists for some episodes of a cell only, say for how many."""
    notes = []
    for cell, key in product(results.figures, keys):
        values = results.values(cell, key)
        count = int(np.isfinite(values).sum())
        if 0 < count < len(values):
            notes.append(f"{metric(key).label.lower()} on {cell.estimator}, {cell.sea} sea, {cell.agent}: {count}")
    return f" Episodes that have the figure, where not all do: {'; '.join(notes)}." if notes else ""


def _any(study: Study, estimator: str) -> Cell:
    return Cell(study.seas[-1], AUTOPILOT, estimator)


# --- words ------------------------------------------------------------------------------------------


def _gap(interval: Interval | None, signed: bool = False) -> str:
    """A difference of scores, with a digit more where it is small."""
    if interval is None:
        return "–"
    decimals = 3 if interval.half >= 0.00095 else 4
    return f"{number(interval.mean, decimals, signed)} ± {number(interval.half, decimals)}"


def _who(agent: str) -> str:
    return "the autopilot" if agent == AUTOPILOT else agent


# --- what is needed to run it again -----------------------------------------------------------------


def command(study: Study, out: Path) -> str:
    """The command that runs this study again."""
    steps = "" if study.steps is None else f" --steps {study.steps}"
    return (
        f"python -m scripts.ablate --out {out} --env-id {study.env_id} --episodes {study.episodes} "
        f"--training-seeds {study.training_seeds}{steps} --jobs {study.jobs}"
    )


def settings(results: Results, out: Path) -> list[tuple[str, list[tuple[str, str]]]]:
    """Every setting, as sections of names and values in plain text."""
    study, system = results.study, results.system
    vehicle: Any = system.vehicle
    trained = results.trained[0]
    run = [
        ("command", command(study, out)),
        ("evaluation seeds", f"{study.seeds[0]} to {study.seeds[-1]}"),
        ("training seeds", f"0 to {study.training_seeds - 1}"),
        ("training time", ", ".join(f"{described['trained_seconds']:.0f} s" for described in results.trained)),
        ("machine", f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"),
    ]
    versions = [("vessel-gym", vessel_gym.__version__)] + [(name, metadata.version(name)) for name in _LIBRARIES]
    ppo = {
        "trained on": f"{study.trained_on}, {study.trained_in} seas",
        "environment steps": f"{trained['trained_steps']:,} each".replace(",", " "),
        **trained["hyperparameters"],
        "source digest (SHA-256)": trained["source"],
    }
    filters = {
        "filter model": system.filter_model,
        "step": f"{vehicle.dt:g} s",
        "process noise SD a step (v, r, ψ)": ", ".join(f"{sd:g}" for sd in vehicle.process_sd[:3]),
        "reading SD (compass, yaw increment)": ", ".join(f"{sd:g} rad" for sd in nominal_sd(vehicle.instruments)),
        "sensors": "nominal: every reading arrives, no outliers",
        "mismatch": "0: the filter's coefficients are the ship's",
    }
    for name, sea in product(study.estimators, study.seas):
        options = study.env_options(name, sea, system)
        tuned = system.tuning(name, system.disturbances[sea]) | options.get("estimator_options", {})
        if tuned:
            filters[f"{name}, {sea}"] = ", ".join(f"{key} {value:.4g}" for key, value in tuned.items())
    seas = [(name, _fields(system.disturbances[name])) for name in study.seas]
    return [
        ("Run", run),
        ("Versions", versions),
        ("Estimators", list(filters.items())),
        ("Seas (SI units)", seas),
        ("Task", [("turning circle", _fields(system.task))]),
        ("Autopilot", [("tolerances", _fields(Tolerances()))]),
        ("PPO", [(name.replace("_", " "), str(value)) for name, value in ppo.items()]),
    ]


def _fields(record: Any) -> str:
    """A frozen dataclass in one line, its nested ones left out."""
    assert is_dataclass(record)
    assert not isinstance(record, type)
    plain = {k: v for k, v in asdict(record).items() if not isinstance(v, dict)}
    return ", ".join(f"{name.replace('_', ' ')} {_plain(value)}" for name, value in plain.items())


def _plain(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


# --- the page ---------------------------------------------------------------------------------------


def write_report(results: Results, out: Path) -> Path:
    """Write ``report.html`` to a folder, whole or not at all.

    Args:
        results: Of `agents.ablation.run`.
        out: The folder.

    Returns:
        The file.

    Raises:
        OSError: if it cannot be written.
    """
    path = out / "report.html"
    with replacing(path) as temporary:
        temporary.write_text(render(results, out), encoding="utf-8")
    return path


def render(results: Results, out: Path) -> str:
    """The report as HTML."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("agents"), autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
    )
    study = results.study
    hardest = study.seas[-1]
    figures = [
        (
            score_figure(results),
            "Score by estimator",
            "Means and 95 % intervals over the evaluation seeds (PPO: mean of its training runs). Above: the score. "
            "Below: what is lost of it against truth at the same seed.",
        ),
        (
            track_figure(results),
            "Tracks, true and believed",
            f"The autopilot in {hardest} seas at evaluation seed {study.seeds[0]}, the first: it was not chosen. No "
            "estimator knows a position: the believed track is dead-reckoned from the estimate, with the speed of the "
            "steady turn at the believed yaw rate; the true speed lags behind that. All tracks are through the water: "
            "the current carries them alike.",
        ),
        (
            input_figure(results),
            "Unknown input, true and estimated",
            f"The same episode on {study.trained_on}, {WINDOW[0]:.0f} to {WINDOW[1]:.0f} s. Above: the yaw increment d "
            "that waves and gusts give the ship in each step. Below: the errors of the estimate and the raw channel.",
        ),
        (
            heading_figure(results),
            "Heading estimation error, and what the filter claims",
            "The same seed. Bands: two standard deviations of the filter's own covariance; an honest filter leaves "
            "them one time in twenty.",
        ),
    ]
    return environment.get_template("report.html").render(
        study=study,
        hardest=hardest,
        answer=answer(results),
        claims=claims(results),
        tables=tables(results),
        figures=figures,
        settings=settings(results, out),
        metrics=METRICS,
        version=vessel_gym.__version__,
        told=TOLD,
    )
