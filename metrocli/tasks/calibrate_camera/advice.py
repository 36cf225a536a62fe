"""Why a camera calibration is undetermined or doubtful, and what would help."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.solution import Solution
from metrocli.effects.estimates import absorbed_in_words
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments.camera_start import plane_frame
from metrocli.instruments.lenses.conventions import projection_range
from metrocli.instruments.lenses.distortion import RADIAL, RATIONAL
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.shared.images.adjustment import AdjustedImages
from metrocli.tasks.shared.images.camera_parameters import HIGH_CORRELATION
from metrocli.words import counted

_PARALLEL = np.radians(3.0)
_TURNED = np.radians(45.0)
"""Turn about the viewing axis between any two images from which an unknown board and the lens are distinguished"""
_SHOWN = 4
"""Most targets whose rejected readings are counted in a message"""


def explained(problem: CameraProblem, solution: Solution, rejected: Table, strange: Sequence[str]) -> str:
    """Return the message of an undetermined calibration: which parameters, why, and what would determine them.

    `rejected` are the readings that were left out as outliers before, `strange` states those that spoil the others.
    """
    lines = [f"{solution.outcome.value}: {solution.observations} readings, {solution.unknowns} unknowns"]
    lines += [f"  undetermined: {in_words(str(combination))}" for combination in solution.undetermined[:3]]
    if len(solution.undetermined) > 3:
        lines.append(f"  and {len(solution.undetermined) - 3} more combinations")
    advice = [] if strange else _advice(problem, solution)
    noticed = [f"  noticed: {line}" for line in [*strange, *problem.sighted.warnings][:8]]
    return "\n".join([*lines, *advice, *_left_out(rejected), *noticed])


def _left_out(rejected: Table) -> list[str]:
    """Return how many readings were left out as outliers, and of which targets the most; nothing if there are none."""
    if not len(rejected):
        return []
    of = ", ".join(f"{number} of {name}" for name, number in Counter(rejected.texts("target")).most_common(_SHOWN))
    left = counted(len(rejected), "reading")
    return [f"  noticed: {left} left out as outliers, the most {of}; `outliers: report` keeps them"]


def in_words(text: str) -> str:
    """Leave out the names of internal blocks."""
    return (
        text.replace(f" of {camera.LENS}", "")
        .replace(f" of {camera.VIEW} ", " of ")
        .replace(f" of {camera.TARGET} ", " of ")
        .replace(f" of {camera.MOUNT} ", " of ")
    )


def _advice(problem: CameraProblem, solution: Solution) -> list[str]:
    columns = {
        column
        for combination in solution.undetermined
        for block, column, _, _ in combination.parts
        if block == camera.LENS
    }
    if hidden := absorbed_in_words(problem.effects, solution, problem.datum):
        return hidden
    if flat := _flat(problem):
        return flat
    radius = _pole(problem, solution)
    if radius is not None and (columns & set(RATIONAL) or not columns):
        return [
            f"  why: the rational terms fit noise and give the lens model a pole at {radius:.0f} px "
            "from the principal point",
            "  what would determine it: fewer distortion parameters "
            "(metrocli calibrate-camera --compare shows which help)",
        ]
    if columns & {"cx", "cy"}:
        return [
            "  what would determine it: a tilted target, and the camera turned by 90 degrees about its viewing axis"
        ]
    if solution.outcome is Outcome.TOO_FEW:
        return ["  what would determine it: more images, more targets, or fewer parameters in `camera: estimate`"]
    return [
        "  what would determine it: more images from different directions and distances, "
        "or fewer parameters in `camera: estimate`"
    ]


def ran_out(problem: CameraProblem, solution: Solution) -> bool:
    """Return whether the iteration limit was reached because of a pole of the lens model or targets without depth."""
    return solution.outcome is Outcome.ITERATION_LIMIT and bool(_pole(problem, solution) or _flat(problem))


def _flat(problem: CameraProblem) -> list[str]:
    """Return why the targets have no depth and what would give them some; an empty list if they have depth.

    On a board all views are parallel to it; with rig cmm all targets lie in one plane.
    """
    if problem.rig == "board" and not _tilted(problem):
        return [
            "  why: all views are parallel to the board, or nearly so",
            "  what would determine it: views tilted by 20 to 45 degrees about both axes of the image",
        ]
    if problem.rig == "cmm" and plane_frame(problem.sighted.targets.points[np.unique(problem.sighted.target)])[1]:
        return [
            "  why: all targets lie in one plane",
            "  what would determine it: targets at several distances along the camera's viewing axis",
        ]
    return []


def _pole(problem: CameraProblem, solution: Solution) -> float | None:
    """Return the radius [px] at which estimated rational terms fold the lens model over inside the image, else None."""
    lens = solution.blocks[camera.LENS]
    if problem.convention != "forward" or not lens.free[0, np.isin(lens.columns, RATIONAL)].any():
        return None
    return projection_range(lens.named(), problem.image_size)


def _tilted(problem: CameraProblem) -> bool:
    """Return whether the viewing axis of any image is more than 3 degrees from the normal of the board.

    True as well if the targets are not in one plane.
    """
    frame, planar = plane_frame(problem.sighted.targets.points[np.unique(problem.sighted.target)])
    if not planar:
        return True
    normal = poses.rotation_of(frame)[2]
    cosine = np.abs(poses.rotation_of(problem.blocks[camera.VIEW].values)[:, 2] @ normal)
    return bool((np.arccos(np.clip(cosine, -1, 1)) > _PARALLEL).any())


def turned_too_little(problem: CameraProblem) -> list[str]:
    """Return that the images of an unknown board are not turned, where the principal point is estimated with it.

    A board that lies the same way round in all images has its errors where the lens has its own. Several solutions
    then fit about equally well (docs/decisions/145-turned-views.md).
    """
    lens = problem.blocks[camera.LENS]
    if problem.rig != "board" or problem.datum is None or not lens.free[0, np.isin(lens.columns, ("cx", "cy"))].any():
        return []
    # an axis of the list may be the normal of the board: the longest axis of the board is in its plane
    along = poses.rotation_of(plane_frame(problem.sighted.targets.points[np.unique(problem.sighted.target)])[0])[0]
    across = poses.rotation_of(problem.blocks[camera.VIEW].values) @ along
    roll = np.sort(np.arctan2(across[:, 1], across[:, 0]))
    # the arc that holds all of them is a turn without the largest gap
    turn = 2 * np.pi - float(np.diff(roll, append=roll[0] + 2 * np.pi).max())
    if turn >= _TURNED:
        return []
    return [
        f"the camera is turned by at most {np.degrees(turn):.0f} degrees about its viewing axis between images. "
        "Errors of lens and board look alike then, and cx and cy can be off by more than their uncertainty. "
        "Turn it by 90 degrees for some images, or use `targets: listed`"
    ]


def unfolded(lens: Block, member: int = 0) -> str:
    """Return what helps against a lens model that folds over, by its free radial terms: one alone must fold."""
    free = [
        name for name, of in zip(lens.columns, lens.free[member], strict=True) if of and name in (*RADIAL, *RATIONAL)
    ]
    several = "use fewer distortion parameters"
    return several if len(free) > 1 else "estimate further radial terms (k1, k2, k3), or correct those that are held"


def folds(problem: CameraProblem, adjusted: AdjustedImages) -> Iterator[tuple[str, bool]]:
    """Yield where the lens model folds over inside the image, and whether there are readings so far out."""
    lens, fisheye = adjusted.solution.blocks[camera.LENS].named(), problem.convention == "fisheye"
    fold = None if problem.convention == "backward" else projection_range(lens, problem.image_size, fisheye)
    if fold is not None:
        u, v = adjusted.group.observations.readings
        yield (
            f"the lens model folds over at {fold:.0f} px from the principal point, inside the image; "
            f"{unfolded(adjusted.solution.blocks[camera.LENS])}",
            bool(np.hypot(u - lens["cx"], v - lens["cy"]).max() >= fold),
        )


def correlation_warnings(table: Table) -> list[str]:
    """Return a warning of parameters that are highly correlated."""
    rows = zip(table.texts("first"), table.texts("second"), table.numbers("correlation"), strict=True)
    pairs = ", ".join(f"{a}-{b} {c:+.3f}" for a, b, c in rows)
    return [f"correlations above {HIGH_CORRELATION}: {pairs}"] if pairs else []
