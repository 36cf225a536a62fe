"""calibrate-machine: the 21 geometric errors of a machine, from a tracker, from lengths, or from a 6-DoF laser.

`files` -> one of `methods` -> `problem` (machine, tools, knots) -> `rank` (what the readings determine)
-> `solve` -> `tables` and `volume` -> `report` with `warnings`, `volume_report`, `iso230` and `acceptance`. `plans`
proposes measurements, `truth` and `simulation` make them, `other_settings` tries other chains and tools.
"""

from metrocli.tasks.kind import Kind

KIND = Kind(
    "calibrate-machine",
    "geometric errors of a 3-axis machine from a tracker, lengths or 6-DoF data",
    measured=("points", "track", "lines", "lengths", "probing"),
    planned=("points", "path", "track", "lines", "lengths", "probing", "balls"),
)
