"""What stays gives what it gave: every environment on every estimator, against the recorded file."""

import subprocess
import sys
from pathlib import Path

import pytest
from golden.record import ENVIRONMENTS, GENERAL, Golden, elsewhere

ROOT = Path(__file__).parents[1]


@pytest.mark.nightly
@pytest.mark.parametrize("env", [*ENVIRONMENTS, *GENERAL])
def test_an_environment_gives_what_is_recorded(env: str):
    if sentence := elsewhere(Golden()):
        pytest.skip(sentence)
    command = [sys.executable, "-m", "tests.golden.record", "--only", f"{env} "]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, (done.stdout + done.stderr)[-5000:]
