"""SigmaCorvette-v0: a SIGMA-class corvette holds a turning circle on what a filter believes."""

from typing import Any

import numpy as np

from vessel_gym.disturbances import Sea
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.system import System
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.vehicles.corvette import Corvette, CorvetteParameters

_DEG = np.pi / 180.0

SEAS = {
    "calm": Sea(wave=0.05 * _DEG, peak=0.9, gust=0.02 * _DEG, current=0.1),
    "moderate": Sea(wave=0.4 * _DEG, peak=0.8, gust=0.1 * _DEG, current=0.3),
    "rough": Sea(wave=1.0 * _DEG, peak=0.6, gust=0.2 * _DEG, current=0.6),
}


def _tuning(name: str, sea: Any) -> dict[str, Any]:
    if name in ("kf-umv-ui", "kf-umv-ui-wdf"):
        return {"input_prior": sea.unknown_input_var}
    return {}


SIGMA_CORVETTE = System(
    vehicle=Corvette(CorvetteParameters()),
    task=TurningCircle(CorvetteParameters()),
    disturbances=SEAS,
    estimator="kf-umv-ui",
    filter_model="corrected",
    filter_models={"ekf": "nonlinear"},
    tuning=_tuning,
)


class SigmaCorvetteEnv(VesselEnv):
    """DOC"""

    system = SIGMA_CORVETTE


class SigmaCorvetteVectorEnv(VesselVectorEnv):
    """The native batch of `SigmaCorvetteEnv`, which documents it."""

    system = SIGMA_CORVETTE
