"""Waves above a submerged vehicle."""

import numpy as np
import pytest

from vessel_gym.core import Core
from vessel_gym.disturbances import SurfaceWater
from vessel_gym.envs import ItsunusaAUVEnv, SegorogeniAUVEnv
from vessel_gym.waves import GRAVITY, jonswap

SYSTEMS = {"segorogeni": SegorogeniAUVEnv.system, "itsunusa": ItsunusaAUVEnv.system}


def above(name: str) -> SurfaceWater:
    system = SYSTEMS[name]
    names = system.vehicle.state_names
    return SurfaceWater(
        0.88, 7.5, system.disturbances["moderate"], names.index("x"), names.index("z")
    )


@pytest.mark.parametrize("depth", [0.0, 2.0, 8.0, 20.0])
def test_wave_velocity_decays_with_depth_as_by_airy(depth):
    """Against the whole spectrum, of the field and of filters' bands. 40,000 draws: 5 deviations are 2 %."""
    water = above("segorogeni")
    rng = np.random.default_rng(0)
    state = np.zeros((40_000, len(SegorogeniAUVEnv.system.vehicle.state_names)))
    state[:, water.down], state[:, water.north] = (
        depth - water.depth,
        rng.uniform(-100.0, 100.0, len(state)),
    )
    z = np.concatenate([np.zeros((len(state), 2)), rng.standard_normal((len(state), 6))], -1)
    drawn, time = (
        water.draw(rng.uniform(size=(len(state), water.uniforms))),
        rng.uniform(0.0, 300.0, len(state)),
    )
    w = np.linspace(0.2, 6.0, 20_000)
    below = jonswap(w, 0.88, 7.5) * (w * np.exp(-(w**2) / GRAVITY * depth)) ** 2
    for speed in (water.effect_at(drawn, time, z[:, :3], state), water.modelled.effect(z, state)):
        assert speed[:, 0].std() == pytest.approx(np.sqrt(np.trapezoid(below, w)), rel=0.02)
        assert not speed[:, 1:].any() or np.array_equal(
            speed[:, 1], z[:, 1]
        )  # they run to the north


def test_above_the_surface_there_is_no_more_than_at_it():
    water = above("segorogeni")
    z, state, time = np.ones((1, 8)), np.zeros((1, 12)), np.ones(1)
    drawn = water.draw(np.full((1, water.uniforms), 0.3))
    state[0, water.down] = -water.depth
    at, model = water.effect_at(drawn, time, z, state), water.modelled.effect(z, state)
    state[0, water.down] = -50.0
    assert (water.effect_at(drawn, time, z, state) == at).all()
    assert (water.modelled.effect(z, state) == model).all()


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_waves_leave_the_rest_of_the_water_unchanged(name):
    system = SYSTEMS[name]
    still = SurfaceWater(1e-9, 7.5, above(name).beside, above(name).north, above(name).down)
    cores = [Core(system, 3, estimator="truth", disturbance=d) for d in (still, still.beside)]
    for core in cores:
        core.start(0)
        for _ in range(20):
            core.step(np.zeros((3, core.config.action_size)))
    k = still.beside.process.size
    one, other = (core.now for core in cores)
    assert (one.slow[:, :k] == other.slow[:, :k]).all()
    assert one.state == pytest.approx(other.state, abs=1e-8)


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_a_filter_holds_the_waves_as_states_and_flies(name):
    water = above(name)
    core = Core(SYSTEMS[name], 4, disturbance=water)
    core.start(0)
    assert (
        core.config.composition.names[-6 - core.config.sensors.bias.size :][:6]
        == water.modelled.names[-6:]
    )
    for _ in range(30):
        core.step(np.zeros((4, core.config.action_size)))
    assert np.isfinite(core.now.belief.mean).all()
