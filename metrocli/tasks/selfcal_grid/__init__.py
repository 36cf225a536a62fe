"""selfcal-grid: errors of a machine and of an artefact from views of a ball grid that nobody calibrated.

`readings` -> `mountings` (was each view as declared) -> `problem` -> `determination` (what the views leave open)
-> `solve` -> `error_map` (between the sites), `lengths` -> `report` with `warnings`. `sequence` is the published
method.
"""

from metrocli.tasks.kind import Kind, Question

KIND = Kind(
    "selfcal-grid",
    "machine and artefact errors from views of an uncalibrated ball grid",
    measured=("views",),
    planned=("views",),
    questions=(
        Question(
            "compare", "Compare the joint adjustment with the paper's sequence of fits; print both, write no result."
        ),
    ),
    result_questions=(
        Question("at", "Print the machine error at a point, such as '10 mm' '0 mm' '-32.5 mm'.", ("X", "Y", "Z")),
    ),
)
