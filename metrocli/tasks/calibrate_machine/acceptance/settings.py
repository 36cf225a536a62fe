"""Where the volume is predicted, and how certain the figures of ISO 230-2 are besides the noise."""

from __future__ import annotations

from metrocli.frozen import dataclass
from metrocli.instruments.machine import AXES
from metrocli.settings import ListOf, Whole, WithUnit, setting


@dataclass(frozen=True)
class VolumeGrid:
    """The grid on which the error of the tool is predicted over the volume."""

    grid: tuple[int, ...] | None = setting(
        ListOf(Whole(2, 50)), "points along x, y, z, and each rotary axis (default: 7, 6, 6; 5 with them)", default=None
    )
    circle: float | None = setting(
        WithUnit("length", positive=True), "radius of the circular tests (default: 0.4 of the travel)", default=None
    )

    def counts(self, axes: int = 3) -> tuple[int, ...]:
        """Return the number of points along each axis."""
        usual = (7, 6, 6) if axes == len(AXES) else (5,) * axes
        return usual if self.grid is None or len(self.grid) != axes else self.grid


@dataclass(frozen=True)
class Positioning:
    """What the figures of ISO 230-2 are uncertain by, besides the noise of the displacement."""

    scale: float = setting(
        WithUnit("ratio", minimum=0.0), "standard uncertainty of all distances in common", default=0.0
    )
    environment: float = setting(
        WithUnit("length", minimum=0.0), "range of the readings at rest over the time of a test (E_VE)", default=0.0
    )
    environment_angle: float = setting(
        WithUnit("angle", minimum=0.0), "the same of the readings about a rotary axis", default=0.0
    )
