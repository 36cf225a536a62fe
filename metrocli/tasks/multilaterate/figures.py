"""The figures of a result of a multilaterate job, by name."""

from __future__ import annotations

from metrocli.tasks.figures import adjusted
from metrocli.tasks.multilaterate.settings import Settings

_STATISTICS = ("rejected", "critical_w", "weakness", "noise_factor", "repeatability", "repeatability_std")


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures: estimates of each tracer, the scale of the air, and statistics."""
    tracer = {f"{{tracer}}.{name}": "mm" for name in ("x", "y", "z", "dead_path")} | {"{tracer}.scale": "1"}
    return adjusted(tracer | {"air.scale": "1"}, _STATISTICS, ["mm"])
