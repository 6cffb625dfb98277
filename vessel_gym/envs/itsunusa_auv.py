"""ItsunusaAUV-v0: an underwater vehicle dives in the vertical plane on what a filter believes."""

from vessel_gym.envs.auv import auv_system
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv

ITSUNUSA_AUV = auv_system("itsunusa", "ItsunusaAUV-v0")


class ItsunusaAUVEnv(VesselEnv):
    """Dive in the vertical plane on what an estimator believes.

    ## Description

    ITSUNUSA, a torpedo of 2 m and 96 kg, dives to a goal 20 m below and 60 m ahead of its start along a smooth step,
    at about 1.5 m/s. The mission is over when the vehicle *believes* to have covered the path. A current carries it
    along, turbulence kicks it, and an acoustic fix of its position comes every 2 s at best.

    The vehicle moves in surge, heave and pitch (eqs. 1-3 of Herlambang, Subchan and Nurhadi's paper, with its
    misprints mended and full kinematics); its coefficients follow from its dimensions (docs/hydrodynamics.md),
    because the paper prints none, and its mass from the water that it displaces (16 kg, as printed, would not sink).
    Two RK4 substeps of 0.05 s. Filters know these equations, the sizes of turbulence and current and the sensors'
    noise; with ``mismatch=0`` their model is exact.

    ## Action Space

    ``Box(-1, 1, (2,), float32)``

    | Num | Action      | Min | Max | Unit                                               |
    |-----|-------------|-----|-----|----------------------------------------------------|
    | 0   | stern plane | -1  | 1   | share of 20 deg, moves at 1 rad/s; positive dives  |
    | 1   | thrust      | -1  | 1   | 0 to 40 N, with a lag of 0.5 s; 1.5 m/s takes 16 N |

    Actions outside the bounds are clipped; NaN raises.

    ## Observation Space

    ``Box(-10, 10, (14,), float32)``, scaled to be of order 1 and clipped. All are estimates but the actuators;
    vectors are in body axes (ahead, below):

    | Num   | Observation                                               | Scale (1 means) |
    |-------|-----------------------------------------------------------|-----------------|
    | 0-1   | vector to the point of the path right above or below      | 0.25 m          |
    | 2-3   | vector to the path's point 5 m on                         | 5 m             |
    | 4-5   | current                                                   | 0.25 m/s        |
    | 6     | flight-path angle of the path minus pitch                 | 0.25 rad        |
    | 7     | remaining path in plan                                    | 10 m            |
    | 8     | surge through the water minus 1.5 m/s                     | 0.25 m/s        |
    | 9     | heave through the water                                   | 0.25 m/s        |
    | 10    | pitch rate                                                | 0.5 rad/s       |
    | 11    | pitch                                                     | 0.5 rad         |
    | 12    | stern plane, measured                                     | 20 deg          |
    | 13    | thrust, measured: -1 none, 1 all                          |                 |

    With ``observe="mean+std"`` the space is ``(21,)``: the standard deviations of the 7 states follow (per 0.05 m/s,
    0.05 m/s, 0.05 rad/s, 0.5 m, 0.5 m, 0.05 rad, 0.1 m/s). With ``observe="measurement"`` it is ``(16,)``: the 6
    readings (scaled by 0.5, 0.25 m/s; 10 m; 0.5 rad; 0.5 rad/s; 20 m), the mask of those that arrived, the path's
    length / 20 m and depth / 10 m, and the actuators: no filter.

    ## Rewards

    In [0, 1] at every step, from the truth; their sum is the score, at most 1. Seven tenths are for the path: every
    metre of it pays once, when the true vehicle first covers it, and the more the closer it is: half at 0.25 m off.
    Three tenths are for arriving, when the vehicle believes to be there: half at 0.5 m off the goal, times the energy
    that cruising at 1.5 m/s would have taken over that used (at most 1; everything but the propeller takes twice what
    it takes at 1.5 m/s). Staying, circling and going back pay nothing, waiting costs, and ending early forgoes the
    rest.

    ## Starting State

    The goal is drawn within 2 m ahead and 1 m down of (60, 20) m. The true state is drawn from the task's prior:
    level at the path's beginning, 1.5 m/s, standard deviations 0.05 m/s, 0.02 rad/s, 0.2 m, 0.05 rad, and a current
    of the disturbance's size. The estimator starts from the same prior and takes in the first readings before the
    first observation. ``reset(options={"goal": (x, 0, z)})`` sets the goal [m], ahead and down of the start.

    ## Episode End

    Termination, with the reason in ``info["end"]``:

    - ``arrived``: the vehicle believes to have covered the path, and is within 0.5 m of the goal;
    - ``missed the goal``: it believes so, and is not;
    - ``off the path``: it is more than 5 m off;
    - ``surfaced``: it is 2 m above its start, which lies 2 m below the surface;
    - ``too deep``: it is 3 m below the goal;
    - ``pitched over``: its pitch is beyond 75 deg.

    With ``observe="measurement"`` nobody sees what an estimator believes, so none ends the episode or enters its
    rewards: whichever is named, it is ``arrived`` or ``missed the goal`` when the true vehicle passes the path's end.
    That it is over is the one bit of truth that the agent gets.

    Truncation: after 600 steps (60 s).

    ## Information

    | Key              | Content                                                                                 |
    |------------------|-----------------------------------------------------------------------------------------|
    | `truth`          | u, w [m/s], q [rad/s], x, z [m], theta [rad], current [m/s]                             |
    | `unknown_input`  | what the water will do over the coming step: kicks on u, w, q, change of the current    |
    | `reference`      | believed progress, cross-track (0), depth error [m]; heading (0) and slope of the path  |
    |                  | there; vector to the point ahead (north, 0, down) [m]; angle (0), length and depth of   |
    |                  | the path. With ``observe="measurement"`` of the true position, not the believed one     |
    | `actuators`      | stern plane [rad], thrust [N]                                                           |
    | `measurement`    | Doppler log (2), depth, pitch, pitch rate, position, 0 where missing                    |
    | `available`      | which readings arrived                                                                  |
    | `estimate`       | of the truth's 7 components                                                             |
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
    gym.make("ItsunusaAUV-v0", estimator="enkf-sr", sensors="nominal", disturbance="moderate",
             mismatch=0.0, observe="mean")
    ```

    - ``estimator``: ``enkf-sr`` (default; 100 members, inflation 1.01, localised), ``enkf``, ``etkf``, ``letkf``,
      ``pf``, ``ekf``, ``iekf``, ``srkf``, ``eskf``, ``adaptive-kf``, ``mhe``, ``ukf``, ``kf`` (made straight about
      steady dives along the path), ``huber-kf``, ``robust-kf``, ``truth``, ``measurement`` (the last reading of
      everything, current 0), ``dead-reckoning``. Those of an unknown input need a `vessel_gym.disturbances.Fault`, or a
      disturbance told as ``"input"``: ``kf-umv-ui`` (which takes the input of the step before for that of now),
      ``kf-umv-ui-wdf``, ``ulise``, ``ekf-ui-wdf``, ``ukf-umv``.
    - ``estimator_options``: the filter's own, e.g. ``{"members": 400}``, ``{"localisation": None}``;
      ``{"model": "steady dives"}`` gives any of them the linear model.
    - ``sensors``: ``clean``, ``nominal`` or ``degraded``. Nominal: Doppler log over ground 0.01 m/s with 10 % lost,
      depth 0.02 m, pitch 0.01 rad, gyroscope 0.005 rad/s, and every 2 s a position fix of 0.5 m with 10 % lost.
      ``degraded`` loses 10 % more of everything, and 5 % of readings have ten times the noise: bad ranges.
    - ``disturbance``: ``calm``, ``moderate``, ``rough``: kicks of 0.002, 0.005, 0.01 m/s and half as many rad/s a
      step, and a current of 0.05, 0.1, 0.2 m/s that wanders in 200 s; ``surface``: ``moderate`` under waves of 0.88 m.
    - ``mismatch``: relative spread of the truth's coefficients around the filter's, 0 to 0.25.
    - ``observe``: ``mean``, ``mean+std`` or ``measurement``, see above; with ``estimator_options={"monitor": "cusum"}``
      also ``mean+alarms`` and ``mean+std+alarms``: behind all else 1 for each sensor that is accused, else 0.
    - ``render_mode``: ``human`` (a window) or ``rgb_array``.

    ## Version History

    - v0: first version.
    """

    system = ITSUNUSA_AUV


class ItsunusaAUVVectorEnv(VesselVectorEnv):
    """The native batch of `ItsunusaAUVEnv`, which documents spaces, rewards and arguments."""

    system = ITSUNUSA_AUV
