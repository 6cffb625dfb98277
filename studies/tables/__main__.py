"""Fly what the tables of docs/ show, and write them anew: ``python -m studies.tables``."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import combinations, product
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np

from agents import rollout
from agents.commands.console import command, progress_bar
from agents.metrics import WITHOUT_COVARIANCE, components, consistency, scores
from agents.policies.checkpoint import description, packaged
from agents.refusal import Refusal
from agents.seeds import evaluation_seeds
from agents.studies.worlds import system_of
from studies.papers.measures import papers_page, readme_line
from studies.tables.arms import EPISODES, Arm
from studies.tables.channel import channel
from studies.tables.compass import compass
from studies.tables.faults import SEEDS, faults, faults_found, gap, inputs, latency
from studies.tables.filters import huber_iterations, published_scores, robust_losses, unstable_zeros
from studies.tables.grades import sensor_grades
from studies.tables.markdown import ROOT, WITHOUT, number, percent, put, rows_of, shown, table
from studies.tables.overturn import overturn
from studies.tables.suites import (
    by_suite,
    differences,
    environments,
    flown,
    found,
    headline,
    truth_first,
)
from vessel_gym.envs.ship import SIGMA_CORVETTE
from vessel_gym.vehicles.corvette import MOTION_UNIT


class Flown(NamedTuple):
    """Metrics of `EPISODES` flights by key, and shares of times in the chi-square band."""

    scores: dict[str, np.ndarray]
    arrived: int
    position_band: float | None
    band: float | None


PLAIN = {"members": 100, "draws": "independent"}
MISMATCH, DEGRADED, ROUGH = {"mismatch": 0.2}, {"sensors": "degraded"}, {"disturbance": "rough"}
DIVES = (
    Arm("`truth`", "truth"),
    Arm("`enkf`", "enkf"),
    Arm("`enkf`, independent draws", "enkf", PLAIN),
    Arm("`enkf-sr`", "enkf-sr"),
    Arm("`enkf-sr`, independent draws", "enkf-sr", PLAIN),
    *(
        Arm(f"`{name}`", name)
        for name in ("ekf", "ukf", "huber-kf", "measurement", "dead-reckoning")
    ),
)
FLIGHTS = (
    *DIVES[:5],
    *(
        Arm(f"`{name}`", name)
        for name in ("ekf", "ukf", "huber-kf", "robust-kf", "measurement", "dead-reckoning")
    ),
)


def elsewhere(default: str) -> tuple[Arm, ...]:
    """Other members, models, sensors and seas, on an environment's default estimator and its rivals."""
    return (
        Arm("default, 1,000 members", default, {"members": 1000}),
        Arm("default, mismatch 0.1", default, world={"mismatch": 0.1}),
        Arm("default, mismatch 0.2", default, world=MISMATCH),
        Arm("`ekf`, mismatch 0.2", "ekf", world=MISMATCH),
        Arm("`truth`, mismatch 0.2", "truth", world=MISMATCH),
        Arm("default, degraded", default, world=DEGRADED),
        Arm("`ekf`, degraded", "ekf", world=DEGRADED),
        Arm("`huber-kf`, degraded", "huber-kf", world=DEGRADED),
        Arm("default, rough", default, world=ROUGH),
        Arm("`ekf`, rough", "ekf", world=ROUGH),
        Arm("`truth`, rough", "truth", world=ROUGH),
    )


JOURNEYS = {
    "SegorogeniAUV-v0": (*DIVES, *elsewhere("enkf")),
    "ItsunusaAUV-v0": (*DIVES, *elsewhere("enkf-sr")),
    "PunaUAV-v0": (*FLIGHTS, *elsewhere("enkf")),
}
"""The ways of each environment's table."""
SHORT = {
    "SegorogeniAUV-v0": ("Segorogeni (`enkf`)", "`truth`", "`enkf`", "`enkf`, independent draws"),
    "ItsunusaAUV-v0": (
        "ITSUNUSA (`enkf-sr`)",
        "`truth`",
        "`enkf-sr`",
        "`enkf-sr`, independent draws",
    ),
    "PunaUAV-v0": ("PUNA (`enkf`)", "`truth`", "`enkf`", "`enkf`, independent draws"),
}
"""Name of an environment on its own page, and the arms that this page adds to those of all environments."""
OTHER = {"moderate": "calm", "rough": "moderate"}
"""A sea that a filter is told of wrongly."""


def turns_in(sea: str) -> tuple[Arm, ...]:
    """Ways of telling filters of the corvette's sea."""
    met, other = ({"assume": {"disturbance": name, "as": "states"}} for name in (sea, OTHER[sea]))
    believed: Any = SIGMA_CORVETTE.disturbances[sea].believed
    still = {"assume": {"disturbance": replace(believed, current=0.0)}}
    return (
        Arm("`truth`", "truth"),
        Arm("`kf-umv-ui`", "kf-umv-ui"),
        Arm("`kf-umv-ui`, without a current", "kf-umv-ui", still),
        Arm("`ekf`, waves as states, as the ship meets them", "ekf", met),
        Arm(f"`ekf`, likewise, assuming a {OTHER[sea]} sea", "ekf", other),
        Arm("`ekf`, waves as states, of no direction", "ekf", {"assume": {"as": "states"}}),
        Arm(
            "`ekf`, waves as process noise, without a current",
            "ekf",
            {"assume": {"as": "process-noise"}},
        ),
        Arm("`ekf`, nothing of waves", "ekf"),
        Arm("`kf-umv-ui`, linear", "kf-umv-ui", {"model": "linear"}),
        Arm("`kf` with d's variance, linear", "kf", {"assume": {"as": "white-input"}}),
        *(Arm(f"`{name}`, linear", name) for name in ("ulise", "kf", "huber-kf", "robust-kf")),
        *(Arm(f"`{name}`", name) for name in ("measurement", "dead-reckoning")),
    )


@cache
def journey(env_id: str, label: str) -> Flown:
    """Rollout metrics of one of an environment's arms."""
    flight = next(arm for arm in JOURNEYS[env_id] if arm.label == label).fly(env_id)
    position, of_all = (
        consistency(flight, where) for where in (components(flight, "x", "y", "z", "h"), None)
    )
    return Flown(scores(flight), int((flight.end == "arrived").sum()), position, of_all)


def journeys(env_id: str) -> str:
    """Scores of estimators in a dive or a flight."""
    altitude = env_id == "PunaUAV-v0"
    heads = ("estimates", f"arrived of {EPISODES}", "off [m]", *(("altitude [m]",) if altitude else ()), "score",
             "position error [m]", "position NEES/n", "in band", "NEES/n, all", "in band")  # fmt: skip
    rows = []
    for arm in JOURNEYS[env_id]:
        of = journey(env_id, arm.label)
        off = "cross_track" if env_id != "ItsunusaAUV-v0" else "normal"
        sure = arm.estimator not in WITHOUT_COVARIANCE
        rows.append((
            arm.label, str(of.arrived), number(of.scores[off], 3),
            *((number(of.scores["altitude"], 2),) if altitude else ()), shown(of.scores["score"]),
            number(of.scores["position_rmse"], 3), number(of.scores["position_nees"], 2) if sure else WITHOUT,
            percent(of.position_band), number(of.scores["nees"], 2) if sure else WITHOUT, percent(of.band),
        ))  # fmt: skip
    return table(heads, rows)


def turns(sea: str) -> str:
    """Scores and errors of the corvette's estimators in a sea."""
    heads = ("estimates", "score", "model 10 % off", "less than `kf-umv-ui`", "off track [m]", "place [m]",
             "heading [mrad]", "yaw rate [mrad/s]", "d [mrad]", "NEES/n")  # fmt: skip
    arms = turns_in(sea)
    ours, rows = arms[1].scores("SigmaCorvette-v0", disturbance=sea)["score"], []
    for arm in arms:
        of, off = (
            arm.scores("SigmaCorvette-v0", disturbance=sea, mismatch=mismatch)
            for mismatch in (0.0, 0.1)
        )
        seen = (
            ("track_error", 1), ("position_rmse", 2), ("heading_rmse", 2), ("yaw_rate_rmse", 2), ("input_rmse", 2),
            ("nees", 2),
        )  # fmt: skip
        less = WITHOUT if arm is arms[1] else shown(ours - of["score"])
        rows.append((
            arm.label, shown(of["score"]), shown(off["score"]), less,
            *(WITHOUT if np.isnan(of[name]).any() else number(of[name], digits) for name, digits in seen),
        ))  # fmt: skip
    return table(heads, rows)


def worth(env_id: str) -> str:
    """Rows of a journey's table for the environment's own page."""
    same = ("`ekf`", "`measurement`", "`dead-reckoning`")
    name, *labels = SHORT[env_id]
    found = (journey(env_id, label) for label in (*labels, *same))
    row = (name, *(f"{shown(of.scores['score'])} ({of.arrived})" for of in found))
    return table(
        (f"Score (arrived of {EPISODES})", "`truth`", "default", "independent draws", *same), [row]
    )


def paired_flights() -> str:
    """Paired differences of the aircraft's scores, which its page argues with."""
    scores = {arm.label: journey("PunaUAV-v0", arm.label).scores["score"] for arm in FLIGHTS}
    default, plain = scores["`enkf`"], scores["`enkf`, independent draws"]
    pairs = {
        "`truth` − default": scores["`truth`"] - default,
        "default − `measurement`": default - scores["`measurement`"],
        "`ekf` − default": scores["`ekf`"] - default,
        "`ukf` − default": scores["`ukf`"] - default,
        "default − independent draws": default - plain,
        "`ekf` − `huber-kf`": scores["`ekf`"] - scores["`huber-kf`"],
    }
    return table(tuple(pairs), [[shown(difference) for difference in pairs.values()]])


def surface_waves() -> str:
    """Scores of the dives under surface waves, which filters are told of or not."""
    untold, rows = {"assume": {"disturbance": "moderate"}}, []
    for env_id, estimators in (
        ("SegorogeniAUV-v0", ("truth", "enkf", "ekf")),
        ("ItsunusaAUV-v0", ("truth", "enkf-sr")),
    ):
        for name in estimators:
            seas = [
                ("moderate", {}),
                ("surface", {}),
                *([("surface", untold)] if name != "truth" else []),
            ]
            cells = [
                shown(Arm(name, name, told).scores(env_id, SEEDS, disturbance=sea)["score"])
                for sea, told in seas
            ]
            rows.append(
                (f"{env_id.removesuffix('-v0')}, `{name}`", *cells, *[WITHOUT] * (3 - len(cells)))
            )
    return table(
        ("", "moderate water", "surface waves", "surface waves, assuming moderate water"), rows
    )


def sensor_sets() -> str:
    """The corvette on `kf-umv-ui` with fewer and other sensors."""
    compass, gyro, receiver = SIGMA_CORVETTE.vehicle.sensors
    sets = {
        "compass, rate gyro, receiver": [compass, gyro, receiver],
        "motion unit instead of the gyro": [compass, MOTION_UNIT, receiver],
        "motion unit besides": [compass, gyro, MOTION_UNIT, receiver],
        "compass and receiver": [compass, receiver],
        "gyro and receiver": [gyro, receiver],
        "compass and gyro": [compass, gyro],
    }
    rows = []
    for label, sensors in sets.items():
        of = Arm(label, "kf-umv-ui").scores("SigmaCorvette-v0", sensors=sensors)
        seen = (number(of[name], 2) for name in ("heading_rmse", "input_rmse", "position_rmse"))
        rows.append((label, shown(of["score"]), *seen))
    return table(("sensors", "score", "heading [mrad]", "d [mrad]", "place [m]"), rows)


def insurance() -> str:
    """The heading error with `kf`, which assumes a size of d, over that with `kf-umv-ui`, by simulation."""

    def error(simulation: str, estimator: str, **options: Any) -> np.ndarray:
        settings = {"estimator": estimator, "estimator_options": options}
        asked = {"simulation": simulation}
        flight = rollout(
            "autopilot",
            "ThesisCorvette-v0",
            evaluation_seeds(EPISODES),
            settings,
            reset_options=asked,
        )
        return scores(flight)["heading_rmse"]

    simulations = {
        "I": "I: d of 0.01 rad",
        "II": "II: larger Q",
        "III": "III: larger R",
        "V": "V: d of 0.1 rad",
    }
    ours = {name: error(name, "kf-umv-ui") for name in simulations}
    rows = []
    for label, sd in (("0.01 rad", 0.01), ("0.1 rad", 0.1), ("1 rad", 1.0), ("nothing", None)):
        options = {} if sd is None else {"input_cov": sd**2}
        rows.append(
            (label, *(shown(error(name, "kf", **options) / ours[name]) for name in simulations))
        )
    return table(("`kf` assumes for d", *simulations.values()), rows)


HEADLINE = (
    "truth", "kf-umv-ui, nonlinear", "ekf assuming waves", "huber-kf, nonlinear", "ekf, nonlinear", "kf, linear",
    "fixed gain, nonlinear", "measurement", "dead-reckoning",
)  # fmt: skip
"""Estimators of the corvette's study in the README and on her page."""


def pairing(results: Path) -> str:
    """Factor of episodes that pairing saves, over all pairs of filters of a study in its nominal condition."""
    rows = []
    for environment in environments(results):
        of = flown(results, environment, "autopilot")
        others = ("truth", "measurement", "dead-reckoning")
        filters = [
            values[0] for (at, name), values in of.items() if at == "nominal" and name not in others
        ]
        pairs = [(a, b) for a, b in combinations(filters, 2) if (a != b).any()]
        factors = [(a.var() + b.var()) / (a - b).var() for a, b in pairs]
        cells = (f"{factor:.1f}" for factor in np.quantile(factors, (0.0, 0.25, 0.5, 0.75)))
        rows.append((environment, str(len(pairs)), *cells))
    return table(
        ("Environment", "pairs", "least", "lower quartile", "median", "upper quartile"), rows
    )


def advice(results: Path) -> str:
    """The answer of a study in sentences, as its report has it, without the times of its machine."""
    lines = (results / "answer.md").read_text(encoding="utf-8").splitlines()
    return fill(
        " ".join(line for line in lines if not line.startswith("A step on")),
        140,
        break_on_hyphens=False,
    )


def exceptions(results: Path) -> str:
    """Conditions of the quick study in which filters differ most, and that cost most."""
    file = results / "episodes.csv"
    best = rows_of(results / "tables" / "ranking.md").splitlines()[2].split("|")[1].strip()

    def less(world: str, condition: str, one: str, other: str) -> str:
        of = flown(file, world, "autopilot")
        return shown(of[condition, one] - of[condition, other])

    worlds = ("PunaUAV-v0", "ItsunusaAUV-v0", "SegorogeniAUV-v0")
    gains = ", ".join(
        f"{less(world, 'bad sensors', 'huber-kf', 'ekf')} in `{world}`" for world in worlds
    )
    lost = " and ".join(
        less("PunaUAV-v0", f"model {share} % off", "truth", best) for share in (10, 20)
    )
    count = flown(file, worlds[0], "autopilot")["bad sensors", best].shape[-1]
    return fill(
        f"Where one measurement in twenty is wild, `huber-kf` scores more than `ekf` by {gains}."
        f" Where lift and mass are 10 or 20 % off, the aircraft loses {lost} of the score on"
        f" `{best}` against the truth. (Means over {count} seeds; each 95 % interval stands for"
        " itself.)",
        140,
        break_on_hyphens=False,
    )


def packaged_agents() -> str:
    """The trained agents of the package beside the autopilots, on default estimates."""
    heads = ("", "estimates", "`autopilot`", "`ppo`", "`ppo` − `autopilot`", f"reached the end, of {EPISODES}",
             "training: seed, steps")  # fmt: skip
    rows = []
    for env_id in ("SigmaCorvette-v0", *JOURNEYS):
        flights = {
            name: rollout(name, env_id, evaluation_seeds(EPISODES), record=False)
            for name in ("autopilot", "ppo")
        }
        system, told = system_of(env_id), description(packaged(env_id)) or {}
        there = (str(int((flight.end == system.task.success).sum())) for flight in flights.values())
        scores = [flight.score for flight in flights.values()]
        rows.append((
            f"`{env_id}`", f"`{system.estimator}`", *map(shown, scores), shown(scores[1] - scores[0]),
            " and ".join(there), f"{told['seed']}, {told['trained_steps']:,}",
        ))  # fmt: skip
    return table(heads, rows)


ENVIRONMENTS, ESTIMATORS = ROOT / "docs/environments", ROOT / "docs/estimators"
HER_PAGE = ENVIRONMENTS / "sigma-corvette.md"
ABLATION, SUITES = ROOT / "results/ablation", ROOT / "results/suites"
CORVETTE, CHANNEL = "SigmaCorvette-v0", "SigmaChannel-v0"


def papers(counted: bool = False) -> str:
    """The papers' measures, or the sentence that counts them, from what ``python -m scripts.reproduce all`` stored."""
    stored, last = (
        ROOT / folder / "summary.json" for folder in ("studies/papers", "results/reproduction")
    )
    if last.exists():
        stored.write_text(last.read_text(encoding="utf-8"), encoding="utf-8")
    return (readme_line if counted else papers_page)(json.loads(stored.read_text(encoding="utf-8")))


TABLES: dict[str, tuple[Path, Callable[[], str]]] = {
    "segorogeni": (ROOT / "docs/dives.md", lambda: journeys("SegorogeniAUV-v0")),
    "itsunusa": (ROOT / "docs/dives.md", lambda: journeys("ItsunusaAUV-v0")),
    "puna": (ROOT / "docs/flight.md", lambda: journeys("PunaUAV-v0")),
    "surface": (ROOT / "docs/dives.md", surface_waves),
    "puna, paired": (ROOT / "docs/flight.md", paired_flights),
    "moderate": (ROOT / "docs/seaway.md", lambda: turns("moderate")),
    "rough": (ROOT / "docs/seaway.md", lambda: turns("rough")),
    "segorogeni, short": (ENVIRONMENTS / "segorogeni-auv.md", lambda: worth("SegorogeniAUV-v0")),
    "itsunusa, short": (ENVIRONMENTS / "itsunusa-auv.md", lambda: worth("ItsunusaAUV-v0")),
    "puna, short": (ENVIRONMENTS / "puna-uav.md", lambda: worth("PunaUAV-v0")),
    "channel": (ENVIRONMENTS / "sigma-channel.md", channel),
    "sensors": (ESTIMATORS / "unknown-input.md", sensor_sets),
    "zeros": (ESTIMATORS / "unknown-input.md", unstable_zeros),
    "huber": (ESTIMATORS / "robust.md", huber_iterations),
    "robust": (ESTIMATORS / "robust.md", robust_losses),
    "lorenz": (ESTIMATORS / "lorenz.md", published_scores),
    "insurance": (ESTIMATORS / "unknown-input.md", insurance),
    "inputs": (ESTIMATORS / "unknown-input.md", inputs),
    "faults": (ESTIMATORS / "unknown-input-faults.md", faults),
    "faults found": (ESTIMATORS / "unknown-input-faults.md", faults_found),
    "agents": (ROOT / "docs/agents.md", packaged_agents),
    "latency": (ROOT / "docs/late-fixes.md", lambda: latency(ROOT / "results/latency")),
    "gap": (ROOT / "docs/late-fixes.md", gap),
    "headline": (
        ROOT / "README.md",
        lambda: by_suite(ABLATION, CORVETTE, "moderate", estimators=HEADLINE),
    ),
    "ablation": (HER_PAGE, lambda: by_suite(ABLATION, CORVETTE, "rough", estimators=HEADLINE)),
    "ablation, PPO": (HER_PAGE, lambda: by_suite(ABLATION, CORVETTE, "moderate", "PPO")),
    "suites": (ROOT / "docs/findings.md", lambda: differences(SUITES)),
    **{
        f"{env_id}, suites": (ROOT / "docs/suites.md", partial(by_suite, SUITES, env_id))
        for env_id in (CORVETTE, CHANNEL, "ThesisCorvette-v0", *JOURNEYS)
    },
    **{
        f"{env_id}, {sea}": (ROOT / "docs/suites.md", partial(by_suite, ABLATION, env_id, sea))
        for env_id, sea in (
            *product((CORVETTE, CHANNEL), ("moderate", "rough")),
            (CHANNEL, "moderate quartering"),
        )
    },
    "compass": (ROOT / "docs/suites.md", compass),
    "pairing": (ROOT / "docs/statistics.md", lambda: pairing(ROOT / "results/quick")),
    "shares": (
        ROOT / "docs/findings.md",
        lambda: rows_of(ROOT / "results/quick/tables/ranking.md"),
    ),
}
"""Page of each table, and the function that makes it."""
TEXTS: dict[str, tuple[Path, Callable[[], str]]] = {
    "grades": (ROOT / "docs/sensor-suites.md", sensor_grades),
    "advice": (ROOT / "docs/findings.md", lambda: advice(ROOT / "results/quick")),
    "exceptions": (ROOT / "docs/findings.md", lambda: exceptions(ROOT / "results/quick")),
    "overturn": (ROOT / "docs/overturn.md", overturn),
    "headline, found": (ROOT / "README.md", lambda: headline(ABLATION, CORVETTE, "moderate")),
    "suites, found": (ROOT / "docs/findings.md", lambda: found(SUITES)),
    "truth, found": (ROOT / "docs/suites.md", lambda: truth_first(ABLATION)),
    "papers": (ROOT / "docs/papers.md", papers),
    "papers, counted": (ROOT / "README.md", lambda: papers(counted=True)),
}
"""Sentences with numbers, likewise."""


def main(names: tuple[str, ...] = (*TABLES, *TEXTS), /) -> None:
    """Write tables of docs/ anew: dives, flights, faults and others are flown, in an hour.

    Tables of studies are taken from results/ablation, results/suites,
    results/quick and results/latency, where `make ablation` and `vessel-gym ablate suites` (or
    quick, or latency) leave them.

    Args:
        names: Which.
    """
    for name in names:
        if name not in TABLES | TEXTS:
            raise Refusal(f"there is no table {name!r}: known are {', '.join(TABLES | TEXTS)}")
    with progress_bar("tables", len(names)) as advance:
        for name in names:
            page, made = (TABLES | TEXTS)[name]
            put(page, f"{'table' if name in TABLES else 'text'}: {name}", made())
            advance()


if __name__ == "__main__":
    command(main)
