"""What the readings of one pose share: the covariance over poses."""

from __future__ import annotations

from metrocli.adjust.clusters.robust import Clusters
from metrocli.effects.estimates import free_blocks
from metrocli.instruments import launch_unit as lu
from metrocli.tasks.locate_launch_unit.solve import Located
from metrocli.tasks.shared.noise import NoiseFound, noise_found


def noise_of(located: Located, model: str, factor: float) -> NoiseFound | None:
    """Return the noise of a located unit; None for methods without residuals of all readings.

    Raises UndeterminedError for fewer than five poses if it is structured.
    """
    if located.solution is None or located.problem is None:
        return None
    pose = {group.name: group.observations.index[lu.RECEIVER] for group in located.used}
    estimates = (lu.UNIT, *free_blocks(located.problem.effects))
    return noise_found((located.solution, factor), model, lambda: Clusters(pose, "poses"), estimates)
