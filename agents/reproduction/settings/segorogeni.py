"""What the EnKF paper on Segorogeni prints (Inovtek Polbeng, Seri Informatika 4(1), 2019), and what we assumed.

It prints neither Q nor R, no initial covariance, no duration, no control and no hydrodynamic coefficient. The noise
and what is measured were decided before the first run, and not changed after it.
"""

from dataclasses import replace

import numpy as np

from agents.reproduction.comparison import Published, published_table
from agents.reproduction.ensembles import channel_sd
from vessel_gym.envs.segorogeni_auv import SEGOROGENI_AUV
from vessel_gym.vehicles.segorogeni import Segorogeni

# --- printed ----------------------------------------------------------------------------------------

MEMBERS = (50, 100, 200, 300)  # section III.D
DT = 0.001  # s, section III.D; forward Euler, eq. (20)
AVERAGED = 10  # runs that its means are over, section III.D
RUDDER = np.deg2rad(5.0)  # rad at the start, section III.D; all velocities and angles there are 0
GOAL = (10.0, 18.0, 6.0)  # m north, east and down of the start, section III.D

QUANTITIES = {"x": "m", "y": "m", "z": "m", "angle": "rad"}
"""What Table III gives the RMSE of, with the unit."""

PUBLISHED = published_table(
    {
        50: ("0.4702", "0.4674", "0.0823", "0.1003", "2.819"),
        100: ("0.4636", "0.4666", "0.0819", "0.1003", "5.692"),
        200: ("0.4648", "0.4657", "0.0814", "0.1003", "11.56"),
        300: ("0.4632", "0.4644", "0.082", "0.1003", "18.15"),
    },
    QUANTITIES | {"time": "s"},
    "Table III",
)
"""Table III by the number of members, then by quantity."""

FINAL = {
    name: Published(printed, "m", "section III.D")
    for name, printed in (("x", "0.02"), ("y", "0.9"), ("z", "0.2"))
}  # fmt: skip
"""Distance between the true and the estimated position at the end of the dive."""

INVERSE_INERTIA = np.array(
    [
        [0.162, -0.0024, 0.8989, 0.0011, 0.0980, 0.0001],
        [-0.0012, -0.8175, -0.0206, -0.0431, -0.0024, 0.0969],
        [1.8855, -0.0418, -1.0230, -0.0036, -0.2205, 0.0024],
        [-0.0518, 0.8865, 0.0511, 1.0468, 0.0088, -0.1050],
        [15.9131, -0.3634, -17.0743, -0.0425, -1.8611, 0.0213],
        [-0.0128, 15.7327, 0.1966, 0.8288, 0.0240, -0.8641],
    ]
)
"""The matrix in front of B1 to B6, after eq. (19)."""

BEST = {"x": 300, "y": 300, "z": 200}
"""The number of members that the paper calls best, section III.D."""

# --- ours -------------------------------------------------------------------------------------------

DURATION = 30.0  # s: at the 1 m/s of Table I an arc over the goal, 25 m long, and the time to gather way
WEIGHT_EXCESS = 12.0  # N, see "depth" in pages/segorogeni.md
VEHICLE = Segorogeni(replace(Segorogeni().body, printed_kinematics=True, buoyancy_excess=-WEIGHT_EXCESS))
OWN_DT = VEHICLE.dt
READING_SD = channel_sd(VEHICLE.sensors, ("u over ground", "v over ground", "w over ground", "r"))  # every OWN_DT
KICK_SD = SEGOROGENI_AUV.disturbances["moderate"].white.diagonal()  # m/s and rad/s, every OWN_DT
PRIOR_SD = SEGOROGENI_AUV.task.prior(np.zeros((1, 3))).cov.diagonal()[:6] ** 0.5
RUNS = AVERAGED  # of a cell at the paper's step
SEEDS = (0, 1, 2, 3, 4)  # of its cells: five times the published number of runs
OWN_RUNS = 200
EXTENDED_RUNS = 25  # of a cell without members at the paper's step, which is cheap: 50 in all
DOUBLED = 2.0  # all noise times this, to see how the errors depend on what we assumed
