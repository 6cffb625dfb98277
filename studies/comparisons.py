"""Tables of docs/ whose cells are rollouts: arms beside one another on the same seeds.

The label of an arm is an estimator, or ``default``, and one of the `VARIANTS` of filter and world.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from agents import Rollout, rollout
from agents.metrics import components, nees_of, scores
from agents.page import mean_and_half, number
from agents.seeds import evaluation_seeds
from agents.studies.worlds import system_of
from estimators import nees
from studies.markdown import NONE, ROOT, table
from vessel_gym.disturbances import Fault
from vessel_gym.sensors import in_quality

CORVETTE, EPISODES = "SigmaCorvette-v0", 100
SETTINGS = tomllib.loads((ROOT / "studies/data/comparisons.toml").read_text(encoding="utf-8"))
VARIANTS: dict[str, dict[str, Any]] = SETTINGS["variants"]
"""Options of an environment, by what follows the estimator in a label."""
_FLOWN: dict[str, dict[str, Any]] = {}


def assuming(disturbance: Any, role: str = "") -> dict[str, Any]:
    """Options of a filter that assumes a disturbance, perhaps in a role, such as ``"states"``."""
    return {
        "estimator_options": {
            "assume": {"disturbance": disturbance} | ({"as": role} if role else {})
        }
    }


def environment_options(environment: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Options of an environment from those of a file.

    Sensors may be a table with the noise and drop-out of `in_quality`. A disturbance may be a table
    of faulty actuators, the disturbance beside them and parameters of a `Fault`. A filter's
    assumption may be a table of such parameters; the world's faulty actuators and other disturbance
    are added to it.
    """
    system, made = system_of(environment), {**options}

    def acting(of: Any) -> Any:
        if not isinstance(of, Mapping):
            return of
        fault = {"beside": "moderate", **of}
        found = system.disturbances[fault.pop("beside")]
        for actuator in fault.pop("faulty"):
            found = Fault(actuator, beside=found, **fault)
        return found

    match made.get("sensors"):
        case {"noise": noise, "dropout": dropout}:
            made["sensors"] = [*in_quality(system.vehicle.sensors, noise, dropout)]
    world = made.get("disturbance")
    match made:
        case {"estimator_options": {"assume": {"disturbance": {**walk}, "as": role}}}:
            if isinstance(world, Mapping):
                world = {key: world[key] for key in ("faulty", "beside")} | walk
            made |= assuming(acting(world), role)
    if "disturbance" in made:
        made["disturbance"] = acting(made["disturbance"])
    return made


def arm_metrics(
    arm: str,
    environment: str,
    variants: Mapping[str, Any] = VARIANTS,
    episodes: int = 0,
    reset: dict[str, Any] | None = None,
    agent: str = "autopilot",
    **world: Any,
) -> dict[str, Any]:
    """Metrics of an arm, one number an episode ``(episodes,)``, and how many episodes arrived.

    Rollouts are flown once. ``world`` holds further options of the environment.
    """
    found = re.fullmatch(r"`?([\w-]+)`?,? ?(.*)", arm)
    assert found is not None
    chosen = variants[found[2]] | ({} if found[1] == "default" else {"estimator": found[1]})
    options, seeds = chosen | world, evaluation_seeds(min(episodes or EPISODES, EPISODES))
    key = repr((environment, options, len(seeds), reset, agent))
    if key not in _FLOWN:
        flight = rollout(
            agent, environment, seeds, environment_options(environment, options), reset
        )
        of: dict[str, Any] = scores(flight)
        of["arrived"] = str((flight.end == system_of(environment).task.success).sum())
        _FLOWN[key] = of
    return _FLOWN[key]


REFUSALS = {
    "needs a LinearModel": "nonlinear model",
    r"needs rank\(H\) = (\d+) unknown inputs?, got (\d+)": "rank H = {1}, not {0}",
    r"standard deviation of (\S+) times": "σ = {0}",
}
"""Refusals of filters, and how a table shows them."""


def cell(
    metric: str = "score",
    decimals: int = 3,
    plain: bool = False,
    below: str = "",
    over: str = "",
    head: str = "",
    environments: Sequence[str] = (),
    **arm: Any,
) -> str:
    """A metric's mean with its interval, or ``plain``; or why the environment refuses the filter.

    Args:
        metric: Key of a metric or of words.
        decimals: Of the number.
        plain: The mean alone; a quotient is then that of two means.
        below: The arm from which this one is subtracted.
        over: The arm by which this one is divided.
        head: Of its row or column, for `comparison`.
        environments: That have its row or column, for `comparison`.
        arm: See `arm_metrics`.
    """
    if below == arm["arm"]:
        return NONE
    try:
        value = arm_metrics(**arm)[metric]
    except ValueError as error:
        for pattern, reason in REFUSALS.items():
            if found := re.search(pattern, str(error)):
                return reason.format(*found.groups())
        raise
    if isinstance(value, str):
        return value
    if below:
        value = arm_metrics(**arm | {"arm": below})[metric] - value
    if over:
        reference = arm_metrics(**arm | {"arm": over})[metric]
        value = value / (reference.mean() if plain else reference)
    return number(value.mean(), decimals) if plain else mean_and_half(value, decimals)


def comparison(name: str, environment: str = "", **more: Any) -> str:
    """A table of ``data/comparisons.toml``: a cell is of what its row, its column and it give.

    Args:
        name: Of the table.
        environment: One of those that have such a table; empty: its own.
        more: Over what the file gives.
    """
    shared: dict[str, Any] = SETTINGS[name] | ({"environment": environment} if environment else {})
    shared |= more
    corner, home = shared.pop("corner", None), shared.get("environment")

    def side(specs: Sequence[Any]) -> list[dict[str, Any]]:
        full = ({"head": s, "arm": s} if isinstance(s, str) else {"head": ""} | s for s in specs)
        return [s for s in full if home in s.get("environments", [home])]

    down, across = side(shared.pop("rows")), side(shared.pop("columns"))
    lines = [[row["head"], *(cell(**shared | row | of) for of in across)] for row in down]
    heads = [*(corner or "").split(" | "), *(of["head"] for of in across)]
    start = corner is None
    return table(heads[start:], [line[start:] for line in lines])


def turns(sea: str, other: str) -> str:
    """Scores and errors of filters that assume the corvette's sea rightly, wrongly or not."""
    believed = system_of(CORVETTE).disturbances[sea].believed
    rows = [of.format(other=other) for of in SETTINGS["turns"]["rows"]]
    still = {"assuming no current": assuming(replace(believed, current=0.0))}
    return comparison("turns", rows=rows, variants=VARIANTS | still, disturbance=sea)


COMPONENTS = {
    "position": ("x", "y"), "heading": ("psi",), "current": ("current north", "current east"),
    "yaw increment": ("last yaw increment",), "surge": ("u",), "sway": ("v",), "yaw rate": ("r",),
}  # fmt: skip
"""States of the corvette whose NEES is shown together."""


def consistency(*shown: str) -> str:
    """NEES of some `COMPONENTS` of the corvette's filters, after the first minute."""
    lines = []
    for sea in ("moderate", "rough"):
        for name in ("kf-umv-ui", "ekf-waves", "ekf"):
            options = {"estimator": name, "disturbance": sea}
            flown = rollout("autopilot", CORVETTE, evaluation_seeds(EPISODES), options)
            flown = flown if name == "ekf-waves" else with_leeway(flown)
            late = np.arange(len(flown.alive)) * flown.config.system.vehicle.dt > 60.0
            counted = flown.alive & late[:, None]
            found = (number(component_nees(flown, each)[counted].mean(), 2) for each in shown)
            lines.append([f"{sea}, `{name}`", *found])
    return table(["NEES/n", *shown], lines)


def with_leeway(flown: Rollout) -> Rollout:
    """A rollout in a `Seaway` whose true current includes the leeway.

    The leeway is that of the ship when it holds the present heading.
    """
    truth, names = flown.history["truth"].copy(), flown.config.true_state.names
    psi, north = truth[..., names.index("psi")], names.index("current north")
    sway = flown.config.world.disturbance.steady_sway(psi)
    truth[..., north] -= sway * np.sin(psi)
    truth[..., north + 1] += sway * np.cos(psi)
    return replace(flown, history=flown.history | {"truth": truth})


def component_nees(flown: Rollout, shown: str) -> np.ndarray:
    """NEES/n ``(T + 1, N)`` of one of `COMPONENTS`; NaN if the filter has none.

    The yaw increment is a state of the filter, or its unknown input.
    """
    names, h = COMPONENTS[shown], flown.history
    if components(flown, *names):
        return np.asarray(nees_of(flown, *names)) / len(names)
    if "input_covariance" in h:
        return nees(h["input_estimate"], h["input_covariance"], h["unknown_input"])
    return np.full(flown.alive.shape, np.nan)


def compass() -> str:
    """Scores by the correlation time [s] of the `budget` compass."""
    first, *others = system_of(CORVETTE).sensors_of("budget").each
    rows = [
        {
            "head": f"{time:g} s",
            "sensors": [replace(first, bias=replace(first.bias, time=time)), *others],
        }
        for time in (10.0, 30.0, 300.0, 3000.0)
    ]
    return comparison("compass", rows=rows)
