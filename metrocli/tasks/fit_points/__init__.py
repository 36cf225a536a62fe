"""fit-points: points of one list laid onto those of another (best fit), and features through points."""

from metrocli.tasks.kind import Kind

KIND = Kind("fit-points", "points laid onto points (best fit), and features through points", measured=("points",))
