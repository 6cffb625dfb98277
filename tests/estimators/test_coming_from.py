"""The page "Coming from filterpy" against the packages themselves, each in its own environment."""

from pathlib import Path

import pytest

from tests.own_environment import ROOT, packages, run_script

SCRIPTS = sorted(Path(__file__).parent.glob("peers/against_*.py"))
SUPPORT = {"jax", "llvmlite", "numpy", "scipy", "torch"}


@pytest.mark.nightly
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_the_page_is_right_about(script: Path):
    run_script(script, timeout=600)


def test_the_page_names_the_versions_compared():
    page = (ROOT / "docs/estimators/coming-from.md").read_text(encoding="utf-8").lower()
    pins = {tuple(pin.split("==")) for script in SCRIPTS for pin in packages(script)}
    names = {"control": "python-control", "stonesoup": "stone soup"}
    for name, version in pins:
        if name not in SUPPORT:
            assert f"{names.get(name, name)} {version}".lower() in page
