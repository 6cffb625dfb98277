"""Peers of the engine: equations are written once, and all compute the same."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from own_environment import ROOT, run_script

from estimators import Gaussian, NonlinearModel, make
from estimators.engine import compiled, jacobian
from studies import corvette_filter as corvette
from studies.scalars import Lines, Scalar, forward, operations, vector


def linearise(function: Any, x: Any, rudder: Any) -> tuple[Any, Any]:
    value = function(x, rudder)
    return value, jacobian(value, x)


def ours(rows: np.ndarray) -> np.ndarray:
    return compiled(lambda row: corvette.ekf_step(row, linearise))(rows)


def test_the_step_is_that_of_the_packages_filter():
    rows = corvette.random_inputs(6)
    mean, cov, rudder, y, available = np.split(rows, [8, 72, 73, 77], 1)
    model = NonlinearModel(
        compiled(corvette.transition),
        compiled(lambda x, u=None: x[..., corvette.SEEN]),
        corvette.Q,
        np.diag(corvette.R),
        measurement_angles=(0,),
    )
    ekf = make("ekf", model)
    belief = ekf.predict(ekf.init(Gaussian(mean, cov.reshape(-1, 8, 8))), rudder)
    belief = ekf.update(belief, y, available=available > 0.0)
    found = ours(rows)
    np.testing.assert_allclose(found[:, :8], belief.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[:, 8:].reshape(-1, 8, 8), belief.cov, rtol=1e-7, atol=1e-12)


def test_lines_that_numpy_writes_compute_the_step():
    lines = Lines("z")
    row = vector([Scalar(f"z[{index}]", lines) for index in range(corvette.INPUTS)])
    with corvette.own_sine():
        found = corvette.ekf_step(row, forward)
    where = lambda mask, a, b: a if mask else b  # noqa: E731
    names = operations(math, where=where, absolute=abs, maximum=max)
    step = lines.function(f"return {', '.join(each.value for each in found)}", names)
    rows = corvette.random_inputs(4)
    np.testing.assert_allclose([step(row) for row in rows], ours(rows), rtol=1e-9, atol=1e-12)


@pytest.mark.nightly
def test_compilers_run_in_an_environment_of_their_own(tmp_path: Path):
    """The script compares the results itself before it measures."""
    path, copy = ROOT / "studies/engine_peers.py", tmp_path / "page.md"
    copy.write_text((ROOT / "docs/engine.md").read_text())
    printed = run_script(path, "--rounds", "1", "--page", str(copy), timeout=1800.0)
    assert printed in copy.read_text()
    assert printed.count("256 of 256 | 3 of 3") == 1
    for name in ("ours", "Numba", "CasADi", "JAX", "heyoka"):
        assert f"| {name} " in printed
