"""ThesisCorvette-v0: the SIGMA-class corvette as the first version and its source have it, for what reproduces them."""

from vessel_gym.disturbances import Sea
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


class ThesisCorvetteEnv(VesselEnv):
    """Hold a commanded turning circle on what an estimator believes, in a sea that turns with the ship.

    The world of the first version, kept for what reproduces its source: waves keep their frequency and size whatever
    the heading, thrust is constant, no position is estimated. `SigmaCorvetteEnv` is the one to fly.

    ## Description

    A SIGMA-class corvette (101 m, 2423 t, 15.4 m/s = 29.9 kn) is commanded into a turn of 3 to 6 ship
    lengths radius, to either side: 5 s straight on, 25 s of rising yaw rate, then a steady turn for the
    rest of 300 s. Waves and gusts kick the heading, a current sets the track. The compass and a motion
    reference unit are noisy, and the agent sees only what a filter makes of them.

    The current moves nothing but the true position, which no instrument reads and no reward counts: one of 50 m/s
    leaves every observation and reward as it is, bit for bit.

    The ship is a nonlinear 3-DOF model (surge, sway, yaw): Clarke's linear derivatives, cross-flow
    drag, rudder with inflow angle, speed loss in the turn; one RK4 step of 0.5 s. The filter's model
    is linear: ``x = (sway, yaw rate, heading)``, ``x+ = A x + B u + G d + w``, ``y = C x + H d + v`` with the unknown
    input ``d``, the yaw increment that waves and gusts give in one step. Source of system and filter:
    Hermawan (2020), corrected as the vehicle's documentation says.

    ## Action Space

    ``Box(-1, 1, (1,), float32)``

    | Num | Action      | Min | Max | Unit                                                        |
    |-----|-------------|-----|-----|-------------------------------------------------------------|
    | 0   | rudder rate | -1  | 1   | share of 5 deg/s; positive turns the ship to starboard      |

    The rudder itself is limited to +-35 deg. Actions outside the bounds are clipped; NaN raises.

    ## Observation Space

    ``Box(-10, 10, (7,), float32)``, scaled to be of order 1 and clipped. With ``e`` for the reference minus the
    estimate:

    | Num | Observation                              | Scale (1 means) |
    |-----|------------------------------------------|-----------------|
    | 0   | heading error e, wrapped                 | 0.1 rad         |
    | 1   | yaw rate error e                         | 0.01 rad/s      |
    | 2   | sway velocity, estimate                  | 2 m/s           |
    | 3   | unknown input d, estimate (0 where the estimator gives none) | 0.01 rad |
    | 4   | rudder angle, measured                   | 35 deg          |
    | 5   | commanded yaw rate                       | 0.04 rad/s      |
    | 6   | commanded yaw rate 10 s ahead            | 0.04 rad/s      |

    ``observe="mean+std"`` appends the estimator's standard deviations of sway, yaw rate, heading and
    unknown input in the scales 2 m/s, 0.01 rad/s, 0.1 rad, 0.01 rad: ``(11,)``.
    ``observe="measurement"`` replaces 0 to 3 by raw readings: heading error of the compass (0.1 rad),
    yaw increment of the motion reference unit (0.01 rad), and 1 or 0 for whether each arrived; a missing
    reading is 0. Whichever estimator is named, nothing of what it believes enters such an episode.

    ## Rewards

    From the truth, each step in [0, 1]::

        (0.8 / (1 + (heading error / 0.05 rad)^2) + 0.2 / (1 + (yaw rate error / 0.15 r_c)^2)) (1 - 0.15 a^2)

    with the commanded yaw rate ``r_c`` and the action ``a``. The kernel is sharp: with a wide one, an agent
    trades heading for rudder. It is never negative and the reference moves with time, so neither
    ending early nor loitering pays. The episode's score, ``info["score"]``, is the sum of rewards over
    600 steps, in [0, 1].

    ## Starting State

    The initial heading, radius and side are uniform. The true sway, yaw rate, heading and surge are drawn
    from the task's prior (standard deviations 0.2 m/s, 0.002 rad/s, 0.03 rad, 0.2 m/s around 0, 0, the
    initial heading, 15.4 m/s), and the estimator starts from that same prior and takes in the first
    reading before the first observation. ``reset(options={"radius": r})`` sets the commanded radius
    [m], 253 m to 100 km, positive to starboard.

    ## Episode End

    - Termination: the true heading is more than 90 deg off the commanded one (the turn is lost).
    - Truncation: after 600 steps (300 s).

    ## Information

    | Key              | Content                                                                     |
    |------------------|-----------------------------------------------------------------------------|
    | `truth`          | x, y [m], heading [rad], surge, sway [m/s], yaw rate [rad/s], roll [rad],   |
    |                  | its rate [rad/s]: scoring only                                              |
    | `unknown_input`  | true d [rad] over the coming step                                           |
    | `reference`      | commanded heading, yaw rate, yaw rate 10 s ahead, final yaw rate            |
    | `actuators`      | rudder [rad]                                                                |
    | `measurement`    | compass and yaw increment [rad], 0 where missing                            |
    | `available`      | which readings arrived                                                      |
    | `estimate`       | sway, yaw rate, heading (and surge for `ekf`)                               |
    | `covariance`     | of the estimate                                                             |
    | `input_estimate` | estimated d [rad], 0 where the estimator gives none                         |
    | `parameters`     | the truth's coefficients, as `system.vehicle.parameter_names` lists them:   |
    |                  | the filters' own, but for ``mismatch``                                      |
    | `healthy`        | False in a step where the estimator's usual update failed:                  |
    |                  | ``core.belief.recovery`` says what it did instead                           |
    | `score`          | sum of rewards so far over 600                                              |
    | `end`            | why the episode has ended: `turn lost`, or empty                            |
    | `is_success`     | whether the turn is held so far: at an episode's end, whether it succeeded  |

    ## Arguments

    ```python
    gym.make("ThesisCorvette-v0", estimator="kf-umv-ui", sensors="nominal", disturbance="moderate",
             mismatch=0.0, observe="mean")
    ```

    - ``estimator``: on the linear model ``kf-umv-ui`` (default), ``ulise`` (whose d is one step late), ``kf``,
      ``huber-kf``, ``robust-kf``; on the nonlinear ship ``ekf``, ``iekf``, ``srkf``, ``eskf``, ``adaptive-kf``,
      ``mhe``, ``ukf``, ``enkf``, ``enkf-sr``, ``etkf``, ``letkf``, ``pf``; and ``truth``, ``measurement`` (compass
      differenced for the yaw rate, sway 0), ``dead-reckoning``. ``kf-umv-ui-wdf``, ``ekf-ui-wdf`` and ``ukf-umv`` take
      d for a further state, as it feeds through to the readings.
    - ``estimator_options``: the filter's own, e.g. ``{"input_cov": 8e-5}`` tells ``kf`` the variance of d; ``model``
      is ``"corrected"`` (default), ``"nonlinear"`` (default of the nonlinear filters) or ``"as-printed"``, eq. 4.3
      of the thesis.
    - ``sensors``: ``clean``, ``nominal`` (compass 2e-3 rad, motion reference unit 1e-3 rad) or ``degraded``.
      When one channel drops, KF-UMV-UI cannot tell ``d`` from a heading error: the reading that is left goes
      to ``d`` and the heading stays as predicted; when both drop, ``d`` gets its prior, N(0, its variance).
    - ``disturbance``: yaw increments of 5e-4, 3.6e-3 or 9e-3 rad a step (``calm``, ``moderate``, ``rough``), and a
      current of 0.1, 0.3 or 0.6 m/s, which only the true position shows.
    - ``mismatch``: relative spread of the hull's and rudder's coefficients around the filter's, 0 to 0.25.
    - ``observe``: ``mean``, ``mean+std`` or ``measurement``, see above; with ``estimator_options={"monitor": "cusum"}``
      also ``mean+alarms`` and ``mean+std+alarms``: behind all else 1 for each sensor that is accused, else 0.
    - ``render_mode``: ``human`` (a window) or ``rgb_array``.

    ## Version History

    - v0: SigmaCorvette-v0 of the first version.
    """

    system = THESIS_CORVETTE


class ThesisCorvetteVectorEnv(VesselVectorEnv):
    """The native batch of `ThesisCorvetteEnv`, which documents spaces, rewards and arguments."""

    system = THESIS_CORVETTE
