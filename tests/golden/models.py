"""Record the models of filters in every environment, and compare them later.

::

    python -m tests.golden.models   # write tests/golden/models.npz

A configuration is an environment, a sensor suite and an estimator with its assumptions. Of each
model the file has the names of its states and unknown inputs, and two weighted sums of f, h, their
Jacobians, Q, R, G, H and of the prior's covariance, at fixed points near the cruising vehicle.
Before they are summed, numbers pass through ``arcsinh(1e4 x)``, so that small ones count like large
ones. Configurations that the package refuses are kept as such.
"""

from pathlib import Path
from typing import Any

import numpy as np

from estimators import Gaussian
from estimators.varying import StateNoise, resolve
from vessel_gym.disturbances import Fault
from vessel_gym.simulation.configuration import Configuration, Options
from vessel_gym.simulation.draws import filter_prior
from vessel_gym.system import registered

from .record import weights

FILE = Path(__file__).with_name("models.npz")
ENVIRONMENTS = (
    "SigmaCorvette-v0", "SigmaChannel-v0", "ThesisCorvette-v0", "SegorogeniAUV-v0",
    "ItsunusaAUV-v0", "PunaUAV-v0",
)  # fmt: skip
SUITES = "nominal", "budget"
ESTIMATORS = (
    "ekf", "kf", "ekf-linear", "ekf-ui-wdf", "huber-kf", "robust-kf", "kf-umv-ui",
    "kf-umv-ui-wdf", "kf-white", "ekf-waves",
)  # fmt: skip
ASSUMED = "states", "unknown-input", "white-input", "process-noise"
ACTUATORS = {"SegorogeniAUV-v0": "rudder", "ItsunusaAUV-v0": "stern plane", "PunaUAV-v0": "bank"}


def configurations(env_id: str) -> dict[str, dict[str, Any]]:
    """Arguments of every configuration of an environment that is tried, by name."""
    given: dict[str, dict[str, Any]] = {
        f"{suite} {estimator}": {"sensors": suite, "estimator": estimator}
        for suite in SUITES
        for estimator in ESTIMATORS
    }
    for how in ASSUMED:
        for estimator in "ekf", "kf":
            options = {"assume": {"as": how, "disturbance": "rough", "Q": 2.0, "R": 3.0}}
            given[f"rough as {how} {estimator}"] = {
                "estimator": estimator, "estimator_options": options,
            }  # fmt: skip
    for name in ("surface", "moderate quartering"):
        given[name] = {"estimator": "ekf", "disturbance": name}
    if env_id in ACTUATORS:
        beside = registered(env_id).disturbances["rough"]
        fault = Fault(ACTUATORS[env_id], 0.03, 0.2, 0.05, start=0.03, walk=0.02, beside=beside)
        for estimator, how in (("ekf", "states"), ("kf-umv-ui", "unknown-input")):
            options = {"assume": {"as": how}}
            given[f"fault {estimator}"] = {
                "estimator": estimator, "disturbance": fault, "estimator_options": options,
            }  # fmt: skip
    return given


def _sums(value: Any) -> list[float]:
    """Two weighted sums of an array of any shape."""
    flat = np.arcsinh(1e4 * np.asarray(value, float).ravel())
    return [float(weights(k, flat.size) @ flat) for k in (1, 2)]


def row(env_id: str, options: dict[str, Any]) -> tuple[str, list[float]]:
    """Names of a configuration, or the kind of its refusal, and sums of its model."""
    system = registered(env_id)
    try:
        config = Configuration(system, Options(**options))
    except (KeyError, ValueError) as error:
        return type(error).__name__, []
    space, model = config.estimation.space, config.estimation.filter.model
    vehicle, n = system.vehicle, len(space.vehicle_states)
    x = np.linspace(-0.3, 0.5, 3 * model.n).reshape(3, model.n)
    x[:, :n] += vehicle.cruise[0][:n]
    u = vehicle.cruise[1] + np.linspace(-0.1, 0.1, 3 * len(vehicle.cruise[1])).reshape(3, -1)
    f, A = model.linearise_transition(x, u)
    h, C = model.linearise_measurement(x, u)
    R = model.R.function(x, u) if isinstance(model.R, StateNoise) else resolve(model.R, u)
    G = 0.0 if model.G is None else model.input_matrix(x, u)
    H = 0.0 if model.H is None else resolve(model.H, u)
    widest = len(vehicle.estimated(vehicle.kinds[0]))
    prior = filter_prior(Gaussian(np.zeros((1, widest)), 0.01 * np.eye(widest)), space).cov
    arrays = f, A, h, C, resolve(model.Q, u), R, G, H, prior
    names = [*space.names, "d", *space.inputs, space.assumed_as, str(model.delayed_feedthrough)]
    names += [f"{model.state_angles} {model.measurement_angles}", *config.estimation.inputs]
    return ", ".join(names), [each for array in arrays for each in _sums(array)]


def table(env_id: str) -> dict[str, tuple[str, list[float]]]:
    """Rows of an environment, by name."""
    given = configurations(env_id)
    return {name: row(env_id, options) for name, options in given.items()}


def recorded() -> dict[str, dict[str, tuple[str, list[float]]]]:
    """Rows of every environment, as the file has them."""
    found: dict[str, dict[str, tuple[str, list[float]]]] = {}
    with np.load(FILE) as file:
        for name, words, sums in zip(file["cases"], file["names"], file["sums"], strict=True):
            env_id, _, case = str(name).partition(" ")
            found.setdefault(env_id, {})[case] = str(words), sums[~np.isnan(sums)].tolist()
    return found


def record() -> None:
    """Write the file."""
    rows = {f"{env} {name}": row for env in ENVIRONMENTS for name, row in table(env).items()}
    sums = np.array([row[1] or [np.nan] * 18 for row in rows.values()])
    names = np.array([row[0] for row in rows.values()])
    np.savez_compressed(FILE, cases=np.array([*rows]), names=names, sums=sums)


if __name__ == "__main__":
    record()
