"""What readings of a machine share that follow each other: the covariance over lines, legs, or blocks of points."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.clusters.robust import Clusters
from metrocli.effects.estimates import free_blocks
from metrocli.instruments.machine import SQUARENESS, TOOL
from metrocli.instruments.six_dof import LINE
from metrocli.instruments.tracker import LEG
from metrocli.tasks.calibrate_machine.problem import ERROR_BLOCKS
from metrocli.tasks.calibrate_machine.solve import Solved
from metrocli.tasks.shared.noise import POINTS_IN_TIME, NoiseFound, in_blocks, noise_found


def noise_of(solved: Solved, model: str, factor: float) -> NoiseFound:
    """Return the noise of a solved calibration.

    Raises UndeterminedError for fewer than five lines or legs, or ten points, if it is structured.
    """
    blocks = solved.solution.blocks
    tools = (TOOL,) if blocks[TOOL].free.any() else ()
    delivered = tuple(name for name in ERROR_BLOCKS if blocks[name].free.any())
    estimates = (SQUARENESS, *tools, *free_blocks(solved.problem.effects))
    return noise_found((solved.solution, factor), model, lambda: clusters_of(solved), estimates, delivered)


def clusters_of(solved: Solved) -> Clusters:
    """Return which readings may share errors: those of one line (six-dof), of one leg, or of successive points."""
    readings = solved.problem.readings
    observations = readings.observations
    for block, over in ((LINE, "lines"), (LEG, "legs of the path")):
        if block in observations.index:
            return Clusters({readings.name: observations.index[block]}, over)
    order = observations.conditions.get("t", np.arange(observations.count, dtype=float))
    return Clusters({readings.name: in_blocks(order)}, POINTS_IN_TIME)
