"""Errors that no residual of an alignment can show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli import units
from metrocli.instruments import spindle_camera as spindle
from metrocli.table import Table
from metrocli.tasks.align_part.problem import Problem
from metrocli.tasks.shared.images.adjustment import Adjusted
from metrocli.tasks.shared.images.uncontrolled import diameters
from metrocli.tasks.shared.uncontrolled import SCALE, SCALE_WORDS, Hidden, table_of

_SEAT = units.parse_quantity("5 um", "length")


def uncontrolled(problem: Problem, adjusted: Adjusted) -> Table:
    """Return what the pose of the part absorbs, and the error from a plausible size of each cause."""
    return table_of(_rows(problem, adjusted))


def _rows(problem: Problem, adjusted: Adjusted) -> Iterator[Hidden]:
    blocks = adjusted.solution.blocks
    used = adjusted.group.observations.index
    held = blocks[spindle.SPINDLE].values[np.unique(used[spindle.SPINDLE]), :3]
    extent = float(np.linalg.norm(np.ptp(held, axis=0)))
    yield Hidden(
        "common scale of the machine and of the target list (places of points)",
        SCALE_WORDS,
        SCALE * extent,
        "temperature of machine and part; calibrated lengths on both",
    )
    yield Hidden(
        "seat of the camera along the spindle (the part along the view)",
        "5 um",
        _SEAT,
        "a target of known place in the machine",
    )
    if problem.sighted.eccentric:
        yield from diameters(adjusted.group, blocks, problem.sighted.targets.radius)
