"""adjust-network: points and stations of a network of trackers, total stations, interferometers, bars and levels."""

from metrocli.tasks.kind import Kind

KIND = Kind(
    "adjust-network",
    "points and stations of a network of trackers, total stations, interferometers, bars and levels",
    measured=("readings", "lengths", "bars", "heights"),
    planned=("readings", "lengths", "bars", "heights"),
)
