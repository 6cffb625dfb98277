"""SegorogeniAUV-v0: an underwater vehicle dives along a curve in three dimensions on what a filter believes."""

from vessel_gym.envs.auv import auv_system
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv

SEGOROGENI_AUV = auv_system("segorogeni", "SegorogeniAUV-v0")


class SegorogeniAUVEnv(VesselEnv):
    """Dive along a curve in three dimensions on what an estimator believes.

    ## Description

    Segorogeni ITS, a torpedo of 0.98 m and 18.5 kg, dives to a goal 6 m below, 10 m north and 18 m east of its start:
    from above an arc of 11.8 m radius through 122 deg, in depth a smooth step, 25 m in all at about 1 m/s. The
    mission is over when the vehicle *believes* to have covered the path. A current carries it along, turbulence kicks
    it, and an acoustic fix of its position comes every 2 s at best.

    The vehicle is a body with six degrees of freedom (eqs. 5-10 of the EnKF paper on this vehicle, Inovtek Polbeng,
    Seri Informatika 4(1), 2019, with full Euler kinematics); its coefficients follow from its dimensions
    (docs/hydrodynamics.md), because the papers print none. Two RK4 substeps of 0.05 s. Filters know these equations,
    the sizes of turbulence and current and the sensors' noise; with ``mismatch=0`` their model is exact.

    ## Action Space

    ``Box(-1, 1, (3,), float32)``

    | Num | Action      | Min | Max | Unit                                                             |
    |-----|-------------|-----|-----|------------------------------------------------------------------|
    | 0   | rudder      | -1  | 1   | share of 20 deg, moves at 1 rad/s; positive turns to starboard   |
    | 1   | stern plane | -1  | 1   | share of 20 deg, moves at 1 rad/s; positive dives                |
    | 2   | thrust      | -1  | 1   | 0 to 8 N, with a lag of 0.5 s; 1 m/s takes 2.8 N                 |

    Actions outside the bounds are clipped; NaN raises.

    ## Observation Space

    ``Box(-10, 10, (24,), float32)``, scaled to be of order 1 and clipped. All are estimates but the actuators and the
    path's curvature; vectors are in body axes (ahead, to starboard, below):

    | Num   | Observation                                                          | Scale (1 means) |
    |-------|----------------------------------------------------------------------|-----------------|
    | 0-2   | vector to the closest point of the path (closest in plan)            | 0.25 m          |
    | 3-5   | vector to the path's point 2.5 m on                                  | 2.5 m           |
    | 6-8   | current                                                              | 0.25 m/s        |
    | 9     | heading of the path minus yaw, wrapped                               | 0.25 rad        |
    | 10    | flight-path angle of the path minus pitch                            | 0.25 rad        |
    | 11    | remaining path in plan                                               | 10 m            |
    | 12    | curvature of the path in plan                                        | 0.1 /m          |
    | 13    | surge through the water minus 1 m/s                                  | 0.25 m/s        |
    | 14-15 | sway, heave through the water                                        | 0.25 m/s        |
    | 16-18 | roll, pitch and yaw rate                                             | 0.5 rad/s       |
    | 19    | roll                                                                 | 0.25 rad        |
    | 20    | pitch                                                                | 0.5 rad         |
    | 21-22 | rudder, stern plane, measured                                        | 20 deg          |
    | 23    | thrust, measured: -1 none, 1 all                                     |                 |

    With ``observe="mean+std"`` the space is ``(38,)``: the standard deviations of the 14 states follow (velocities
    per 0.05 m/s, rates per 0.05 rad/s, position per 0.5 m, angles per 0.05 rad, current per 0.1 m/s). With
    ``observe="measurement"`` it is ``(30,)``: the 12 readings (scaled by 0.5, 0.25, 0.25 m/s; 5 m; 0.25, 0.5, 1 rad;
    0.5 rad/s; 10 m), the mask of those that arrived, the path's angle, length / 10 m and depth / 5 m, and the
    actuators: no filter.

    ## Rewards

    In [0, 1] at every step, from the truth; their sum is the score, at most 1. Seven tenths are for the path: every
    metre of it pays once, when the true vehicle first covers it, and the more the closer it is: half at 0.25 m off.
    Three tenths are for arriving, when the vehicle believes to be there: half at 0.5 m off the goal, times the energy
    that cruising at 1 m/s would have taken over that used (at most 1; everything but the propeller takes twice what
    it takes at 1 m/s). Staying, circling and going back pay nothing, waiting costs, and ending early forgoes the
    rest.

    ## Starting State

    The goal is drawn within 1 m north, 1 m east and 0.5 m down of (10, 18, 6) m. The true state is drawn from the
    task's prior: level at the path's beginning, 1 m/s, standard deviations 0.05 m/s, 0.02 rad/s, 0.2 m, 0.05 rad, and
    a current of the disturbance's size. The estimator starts from the same prior and takes in the first readings
    before the first observation. The rudder starts at 5 deg, as in the paper. ``reset(options={"goal": (x, y, z)})``
    sets the goal [m], north, east and down of the start.

    ## Episode End

    Termination, with the reason in ``info["end"]``:

    - ``arrived``: the vehicle believes to have covered the path, and is within 0.5 m of the goal;
    - ``missed the goal``: it believes so, and is not;
    - ``off the path``: it is more than 5 m off;
    - ``surfaced``: it is 2 m above its start, which lies 2 m below the surface;
    - ``too deep``: it is 3 m below the goal;
    - ``pitched over``: its pitch is beyond 75 deg (Euler angles have their pole at 90).

    With ``observe="measurement"`` nobody sees what an estimator believes, so none ends the episode or enters its
    rewards: whichever is named, it is ``arrived`` or ``missed the goal`` when the true vehicle passes the path's end.
    That it is over is the one bit of truth that the agent gets.

    Truncation: after 500 steps (50 s).

    ## Information

    | Key              | Content                                                                                 |
    |------------------|-----------------------------------------------------------------------------------------|
    | `truth`          | u, v, w [m/s], p, q, r [rad/s], x, y, z [m], phi, theta, psi [rad], current north, east |
    | `unknown_input`  | what the water will do over the coming step: kicks on u to r, changes of the current    |
    | `reference`      | believed progress, cross-track, depth error [m]; heading and slope of the path there;   |
    |                  | vector to the point ahead (north, east, down) [m]; angle, length and depth of the path. |
    |                  | With ``observe="measurement"`` of the true position, not the believed one               |
    | `actuators`      | rudder, stern plane [rad], thrust [N]                                                   |
    | `measurement`    | Doppler log (3), depth, attitude (3), gyroscope (3), position (2), 0 where missing      |
    | `available`      | which readings arrived                                                                  |
    | `estimate`       | of the truth's 14 components                                                            |
    | `covariance`     | of the estimate                                                                         |
    | `input_estimate` | 0: no estimator here gives one                                                          |
    | `parameters`     | the truth's coefficients, as `system.vehicle.parameter_names` lists them: the filters'  |
    |                  | own, but for ``mismatch``                                                               |
    | `healthy`        | False in a step where the estimator's usual update failed:                              |
    |                  | ``core.belief.recovery`` says what it did instead                                       |
    | `score`          | sum of rewards so far                                                                   |
    | `end`            | why the episode has ended, or empty                                                     |
    | `is_success`     | whether the vehicle has arrived: at an episode's end, whether it succeeded              |

    ## Arguments

    ```python
    gym.make("SegorogeniAUV-v0", estimator="enkf", sensors="nominal", disturbance="moderate",
             mismatch=0.0, observe="mean")
    ```

    - ``estimator``: ``enkf`` (default; 100 members, inflation 1.01, localised by plane), ``enkf-sr``, ``etkf``,
      ``letkf``, ``pf``, ``ekf``, ``iekf``, ``srkf``, ``eskf``, ``adaptive-kf``, ``mhe``, ``ukf``, ``huber-kf``,
      ``robust-kf``, ``truth``, ``measurement`` (the last reading of everything, current 0), ``dead-reckoning``. Those
      that need a linear model refuse this one: ``kf``, ``kf-umv-ui-wdf``, ``ulise``; those of an unknown input need a
      `vessel_gym.disturbances.Fault`, or a disturbance told as ``"input"``: ``ekf-ui-wdf``, ``ukf-umv``, and
      ``kf-umv-ui`` if a sensor reads that input itself.
    - ``estimator_options``: the filter's own, e.g. ``{"members": 300}``, ``{"localisation": None}``.
    - ``sensors``: ``clean``, ``nominal`` or ``degraded``. Nominal: Doppler log over ground 0.01 m/s with 10 % lost,
      depth 0.02 m, roll and pitch 0.01, yaw 0.03 rad, gyroscope 0.005 rad/s, and every 2 s a position fix of 0.5 m
      with 10 % lost. ``degraded`` loses 10 % more of everything, and 5 % of readings have ten times the noise: bad
      ranges.
    - ``disturbance``: ``calm``, ``moderate``, ``rough``: kicks of 0.002, 0.005, 0.01 m/s and rad/s a step, and a
      current of 0.05, 0.1, 0.2 m/s that wanders in 200 s; ``surface``: ``moderate`` under waves of 0.88 m.
    - ``mismatch``: relative spread of the truth's coefficients around the filter's, 0 to 0.25.
    - ``observe``: ``mean``, ``mean+std`` or ``measurement``, see above; with ``estimator_options={"monitor": "cusum"}``
      also ``mean+alarms`` and ``mean+std+alarms``: behind all else 1 for each sensor that is accused, else 0.
    - ``render_mode``: ``human`` (a window) or ``rgb_array``.

    ## Version History

    - v0: first version.
    """

    system = SEGOROGENI_AUV


class SegorogeniAUVVectorEnv(VesselVectorEnv):
    """The native batch of `SegorogeniAUVEnv`, which documents spaces, rewards and arguments."""

    system = SEGOROGENI_AUV
