"""The figures of a result of a locate-launch-unit job, by name."""

from __future__ import annotations

from metrocli.tasks.figures import adjusted
from metrocli.tasks.locate_launch_unit.settings import Settings


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures; a method as printed has no sigma0."""
    unit = {"x": "mm", "y": "mm", "z": "mm", "gamma": "rad", "air.scale": "1"}
    return adjusted(unit, ("poses", "critical_w", "rejected", "noise_factor"), ["mm", "rad"])
