"""align-part: pose of a part in the machine, measured by a camera in the spindle, with the camera's clamping angle."""

from metrocli.tasks.kind import Kind

KIND = Kind(
    "align-part",
    "part location and orientation in the machine (6D/7D)",
    measured=("observations", "images"),
    planned=("observations", "images"),
)
