"""calibrate-camera: the lens model of a camera, from a board, from targets placed by a CMM, or from a network.

`readings` -> `build` (blocks and groups, with `starts`) -> `problem` -> adjustment of shared.images -> `report`,
with `lens_conventions`, `projection_error` and `length_errors`. `advice` and `doubts` have what the readings
cannot determine or contradict, `wrong_images` what contradicts the others; `compare` fits each lens model.
"""

from metrocli.tasks.kind import Kind, Question

KIND = Kind(
    "calibrate-camera",
    "camera model from images or observed points",
    measured=("observations", "images"),
    planned=("observations", "images"),
    described=(
        Question("images", "Images of a board, in quotes, instead of a job, which is then written.", ("PATTERN",)),
        Question("board", "The board: e.g. 'chessboard 9x6 25 mm', 'charuco 11x8 15 mm 11 mm 4x4_50'.", ("BOARD",)),
    ),
    questions=(Question("compare", "Fit each lens model and print how well it fits, without writing a result."),),
)
