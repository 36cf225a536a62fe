"""Errors that no residual of a camera calibration can show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli import units
from metrocli.instruments import camera
from metrocli.instruments.camera import TARGET
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.principal_point import PrincipalPoint
from metrocli.tasks.calibrate_camera.problem import Problem
from metrocli.tasks.calibrate_camera.settings import Camera
from metrocli.tasks.shared.images.adjustment import Adjusted
from metrocli.tasks.shared.images.uncontrolled import diameters
from metrocli.tasks.shared.uncontrolled import SCALE, SCALE_WORDS, Hidden, table_of

_PITCH = units.parse_quantity("0.1 percent", "ratio")
_CENTRE = units.parse_quantity("10 percent", "ratio")
_PIXEL = units.parse_quantity("0.1 percent", "ratio")


def uncontrolled(problem: Problem, settings: Camera, adjusted: Adjusted, centre: PrincipalPoint | None) -> Table:
    """Return the settings that enter the result without a residual, and the error from a plausible mistake in each."""
    return table_of(_rows(problem, settings, adjusted, centre))


def _rows(problem: Problem, settings: Camera, adjusted: Adjusted, centre: PrincipalPoint | None) -> Iterator[Hidden]:
    blocks = adjusted.solution.blocks
    lens = blocks[camera.LENS].named()
    seen = blocks[TARGET].values[np.unique(adjusted.group.observations.index[TARGET])]
    place = blocks[camera.view_name(problem.rig)].values[:, :3]
    if problem.rig == "board":
        yield Hidden(
            "pitch, or scale of the target list (distances of the board; the lens does not depend on it)",
            "0.1 %",
            _PITCH * float(np.median(np.linalg.norm(place, axis=1))),
            "the board measured over its whole length",
        )
    else:
        yield Hidden(
            "common scale of the targets (distance of the camera from them)",
            SCALE_WORDS,
            SCALE * float(np.linalg.norm(place - seen.mean(axis=0), axis=1).max()),
            "temperature and calibration of what placed the targets, or of the scale bars",
        )
    focal = float(lens.get("f", lens.get("fx", 0.0)))
    off = centre.allowed if centre is not None else _CENTRE * np.array(problem.image_size)
    if off.any():
        distance = float(np.median(np.linalg.norm(place - seen.mean(axis=0), axis=1)))
        yield Hidden(
            "image_size, whose middle is the principal point, or held cx and cy (places of the camera across its view)",
            "what the readings do not exclude" if centre is not None else "10 % of the image size",
            float(np.linalg.norm(off)) / focal * distance,
            "cx and cy among `estimate`, with views that are tilted and turned",
        )
    if settings.pixel_size is not None:
        yield Hidden(
            "pixel_size (the lens in mm; in px it does not depend on it)",
            "0.1 %",
            _PIXEL * focal * settings.pixel_size,
            "the data sheet of the sensor",
        )
    if problem.sighted.eccentric:
        yield from diameters(adjusted.group, blocks, problem.sighted.targets.radius)
