"""Hermawan's five simulations: KF-UMV-UI follows a turning circle with an unknown input in the readings."""

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from agents.cells import Cell
from agents.reproduction.settings import corvette as settings
from agents.reproduction.settings.corvette import SAMPLES, SIMULATIONS, Simulation
from estimators import Gaussian, LinearModel, make
from vessel_gym.vehicles.corvette import Corvette, steady_turns
from vessel_gym.vehicles.corvette_equations import AROUND, CorvetteParameters, corvette_rates
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.integration import runge_kutta

MODELS = ("as-printed", "corrected")
LEVELS = (settings.NOISE, settings.SMALL**0.5, settings.LARGE**0.5)
"""Standard deviations [rad] of the reading noise: fixed, and what the two printed R mean as variances."""
_SHIP = load("corvette-thesis", CorvetteParameters)


# --- the experiment ---------------------------------------------------------------------------------


def cells(runs: int = 200, seed: int = 0) -> dict[str, Cell]:
    """A cell for each simulation and filter model; equal seeds pair the runs of all."""
    return {
        f"{simulation}, {model}": Cell(
            function="agents.reproduction.corvette:simulate",
            arguments={"simulation": simulation, "model": model, "runs": runs, "seed": seed},
            label=f"corvette, simulation {simulation}, model {model}",
        )
        for simulation in SIMULATIONS
        for model in MODELS
    }


@cache
def turning_record() -> tuple[np.ndarray, np.ndarray]:
    """Heading ``(195,)`` [rad] of a turning circle, and the known input ``(195, 2)``: rudder [rad], yaw rate [rad/s].

    The nonlinear ship leaves a straight course with the helm put over at its rate limit.
    """
    fine = 16  # RK4 steps a sample: the rudder's stop falls between samples
    dt, helm, c = settings.STEP / fine, np.deg2rad(settings.HELM), _SHIP.vector()
    rudder = np.minimum(_SHIP.rudder_rate * dt * np.arange(fine * (SAMPLES - 1) + 1), helm)
    state = np.array([0.0, 0.0, 0.0, _SHIP.speed, *np.zeros(4)])
    heading = [state[2]]
    for start, end in pairwise(rudder):
        state = runge_kutta(corvette_rates, state, np.array([start]), np.array([end]), np.zeros(len(AROUND)), c, dt)
        heading.append(state[2])
    turns = steady_turns(_SHIP)
    commanded = np.full(SAMPLES, np.interp(helm, turns.rudder, turns.yaw_rate))
    return np.array(heading)[::fine], np.stack([rudder[::fine], commanded], -1)


def unknown_input(size: float, switch: int = settings.SWITCH) -> np.ndarray:
    """The unknown input d ``(195,)`` [rad]: up, and down from sample ``switch`` on."""
    return np.where(np.arange(SAMPLES) < switch, size, -size)


def filter_model(simulation: Simulation, model: str) -> LinearModel:
    """What the filter of a simulation believes: eqs. 4.3 to 4.5, or the corrected ship, with the stated Q and R."""
    A, B = Corvette(_SHIP, settings.STEP).linear(model)
    C, G, H = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]), np.array([[0.0], [0.0], [1.0]]), np.ones((2, 1))
    # The thesis wraps no angle; at 1 rad it would matter.
    return LinearModel(A, C, simulation.Q * np.eye(3), simulation.R * np.eye(2), B=B, G=G, H=H)


def estimate(
    model: LinearModel,
    heading: np.ndarray,
    d: np.ndarray,
    u: np.ndarray,
    noise: np.ndarray,
    prior: float = settings.PRIOR,
) -> np.ndarray:
    """Errors of KF-UMV-UI on the readings ``(heading + d + noise, d + noise)`` of eq. 4.5.

    Args:
        model: What the filter believes.
        heading: ``(T,)`` or ``(runs, T)`` real heading [rad].
        d: ``(T,)`` unknown input [rad].
        u: ``(T, 2)`` known input.
        noise: ``(runs, T, 2)`` of the readings [rad].
        prior: Variance of each state at the start.

    Returns:
        Errors ``(3, runs, T)`` [rad] of the heading and of the unknown input after the reading, and of the heading
        before it.
    """
    umv = make("kf-umv-ui", model)
    belief = umv.init(Gaussian(np.zeros((len(noise), 3)), prior * np.eye(3)))
    readings = np.stack(np.broadcast_arrays(heading + d, d), -1) + noise
    errors = np.empty((3, *readings.shape[:2]))
    for k in range(len(d)):
        predicted = umv.predict(belief, u[k - 1]) if k else belief.replace(u=u[[0] * len(noise)])
        belief = umv.update(predicted, readings[:, k])
        assert belief.input_mean is not None
        errors[:, :, k] = (
            belief.mean[:, 2] - heading[..., k],
            belief.input_mean[:, 0] - d[k],
            predicted.mean[:, 2] - heading[..., k],
        )
    return errors


def bound(model: LinearModel, u: np.ndarray) -> tuple[float, float]:
    """Standard deviations [rad] of heading and d that the filter's covariances settle at, with ``u (2,)`` held."""
    umv = make("kf-umv-ui", model)
    belief = umv.update(
        umv.init(Gaussian(np.zeros((1, 3)), settings.PRIOR * np.eye(3))).replace(u=u[None]), np.zeros(2)
    )
    for _ in range(10_000):
        last, belief = belief, umv.update(umv.predict(belief, u), np.zeros(2))
        if np.allclose(belief.cov, last.cov, rtol=1e-10, atol=0.0):
            break
    assert belief.input_cov is not None
    return float(np.sqrt(belief.cov[0, 2, 2])), float(np.sqrt(belief.input_cov[0, 0, 0]))


def simulate(simulation: str, model: str, runs: int, seed: int) -> dict[str, Any]:
    """One of the five simulations with one filter model, at every noise level.

    Returns:
        ``rmse``: by noise level, heading, unknown input and predicted heading ``(3, runs)``; ``wide``: the same at the
        lowest level from a wide prior; ``driven``: likewise where d drives the heading; ``quiet``: without noise, RMSE
        of the three in all ("all"), where d is absent ("turn"), what d adds ("d"), and where d is up for one sample
        ("literal"); ``bound``: what the covariances settle at; ``example``: the first run at the lowest level.
    """
    s = SIMULATIONS[simulation]
    believed = filter_model(s, model)
    heading, u = turning_record()
    d = unknown_input(s.size)
    noise = np.random.default_rng(seed).standard_normal((runs, SAMPLES, 2))

    def errors(
        level: float, heading: np.ndarray = heading, d: np.ndarray = d, prior: float = settings.PRIOR
    ) -> np.ndarray:
        drawn = level * noise if level else np.zeros((1, SAMPLES, 2))
        return estimate(believed, heading, d, u, drawn, prior)

    lowest = errors(LEVELS[0])
    whole, turn = errors(0.0), errors(0.0, d=np.zeros(SAMPLES))
    quiet = {"all": whole, "turn": turn, "d": whole - turn, "literal": errors(0.0, d=unknown_input(s.size, 1))}
    driven = heading + np.concatenate([[0.0], np.cumsum(d)[:-1]])  # eq. 4.4: psi+ = psi + ... + d
    return {
        "rmse": {f"{level:.4f}": rms(lowest if level == LEVELS[0] else errors(level)) for level in LEVELS},
        "wide": rms(errors(LEVELS[0], prior=settings.WIDE_PRIOR)),
        "driven": rms(errors(LEVELS[0], driven)),
        "quiet": {name: rms(error)[:, 0] for name, error in quiet.items()},
        "bound": bound(believed, u[-1]),
        "example": {"heading": heading, "unknown input": d, "errors": lowest[:2, 0]},
    }


def rms(errors: np.ndarray) -> np.ndarray:
    """Root mean square over time, the last axis."""
    return np.sqrt(np.mean(errors**2, -1))
