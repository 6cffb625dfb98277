"""ITSUNUSA's dive to 20 m with ensembles of 200 to 400 members."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from agents.controllers.dive import DiveAutopilot
from agents.jobs import Job
from estimators import EnsembleTransformFilter, Filter, Model, make
from estimators.linalg import cholesky
from studies.papers.dive import Experiment, channel_sd, own_step, rms
from vessel_gym.envs.auv import ITSUNUSA_AUV
from vessel_gym.system import Estimate
from vessel_gym.vehicles.itsunusa import STATE, Itsunusa

QUANTITIES = {"surge": "m/s", "heave": "m/s", "pitch rate": "rad/s", "depth": "m"}
PRINTED, SYMMETRIC = "evensen2004", "symmetric"
"""Forms of `enkf-sr`: the update of the paper's Table 1, and that of this package, which keeps the members' mean."""
_ESTIMATED = [STATE.index(name) for name in ("u", "w", "q", "theta")]
_SCORED = [STATE.index(name) for name in ("u", "w", "q", "z")]
_DEPTH = STATE.index("z")
_STILL = np.zeros(1)  # the current
VEHICLE = Itsunusa()
_step = own_step(VEHICLE)
MEASUREMENT_SD = channel_sd(VEHICLE.sensors, ("u over ground", "w over ground", "q", "theta"))
PROCESS_SD = np.append(
    ITSUNUSA_AUV.disturbances["moderate"].white.diagonal(), 0.0
)  # on u, w, q and pitch
PRIOR_SD = ITSUNUSA_AUV.task.prior(np.zeros((1, 3))).cov.diagonal()[[0, 1, 2, 5]] ** 0.5


def jobs(settings: Mapping[str, Any]) -> dict[str, Job]:
    """Everything to compute, by name."""
    here, found = __name__, {}
    shared = {key: settings[key] for key in ("runs", "seed", "trial")}

    def dives(name: str, form: str, members: int, measured: int = 3, **factors: float) -> None:
        arguments = {"form": form, "members": members, "measured": measured} | shared | factors
        found[name] = Job(f"{here}:estimate", arguments, f"itsunusa, {form}, {members} members")

    for members in settings["members"]:
        dives(f"{PRINTED}, {members}", PRINTED, members)
        dives(f"{SYMMETRIC}, {members}", SYMMETRIC, members)
        dives(f"{SYMMETRIC}, {members}, pitch", SYMMETRIC, members, 4)
    names, process, measurement = (choice["believed"] for choice in settings["open"].values())
    dives("believed", "ekf", 0, len(names.split(", ")), process=process, measurement=measurement)
    return found


def estimate(
    form: str, members: int, runs: int, seed: int, trial: Mapping[str, float], measured: int = 3, process: float = 1.0,
    measurement: float = 1.0,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Errors in some runs of the dive; truth and measurements of the motions depend on the seed alone.

    Args:
        form: Of `enkf-sr`; or "ekf" for the filter that has no members.
        members: N.
        runs: Dives.
        seed: Of truth, measurements and filter.
        trial: Depth and distance ahead [m].
        measured: How many of u, w, q and pitch.
        process: Factor on the process noise.
        measurement: Factor on the measurement noise.

    Returns:
        ``rmse (runs, 4)`` of surge, heave [m/s], pitch rate [rad/s] and depth [m].
    """
    experiment = dive(trial, measured, process, measurement)
    dives = experiment.run(runs, np.random.default_rng([seed, 0]))
    filter_ = _filter(experiment, form, members)
    means = experiment.estimates(
        filter_, dives.measurements, np.random.default_rng([seed, members])
    )
    found = np.concatenate([means[..., :3], depths(experiment, means)[..., None]], -1)
    return {"rmse": rms((found - dives.truth[..., _SCORED])[1:])}


class PublishedSquareRootFilter(EnsembleTransformFilter):
    """EnKF-SR as published, with anomalies ``A V sqrt(I - s's)`` where `enkf-sr` has ``A V sqrt(I - s's) V'``.

    ``L^-1 Y / sqrt(N - 1) = U s V'`` with ``S = L L'``. The second moments are the same, but the
    mean of the members moves at random, by about a quarter of the spread at N = 10 (Sakov & Oke
    2008b; Livings, Dance & Nichols 2008).

    Source: Evensen (2004), Sampling strategies and square root analysis schemes for the EnKF.
    """

    def __init__(self, model: Model, members: int) -> None:
        super().__init__(model, members, draws="independent")

    def _analysis(
        self, belief: Any, e: Any, Y: Any, S: Any, R: Any, available: Any, rng: Any
    ) -> Any:
        X = np.linalg.inv(cholesky(S)) @ Y / np.sqrt(self.members - 1)
        X[~np.isfinite(X).all((-2, -1))] = 0.0  # rows without a finite mean are lost anyway
        _, s, Vt = np.linalg.svd(X)
        scale = np.ones((*X.shape[:-2], self.members))
        scale[..., : s.shape[-1]] = np.sqrt(np.maximum(1.0 - s**2, 0.0))
        # (..., N, n)
        anomalies = scale[..., None] * (Vt @ (belief.members - belief.mean[..., None]).mT)
        shift, _ = super()._analysis(belief, e, Y, S, R, available, rng)
        return shift, np.ascontiguousarray(anomalies.mT)


def _filter(experiment: Experiment, form: str, members: int) -> Filter:
    if form == "ekf":
        return make("ekf", experiment.model)
    if form == PRINTED:
        return PublishedSquareRootFilter(experiment.model, members)
    return make("enkf-sr", experiment.model, members=members, draws="independent")


def dive(
    trial: Mapping[str, float], measured: int = 3, process: float = 1.0, measurement: float = 1.0
) -> Experiment:
    """The dive from rest under the recorded controls, and the filter's assumptions; see `estimate`."""
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


def depths(experiment: Experiment, estimates: np.ndarray) -> np.ndarray:
    """Depth [m] ``(T + 1, B)`` by the vehicle's kinematics from estimates ``(T + 1, B, 4)``."""
    sunk = experiment.advance(experiment.state(estimates[:-1]), experiment.controls[:, None])[
        ..., _DEPTH
    ]
    depth = np.zeros(estimates.shape[:-1])
    np.cumsum(sunk, 0, out=depth[1:])
    return depth


@cache
def recorded_controls(ahead: float, depth: float) -> np.ndarray:
    """Actuators before and after each step ``(T, 4)`` of the autopilot's dive in still water, from rest."""
    task = ITSUNUSA_AUV.task
    autopilot = DiveAutopilot(ITSUNUSA_AUV)
    scenario = task.scenario(np.zeros((1, task.uniforms)), {"goal": (ahead, 0.0, depth)})
    truth, actuators = np.zeros((1, len(STATE))), np.zeros((1, len(VEHICLE.action_names)))
    controls: list[np.ndarray] = []
    for step in range(task.horizon):
        reference = task.reference(scenario, np.array([step]), truth)
        if reference[0, 0] >= scenario[0, 1]:
            break
        action = autopilot.act(task.observe(Estimate(truth, _STILL[None]), reference, actuators))
        before, actuators = actuators, VEHICLE.actuate(actuators, action)
        controls.append(np.concatenate([before, actuators], -1)[0])
        truth = _step(truth, controls[-1])
    return np.stack(controls)
