"""The turning circle of a ship of any size: a model of three metres is not given ten metres of tolerance."""

from dataclasses import dataclass, field
from typing import Any

from vessel_gym.tasks.circle_track import CircleTrack
from vessel_gym.vehicles.corvette_equations import CorvetteParameters
from vessel_gym.vehicles.files import load


@dataclass(frozen=True)
class ScaledCircle(CircleTrack, verified=True):
    """`CircleTrack` with lengths and speeds in proportion to those of the ship."""

    corvette: CorvetteParameters = field(default_factory=lambda: load("corvette", CorvetteParameters))

    def __post_init__(self) -> None:
        super().__post_init__()
        length, speed = self.ship.length / self.corvette.length, self.ship.speed / self.corvette.speed
        scaled: dict[str, Any] = {
            name: length * getattr(CircleTrack, name) for name in ("DISTANCE_TOLERANCE", "TRACK_SCALE")
        }
        scaled |= {name: speed * getattr(CircleTrack, name) for name in ("SWAY_SCALE", "SPEED_SCALE", "FLOW_SCALE")}
        x, y, psi, u, v, r = CircleTrack.prior_sd
        scaled["prior_sd"] = (length * x, length * y, psi, speed * u, speed * v, r / self.pace)
        for name, value in scaled.items():
            object.__setattr__(self, name, value)
