"""locate-launch-unit: place of an interferometer's launch unit in the machine, and plan of its measuring lines.

`readings` -> `problem` -> `solve` (three methods; what is mislabelled where nothing fits) -> `report`. A plan: `lines`
through the unit -> `margin` (is the beam in range, which poses would help) -> their programs.
"""

from metrocli.tasks.kind import Kind, Question

KIND = Kind(
    "locate-launch-unit",
    "interferometer launch unit in the machine; measuring trajectories",
    measured=("poses",),
    planned=("poses",),
    questions=(
        Question("compare", "Print the result of each of the three methods for these poses, without writing a file."),
    ),
)
