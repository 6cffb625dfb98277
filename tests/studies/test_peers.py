"""Peers of the engine: the equations are written once, and all compute the same."""

from pathlib import Path

import numpy as np
import pytest
from own_environment import ROOT, run_script

from estimators import Gaussian, NonlinearModel, make
from studies import engine_peers as peers


def test_the_step_is_that_of_the_packages_filter():
    def transition(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.moveaxis(peers.transition(np.moveaxis(x, -1, 0), u[..., 0], np), 0, -1)

    rows = peers.random_inputs(6)
    mean, cov, rudder, y, available = np.split(rows, [8, 72, 73, 77], 1)
    model = NonlinearModel(
        transition, lambda x, u: x[..., peers.MEASURED], peers.Q, np.diag(peers.R)
    )
    ekf = make("ekf", model)
    belief = ekf.predict(ekf.init(Gaussian(mean, cov.reshape(-1, 8, 8))), rudder)
    belief = ekf.update(belief, y, available=available > 0.0)
    found = peers.ours()(rows)()
    np.testing.assert_allclose(found[:, :8], belief.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[:, 8:].reshape(-1, 8, 8), belief.cov, rtol=1e-7, atol=1e-9)


@pytest.mark.nightly
def test_compilers_run_in_an_environment_of_their_own(tmp_path: Path):
    """The script compares the results itself before it measures."""
    path, copy = ROOT / "studies/engine_peers.py", tmp_path / "page.md"
    copy.write_text((ROOT / "docs/engine.md").read_text())
    printed = run_script(path, "--rounds", "1", "--page", str(copy), timeout=1800.0)
    assert printed in copy.read_text()
    assert "256 of 256" in next(line for line in printed.splitlines() if "| ours " in line)
    for name in peers.LIBRARIES:
        assert f"| {name} " in printed
