"""SigmaChannel-v0: a SIGMA-class corvette keeps between the edges of a channel in bow and quartering seas."""

from dataclasses import replace

import numpy as np

from vessel_gym.envs.shared import documented
from vessel_gym.envs.ship import seas
from vessel_gym.envs.sigma_corvette import SIGMA_CORVETTE
from vessel_gym.envs.single import VesselEnv
from vessel_gym.envs.vector import VesselVectorEnv
from vessel_gym.tasks.channel import Channel
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.files import load

_SHIP = load("corvette", CorvetteParameters)
_TASK = Channel(_SHIP)
_SEAS = seas(_SHIP, _TASK.dt)
SIGMA_CHANNEL = replace(
    SIGMA_CORVETTE,
    name="SigmaChannel-v0",
    task=_TASK,
    # The channel leads north-east or north-west: waves that run to the south come from 45 degrees off the bow, those
    # that run to the north from 45 degrees off the stern.
    disturbances={name: replace(sea, direction=np.pi) for name, sea in _SEAS.items()}
    | {f"{name} quartering": _SEAS[name] for name in ("moderate", "rough")},
)


@documented
class SigmaChannelEnv(VesselEnv):
    """Keep to a channel in bow or quartering seas, with an estimator in the loop."""

    system = SIGMA_CHANNEL


class SigmaChannelVectorEnv(VesselVectorEnv):
    """The native batch of `SigmaChannelEnv`, which documents spaces, rewards and arguments."""

    system = SIGMA_CHANNEL
