"""Errors that no residual of a camera calibration can show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli import units
from metrocli.instruments import camera
from metrocli.instruments.camera import TARGET
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.problem import Problem
from metrocli.tasks.calibrate_camera.settings import Camera
from metrocli.tasks.shared.images.adjustment import Adjusted
from metrocli.tasks.shared.images.uncontrolled import diameters
from metrocli.tasks.shared.uncontrolled import SCALE, SCALE_WORDS, Hidden, table_of

_PITCH = units.parse_quantity("0.1 percent", "ratio")
_PIXEL = units.parse_quantity("0.1 percent", "ratio")


def uncontrolled(problem: Problem, settings: Camera, adjusted: Adjusted) -> Table:
    """Return the settings that enter the result without a residual, and the error from a plausible mistake in each."""
    return table_of(_rows(problem, settings, adjusted))


def _rows(problem: Problem, settings: Camera, adjusted: Adjusted) -> Iterator[Hidden]:
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
    if settings.pixel_size is not None:
        focal = float(lens.get("f", lens.get("fx", 0.0)))
        yield Hidden(
            "pixel_size (the lens in mm; in px it does not depend on it)",
            "0.1 %",
            _PIXEL * focal * settings.pixel_size,
            "the data sheet of the sensor",
        )
    if problem.sighted.eccentric:
        yield from diameters(adjusted.group, blocks, problem.sighted.targets.radius)
