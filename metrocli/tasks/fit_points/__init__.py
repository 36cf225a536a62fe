"""fit-points: points of one list laid onto those of another (best fit)."""

from metrocli.tasks.kind import Kind

KIND = Kind(
    "fit-points", "points laid onto points of the same names (best fit of 6 or 7 parameters)", measured=("points",)
)
