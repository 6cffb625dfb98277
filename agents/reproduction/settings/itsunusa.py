"""What the EnKF-SR paper on the diving ITSUNUSA prints (Herlambang, Subchan and Nurhadi), and what we assumed.

It prints neither Q nor R, no measured quantities, no initial covariance, no control and no hydrodynamic coefficient.
The noise and what is measured were decided before the first run, and not changed after it.
"""

import numpy as np

from agents.reproduction.comparison import Published, published_table
from agents.reproduction.ensembles import channel_sd
from vessel_gym.envs.itsunusa_auv import ITSUNUSA_AUV
from vessel_gym.vehicles.itsunusa import Itsunusa

# --- printed ----------------------------------------------------------------------------------------

MEMBERS = (200, 300, 400)  # results section
DT = 0.1  # s, results section; all velocities are 0 at the start
DEPTH = 20.0  # m, results section

QUANTITIES = {"surge": "m/s", "heave": "m/s", "pitch rate": "rad/s", "position": "m"}
"""What Table 2 gives the RMSE of, with the unit."""

PUBLISHED = published_table(
    {
        200: ("0.02568", "0.02344", "0.00539", "0.03541", "4.632"),
        300: ("0.02079", "0.01872", "0.00465", "0.02875", "6.281"),
        400: ("0.01582", "0.01269", "0.00415", "0.01938", "7.1569"),
    },
    QUANTITIES | {"time": "s"},
    "Table 2",
)
"""Table 2 by the number of members, then by quantity."""

POSITION = Published("0.03", "m", "results section, on Figure 6")
RELATIVE = Published("0.0015", "%", "results section, on Figure 6", meant=0.15)
"""The position error in words, and over the depth: 0.03 m of 20 m are 0.15 %."""

BOUND = Published("2", "%", "results section, below Figure 6")
"""What the position error is said to stay below."""

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
