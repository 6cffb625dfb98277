"""ThesisCorvette-v0: the SIGMA-class corvette as the first version and its source have it, for what reproduces them."""

from vessel_gym.disturbances import Sea
from vessel_gym.envs.shared import documented
from vessel_gym.envs.ship import input_tuning
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.system import System
from vessel_gym.tasks.turning_circle import TurningCircle
from vessel_gym.vehicles.corvette import Corvette
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.files import load

_DEG = 3.141592653589793 / 180.0
SEAS = {
    "calm": Sea(wave=0.05 * _DEG, peak=0.9, gust=0.02 * _DEG, current=0.1),
    "moderate": Sea(wave=0.4 * _DEG, peak=0.8, gust=0.1 * _DEG, current=0.3),
    "rough": Sea(wave=1.0 * _DEG, peak=0.6, gust=0.2 * _DEG, current=0.6),
}
THESIS_CORVETTE = System(
    name="ThesisCorvette-v0",
    vehicle=Corvette(),
    task=TurningCircle(load("corvette-thesis", CorvetteParameters)),
    disturbances=SEAS,
    estimator="kf-umv-ui",
    filter_model="corrected",
    filter_models=dict.fromkeys(
        ("ekf", "iekf", "srkf", "eskf", "adaptive-kf", "mhe", "ukf", "enkf", "enkf-sr", "etkf", "letkf", "pf"),
        "nonlinear",
    ),
    tuning=input_tuning,
)


@documented
class ThesisCorvetteEnv(VesselEnv):
    """Hold a commanded turning circle on what an estimator believes, in a sea that turns with the ship.

    The world of the first version, kept for what reproduces its source: waves keep their frequency and size whatever
    the heading, thrust is constant, no position is estimated. `SigmaCorvetteEnv` is the one to fly.
    """

    system = THESIS_CORVETTE


class ThesisCorvetteVectorEnv(VesselVectorEnv):
    """The native batch of `ThesisCorvetteEnv`, which documents spaces, rewards and arguments."""

    system = THESIS_CORVETTE
