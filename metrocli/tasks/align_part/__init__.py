"""align-part: pose of a part in the machine, measured by a camera in the spindle, with the camera's clamping angle.

`camera`, `spindle_poses` (of a calibrated machine, too) and `fitted_targets` are inputs with a covariance ->
`problem` (two poses of flat parts) -> adjustment of shared.images -> `fixturing` (screws, zero point, points to
gauge) -> `report`. Where no start meets the targets, `exchanged` seeks rows of the poses that are.
"""

from metrocli.tasks.kind import Kind

KIND = Kind(
    "align-part",
    "part location and orientation in the machine (6D/7D)",
    measured=("observations", "images"),
    planned=("observations", "images"),
)
