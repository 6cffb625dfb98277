"""Spectra of seas: the energy of waves by frequency and by the direction to which they run."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimators.checks import finite_array, number, shaped_array
from vessel_gym.checks import LARGEST, all_are, check_numbers, one_of

TURN = 2.0 * np.pi
_RANGE = 0.4, 4.0
"""Lowest and highest frequency of a system of waves, in units of its peak frequency."""
_DEGREE = np.pi / 180.0
_FREQUENCY_UNITS = {"hertz": TURN, "rad/s": 1.0}
_ANGLES = {"degree": _DEGREE, "radian": 1.0}
_SENSES = {"coming from": np.pi, "going to": 0.0}
_EDGES = np.linspace(-np.pi, np.pi, 181)
"""Directions [rad], relative to the mean, between which a system's energy is tabled."""


def jonswap(
    frequency: np.ndarray, height: float, period: float, peakedness: float = 3.3
) -> np.ndarray:
    """JONSWAP spectrum [m2 s] at frequencies [rad/s], scaled to a significant ``height`` [m].

    Hasselmann et al. (1973); a peakedness of 1 gives Pierson and Moskowitz's spectrum. The
    ``period`` [s] is that of the peak.
    """
    peak = TURN / period
    width = np.where(frequency <= peak, 0.07, 0.09)
    bump = np.exp(-((frequency - peak) ** 2) / (2.0 * (width * peak) ** 2))
    shape = frequency**-5.0 * np.exp(-1.25 * (peak / frequency) ** 4) * peakedness**bump
    return shape * (height**2 / 16.0) / np.trapezoid(shape, frequency)


@dataclass(frozen=True)
class WaveSystem:
    """Waves of one origin, a wind sea or a swell: a JONSWAP spectrum spread about a direction.

    The spreading is ``"cos2"``, which is ``(2 / pi) cos^2(theta)`` within 90 degrees of the mean; a
    number s, which is in proportion to ``cos^2s(theta / 2)`` (Longuet-Higgins et al. 1963); or
    ``"long-crested"``, all waves in one direction.

    Raises:
        ValueError: for a number out of range, or an unknown spreading.
    """

    height: float  # significant wave height, m
    period: float  # peak period, s
    direction: float = 0.0  # mean direction to which the waves run, rad from north
    spreading: str | float = "cos2"
    peakedness: float = 3.3

    def __post_init__(self) -> None:
        check_numbers(
            self, not_negative="height", positive="period peakedness", direction="direction"
        )
        if isinstance(self.spreading, str):
            one_of("spreading", self.spreading, ("cos2", "long-crested"))
        else:
            number("spreading of WaveSystem", self.spreading, 0.0, 1e4, "cos2, long-crested or s")

    @property
    def frequency(self) -> np.ndarray:
        """Frequencies [rad/s] that the system has."""
        return TURN / self.period * np.linspace(*_RANGE, 1001)

    def energy(self, frequency: np.ndarray) -> np.ndarray:
        """Spectrum [m2 s] at frequencies [rad/s]."""
        own = self.frequency
        tabled = jonswap(own, self.height, self.period, self.peakedness)
        return np.interp(frequency, own, tabled, left=0.0, right=0.0)

    def share(self, direction: np.ndarray) -> np.ndarray:
        """Share of the energy that runs to directions [rad] below these, of the mean +- pi."""
        off = direction - self.direction
        turns = np.floor(off / TURN + 0.5)
        return turns + np.interp(off - TURN * turns, *self.shares)

    @cached_property
    def shares(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions [rad] relative to the mean, and the share of the energy below them."""
        if self.spreading == "long-crested":
            return np.array([-1e-9, 1e-9]), np.array([0.0, 1.0])
        if self.spreading == "cos2":
            inside = np.clip(_EDGES, -0.5 * np.pi, 0.5 * np.pi)
            return _EDGES, 0.5 + (inside + 0.5 * np.sin(2.0 * inside)) / np.pi
        fine = np.linspace(-np.pi, np.pi, 36_001)
        density = np.cos(0.5 * fine) ** (2.0 * float(self.spreading))
        below = np.append(0.0, np.cumsum(density[1:] + density[:-1]))
        return _EDGES, np.interp(_EDGES, fine, below / below[-1])


@dataclass(frozen=True, eq=False)
class WaveSpectrum:
    """Energy of a sea by frequency and direction.

    Made by `of_systems`, from parameters, or by `of_arrays`, from a spectrum that was measured or
    computed.

    Attributes:
        frequency: Increasing frequencies ``(f,)`` [rad/s].
        energy: Energy of all directions ``(f,)`` [m2 s], linear between frequencies.
        edges: Increasing directions ``(e,)`` [rad from north] over one turn.
        share: Share ``(f, e)`` of a frequency's energy that runs to directions below each edge,
            from 0 to 1; ``(1, e)`` if it is equal for all frequencies.
    """

    frequency: np.ndarray
    energy: np.ndarray
    edges: np.ndarray
    share: np.ndarray

    @classmethod
    def of_systems(cls, *systems: WaveSystem) -> "WaveSpectrum":
        """Spectrum of one or more `WaveSystem`, for example a wind sea and a swell.

        Raises:
            TypeError: for anything but systems of waves.
        """
        if not systems or not all_are(WaveSystem, systems):
            raise TypeError("of_systems takes one or more WaveSystem(height, period, ...)")
        frequency = np.unique(np.concatenate([each.frequency for each in systems]))
        energies = np.stack([each.energy(frequency) for each in systems])
        total = energies.sum(0)
        mean = _mean_direction(
            *np.transpose([(each.height**2, each.direction) for each in systems])
        )
        equal = np.full_like(energies, 1 / len(systems))
        parts = np.divide(energies, total, out=equal, where=total > 0.0)
        near = [
            mean + (each.direction + each.shares[0] - mean + np.pi) % TURN - np.pi
            for each in systems
        ]
        edges = np.unique(np.concatenate([[mean - np.pi, mean + np.pi], *near]))
        below = np.stack([each.share(edges) - each.share(edges[:1]) for each in systems])
        return cls(frequency, total, edges, below if len(systems) == 1 else parts.T @ below)

    @classmethod
    def of_arrays(
        cls,
        frequency: np.ndarray,
        direction: np.ndarray,
        density: np.ndarray,
        *,
        frequency_unit: str,
        direction_unit: str,
        per: str,
        directions: str,
    ) -> "WaveSpectrum":
        """Spectrum of a density over frequency and direction.

        Units and senses have no defaults, for every program has its own. A direction is taken to
        stand for the bin between the middles to its neighbours.

        Args:
            frequency: Increasing frequencies ``(f,)``.
            direction: Directions ``(d,)`` from north to east, at regular steps around the circle.
            density: Energy density ``(f, d)`` [m2 by units of frequency and angle].
            frequency_unit: ``"hertz"`` or ``"rad/s"``, of ``frequency`` and in ``density``.
            direction_unit: ``"degree"`` or ``"radian"``, of ``direction``.
            per: ``"degree"`` or ``"radian"``, in ``density``.
            directions: ``"coming from"`` or ``"going to"``, what ``direction`` says of the waves.

        Raises:
            ValueError: for an unknown word, frequencies that do not increase or leave a gap,
                directions that do not go once around the circle in regular steps, densities that
                are negative or not finite, or a spectrum without energy.
        """
        unit = _FREQUENCY_UNITS[one_of("frequency_unit", frequency_unit, _FREQUENCY_UNITS)]
        angle = _ANGLES[one_of("direction_unit", direction_unit, _ANGLES)]
        per_radian = 1.0 / _ANGLES[one_of("unit of an angle in per", per, _ANGLES)]
        turned = _SENSES[one_of("sense of directions", directions, _SENSES)]
        w = _frequencies(frequency) * unit
        toward, order = _around(finite_array("direction", direction, "d") * angle + turned)
        density = _densities(density, (len(w), len(toward)))[:, order]
        bins = 0.5 * (np.append(toward[1:], toward[0] + TURN) + toward)
        widths = np.diff(bins, prepend=bins[-1] - TURN)
        cells = density / unit * per_radian * widths
        mean = _mean_direction(np.trapezoid(cells, w, axis=0), toward)
        first = np.argmin(np.abs((bins - mean) % TURN - np.pi))  # the edge opposite to the mean
        edges = np.append(bins[first], bins[first] + np.cumsum(np.roll(widths, -first - 1)))
        return cls(w, cells.sum(1), edges, _shares(np.roll(cells, -first - 1, axis=1)))

    @cached_property
    def cells(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Frequencies ``(f, 1)`` [rad/s], directions ``(d,)`` [rad], energies ``(f, d)`` [m2]."""
        steps = np.diff(self.frequency)
        weights = 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps))
        energy = (weights * self.energy)[:, None] * np.diff(self.share)
        return self.frequency[:, None], 0.5 * (self.edges[1:] + self.edges[:-1]), energy

    @cached_property
    def height(self) -> float:
        """Significant wave height [m], four times the root of the energy."""
        return float(4.0 * np.sqrt(self.below[-1]))

    @cached_property
    def period(self) -> float:
        """Period [s] of the frequency with most energy."""
        return float(TURN / self.frequency[self.energy.argmax()])

    @cached_property
    def direction(self) -> float:
        """Mean direction [rad from north] to which the waves run, weighted by energy."""
        _, directions, energy = self.cells
        return _mean_direction(energy.sum(0), directions)

    @cached_property
    def below(self) -> np.ndarray:
        """Energy ``(f,)`` [m2] at lower frequencies than each."""
        steps = np.diff(self.frequency) * (self.energy[1:] + self.energy[:-1]) / 2.0
        return np.append(0.0, np.cumsum(steps))

    def frequency_at(self, share: np.ndarray) -> np.ndarray:
        """Frequency [rad/s] below which a share ``(...)`` of the energy lies."""
        first, last = np.flatnonzero(np.diff(self.below) > 0.0)[[0, -1]]
        inside = slice(first, last + 2)  # not at frequencies without energy at the ends
        return np.interp(
            np.multiply(share, self.below[-1]), self.below[inside], self.frequency[inside]
        )

    def directions_at(self, frequency: float, share: np.ndarray) -> np.ndarray:
        """Direction [rad] below which a share ``(...)`` of the energy of a frequency runs."""
        place = np.interp(frequency, self.frequency, np.arange(len(self.frequency)))
        i = min(int(place), len(self.frequency) - 2)
        shares = np.broadcast_to(self.share, (len(self.frequency), len(self.edges)))[i : i + 2]
        weights = self.energy[i : i + 2] * [1.0 - (place - i), place - i]
        below = weights @ shares / weights.sum() if weights.any() else shares[0]
        inside = np.clip(share, 1e-9, 1.0 - 1e-9)  # not in directions without energy at the ends
        return np.interp(inside, below, self.edges)


def _frequencies(frequency: object) -> np.ndarray:
    """Increasing frequencies, none of whose steps is far larger than both of its neighbours."""
    values = finite_array("frequency of a spectrum", frequency, "f")
    steps = np.diff(values)
    if not len(steps) or not values[0] > 0.0 or not (steps > 0.0).all():
        raise ValueError(
            "frequency of a spectrum must be two or more numbers above 0 that increase"
        )
    beside = np.pad(steps, 1)
    gaps = np.flatnonzero(steps > 2.5 * np.maximum(beside[2:], beside[:-2]))
    if len(steps) > 1 and len(gaps):
        low, high = values[gaps[0] : gaps[0] + 2]
        raise ValueError(
            f"frequency of a spectrum has a gap from {low:.4g} to {high:.4g}: give densities there,"
            " 0 where there is no energy"
        )
    return values


def _around(toward: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions in [0, 2 pi) in order, and their places in what was given."""
    if len(toward) < 4 or np.ptp(toward) > 1.001 * TURN:
        raise ValueError(
            "directions of a spectrum must be four or more within one turn: is direction_unit"
            " right?"
        )
    toward = np.round(toward % TURN, 9) % np.round(TURN, 9)
    directions, order = np.unique(toward, return_index=True)
    steps = np.diff(np.append(directions, directions[0] + TURN))
    if len(directions) < len(toward):
        raise ValueError(
            "directions of a spectrum must differ; 0 and a whole turn are one direction: leave out"
            " one of them"
        )
    if steps.max() > 1.5 * np.median(steps):
        i = int(steps.argmax())
        raise ValueError(
            "directions of a spectrum must cover the circle in regular steps; from"
            f" {directions[i] / _DEGREE:.4g} degrees on, {steps[i] / _DEGREE:.4g} degrees lack one"
        )
    return directions, order


def _densities(density: object, shape: tuple[int, int]) -> np.ndarray:
    values = shaped_array("density of a spectrum (frequencies by directions)", density, *shape)
    if not ((values >= 0.0) & (values < LARGEST)).all():
        raise ValueError(
            "density of a spectrum must be finite and not negative: set 0 where there is no energy"
        )
    if not values.any():
        raise ValueError("density of a spectrum must have energy, but all of it is 0")
    return values


def _shares(cells: np.ndarray) -> np.ndarray:
    """Cumulative shares ``(f, d + 1)`` of energies; those of all where a frequency has none."""
    total = cells.sum(1, keepdims=True)
    of_all = np.full_like(cells, cells.sum(0) / cells.sum())
    shares = np.divide(cells, total, out=of_all, where=total > 0.0)
    return np.pad(np.cumsum(shares, axis=1), ((0, 0), (1, 0)))


def _mean_direction(energy: np.ndarray, direction: np.ndarray) -> float:
    """Direction of the mean of unit vectors."""
    return float(np.angle((energy * np.exp(1j * direction)).sum() or 1.0))
