"""The corvette's environment with episodes of 80 steps, for laws that hold at any length."""

from dataclasses import replace
from unittest.mock import patch

from vessel_gym.envs import SigmaCorvetteEnv, register_environment

SYSTEM = SigmaCorvetteEnv.system
with patch("vessel_gym.envs.own.check_system"):  # other tests check the corvette
    BRIEF = register_environment(
        replace(SYSTEM, name="BriefCorvette-v0", task=replace(SYSTEM.task, horizon=80))
    )
