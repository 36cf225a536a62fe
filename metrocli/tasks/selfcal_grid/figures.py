"""The figures of a result of a selfcal-grid job, by name."""

from __future__ import annotations

from metrocli.tasks.figures import POSE, adjusted
from metrocli.tasks.selfcal_grid.settings import Settings

_FIELDS = (
    "largest_machine_error.mm", "rms_machine_error.mm", "rms_artefact_error.mm", "largest_length_error.mm",
    "largest_length_error_std.mm",
)  # fmt: skip
"""Of error fields that the views determine completely"""


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures: the mounting of each view, and statistics."""
    mounting = {f"{{view}}.{name}": unit for name, unit in POSE.items()}
    statistics = ("undetermined", "noise_gain", "rejected", "critical_w", "noise.mm")
    return adjusted(mounting, (*statistics, *_FIELDS), ["mm"])
