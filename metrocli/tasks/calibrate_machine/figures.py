"""The figures of a result of a calibrate-machine job, by name."""

from __future__ import annotations

from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.figures import adjusted

_STATISTICS = (
    "rank", "possible_rank", "ratio", "readings", "rejected", "critical_w", "noise_factor",
    "repeatability", "repeatability_std", "lines",
)  # fmt: skip
_TRACK = (
    "track_points", "points_used", "cut_at_corners", "cut_standing", "cut_wild", "cut_off_path", "beam_breaks",
    "path_length", "condensed_points", "noise_in_cells",
)  # fmt: skip
"""Of a measurement on the fly"""


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures: squareness errors, tool vectors and statistics."""
    square, tool = dict.fromkeys(("A0Z", "B0Z", "C0Y"), "rad"), {f"{{tool}}.{axis}": "mm" for axis in "xyz"}
    return adjusted(square | tool, (*_STATISTICS, *_TRACK), ["mm", "rad"])
