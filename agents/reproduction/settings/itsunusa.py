"""What the EnKF-SR paper on the diving ITSUNUSA prints (Herlambang, Subchan and Nurhadi), and what we assumed.

It prints neither Q nor R, no measured quantities, no initial covariance, no control and no hydrodynamic coefficient.
The noise and what is measured were decided before the first run, and not changed after it.
"""

import numpy as np

from agents.reproduction.comparison import Published
from agents.reproduction.ensembles import channel_sd
from vessel_gym.envs.itsunusa_auv import ITSUNUSA_AUV
from vessel_gym.vehicles.itsunusa import Itsunusa

# --- printed ----------------------------------------------------------------------------------------

MEMBERS = (200, 300, 400)  # results section
DT = 0.1  # s, results section; all velocities are 0 at the start
DEPTH = 20.0  # m, results section

QUANTITIES = {"surge": "m/s", "heave": "m/s", "pitch rate": "rad/s", "position": "m"}
"""What Table 2 gives the RMSE of, with the unit."""

_TABLE = {
    200: ("0.02568", "0.02344", "0.00539", "0.03541", "4.632"),
    300: ("0.02079", "0.01872", "0.00465", "0.02875", "6.281"),
    400: ("0.01582", "0.01269", "0.00415", "0.01938", "7.1569"),
}
_UNITS = QUANTITIES | {"time": "s"}
PUBLISHED = {
    members: {
        name: Published(printed, unit, "Table 2") for (name, unit), printed in zip(_UNITS.items(), row, strict=True)
    }
    for members, row in _TABLE.items()
}
"""Table 2 by the number of members, then by quantity."""

POSITION = Published("0.03", "m", "results section, on Figure 6")
RELATIVE = Published("0.0015", "%", "results section, on Figure 6", meant=0.15)
"""The position error in words, and over the depth: 0.03 m of 20 m are 0.15 %."""

BOUND = Published("2", "%", "results section, below Figure 6")
"""What the position error is said to stay below."""

MISPRINTS = [
    "The error of the position is said to be 0.0015 %: 0.03 m of 20 m are 0.15 %.",
    "The text gives about 0.03 m for the position with 400 members, Table 2 has 0.01938 m.",
    "Eqs. (2) and (3) have u²u² where u²δ of the stern plane is meant; in eqs. (1) to (3) z_G q, x_G q and z_G "
    "(u + wq) have lost the dots of q and u; the moment in eq. (3) is printed as a fraction and is a difference.",
    "The update that the paper's Table 1 prints leaves the last Vᵀ out, as Evensen (2004) did: the members' mean then "
    "moves at random in every update. The symmetric form, this package's default, mends that.",
    "The printed 16 kg is a sixth of what a body of 2 m by 0.30 m displaces.",
]

# --- ours -------------------------------------------------------------------------------------------

VEHICLE = Itsunusa()
GOAL = (60.0, 0.0, DEPTH)  # m north, east and down of the start, the run that of ItsunusaAUV-v0
READING_SD = channel_sd(VEHICLE.sensors, ("u over ground", "w over ground", "q"))
INCLINOMETER_SD = channel_sd(VEHICLE.sensors, ("theta",))  # a check beside the table: pitch measured, too
KICK_SD = np.append(ITSUNUSA_AUV.disturbances["moderate"].white.diagonal(), 0.0)  # on u, w, q and pitch
PRIOR_SD = ITSUNUSA_AUV.task.prior(np.zeros((1, 3))).cov.diagonal()[[0, 1, 2, 5]] ** 0.5
RUNS = 50
SEED = 0
DOUBLED = 2.0  # all noise times this, to see how the errors depend on what we assumed

VARIANTS = {"evensen2004": "as printed", "symmetric": "symmetric"}
"""Forms of `enkf-sr`: the paper's Table 1, and this package's default, which keeps the members' mean."""

ASSUMPTIONS = [
    (
        "noise of the readings",
        "The paper prints no R. We take the instruments of this package's vehicle, figures of public vehicle "
        f"configurations: Doppler log {READING_SD[0]:g} m/s, gyroscope {READING_SD[-1]:g} rad/s at every step of "
        f"{DT} s.",
    ),
    (
        "process noise",
        f"The paper prints no Q. We take the moderate water of ItsunusaAUV-v0: kicks of {KICK_SD[0]:g} m/s on surge "
        f"and heave and {KICK_SD[2]:g} rad/s on the pitch rate at every step. Truth and filter have the same Q, so "
        "that the filter's model is exact but for its members.",
    ),
    (
        "what is measured",
        "Surge, heave and pitch rate, the motions of Table 2: the paper does not say, and the authors' paper on "
        "Segorogeni measures the motions that it estimates. Neither depth nor pitch is measured.",
    ),
    (
        "state",
        "Surge, heave, pitch rate and pitch, which the restoring forces in X_res, Z_res and M_res need. Depth is "
        "integrated over the estimates, as in the paper on Segorogeni.",
    ),
    ("R in the update", "R itself, where the paper's Table 1 has the sample E Eᵀ of its perturbations."),
    (
        "first members",
        f"Drawn about the printed start at rest with the package's prior of a dive: {PRIOR_SD[0]:g} m/s, "
        f"{PRIOR_SD[2]:g} rad/s, and {PRIOR_SD[3]:g} rad of pitch.",
    ),
    (
        "vehicle",
        "Coefficients from the printed dimensions (docs/hydrodynamics.md); 96 kg, what it displaces less 6 N, because "
        "the printed 16 kg could not be made to dive.",
    ),
    (
        "control",
        f"What the package's dive autopilot did on the undisturbed vehicle, from rest to {GOAL[0]:g} m ahead and "
        f"{GOAL[2]:g} m down, replayed. The filter knows it.",
    ),
    ("position error", f"Of the depth: the paper calls it the diving position and relates it to {DEPTH:g} m."),
]
"""What the paper does not print, what we took, and why."""
