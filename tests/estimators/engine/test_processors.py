"""Episodes have equal bits on processors with AVX-512, AVX2 and SSE alone."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("digests.py")


def digests(features: str, folder: Path) -> str:
    """Digests of episodes on a processor with some features."""
    environment = os.environ | {"VESSEL_GYM_CACHE": str(folder)}
    command = [sys.executable, "-W", "ignore", str(SCRIPT), features]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return run.stdout


@pytest.mark.nightly
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="of x86-64 alone")
@pytest.mark.parametrize("features", ["avx2", "sse"])
def test_fewer_vector_features_give_equal_bits(features: str, tmp_path: Path):
    here = digests("native", tmp_path)
    assert len(here.split()) == 12
    assert digests(features, tmp_path) == here
