"""Simulated trials of a ship, and logs of them as files."""

from pathlib import Path

import numpy as np

from vessel_gym.identification.prediction import simulate
from vessel_gym.identification.trial import Trial
from vessel_gym.vehicles.manoeuvring import Particulars

SHIP = Particulars(
    length=3.0, beam=0.49, draught=0.2, mass=245.0, propeller_diameter=0.084, rudder_area=0.0106, x_g=0.09,
    frontal_area=0.135, lateral_area=0.52,
)  # fmt: skip
"""A model of a tanker."""
STEP = 0.2


def coefficients(rng: np.random.Generator, spread: float = 0.5) -> np.ndarray:
    """Coefficients of a ship near what is assumed of one."""
    table = SHIP.coefficients
    mean, sd = np.array([each.mean for each in table]), np.array([each.sd for each in table])
    return mean + spread * sd * np.clip(rng.normal(size=len(sd)), -2.0, 2.0)


def gauss_markov(rng: np.random.Generator, count: int, constant: float, columns: int) -> np.ndarray:
    """Processes ``(count, columns)`` of unit variance with a time constant [s]."""
    kept, value, found = np.exp(-STEP / constant), rng.normal(size=columns), np.empty((count, columns))
    for i in range(count):
        value = kept * value + np.sqrt(1.0 - kept**2) * rng.normal(size=columns)
        found[i] = value
    return found


def trial(rng: np.random.Generator, c: np.ndarray, seconds: float = 400.0, noise: float = 1.0) -> Trial:
    """A trial under random rudder and revolutions, in wind and with coloured accelerations, measured with noise."""
    count = round(seconds / STEP)
    change = round(25.0 / STEP)
    rudder = np.repeat(rng.uniform(-0.6, 0.6, -(-count // change)), change)[:count]
    revolutions = np.repeat(rng.uniform(-3.0, 12.0, -(-count // change)), change)[:count]
    control = np.stack([rudder, np.where(np.abs(revolutions) < 2.0, 8.0, revolutions)], -1)
    wind = rng.normal(size=2) + 0.3 * gauss_markov(rng, count, 10.0, 2)
    air = np.concatenate([wind, np.broadcast_to(wind.mean(0), wind.shape)], -1)
    extra = noise * gauss_markov(rng, count, 8.0, 3) * (5e-4, 5e-4, 3e-4)
    start = np.array([0.0, 0.0, rng.uniform(-3.0, 3.0), 0.2, 0.0, 0.0])
    p, states = SHIP.vector(), [start]
    for k in range(count):
        after = simulate(states[-1], control[k : k + 1], air[k : k + 1], c, p, STEP)[-1]
        after[3:] += STEP * extra[k]
        states.append(after)
    measured = np.array(states) + noise * rng.normal(size=(count + 1, 6)) * (0.02, 0.02, 0.003, 0.01, 0.01, 5e-4)
    return Trial("simulated", STEP, 0.0, measured, control, air)


def write(path: Path, trial: Trial) -> None:
    """Write a trial as a CSV log, in degrees and revolutions a minute."""
    wind_speed = np.hypot(*trial.air[:, :2].T)
    wind_from = np.rad2deg(np.arctan2(trial.air[:, 1], trial.air[:, 0]))
    lines = ["time [s],x [m],y [m],heading [deg],yaw rate [deg/s],rudder [deg],revolutions [rpm],"
             "wind speed [m/s],wind direction [deg]"]  # fmt: skip
    for k in range(len(trial)):
        x, y, psi, _, _, r = trial.states[k]
        numbers = (
            k * STEP, x, y, np.rad2deg(psi) % 360.0, np.rad2deg(r), np.rad2deg(trial.control[k, 0]),
            60.0 * trial.control[k, 1], wind_speed[k], wind_from[k],
        )  # fmt: skip
        lines.append(",".join(f"{number:.6g}" for number in numbers))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
