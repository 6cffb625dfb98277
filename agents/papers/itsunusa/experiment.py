"""ITSUNUSA's dive to 20 m with ensembles of 200 to 400 members."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from agents.controllers.dive import DiveAutopilot
from agents.papers.figures import figure, panels
from agents.papers.measures import (
    EXPLORATORY,
    against_table,
    by_members,
    comparison_table,
    means,
    rows,
    with_units,
)
from agents.papers.vehicle import Experiment, channel_sd, own_step
from estimators import Filter, make, rmse
from vessel_gym.envs import ItsunusaAUVEnv
from vessel_gym.system import Estimate
from vessel_gym.vehicles.itsunusa import STATE, Itsunusa

QUANTITIES = {"surge": "m/s", "heave": "m/s", "pitch rate": "rad/s", "depth": "m"}
_ESTIMATED = [STATE.index(name) for name in ("u", "w", "q", "theta")]
_SCORED = [STATE.index(name) for name in ("u", "w", "q", "z")]
_DEPTH = STATE.index("z")
VEHICLE = Itsunusa()
_step = own_step(VEHICLE)
MEASUREMENT_SD = channel_sd(VEHICLE.sensors, ("u over ground", "w over ground", "q", "theta"))
# on u, w, q and pitch
PROCESS_SD = np.append(ItsunusaAUVEnv.system.disturbances["moderate"].white.diagonal(), 0.0)
PRIOR_SD = np.array(ItsunusaAUVEnv.system.task.prior_sd)[[0, 1, 2, 5]]


def rms_errors(experiment: Experiment, filter_: Filter, runs: int, seed: int) -> np.ndarray:
    """RMSE ``(runs, 4)`` of the `QUANTITIES` in some dives.

    Truth and measurements of the motions depend on the seed alone.
    """
    truth, measurements = experiment.simulate(runs, np.random.default_rng([seed, 0]))
    found = scored(experiment, experiment.estimates(filter_, measurements, seed)[0])
    return rmse(found[1:], truth[1:, :, _SCORED], axis=0)


def dive(
    trial: Mapping[str, float], measured: int = 3, process: float = 1.0, measurement: float = 1.0
) -> Experiment:
    """The dive from rest under recorded controls, and the filter's assumptions.

    Args:
        trial: Depth and distance ahead [m].
        measured: How many of u, w, q and pitch.
        process: Factor on the process noise.
        measurement: Factor on the measurement noise.
    """
    return Experiment(
        advance=_step,
        start=np.zeros(len(STATE)),
        controls=recorded_controls(trial["ahead"], trial["depth"]),
        estimated=_ESTIMATED,
        measured=list(range(measured)),
        process_sd=process * PROCESS_SD,
        measurement_sd=measurement * MEASUREMENT_SD[:measured],
        prior_sd=PRIOR_SD,
    )


def scored(experiment: Experiment, estimates: np.ndarray) -> np.ndarray:
    """Estimated `QUANTITIES` ``(T + 1, B, 4)``; the depth follows by the vehicle's kinematics."""
    depth = experiment.path(experiment.state(estimates[:-1]), [_DEPTH])
    return np.concatenate([estimates[..., :3], depth], -1)


@cache
def recorded_controls(ahead: float, depth: float) -> np.ndarray:
    """Actuators before and after each step ``(T, 4)`` of the autopilot's dive in still water."""
    system = ItsunusaAUVEnv.system
    task, autopilot = system.task, DiveAutopilot(system, direction=0.06, rate=0.4, ahead=1.0)
    scenario = task.scenario(np.zeros((1, task.uniforms)), {"goal": (ahead, 0.0, depth)})
    truth, actuators = np.zeros((1, len(STATE))), np.zeros((1, len(VEHICLE.action_names)))
    controls: list[np.ndarray] = []
    for step in range(task.horizon):
        reference = task.reference(scenario, np.array([step]), truth)
        if reference[0, 0] >= scenario[0, 1]:
            break
        estimate = Estimate(truth, np.zeros((1, 1)))  # without a current
        action = autopilot.act(task.observe(estimate, scenario, reference, actuators))
        before, actuators = actuators, VEHICLE.actuate(actuators, action)
        controls.append(np.concatenate([before, actuators], -1)[0])
        truth = _step(truth, controls[-1])
    return np.stack(controls)


# --- tables ---------------------------------------------------------------------------------------


FORMS = {"as printed": (True, 3), "pitch measured": (False, 4), "symmetric": (False, 3)}
"""Has the filter the update of Table 1, and how many quantities are measured?

Otherwise it has this package's, which keeps the members' mean.
"""


def report(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Tables and measures."""
    trial, sizes = settings["trial"], (settings["runs"], settings["seed"])
    forms: list[Any] = [("form", "members", *with_units(QUANTITIES))]
    columns = {}
    for label, (as_printed, measured) in FORMS.items():
        of = dive(trial, measured)
        found = {
            n: rms_errors(of, of.ensemble(n, "enkf-sr", as_printed=as_printed), *sizes)
            for n in settings["members"]
        }
        columns[label] = against_table("Table 2", settings["printed"], QUANTITIES, found)
        forms += by_members(label, found)
    names, process, measurement = (choice["believed"] for choice in settings["open"].values())
    of = dive(trial, len(names.split(", ")), process, measurement)
    forms.append(("believed: ekf", "none", *means(rms_errors(of, make("ekf", of.model), *sizes))))
    del columns["symmetric"]  # the page has its errors alone
    (_, plain), (pitched, other) = columns.items()
    paper = settings["paper"]
    way = f"{paper}, {pitched} ({EXPLORATORY})"
    return {
        "tables": {"published": comparison_table(columns), "forms": forms},
        "figures": _figures(settings["members"][-1], settings["seed"], trial),
        "rows": [*rows(paper, plain), *rows(way, other)],
    }


def _figures(members: int, seed: int, trial: Mapping[str, float]) -> list[Any]:
    """Figures 3 to 6: motions and depth in a dive with the update of Table 1."""
    experiment = dive(trial)
    truth, measurements = experiment.simulate(1, np.random.default_rng([seed, 0]))
    printed = experiment.ensemble(members, "enkf-sr", as_printed=True)
    estimates, sds = experiment.estimates(printed, measurements, seed)
    lines = {"real": truth[:, 0, _SCORED], "EnKF-SR": scored(experiment, estimates)[:, 0]}
    bands = [*sds[:, 0, :3].T, None]  # depth is integrated
    drawn = panels(VEHICLE.dt * np.arange(len(truth)), with_units(QUANTITIES), lines, bands)
    return [
        figure(str(number), f"Estimate of {name} by EnKF-SR with {members} members.", panel)
        for number, name, panel in zip((3, 4, 5, 6), QUANTITIES, drawn, strict=True)
    ]
