"""calibrate-machine: the 21 geometric errors of a machine with three linear axes, from a tracker or a 6-DoF laser."""

from metrocli.tasks.kind import Kind

KIND = Kind(
    "calibrate-machine",
    "geometric errors of a 3-axis machine from tracker or 6-DoF data",
    measured=("points", "track", "lines"),
    planned=("points", "path", "track", "lines"),
)
