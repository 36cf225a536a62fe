"""multilaterate: reflector positions from the lengths of four or more tracking interferometers.

`readings` -> `problem` -> `blunders` (robust start, wrong lengths) -> `solve` -> `uncontrolled` (mirror images)
-> `correction` of probing points -> `report`, with shared.features. `layout` and `layout_faults` judge a plan.
"""

from metrocli.tasks.kind import Kind, Question

KIND = Kind(
    "multilaterate",
    "reflector positions from length changes of 4+ tracers",
    measured=("lengths",),
    planned=("lengths", "probing"),
    result_questions=(
        Question("distance", "Print the distance of two points with its uncertainty.", ("POINT", "POINT")),
    ),
)
