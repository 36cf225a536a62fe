"""Covariance of an adjustment whose readings share errors within clusters, such as the readings of one image.

The residuals of each cluster as a whole give the covariance (CR2), shrunk towards that of white noise because clusters
are few. Method: docs/algorithms/cluster-robust-covariance.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.clusters.rows import ClusterRows, numbers_of, rows_of, rows_without_members
from metrocli.adjust.clusters.sample import ClusterSample
from metrocli.adjust.schur.covariance import Covariance, shapes_of
from metrocli.adjust.schur.layout import Layout, without_elimination
from metrocli.adjust.schur.member_covariance import MemberCovariance
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index, Mask
from metrocli.errors import InputError, UndeterminedError
from metrocli.frozen import dataclass

ESTIMATED, STRUCTURED = "estimated", "structured"
FROM_RESIDUALS = (ESTIMATED, STRUCTURED)
"""Settings of a job's noise with which its size follows from the residuals; `structured` is with this covariance"""
FEWEST = 5
"""Fewest clusters from which a covariance is taken"""
MOST = 6000
"""Most unknowns whose covariance is one dense table"""


@dataclass(frozen=True)
class ClusterRobust:
    """An adjustment with the covariance that lets readings of one cluster share errors."""

    solution: Solution
    """The adjustment with this covariance; redundancies and tests belong to the original one"""
    white: Solution
    """The adjustment with the covariance for independent errors"""
    sample: ClusterSample
    layout: Layout
    """The unknowns of the sample"""

    @property
    def clusters(self) -> int:
        """Number of clusters."""
        return len(self.sample.clusters)

    def inflation(self, names: Sequence[str]) -> float:
        """Return the root mean square growth of the standard uncertainties of blocks against independent errors."""
        return growth(np.diag(self.solution.joint(names)), np.diag(self.white.joint(names)))

    def dof(self, names: Sequence[str]) -> Array:
        """Return the degrees of freedom (k,) of the variances of the free entries of blocks, as `Solution.joint`."""
        return self.sample.dof(np.concatenate([columns_of(self.layout, name) for name in names]))


def growth(variances: Array, white: Array) -> float:
    """Return the root mean square growth of standard uncertainties; 1 if there are none."""
    known = white > 0
    return float(np.sqrt(np.mean(variances[known] / white[known]))) if known.any() else 1.0


def must_suffice(count: int, over: str) -> None:
    """Raise UndeterminedError if clusters are too few; `over` is what they are, in words."""
    if count < FEWEST:
        raise UndeterminedError(
            f"noise: structured: {count} {over} are too few to find how much their readings share "
            f"errors; at least {FEWEST} are needed: take more {over}, or use `noise: estimated` "
            "(`model: estimated` beside declared parts)"
        )


def must_be_few(unknowns: int) -> None:
    """Raise InputError for more unknowns than fit into one table."""
    if unknowns > MOST:
        raise InputError(
            f"noise: structured keeps the covariance of all unknowns in one table; {unknowns} unknowns are more "
            f"than {MOST}: use `noise: estimated`, or fewer readings of fewer unknowns"
        )


@dataclass(frozen=True)
class Clusters:
    """Readings that may share errors."""

    of: Mapping[str, Index]
    """The cluster (n,) of each reading of some groups, by group; the errors of all other groups are independent"""
    over: str = "clusters"
    """What a cluster is, in words: images"""
    grows: bool = True
    """Whether errors are shared by the readings of an unknown that only one cluster uses, as by those of a pose"""
    free: bool = False
    """Whether the datum depends on unknowns that only one cluster uses"""
    first: tuple[str, ...] = ()
    """Blocks whose variances have a factor of their own, such as the lens; if none, what all clusters use"""


def cluster_robust(solution: Solution, clusters: Clusters) -> ClusterRobust:
    """Return an adjustment with the covariance that lets readings of one cluster share errors.

    No standard uncertainty is smaller than for independent errors. Raises UndeterminedError for fewer than 5 clusters,
    and InputError for more unknowns than fit into one table.
    """
    must_suffice(len(numbers_of(clusters.of)), clusters.over)
    rows = rows_without_members(solution, clusters.of)
    # members in one cluster each are eliminated as before: the covariance stays a small table for any number of them
    if rows is not None:
        layout, white = solution.covariance_or_raise().layout, _without_datum(solution)
        sample = ClusterSample.of(white, rows, _first(rows, layout, clusters), solution.dof, clusters.grows)
        robust = replace(solution, covariance=_of_members(solution, white, sample))
        return ClusterRobust(robust, solution, sample, layout)
    layout = without_elimination(solution.blocks)
    must_be_few(layout.width)
    rows = rows_of(solution, clusters.of, clusters.free)
    white = _joint(solution, layout)[np.ix_(rows.shared, rows.shared)]
    sample = ClusterSample.of(white, rows, _first(rows, layout, clusters), solution.dof, clusters.grows)
    matrix = sample.covariance()
    covariance = Covariance(layout, shapes_of(solution.blocks), matrix, MemberCovariance((0, 0), (), (), matrix))
    return ClusterRobust(replace(solution, covariance=covariance), solution, sample, layout)


def _first(rows: ClusterRows, layout: Layout, clusters: Clusters) -> Mask:
    """Return the unknowns whose variances have a factor of their own, (unknowns,)."""
    return _of_blocks(layout, clusters.first) if clusters.first else rows.common


def _change_of_datum(solution: Solution) -> Array:
    """Return A, (width, width), which removes from the reduced unknowns what the members' noise gives to the datum.

    `A = I + E_r sum H_i W_i`, with the terms of `Gauge`; the identity without inner constraints on the members.
    """
    members = solution.covariance_or_raise().eliminated
    identity = np.eye(len(members.reduced))
    if members.gauge is None:
        return identity
    constraint = members.gauge.frame.constraint(np.arange(members.shape[0]))
    return np.asarray(identity + members.gauge.reduced @ np.einsum("nsf,nsw->fw", constraint, members.weights))


def _without_datum(solution: Solution) -> Array:
    """Return the covariance of the reduced unknowns without the members' noise in the datum, (width, width)."""
    change = _change_of_datum(solution)
    known = solution.covariance_or_raise()
    return np.asarray(known.factor * change @ known.reduced @ change.T)


def _of_members(solution: Solution, white: Array, sample: ClusterSample) -> Covariance:
    """Return the covariance of an adjustment whose members each belong to one cluster.

    The members' own noise grows by one factor, also where it enters the datum: `V_r = phi (Q_r - A Q_r A') + V_A`.
    """
    known, own = solution.covariance_or_raise(), sample.own_factor
    # everything else multiplies by `factor`, so it is divided out here
    reduced = known.reduced + (sample.of_shared() / own - white) / known.factor
    members = replace(known.eliminated, reduced=reduced)
    return replace(known, reduced=reduced, eliminated=members, factor=own * known.factor)


def _joint(solution: Solution, layout: Layout) -> Array:
    """Return the covariance of all unknowns for independent errors, (unknowns, unknowns)."""
    known = solution.covariance_or_raise()
    free = {name: np.flatnonzero(columns.ravel() >= 0) for name, columns in layout.columns.items()}
    return np.concatenate(
        [np.concatenate([known.between(a, b)[np.ix_(i, j)] for b, j in free.items()], axis=1) for a, i in free.items()]
    )


def _of_blocks(layout: Layout, names: Sequence[str]) -> Mask:
    """Return which unknowns are those of some blocks, (unknowns,)."""
    mask = np.zeros(layout.width, dtype=bool)
    for name in names:
        mask[columns_of(layout, name)] = True
    return mask


def columns_of(layout: Layout, name: str) -> Index:
    """Return the numbers of the free entries of a block, row by row."""
    columns = layout.columns[name].ravel() if name in layout.columns else np.zeros(0, dtype=np.intp)
    return np.asarray(columns[columns >= 0])
