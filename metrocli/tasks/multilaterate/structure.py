"""What lengths read one after the other share: the covariance over blocks of points in time."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.clusters.robust import Clusters
from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.effects.estimates import free_blocks
from metrocli.instruments import tracer as t
from metrocli.tasks.multilaterate.solve import Solved
from metrocli.tasks.shared.environment import blocks_of
from metrocli.tasks.shared.noise import POINTS_IN_TIME, NoiseFound, in_blocks, noise_found


def noise_of(solved: Solved, model: str, factor: float) -> NoiseFound:
    """Return the noise of a solved network; raises UndeterminedError for fewer than ten points if it is structured."""
    estimates = (t.TRACER, *blocks_of(solved.solution), *free_blocks(solved.network.effects))

    def clusters() -> Clusters:
        # the lengths of a point are from several tracers, whose errors are independent of each other
        free = solved.network.datum is not None
        return Clusters({solved.group.name: clusters_of(solved)}, POINTS_IN_TIME, grows=False, free=free)

    return noise_found((solved.solution, factor), model, clusters, estimates)


def clusters_of(solved: Solved) -> Index:
    """Return the block of points in time of each length used, (n,).

    All lengths of a point are in one block, so that each point belongs to one. Points follow each other by the mean
    time of their lengths, without times by the first length in the file.
    """
    observations = solved.group.observations
    point = observations.index[t.POINT]
    used, number = np.unique(point, return_inverse=True)
    return in_blocks(_order(observations.conditions.get("t"), number, len(used)))[number]


def _order(time: Array | None, number: Index, count: int) -> Array:
    """Return by what the points are in order, (count,)."""
    if time is not None:
        return np.asarray(np.bincount(number, time, count) / np.bincount(number, minlength=count))
    first = np.full(count, len(number), dtype=float)
    np.minimum.at(first, number, np.arange(len(number)))
    return first
