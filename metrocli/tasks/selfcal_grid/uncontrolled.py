"""Errors that no residual of a self-calibration can show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli import units
from metrocli.table import Table
from metrocli.tasks.selfcal_grid.problem import Problem
from metrocli.tasks.shared.uncontrolled import SCALE, SCALE_WORDS, Hidden, table_of


def uncontrolled(problem: Problem) -> Table:
    """Return what machine and artefact error absorb together, and the error over the grid from a plausible size."""
    return table_of(_rows(problem))


def _rows(problem: Problem) -> Iterator[Hidden]:
    extent = problem.grid.pitch * float(np.linalg.norm(np.ptp(problem.grid.sites, axis=0)))
    if problem.scale_given:
        growth = units.parse_quantity("1.15 ppm", "ratio")
        yield Hidden(
            "temperature of the calibrated lengths (scale of both errors)",
            "0.1 K of steel (1.15 um/m)",
            growth * extent,
            "the temperature of the artefact in each view",
        )
        return
    # the gauge gives half of a common scale to the machine, the other half to the artefact
    yield Hidden(
        "pitch of the artefact (scale of the machine error over the grid)",
        SCALE_WORDS,
        SCALE / 2 * extent,
        "a calibrated length of the artefact (inputs: lengths)",
    )
