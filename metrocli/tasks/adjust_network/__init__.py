"""adjust-network: points and stations of a network of trackers, total stations, interferometers, bars and levels.

`readings` (`sightings`) -> `starts` -> `unknowns` (blocks), `groups`, `noise` -> `problem` (datum) -> `solve`
(outliers by `suspects`) -> `report` (stations by `placed`). `other_settings`: mistakes in the files that the readings
contradict.
"""

from metrocli.tasks.kind import Kind

KIND = Kind(
    "adjust-network",
    "points and stations of a network of trackers, total stations, interferometers, bars and levels",
    measured=("readings", "lengths", "bars", "heights"),
    planned=("readings", "lengths", "bars", "heights"),
)
