"""align-part: where a part stands in the machine, seen by a camera in the spindle whose clamping angle is found too."""

from metrocli.tasks.kind import Kind

KIND = Kind(
    "align-part",
    "part location and orientation in the machine (6D/7D)",
    measured=("observations", "images"),
    planned=("observations", "images"),
)
