"""locate-launch-unit: where the launch unit of an interferometer stands in the machine, and what to measure with it."""

from metrocli.tasks.kind import Kind, Question

KIND = Kind(
    "locate-launch-unit",
    "interferometer launch unit in the machine; measuring trajectories",
    measured=("poses",),
    planned=("poses",),
    questions=(
        Question("compare", "Print what each of the three methods makes of the poses, without writing a result."),
    ),
)
