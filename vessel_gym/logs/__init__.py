"""Measured logs: reading them from files and pipes, and what is wrong with them.

It imports `estimators.checks` and `vessel_gym.toml_file`; identification, estimation and commands import it.
"""

from vessel_gym.logs.columns import Columns, read_columns
from vessel_gym.logs.log import Channel, Log, LogError
from vessel_gym.logs.read import read, rows

__all__ = ["Channel", "Columns", "Log", "LogError", "read", "read_columns", "rows"]
