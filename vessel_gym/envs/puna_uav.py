"""PunaUAV-v0: a small aircraft flies a Dubins path round obstacles on what a filter believes."""

from vessel_gym.envs.fixed_wing import fixed_wing_system
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv

PUNA_UAV = fixed_wing_system("puna", "PunaUAV-v0")


class PunaUAVEnv(VesselEnv):
    """Fly a path round obstacles to a goal on what an estimator believes.

    ## Description

    A small fixed-wing aircraft of 3.4 kg flies a Dubins path of arcs and straights round circular obstacles, 0.6 to
    1.4 km to a goal pose, at a commanded altitude and 20 m/s through the air. The path never turns tighter than 130 m
    and keeps 20 m from obstacles. The flight is over when the aircraft *believes* to have covered the path. A wind
    carries it along, gusts shake it, and its GNSS shows where it is once a second, with a bias that wanders.

    The aircraft is a point mass that turns coordinated (Beard & McLain 2012, ch. 9) with the lift and drag of the
    Skywalker X8 (Gryte 2018): the paper on Dubins paths and the ensemble Kalman filter for a PUNA prints the form of
    the equations (thrust and angle of attack as controls; drag, lift and density as polynomials), but no constants. One
    RK4 step of 0.1 s. Positions count from where the GNSS showed them at the start: obstacles and goal are placed in
    that frame, in which its bias is small at first. Filters know these equations, the spectra of gusts and bias and the
    sensors' noise; with ``mismatch=0`` their model is exact.

    ## Action Space

    ``Box(-1, 1, (3,), float32)``

    | Num | Action          | Min | Max | Unit                                                              |
    |-----|-----------------|-----|-----|-------------------------------------------------------------------|
    | 0   | thrust          | -1  | 1   | 0, at 0 4.1 N, 16 N; with a lag of 0.5 s                          |
    | 1   | angle of attack | -1  | 1   | -4, at 0 1.3, 12 deg; moves at 0.5 rad/s                          |
    | 2   | bank            | -1  | 1   | share of 35 deg, followed with a lag of 0.5 s; positive turns to  |
    |     |                 |     |     | starboard                                                         |

    Between these values it is linear: at 0, 0, 0 the aircraft flies level at 20 m/s. Actions outside the bounds are
    clipped; NaN raises.

    ## Observation Space

    ``Box(-10, 10, (18,), float32)``, scaled to be of order 1 and clipped. All are estimates but the actuators:

    | Num   | Observation                                                                | Scale (1 means)   |
    |-------|----------------------------------------------------------------------------|-------------------|
    | 0     | cross-track error, positive to starboard of the path                       | 10 m              |
    | 1     | altitude minus the commanded one                                           | 5 m               |
    | 2-3   | sine, cosine of the course of the path minus course over ground            | 0.5, 1            |
    | 4-5   | mean curvature of the path over the next 20 m, and from 20 to 60 m on;     | 0.01 /m           |
    |       | positive to starboard                                                      |                   |
    | 6     | bank that holds the first of these at the present ground speed             | 0.5 rad           |
    | 7     | ground speed minus 20 m/s                                                  | 5 m/s             |
    | 8     | airspeed minus 20 m/s                                                      | 2 m/s             |
    | 9     | climb over ground                                                          | 1 m/s             |
    | 10    | wind down                                                                  | 1 m/s             |
    | 11    | bank                                                                       | 0.5 rad           |
    | 12-13 | obstacles nearer than 100 m: sum of unit vectors to them, ahead and to     | 1                 |
    |       | starboard of the course, each times 1 - (distance of its edge) / 100 m     |                   |
    | 14    | remaining path                                                             | 500 m             |
    | 15-17 | thrust, angle of attack, bank command, measured: as in the action          |                   |

    With ``observe="mean+std"`` the space is ``(34,)``: the standard deviations of the 16 states follow (position per
    1 m, velocities per 0.2 m/s, bank per 0.02 rad, mean wind per 1 m/s, gusts per 0.5 m/s, bias per 1 m). With
    ``observe="measurement"`` it is ``(117,)``: the 9 readings (scaled by 100, 100, 100 m; 20 m/s, 3 rad, 1 m/s; 100 m;
    20 m/s; 0.5 rad), the mask of those that arrived, the 16 segments of the path (x, y / 100 m, heading / 3 rad,
    curvature / 0.01, length / 100 m), the commanded altitude / 100 m, the 5 obstacles (x, y / 100 m, radius / 50 m)
    and the actuators: no filter.

    ## Rewards

    In [0, 1] at every step, from the truth; their sum is the score, at most 1. Seven tenths are for the path: every
    metre of it pays once, when the true aircraft first covers it, and the more the closer it is: half at 3 m off in
    plan, half at 1.5 m off the altitude. It pays up to a tenth less for commands that jump from step to step, and less
    and less within 10 m of an obstacle. Three tenths are for arriving, when the aircraft believes to be there: half at
    8 m off the goal in plan, times the share of the path that was covered. Waiting, circling and short cuts pay
    nothing.

    ## Starting State

    The start is (0, 0) on any heading; the goal lies 600 to 900 m away within 90 deg of that heading, to be reached
    within 90 deg of the direct way; three obstacles of 30 to 60 m lie about the direct way (fewer, if no path was
    found); the commanded altitude is 80 to 120 m. The true state is drawn from the task's prior: at the path's
    beginning, level, 20 m/s along it through the air, standard deviations 1 m, 0.5 m/s (0.3 m/s up), 0.02 rad, and a
    wind of the disturbance's size that carries it along from the first moment. The estimator starts from the same prior
    and takes in the first readings before the first observation.

    ``reset(options={"start": (x, y, heading), "goal": (x, y, heading), "obstacles": [(x, y, radius), ...],
    "altitude": h})`` sets any of these [m, rad]; with obstacles but no poses, the flight is from (0, 0, 0) to
    (750, 0, 0). A scene without a path is refused in a sentence that says why.

    ## Episode End

    Termination, with the reason in ``info["end"]``:

    - ``arrived``: the aircraft believes to have covered the path, and is within 8 m of the goal in plan;
    - ``missed the goal``: it believes so, and is not;
    - ``hit an obstacle``: it is inside one (at any altitude);
    - ``stalled``: its airspeed is below 10 m/s;
    - ``crashed``: its altitude is 0;
    - ``off the path``: it is more than 100 m off in plan;
    - ``off the altitude``: it is more than 40 m off the commanded altitude.

    With ``observe="measurement"`` nobody sees what an estimator believes, so none ends the episode or enters its
    rewards: whichever is named, it is ``arrived`` or ``missed the goal`` when the true aircraft passes the path's end.
    That it is over is the one bit of truth that the agent gets.

    Truncation: after 900 steps (90 s).

    ## Information

    | Key              | Content                                                                                 |
    |------------------|-----------------------------------------------------------------------------------------|
    | `truth`          | x, y, altitude [m]; velocity over ground north, east, up [m/s]; bank [rad]; mean wind   |
    |                  | north, east; gusts north, east and two states of the vertical one [m/s]; bias of the    |
    |                  | GNSS in x, y, altitude [m]                                                              |
    | `unknown_input`  | what will enter velocity, bank, wind, gusts and bias over the coming step               |
    | `reference`      | believed progress, cross-track and altitude error [m]; heading of the path there, its   |
    |                  | mean curvatures ahead; 16 segments (x, y, heading, curvature, length), length,           |
    |                  | commanded altitude, 5 obstacles (x, y, radius; 0: none). With ``observe="measurement"`` |
    |                  | of the true position, not the believed one                                              |
    | `actuators`      | thrust [N], angle of attack, bank command [rad]                                         |
    | `measurement`    | GNSS: x, y, altitude, ground speed, course, climb; barometer; pitot tube; bank; 0 where |
    |                  | missing                                                                                 |
    | `available`      | which readings arrived                                                                  |
    | `estimate`       | of the truth's 16 components                                                            |
    | `covariance`     | of the estimate                                                                         |
    | `input_estimate` | 0: no estimator here gives one                                                          |
    | `parameters`     | the truth's coefficients, as `system.vehicle.parameter_names` lists them: the filters'  |
    |                  | own, but for ``mismatch``                                                               |
    | `healthy`        | False in a step where the estimator's usual update failed:                              |
    |                  | ``core.belief.recovery`` says what it did instead                                       |
    | `score`          | sum of rewards so far                                                                   |
    | `end`            | why the episode has ended, or empty                                                     |
    | `is_success`     | whether the aircraft has arrived: at an episode's end, whether it succeeded             |

    ## Arguments

    ```python
    gym.make("PunaUAV-v0", estimator="enkf", sensors="nominal", disturbance="moderate", mismatch=0.0, observe="mean")
    ```

    - ``estimator``: ``enkf`` (default; 100 members, inflation 1.01, localised by instrument), ``enkf-sr``, ``etkf``,
      ``letkf``, ``pf``, ``ekf``, ``iekf``, ``srkf``, ``eskf``, ``adaptive-kf``, ``mhe``, ``ukf``, ``huber-kf``,
      ``robust-kf``, ``truth``, ``measurement`` (the last reading of everything; a wind along the course alone),
      ``dead-reckoning``. Those that need a linear model refuse this one: ``kf``, ``kf-umv-ui-wdf``, ``ulise``; those of
      an unknown input need a `vessel_gym.disturbances.Fault`, or a disturbance told as ``"input"``: ``ekf-ui-wdf``,
      ``ukf-umv``, and ``kf-umv-ui`` if a sensor reads that input itself.
    - ``estimator_options``: the filter's own, e.g. ``{"members": 300}``, ``{"localisation": None}``.
    - ``sensors``: ``clean``, ``nominal`` or ``degraded``. Nominal: every second a GNSS fix of 1 m in plan and 1.5 m in
      altitude, with ground speed 0.05 m/s, course 0.03 rad and climb 0.1 m/s; every step barometer 0.5 m, pitot tube
      0.5 m/s and bank 0.02 rad. The GNSS's bias wanders by 0.21 m in plan (each axis) and 0.40 m in altitude in a
      second, as a random walk. ``degraded`` loses 10 % of everything, and 5 % of readings have ten times the noise.
    - ``disturbance``: ``calm``, ``moderate``, ``rough``: a mean wind of 1, 3, 5 m/s RMS, with Dryden gusts of 0.35,
      1.06, 2.12 m/s level and 0.25, 0.7, 1.4 m/s vertical. The mean wind wanders in 200 s; besides, turbulence kicks
      velocities by 0.05 m/s and the bank by 0.005 rad a step.
    - ``mismatch``: relative spread of the truth's coefficients around the filter's, 0 to 0.25.
    - ``observe``: ``mean``, ``mean+std`` or ``measurement``, see above; with ``estimator_options={"monitor": "cusum"}``
      also ``mean+alarms`` and ``mean+std+alarms``: behind all else 1 for each sensor that is accused, else 0.
    - ``render_mode``: ``human`` (a window) or ``rgb_array``.

    ## Version History

    - v0: first version.
    """

    system = PUNA_UAV


class PunaUAVVectorEnv(VesselVectorEnv):
    """The native batch of `PunaUAVEnv`, which documents spaces, rewards and arguments."""

    system = PUNA_UAV
