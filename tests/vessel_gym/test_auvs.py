"""Laws of both underwater vehicles: inertia, energy, currents, and what filters are told of them."""

import numpy as np
import pytest
from energies import DRAG, LIFT
from hypothesis import given
from hypothesis import strategies as st
from sensing import exogenous, sensors_of, without_a_filter
from vehicle_cases import AUV, AUVS, WITH_REMUS

from estimators import wrap

each_auv = pytest.mark.parametrize("auv", AUVS.values(), ids=AUVS)


@pytest.mark.parametrize(
    ("auv", "c"),
    [(auv, auv.case.nominal) for auv in AUVS.values()]
    + [(AUVS["segorogeni"], WITH_REMUS.vector())],
    ids=[*AUVS, "REMUS"],
)
def test_inertia_is_symmetric_positive_definite_and_inverted(auv: AUV, c: np.ndarray):
    M, axes = auv.inertia(c), auv.axes
    np.testing.assert_array_equal(M, M.T)
    assert np.linalg.eigvalsh(M).min() > 0.0
    values = dict(zip(auv.vehicle.parameter_names, c, strict=True))
    inverse = [
        [values.get(f"inverse_{a}{b}", values.get(f"inverse_{b}{a}", 0.0)) for b in axes]
        for a in axes
    ]
    np.testing.assert_allclose(M @ inverse, np.eye(len(axes)), rtol=0, atol=1e-12)


# --- energy ---------------------------------------------------------------------------------------


@each_auv
@given(seed=st.integers(0, 2**32 - 1), size=st.floats(0.0, 1.5))
def test_in_still_water_without_thrust_energy_never_grows(auv: AUV, seed: int, size: float):
    states, _, flow = auv.case.draw(np.random.default_rng(seed), 20)
    states *= size
    gained = auv.power(states, auv.rates(states, 0.0 * flow, auv.case.nominal), auv.case.nominal)
    assert (gained <= 1e-12 * (1.0 + np.abs(states[:, : len(auv.axes)]).max(-1)) ** 3).all()


@each_auv
def test_without_drag_and_lift_energy_is_conserved(auv: AUV):
    c, names = auv.changed(**dict.fromkeys(DRAG + LIFT, 0.0)), auv.vehicle.state_names
    states, _, currents = auv.case.draw(np.random.default_rng(3), 20)
    states[:, [names.index(name) for name in ("phi", "theta") if name in names]] *= (
        0.3  # clear of the pole
    )
    states[:, : len(auv.axes)] *= 0.2
    np.testing.assert_allclose(
        auv.power(states, auv.rates(states, currents, c), c), 0.0, atol=1e-12
    )
    after = auv.drift(states, currents, c, 10.0, 10_000)
    np.testing.assert_allclose(auv.energy(after, c), auv.energy(states, c), rtol=0, atol=1e-8)
    assert np.abs(after - states).max() > 1.0


# --- currents -------------------------------------------------------------------------------------


@each_auv
def test_a_current_shifts_the_track_and_nothing_else(auv: AUV):
    states, controls, currents = auv.case.draw(np.random.default_rng(11), 20)
    moving, c, names = np.tile(controls, 2), auv.case.nominal, auv.vehicle.state_names
    drifted, straight = (
        auv.case.step(states, moving, flow, c, 2.0, 40) for flow in (currents, 0.0 * currents)
    )
    level = [names.index(name) for name in ("x", "y") if name in names]
    np.testing.assert_allclose(
        drifted[:, level] - straight[:, level], 2.0 * currents, rtol=0, atol=1e-12
    )
    np.testing.assert_array_equal(np.delete(drifted, level, -1), np.delete(straight, level, -1))


# --- what filters are told ------------------------------------------------------------------------


@each_auv
def test_in_still_water_exact_measurements_give_back_the_state(auv: AUV):
    states, _, currents = auv.case.draw(np.random.default_rng(15), 20)
    names, sensors = auv.vehicle.state_names, sensors_of(auv.vehicle)
    measurements = sensors.exact(states, exogenous(auv.vehicle, 0.0 * currents))
    known = sensors.states_from(measurements)
    np.testing.assert_array_equal(np.stack([known[name] for name in names], -1), states)
    x, d = without_a_filter(auv.composed(), auv.vehicle.increments, measurements)
    x, angles = np.array(x), [names.index(name) for name in auv.vehicle.angles]
    x[:, angles] = wrap(x[:, angles] - states[:, angles]) + states[:, angles]
    np.testing.assert_allclose(x, np.hstack([states, 0.0 * currents]), rtol=0, atol=1e-14)
    np.testing.assert_array_equal(d, np.zeros((20, len(auv.axes))))
