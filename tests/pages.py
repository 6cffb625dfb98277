"""The pages on parts of one's own: their code, as modules to import, and an environment of each page."""

import atexit
import re
import shutil
import sys
import tempfile
from contextlib import chdir
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from unittest.mock import patch

from vessel_gym.envs import SegorogeniAUVEnv, register_environment

DOCS = Path(__file__).parents[1] / "docs"
PAGES = {
    "my_sensor": "own-sensor", "my_disturbance": "own-disturbance", "my_task": "own-task",
    "my_vehicle": "own-equations", "usv": "recipes/differential-drive", "my_parts": "tuning",
}  # fmt: skip
OWN = ("Usbl-v0", "Shear-v0", "Docking-v0", "HeavyShip-v0")
"""The environments, registered when this module is imported; the last is that of the page on vehicles."""


def blocks(page: str, kind: str) -> list[str]:
    """The blocks of code of one kind in a page."""
    return re.findall(
        rf"^```{kind}\n(.*?)^```", (DOCS / f"{page}.md").read_text(encoding="utf-8"), re.M | re.S
    )


def code(module: str) -> str:
    """The code of a module that a page shows."""
    return blocks(PAGES[module], f"python {module}")[0]


_FOLDER = Path(tempfile.mkdtemp())  # on the path to the end: a study looks for the modules' files
atexit.register(shutil.rmtree, _FOLDER)
sys.path.append(str(_FOLDER))
for _module in PAGES:
    (_FOLDER / f"{_module}.py").write_text(code(_module), encoding="utf-8")
(_FOLDER / "my_ship.toml").write_text(blocks("vehicles", "toml")[0], encoding="utf-8")

with patch("vessel_gym.envs.own.check_system"):  # test_check_system checks them, once
    # The tasks register their environments themselves.
    my_sensor, my_disturbance, _, my_vehicle, *_ = map(import_module, PAGES)
    _SYSTEM = SegorogeniAUVEnv.system
    register_environment(replace(_SYSTEM, name="Usbl-v0", sensors=tuple(my_sensor.SENSORS)))
    _SHEAR = dict.fromkeys(("calm", "moderate", "rough"), my_disturbance.SHEAR)
    register_environment(replace(_SYSTEM, name="Shear-v0", disturbances=_SHEAR))
    with chdir(_FOLDER):
        exec(
            compile(blocks("vehicles", "python")[1], "docs/vehicles.md", "exec"),
            {"__name__": "page"},
        )
