"""A kind of job for the tests of the house: a straight line through readings, small enough to check by hand."""

from metrocli.tasks.kind import Kind, Question

KIND = Kind(
    "straight-line",
    "a straight line through readings",
    measured=("readings",),
    planned=("readings",),
    questions=(Question("compare", "Compare models."),),
    package="straight_line",
)
