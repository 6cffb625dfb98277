"""Draws docs/images/sea.png: a spectrum of a wind sea and a swell, and waves that episodes draw from it."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from vessel_gym.disturbances import WaveSpectrum, WaveSystem
from vessel_gym.disturbances.waves import WaveField

wind_sea = WaveSystem(height=1.5, period=6.0, direction=np.deg2rad(60.0))
swell = WaveSystem(height=1.0, period=13.0, direction=np.deg2rad(150.0), spreading=20.0)
spectrum = WaveSpectrum.of_systems(wind_sea, swell)
field = WaveField(spectrum)
waves = field.draw(np.random.default_rng(1).random((1, field.uniforms)))[0]
w, _, kx, ky = np.split(waves, 4)

frequency, directions, _ = spectrum.cells
density = spectrum.energy[:, None] * np.diff(spectrum.share) / np.diff(spectrum.edges)
around = np.append(directions, directions[0] + 2.0 * np.pi)
hertz = frequency[:, 0] / (2.0 * np.pi)

figure, axes = plt.subplots(
    figsize=(5.2, 4.4), subplot_kw={"projection": "polar"}, layout="constrained"
)
axes.set(theta_zero_location="N", theta_direction=-1, ylim=(0.0, 0.4), rlabel_position=-60.0)
levels = np.linspace(0.0, density.max(), 12)[1:]
filled = axes.contourf(
    around, hertz, np.c_[density, density[:, :1]], levels, cmap="Blues", extend="max"
)
axes.plot(np.arctan2(ky, kx), w / (2.0 * np.pi), "o", color="tab:orange", markersize=4)
axes.set_xticks(np.deg2rad([0, 90, 180, 270]), ["north", "east", "south", "west"])
axes.set_yticks([0.1, 0.2, 0.3], ["0.1 Hz", "0.2", "0.3"])
axes.grid(alpha=0.4)
figure.colorbar(filled, label="energy density [m$^2$ s / rad]", shrink=0.8, format="%.2f")
figure.savefig(Path(__file__).with_suffix(".png"), dpi=130)
