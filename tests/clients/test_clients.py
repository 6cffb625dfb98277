"""Learners of others get each transition of our environments once, and as it was."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
import with_cleanrl_loop
import with_stable_baselines3
from own_environment import ROOT, packages, run_script
from recorder import ENVIRONMENTS, Record

INSTALLED = (
    with_cleanrl_loop.native,
    with_cleanrl_loop.gymnasiums_own,
    with_stable_baselines3.on_policy,
    with_stable_baselines3.off_policy,
)
SCRIPTS = [path for path in Path(__file__).parent.glob("with_*.py") if "# ///" in path.read_text()]


@pytest.mark.parametrize("play", INSTALLED)
@pytest.mark.parametrize("env_id", ENVIRONMENTS)
def test_a_learner_stores_what_happened(play: Callable[[Record], None], env_id: str):
    with Record(env_id) as record:
        play(record)


@pytest.mark.nightly
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_learner_with_packages_of_its_own_does_too(script: Path):
    print(run_script(script, timeout=1800.0))


def test_the_page_names_the_versions_that_are_run():
    page = (ROOT / "docs" / "tutorials" / "coming-from-rl.md").read_text()
    run = " ".join(sum(map(packages, SCRIPTS), [(ROOT / "constraints.txt").read_text()]))
    named = re.findall(r"^\| .*? (\d+\.\d+\.\d+)", page, re.M)
    assert len(named) > 5
    assert [version for version in named if f"=={version}" not in run] == []
