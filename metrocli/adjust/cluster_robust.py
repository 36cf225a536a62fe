"""Covariance of an adjustment whose readings share errors within clusters, such as the readings of one image.

The residuals of each cluster as a whole give the covariance (CR2), shrunk towards that of white noise because clusters
are few. Method: docs/algorithms/cluster-robust-covariance.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.cluster_rows import rows_of
from metrocli.adjust.cluster_sample import Sample, columns_of
from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.adjust.schur.covariance import Covariance, shapes_of
from metrocli.adjust.schur.member_covariance import MemberCovariance
from metrocli.adjust.solution import Solution
from metrocli.errors import InputError, UndeterminedError

ESTIMATED, STRUCTURED = "estimated", "structured"
FROM_RESIDUALS = (ESTIMATED, STRUCTURED)
"""Settings of a job's noise with which its size follows from the residuals; `structured` is with this covariance"""
FEWEST = 5
"""Fewest clusters from which a covariance is taken"""
_MOST = 6000
"""Most unknowns, because their covariance is one dense table"""


@dataclass(frozen=True)
class ClusterRobust:
    """An adjustment with the covariance that lets readings of one cluster share errors."""

    solution: Solution
    """The adjustment with this covariance; redundancies and tests belong to the original one"""
    white: Solution
    """The adjustment with the covariance for independent errors"""
    sample: Sample

    @property
    def clusters(self) -> int:
        """Number of clusters."""
        return len(self.sample.clusters)

    def inflation(self, names: Sequence[str]) -> float:
        """Return the root mean square growth of the standard uncertainties of blocks against independent errors."""
        grown, white = (np.diag(one.joint(names)) for one in (self.solution, self.white))
        return float(np.sqrt(np.mean(grown[white > 0] / white[white > 0]))) if (white > 0).any() else 1.0

    def dof(self, names: Sequence[str]) -> Array:
        """Return the degrees of freedom (k,) of the variances of the free entries of blocks, as `Solution.joint`."""
        layout = self.sample.layout
        return self.sample.dof(np.concatenate([columns_of(layout, name) for name in names]))


def must_suffice(count: int, over: str) -> None:
    """Raise UndeterminedError if clusters are too few; `over` is what they are, in words."""
    if count < FEWEST:
        raise UndeterminedError(
            f"noise: structured: {count} {over} are too few to find how much their readings share "
            f"errors; at least {FEWEST} are needed: take more {over}, or use `noise: estimated`"
        )


def cluster_robust(solution: Solution, clusters: Mapping[str, Index], over: str = "clusters") -> ClusterRobust:
    """Return an adjustment with the covariance that lets readings of one cluster share errors.

    `clusters` has the cluster (n,) of each reading of some groups, by the name of the group; the errors of all other
    groups (priors, conditions) are independent. `over` is what a cluster is, in words. No standard uncertainty is
    smaller than for independent errors. Raises UndeterminedError for fewer than 5 clusters, and InputError for more
    unknowns than fit into one table.
    """
    rows = rows_of(solution, clusters)
    count, width = len(rows.of_clusters), rows.layout.width
    must_suffice(count, over)
    if width > _MOST:
        raise InputError(
            f"noise: structured keeps the covariance of all unknowns in one table; {width} unknowns are more "
            f"than {_MOST}: use `noise: estimated`, or fewer readings of fewer unknowns"
        )
    sample = Sample.of(solution, rows)
    matrix = sample.covariance()
    covariance = Covariance(rows.layout, shapes_of(solution.blocks), matrix, MemberCovariance((0, 0), (), (), matrix))
    return ClusterRobust(replace(solution, covariance=covariance), solution, sample)
