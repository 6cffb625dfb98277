"""SigmaCorvette-v0: a SIGMA-class corvette holds a turning circle on what a filter believes."""

from vessel_gym.envs.ship import ship_system
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv

SIGMA_CORVETTE = ship_system("corvette", "SigmaCorvette-v0")
SEAS = SIGMA_CORVETTE.disturbances


class SigmaCorvetteEnv(VesselEnv):
    """Hold a turning circle, as a place on the map, on what an estimator believes.

    ## Description

    A SIGMA-class corvette (101 m, 2423 t, 15.4 m/s = 29.9 kn) is commanded onto a track: 77 m straight on, a clothoid
    of some 350 m, then a circle of 3 to 6 ship lengths radius, to either side, for the rest of 300 s. Waves, which she
    meets at every angle and frequency as she turns, kick the heading; wind, drift and a current set her off the track.
    Compass, rate gyro and receiver are noisy, and the agent sees only what a filter makes of them.

    The ship moves in surge, sway, yaw and roll: Clarke's linear derivatives, cross-flow drag, propellers of constant
    revolutions, rudders in their race, speed loss in the turn; one RK4 step of 0.5 s. The sea is a field of long waves
    (JONSWAP, three bands) that run to the north, like the wind: see `vessel_gym.seaway.Seaway`. Their first-order
    motion is superposed on manoeuvring: with the unknown input ``d``, the yaw increment that waves give in a step, the
    heading goes on by ``d`` beside its own change, the compass reads ``psi + d`` and the gyro ``r + d / dt``, which is
    the thesis' arrangement (Hermawan 2020, eq. 4.5) with a rate gyro.

    Filters estimate ``x = (north, east, heading, surge, sway, yaw rate)``, and a current, for which they also take the
    leeway of wind and drift: by position nobody can tell these apart. They are told nothing of waves but that ``d`` is
    unknown, and how large it is; ``estimator_options={"told": ...}`` tells them otherwise.

    ## Action Space

    ``Box(-1, 1, (1,), float32)``

    | Num | Action      | Min | Max | Unit                                                        |
    |-----|-------------|-----|-----|-------------------------------------------------------------|
    | 0   | rudder rate | -1  | 1   | share of 5 deg/s; positive turns the ship to starboard      |

    The rudder itself is limited to +-35 deg. Actions outside the bounds are clipped; NaN raises.

    ## Observation Space

    ``Box(-10, 10, (11,), float32)``, scaled to be of order 1 and clipped. What is commanded is that of the track's
    point next to where the ship is believed to be:

    | Num | Observation                                                         | Scale (1 means) |
    |-----|---------------------------------------------------------------------|-----------------|
    | 0   | heading that holds the track in the believed current, less the estimated one | 0.1 rad |
    | 1   | yaw rate that does so, less the estimated one                       | 0.01 rad/s      |
    | 2   | sway velocity, estimate                                             | 2 m/s           |
    | 3   | unknown input d, estimate (0 where the estimator gives none)        | 0.01 rad        |
    | 4   | rudder angle, measured                                              | 35 deg          |
    | 5   | commanded yaw rate                                                  | 0.04 rad/s      |
    | 6   | commanded yaw rate 10 s ahead                                       | 0.04 rad/s      |
    | 7   | estimated distance to starboard of the track                        | 20 m            |
    | 8   | estimated surge, less that of the steady turn                       | 2 m/s           |
    | 9   | estimated current along the track                                   | 1 m/s           |
    | 10  | and to starboard of it                                              | 1 m/s           |

    ``observe="mean+std"`` appends the estimator's standard deviations of north, east, heading, sway, yaw rate and
    unknown input in the scales 5 m, 5 m, 0.1 rad, 2 m/s, 0.01 rad/s, 0.01 rad: ``(17,)``.
    ``observe="measurement"`` shows raw readings instead: compass [rad] and place (in two ship lengths) from the first
    heading on, yaw rate (0.01 rad/s), and 1 or 0 for whether each arrived; then rudder and yaw rate of the turn:
    ``(10,)``. A missing reading is 0. Whichever estimator is named, nothing of what it believes enters such an episode.
    ``guidance=False`` shows the estimate as it is, from the first heading on, and the mission: ``(12,)``.

    ## Rewards

    From the truth, each step in [0, 1]::

        (0.5 / (1 + (e / 10 m)^2) + 0.3 / (1 + (chi_e / 0.05 rad)^2) + 0.2 / (1 + (r_e / 0.15 r_c)^2))
        (1 - 0.15 a^2) p

    with the distance ``e`` from the track, the course over ground off the track's direction ``chi_e``, the yaw rate off
    that of the track ``r_e``, the commanded yaw rate ``r_c`` of the turn, the action ``a``, and the progress ``p``: how
    much further along the track the ship has come than ever before, in [0, 1] of 0.85 of what she should. It is never
    negative, and neither ending early nor loitering pays. The episode's score, ``info["score"]``, is the sum of rewards
    over 600 steps, in [0, 1].

    ## Starting State

    The initial heading, radius and side are uniform. The track begins at the origin. The true sway, yaw rate, heading,
    place and surge are drawn from the task's prior (standard deviations 0.2 m/s, 0.002 rad/s, 0.03 rad, 2 m, 2 m,
    0.2 m/s around 0, 0, the initial heading, the origin, 15.4 m/s), and the estimator starts from that same prior and
    takes in the first readings before the first observation. ``reset(options={"radius": r})`` sets the commanded radius
    [m], 253 m to 100 km, positive to starboard.

    ## Episode End

    - Termination: the true ship is more than 3 ship lengths off the track (the turn is lost).
    - Truncation: after 600 steps (300 s).

    ## Information

    | Key              | Content                                                                     |
    |------------------|-----------------------------------------------------------------------------|
    | `truth`          | x, y [m], heading [rad], surge, sway [m/s], yaw rate [rad/s], roll [rad],   |
    |                  | its rate [rad/s], then the sea: bands of waves, current: scoring only       |
    | `unknown_input`  | true d [rad] over the coming step                                           |
    | `reference`      | of the track's nearest point: heading to steer in still water, yaw rate,    |
    |                  | yaw rate 10 s ahead, final yaw rate, distance to starboard of the track     |
    |                  | [m], its direction, surge of the steady turn [m/s], believed heading        |
    | `actuators`      | rudder [rad]                                                                |
    | `measurement`    | compass [rad], yaw rate [rad/s], north, east [m], 0 where missing           |
    | `available`      | which readings arrived                                                      |
    | `estimate`       | north, east, heading, surge, sway, yaw rate, current north and east         |
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
    gym.make("SigmaCorvette-v0", estimator="kf-umv-ui", sensors="nominal", disturbance="moderate",
             mismatch=0.0, observe="mean")
    ```

    - ``estimator``: on the nonlinear ship ``kf-umv-ui`` (default, linearised at the estimate), ``ekf``, ``iekf``,
      ``srkf``, ``eskf``, ``adaptive-kf``, ``mhe``, ``ukf``, ``enkf``, ``enkf-sr``, ``etkf``, ``letkf``, ``pf``, and
      with d as a further state ``ekf-ui-wdf``, ``ukf-umv``; on a linear model about the commanded turn ``ulise`` (whose
      d is one step late), ``kf-umv-ui-wdf``, ``kf``, ``huber-kf``, ``robust-kf``; and ``truth``, ``measurement``
      (readings held), ``dead-reckoning``.
    - ``estimator_options``: the filter's own, and ``model``: ``"nonlinear"`` or ``"linear"``; ``told``: what the filter
      is told of the sea. Waves as states: ``{"told": {"disturbance": "moderate", "as": "states"}}``; as noise, without
      a current: ``{"told": {"as": "noise"}}``; d as white of known variance, for ``kf``: ``{"told": {"as": "white"}}``.
    - ``sensors``: ``clean``, ``nominal`` (compass 2e-3 rad, gyro 2e-3 rad/s, receiver 2 m every second) or
      ``degraded``; or your own, such as the thesis' motion reference unit, `vessel_gym.vehicles.corvette.MOTION_UNIT`.
    - ``disturbance``: ``calm``, ``moderate`` or ``rough``: significant heights of 0.3, 1.88 and 3.25 m, winds of 8.5,
      19 and 24.5 kn, currents of 0.1, 0.3 and 0.6 m/s.
    - ``mismatch``: relative spread of the hull's and rudder's coefficients around the filter's, 0 to 0.25.
    - ``observe``: ``mean``, ``mean+std`` or ``measurement``, see above; with ``estimator_options={"monitor": "cusum"}``
      also ``mean+alarms`` and ``mean+std+alarms``: behind all else 1 for each sensor that is accused, else 0.
    - ``render_mode``: ``human`` (a window) or ``rgb_array``.

    ## Version History

    - v0: before 1.0, a new world under the old name: waves as a turning ship meets them, wind and drift, propellers of
      constant revolutions, roll, a receiver, and a track over ground instead of a heading over time. The first one is
      ``ThesisCorvette-v0``.
    """

    system = SIGMA_CORVETTE


class SigmaCorvetteVectorEnv(VesselVectorEnv):
    """The native batch of `SigmaCorvetteEnv`, which documents spaces, rewards and arguments."""

    system = SIGMA_CORVETTE
