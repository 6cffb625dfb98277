"""Spectra of seas: by systems of waves, and by arrays in any units."""

from typing import Any

import numpy as np
import pytest

from vessel_gym.disturbances.spectrum import WaveSpectrum, WaveSystem, jonswap
from vessel_gym.disturbances.waves import WaveField
from vessel_gym.vehicles.vehicle import GRAVITY

DEG, TURN = np.pi / 180.0, 2.0 * np.pi
WIND_SEA, SWELL = WaveSystem(1.5, 6.0, 0.5), WaveSystem(1.0, 13.0, 2.6, spreading=20.0)
BOTH = WaveSpectrum.of_systems(WIND_SEA, SWELL)


def density(w: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Energy of `BOTH` [m2 s/rad] to directions theta ``(f, d)``."""
    parts = []
    for each in (WIND_SEA, SWELL):
        off = (theta - each.direction + np.pi) % TURN - np.pi
        if each.spreading == "cos2":
            spread = np.where(np.abs(off) < np.pi / 2, np.cos(off) ** 2, 0.0)
        else:
            spread = np.cos(0.5 * off) ** (2.0 * float(each.spreading))
        spread = spread / (spread.sum() * TURN / len(theta))
        parts.append(each.energy(w)[:, None] * spread)
    return np.sum(parts, 0)


W, THETA = np.linspace(0.18, 4.3, 700), TURN / 180.0 * np.arange(180.0)
DENSITY = density(W, THETA)


def test_systems_of_waves_add_their_energies() -> None:
    assert BOTH.height == pytest.approx(np.hypot(1.5, 1.0), rel=1e-3)
    assert BOTH.period == pytest.approx(6.0, rel=0.01)
    swell = WaveSpectrum.of_systems(SWELL)
    assert swell.direction == pytest.approx(2.6, abs=1e-6)


@pytest.mark.parametrize("frequency_unit", ["hertz", "rad/s"])
@pytest.mark.parametrize("direction_unit", ["degree", "radian"])
@pytest.mark.parametrize("per", ["degree", "radian"])
@pytest.mark.parametrize("directions", ["coming from", "going to"])
def test_one_sea_in_any_units_is_one_spectrum(
    frequency_unit: str, direction_unit: str, per: str, directions: str
) -> None:
    f, d, values, order = W, THETA, DENSITY, np.roll(np.arange(180), 70)
    if frequency_unit == "hertz":
        f, values = f / TURN, values * TURN
    if directions == "coming from":
        d = d + np.pi
    if direction_unit == "degree":
        d = np.rad2deg(d)
    if per == "degree":
        values = values * DEG
    words: Any = dict(
        frequency_unit=frequency_unit, direction_unit=direction_unit, per=per, directions=directions
    )
    found = WaveSpectrum.of_arrays(f, d[order], values[:, order], **words)
    assert found.height == pytest.approx(BOTH.height, rel=0.01)
    assert found.direction == pytest.approx(BOTH.direction, abs=0.01)
    w = found.frequency_at(np.array([0.2, 0.5, 0.9]))
    assert w == pytest.approx(BOTH.frequency_at(np.array([0.2, 0.5, 0.9])), rel=0.01)
    share = np.array([0.1, 0.4, 0.9])
    for each in w:
        off = np.exp(1j * (found.directions_at(each, share) - BOTH.directions_at(each, share)))
        assert np.abs(np.angle(off)).max() < 0.04


def test_drawn_waves_have_the_energy_of_each_band() -> None:
    """Two peaks in ten bands of equal energy by frequency, and in ten by direction: within 5 %.

    Frequencies are stratified; by direction 24,000 draws are binomial: 5 deviations are 5 % of .1.
    """
    field = WaveField(BOTH)
    drawn = field.draw(np.random.default_rng(0).uniform(size=(2000, field.uniforms)))
    w, _, kx, ky = field.constants(drawn)
    edges = BOTH.frequency_at(np.linspace(0.0, 1.0, 11))
    assert np.histogram(w, edges)[0] / w.size == pytest.approx(0.1, rel=0.05)
    _, _, energy = BOTH.cells
    below = np.append(0.0, energy.sum(0).cumsum()) / energy.sum()
    edges = np.interp(np.linspace(0.0, 1.0, 11), below, BOTH.edges)
    toward = (np.arctan2(ky, kx) - BOTH.edges[0]) % TURN + BOTH.edges[0]
    assert np.histogram(toward, edges)[0] / w.size == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize("spectrum", [BOTH, WaveSpectrum.of_systems(WIND_SEA)])
def test_drawn_waves_have_the_covariances_of_the_spectrum(spectrum: WaveSpectrum) -> None:
    """Elevations up to a minute or 50 m apart: over 48,000 waves .02 is six standard errors."""
    field = WaveField(spectrum)
    drawn = field.draw(np.random.default_rng(1).uniform(size=(2000, field.uniforms)))
    w, _, kx, ky = field.constants(drawn)
    each, theta, energy = spectrum.cells
    k = each**2 / GRAVITY
    for time, north, east in ((9, 0, 0), (60, 0, 0), (0, 50, 0), (0, 0, 50), (5, 30, -40)):
        found = np.cos(w * time - kx * north - ky * east).mean()
        phase = each * time - k * (np.cos(theta) * north + np.sin(theta) * east)
        expected = (energy * np.cos(phase)).sum() / energy.sum()
        assert found == pytest.approx(expected, abs=0.02)


GOOD: dict[str, Any] = dict(
    frequency=W, direction=THETA, density=DENSITY, frequency_unit="rad/s", direction_unit="radian",
    per="radian", directions="going to",
)  # fmt: skip


def drawn(spectrum: WaveSpectrum) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [rad/s] and directions [rad] of 24,000 waves."""
    field = WaveField(spectrum)
    waves = field.draw(np.random.default_rng(2).uniform(size=(1000, field.uniforms)))
    w, _, kx, ky = field.constants(waves)
    return w, np.arctan2(ky, kx)


def test_no_wave_is_drawn_where_the_spectrum_is_zero() -> None:
    """Zeros above the last frequency, and between a swell and a wind sea across it."""
    inside = (W > 0.35) & (W < 0.6), (W > 1.0) & (W < 2.0)
    toward = np.deg2rad([100.0, 190.0])[:, None]
    near = np.abs((THETA - toward + np.pi) % TURN - np.pi) < np.deg2rad(15.0)
    crossing = inside[0][:, None] * near[0] + 0.3 * inside[1][:, None] * near[1]
    w, theta = drawn(WaveSpectrum.of_arrays(**GOOD | {"density": crossing}))
    step = W[1] - W[0]
    assert w.min() > 0.35 - step
    assert w.max() < 2.0 + step
    for some, way in ((w < 0.65, toward[0]), (w > 0.95, toward[1])):
        off = np.abs((theta[some] - way + np.pi) % TURN - np.pi)
        assert (off < np.deg2rad(18.0)).mean() > 0.995


def test_two_long_crested_systems_have_two_directions() -> None:
    ways = 0.0, 0.5 * np.pi
    systems = [WaveSystem(1.0, 8.0, way, "long-crested") for way in ways]
    _, theta = drawn(WaveSpectrum.of_systems(*systems))
    off = np.abs(theta[..., None] - ways)
    assert off.min(-1).max() < 1e-6
    assert (off[..., 0] < 1e-6).mean() == pytest.approx(0.5, abs=0.01)


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "unit": ({"frequency_unit": "Hz"}, "hertz"),
    "unit of direction": ({"direction_unit": "deg"}, "degree"),
    "density's unit": ({"per": "rad"}, "radian"),
    "sense": ({"directions": "from"}, "coming from"),
    "degrees for radians": ({"direction": np.rad2deg(THETA[::18]), "density": DENSITY[:, ::18]}, "one turn"),
    "no directions": ({"direction": [], "density": DENSITY[:, :0]}, "four or more"),
    "a missing direction": (
        {"direction": np.delete(THETA, 7), "density": np.delete(DENSITY, 7, 1)}, "cover the circle",
    ),
    "0 and 360 degrees": (
        {"direction": np.append(THETA, TURN), "density": DENSITY[:, [*range(180), 0]]},
        "leave out one",
    ),
    "a gap": (
        {"frequency": np.delete(W, slice(200, 210)), "density": np.delete(DENSITY, slice(200, 210), 0)},
        "gap from",
    ),
    "frequency 0": ({"frequency": W - W[0]}, "above 0"),
    "shape": ({"density": DENSITY.T}, "shape"),
    "NaN": ({"density": DENSITY * np.where(W > 4.0, np.nan, 1.0)[:, None]}, "finite"),
    "masked": ({"density": np.ma.masked_greater(DENSITY, 0.1)}, "finite"),
    "complex": ({"density": DENSITY + 0j}, "density"),
    "negative": ({"density": DENSITY - 1.0}, "negative"),
    "nothing": ({"density": 0.0 * DENSITY}, "energy"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_spectrum_that_is_none_is_refused(case: str) -> None:
    changes, word = WRONG[case]
    with pytest.raises(ValueError, match=word) as error:
        WaveSpectrum.of_arrays(**GOOD | changes)
    assert "\n" not in str(error.value)


def test_a_spectrum_has_its_significant_height_and_peak() -> None:
    w = np.linspace(0.2, 6.0, 20_000)
    spectrum = jonswap(w, 3.25, 9.7)
    assert 4.0 * np.sqrt(np.trapezoid(spectrum, w)) == pytest.approx(3.25, rel=1e-12)
    assert w[spectrum.argmax()] == pytest.approx(2.0 * np.pi / 9.7, rel=1e-3)
