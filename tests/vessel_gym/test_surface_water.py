"""Waves above a submerged vehicle."""

import numpy as np
import pytest

from vessel_gym.disturbances.spectrum import WaveSpectrum, WaveSystem
from vessel_gym.disturbances.water import SurfaceWater
from vessel_gym.envs import ItsunusaAUVEnv, SegorogeniAUVEnv
from vessel_gym.simulation.core import Core
from vessel_gym.vehicles.vehicle import GRAVITY

SYSTEMS = {"segorogeni": SegorogeniAUVEnv.system, "itsunusa": ItsunusaAUVEnv.system}


def above(name: str, height: float = 0.88) -> SurfaceWater:
    system = SYSTEMS[name]
    names = system.vehicle.state_names
    place = tuple(names.index(each) for each in ("x", "y") if each in names)
    spectrum = WaveSpectrum.of_systems(WaveSystem(height, 7.5))
    return SurfaceWater(spectrum, system.disturbances["moderate"], place, names.index("z"))


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_wave_velocity_decays_with_depth_as_by_airy(name):
    """Against the whole spectrum, of the field and of filters' bands. 40,000 draws: 5 deviations are 2 %."""
    water, rng = above(name), np.random.default_rng(0)
    count, place = len(water.place), list(water.place)
    state = np.zeros((40_000, len(SYSTEMS[name].vehicle.state_names)))
    state[:, place] = rng.uniform(-100.0, 100.0, (len(state), count))
    z = np.concatenate([np.zeros((len(state), count)), rng.standard_normal((len(state), 8))], -1)
    drawn = water.draw(rng.uniform(size=(len(state), water.uniforms)))
    time = rng.uniform(0.0, 300.0, len(state))
    w, theta, energy = water.spectrum.cells
    way = np.stack([np.cos(theta), np.sin(theta)], -1)[:, :count]
    for depth in (0.0, 2.0, 8.0, 20.0):
        state[:, water.down] = depth - water.depth
        below = (energy * (w * np.exp(-(w**2) / GRAVITY * depth)) ** 2).sum(0)
        exact = np.sqrt(below @ way**2)
        field = water.effect_at(drawn, time, z[:, : 2 * count], state)
        assert field.std(0) == pytest.approx(exact, rel=0.02)
        assert water.modelled.effect(z, state).std(0) == pytest.approx(exact, rel=0.04)


def test_above_the_surface_there_is_no_more_than_at_it():
    water = above("segorogeni")
    z, state, time = np.ones((1, 10)), np.zeros((1, 12)), np.ones(1)
    drawn = water.draw(np.full((1, water.uniforms), 0.3))
    state[0, water.down] = -water.depth
    at, model = water.effect_at(drawn, time, z, state), water.modelled.effect(z, state)
    state[0, water.down] = -50.0
    assert (water.effect_at(drawn, time, z, state) == at).all()
    assert (water.modelled.effect(z, state) == model).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_waves_leave_the_rest_of_the_water_unchanged(name):
    still = above(name, height=1e-9)
    cores = [
        Core(SYSTEMS[name], 3, estimator="truth", disturbance=d) for d in (still, still.beside)
    ]
    for core in cores:
        core.start(0)
        for _ in range(20):
            core.step(np.zeros((3, core.config.action_size)))
    k = still.beside.process.size
    one, other = (core.now for core in cores)
    assert (one.slow[:, :k] == other.slow[:, :k]).all()
    assert one.state == pytest.approx(other.state, abs=1e-8)
