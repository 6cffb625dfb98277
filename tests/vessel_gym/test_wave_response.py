"""A hull of your own in waves: tables of its response, in the truth and in filters."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from own_environment import ROOT, packages, run_script

from vessel_gym.disturbances.spectrum import WaveSpectrum, WaveSystem
from vessel_gym.disturbances.wave_response import TabledResponse, WaveResponse
from vessel_gym.envs import SigmaCorvetteEnv
from vessel_gym.vehicles.corvette_equations import STATE, CorvetteParameters
from vessel_gym.vehicles.files import load
from vessel_gym.vehicles.seakeeping import StripTheory, encounter_frequency

SHIP = load("corvette", CorvetteParameters)
SEA = replace(
    SigmaCorvetteEnv.system.disturbances["moderate"],
    spectrum=WaveSpectrum.of_systems(WaveSystem(1.88, 8.8, 0.4)),
)
W, BETA = np.linspace(0.2, 3.0, 80), np.linspace(0.0, np.pi, 61)


def own_table(speed: Any) -> WaveResponse:
    """Response of the corvette by strip theory."""
    each = [StripTheory(SHIP).motion(W[:, None], BETA, U) for U in speed]
    return WaveResponse(W, BETA, speed, *np.moveaxis(np.stack(each, 2), -1, 0))


def random_table(seed: int = 0) -> WaveResponse:
    rng, speed = np.random.default_rng(seed), np.array([2.0, 9.0, 14.0])
    direction = np.linspace(0.0, np.pi, 10)
    parts = rng.normal(size=(2, 3, 12, 10, 3)) * np.sin(direction)[:, None]
    return WaveResponse(
        np.sort(rng.uniform(0.2, 3.0, 12)), direction, speed, *(parts[0] + 1j * parts[1])
    )


OWN = replace(SEA, response=own_table(np.linspace(5.0, 17.0, 12)))


CELLS, DIRECTIONS, ENERGY = (
    each[::k] for each, k in zip(SEA.spectrum.cells, (8, 1, 8), strict=True)
)


def rms(motion: np.ndarray) -> np.ndarray:
    """RMS of sway velocity, yaw rate and roll moment ``(3,)`` in the sea."""
    return np.sqrt((ENERGY[..., None] * np.abs(motion) ** 2).sum((0, 1)))


@pytest.mark.parametrize("speed", [7.0, 12.0, 15.4])
@pytest.mark.parametrize("tabled", [[0.0], np.linspace(5.0, 17.0, 12)], ids=["at rest", "speeds"])
def test_strip_theory_passes_through_its_own_table(tabled: Any, speed: float) -> None:
    table = TabledResponse(SHIP, own_table(tabled))
    for heading in np.deg2rad([0.0, 45.0, 100.0, 170.0, 290.0]):
        beta = DIRECTIONS - heading
        expected = rms(StripTheory(SHIP).motion(CELLS, beta, speed))
        assert rms(table.motion(CELLS, beta, speed)) == pytest.approx(expected, rel=0.01)


def test_any_table_is_reproduced_at_its_entries() -> None:
    given = random_table()
    table = TabledResponse(SHIP, given)
    for i, speed in enumerate(given.speed):
        found = table.motion(given.frequency[:, None], given.direction, speed)
        expected = np.stack([given.sway, given.yaw, given.roll], -1)[:, :, i]
        assert np.abs(found - expected).max() < 1e-9


def test_half_a_circle_is_mirrored() -> None:
    table, w = TabledResponse(SHIP, random_table()), np.linspace(0.3, 2.5, 40)[:, None]
    one, other = (table.motion(w, side * np.linspace(-7.0, 7.0, 57), 6.0) for side in (1.0, -1.0))
    assert (np.abs(one + other) <= 1e-9 * np.abs(one).max((0, 1))).all()


@pytest.mark.parametrize("speed", [1.0, 7.0, 15.4])
def test_ship_answers_each_wave_as_her_table_says(speed: float) -> None:
    """Against the sum over the waves drawn, of a table of random numbers."""
    sea, psi = replace(SEA, response=random_table()), np.linspace(-4, 4, 9)
    drawn = sea.draw(np.random.default_rng(1).uniform(size=(len(psi), sea.uniforms)))
    time, z, state = (
        np.full(len(psi), 37.0),
        np.zeros((len(psi), 4)),
        np.zeros((len(psi), len(STATE))),
    )
    state[:, 2], state[:, 3] = psi, speed
    w, phase, kx, ky = sea.waves.constants(drawn)
    beta = np.arctan2(ky, kx) - psi[:, None]
    half = 0.5 * sea.dt * encounter_frequency(w, beta, np.array(speed))
    motion = sea.hull.motion(w, beta, speed)[..., :2] * np.sinc(half / np.pi)[..., None]
    waves = motion * np.exp(1j * (phase + 37.0 * w + half))[..., None]
    expected = sea.waves.amplitude * waves.sum(1).real
    found = (sea.effect_at(drawn, time, z, state) - sea.effect(z, state))[:, [7, 0]]
    found = found / [1.0, sea.dt]
    assert (np.abs(found - expected) < 1e-3 * np.abs(expected).max(0)).all()


def test_filters_assume_the_waves_of_the_table() -> None:
    psi = np.array([0.0, 2.0])
    assert OWN.yaw_rate(psi, 15.4) == pytest.approx(SEA.yaw_rate(psi, 15.4), rel=0.01)
    assert OWN.believed.wave == pytest.approx(SEA.believed.wave, rel=0.01)
    own, expected = (np.abs(sea.modelled.loadings(psi, 12.0)).sum(0) for sea in (OWN, SEA))
    assert (np.abs(own - expected) < 0.02 * expected.max(0)).all()
    double = replace(own_table([0.0]), **{"yaw": 2.0 * own_table([0.0]).yaw})
    assert replace(SEA, response=double).input_sd[0] > 1.5 * SEA.input_sd[0]


GOOD: dict[str, Any] = dict(
    frequency=W, direction=BETA, speed=[0.0],
    **dict.fromkeys(("sway", "yaw", "roll"), np.ones((80, 61, 1), complex)),
)  # fmt: skip
WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "frequency": ({"frequency": W[::-1]}, "increase"),
    "frequency 0": ({"frequency": W - W[0]}, "from 0.001 up"),
    "a speed astern": ({"speed": [-1.0]}, "from 0 up"),
    "no speed": ({"speed": []}, "speed"),
    "degrees": ({"direction": np.rad2deg(BETA)}, "regular steps"),
    "a whole turn": ({"direction": 2.0 * BETA}, "from 0 to pi"),
    "shape": ({"sway": np.ones((61, 80, 1), complex)}, "shape"),
    "magnitudes": ({"yaw": np.ones((80, 61, 1))}, "complex"),
    "NaN": ({"roll": np.full((80, 61, 1), np.nan + 0j)}, "finite"),
    "masked": ({"roll": np.ma.masked_all((80, 61, 1), complex)}, "finite"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_table_that_is_none_is_refused(case: str) -> None:
    changes, word = WRONG[case]
    with pytest.raises(ValueError, match=word) as error:
        WaveResponse(**GOOD | changes)
    assert "\n" not in str(error.value)


def test_a_sea_refuses_a_table_without_its_waves() -> None:
    short = WaveResponse(**GOOD | {"frequency": 0.3 * W})
    with pytest.raises(ValueError, match="where the sea has energy"):
        replace(SEA, response=short)
    with pytest.raises(TypeError, match="WaveResponse"):
        replace(SEA, response=GOOD)


RECIPE = Path(__file__).with_name("with_capytaine.py")


@pytest.mark.nightly
def test_a_panel_method_agrees_with_strip_theory_at_rest() -> None:
    run_script(RECIPE, timeout=900.0)


def test_the_recipe_names_the_version_that_is_run() -> None:
    page = (ROOT / "docs/recipes/capytaine.md").read_text(encoding="utf-8")
    assert f"pip install {packages(RECIPE)[0]}`" in page
