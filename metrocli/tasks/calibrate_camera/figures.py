"""The figures of a result of a calibrate-camera job, by name."""

from __future__ import annotations

from metrocli.instruments.lens import PARAMETERS, PIXELS
from metrocli.tasks.calibrate_camera.settings import Settings
from metrocli.tasks.figures import POSE, adjusted

_STATISTICS = (
    "noise", "rank", "rms_u", "rms_v", "readings", "rejected", "images", "targets", "coverage_cells", "coverage_hull",
    "coverage_radius", "sigma0_low", "sigma0_high", "condition", "image_width", "image_height", "pixel_size",
)  # fmt: skip
_LENGTHS = ("test_lengths", "length_measuring_error", "length_max_en", "length_error_over_limit")
"""Of lengths that test the network"""


def figures(settings: Settings) -> dict[str, str]:
    """Return the units of the figures; the pose is there only with rig cmm."""
    lens = {name: "px" if name in PIXELS else "1" for name in PARAMETERS}
    return adjusted(lens | POSE, (*_STATISTICS, *_LENGTHS), ["px"])
