"""Whitened rows of an adjustment by cluster, such as the image of each reading, with the unknowns that each uses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.adjust.model.groups import LinearGroup
from metrocli.adjust.schur.layout import Layout, without_elimination
from metrocli.adjust.solution import Solution
from metrocli.adjust.sparse.nested_dissection import Sparse
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Cluster:
    """Whitened rows of one cluster."""

    columns: Index
    """Unknowns that it uses, (k,)"""
    jacobian: Array
    """(rows, k)"""
    residual: Array
    """(rows,)"""


@dataclass(frozen=True)
class ClusterRows:
    """The rows of all clusters, and those whose errors are independent."""

    width: int
    """Number of unknowns"""
    of_clusters: tuple[Cluster, ...]
    others: tuple[Cluster, ...]
    together: bool = False
    """Whether unknowns that only one cluster uses count as shared, because the datum depends on them"""

    @property
    def common(self) -> Mask:
        """The unknowns that all clusters use, (unknowns,)."""
        return np.asarray(self._counts == len(self.of_clusters))

    @property
    def shared(self) -> Mask:
        """The unknowns of more than one cluster or of other rows, (unknowns,)."""
        if self.together:
            return np.ones(self.width, dtype=bool)
        several: Mask = self._counts > 1
        for other in self.others:
            several[other.columns] = True
        return several

    @property
    def _counts(self) -> Index:
        """How many clusters use each unknown."""
        counts = np.zeros(self.width, dtype=np.intp)
        for cluster in self.of_clusters:
            counts[cluster.columns] += 1
        return counts


def rows_of(solution: Solution, clusters: Mapping[str, Index], together: bool = False) -> ClusterRows:
    """Return the rows at a solution; `clusters` has the cluster (n,) of each reading of some groups, by group."""
    layout = without_elimination(solution.blocks)
    linear = {group.name: group.linear(solution.blocks, layout.wanted) for group in solution.groups}
    of_clusters = tuple(
        _joined([_selected(linear[name], layout, np.flatnonzero(index == at)) for name, index in clusters.items()])
        for at in numbers_of(clusters)
    )
    others = tuple(
        _selected(group, layout, np.arange(group.residual.shape[1]))
        for name, group in linear.items()
        if name not in clusters
    )
    return ClusterRows(layout.width, of_clusters, others, together)


def rows_without_members(solution: Solution, clusters: Mapping[str, Index]) -> ClusterRows | None:
    """Return the rows at a solution without its eliminated block, by the unknowns of the reduced system.

    The members are removed from the rows, `J_r - J_e W`, which leaves the residuals as they are. Priors of members
    belong to the cluster of their member. Return None if a member is used by several clusters, or a reading by two.
    """
    known = solution.covariance_or_raise()
    layout, name = known.layout, known.layout.eliminated
    # a tied member shares a reading with another member, and both may lie in different clusters
    if name is None or len(layout.tied):
        return None
    of_member = _clusters_of_members(solution, clusters, name)
    if of_member is None:
        return None
    everywhere = dict(clusters)
    linear = {group.name: group.linear(solution.blocks, layout.wanted) for group in solution.groups}
    for group in solution.groups:
        if group.name not in clusters and name in group.chain.blocks:
            everywhere[group.name] = of_member[np.ravel(group.observations.index[name])]
    of_clusters, others = [], []
    for at in numbers_of(clusters):
        parts = [
            _without_member(linear[group], solution, np.flatnonzero(index == at)) for group, index in everywhere.items()
        ]
        of_clusters.append(_joined(parts))
    for name_of_group, rows in linear.items():
        if name_of_group not in everywhere:
            others.append(_selected(rows, layout, np.arange(rows.residual.shape[1])))
    return ClusterRows(layout.width, tuple(of_clusters), tuple(others), together=True)


def rows_of_table(jacobian: Sparse, residual: Array, cluster: Index) -> ClusterRows:
    """Return rows from the derivatives (rows, unknowns) and residuals (rows,); `cluster` (rows,) is -1 in others."""
    parts = {at: np.flatnonzero(cluster == at) for at in np.unique(cluster).tolist()}
    dense = {at: _dense(jacobian[rows], residual[rows]) for at, rows in parts.items()}
    of_clusters = tuple(rows for at, rows in dense.items() if at >= 0)
    return ClusterRows(int(jacobian.shape[1]), of_clusters, (dense[-1],) if -1 in dense else (), together=True)


def numbers_of(clusters: Mapping[str, Index]) -> list[int]:
    """Return the numbers of all clusters."""
    numbers: list[int] = np.unique(np.concatenate([np.unique(index) for index in clusters.values()])).tolist()
    return numbers


def _dense(jacobian: Sparse, residual: Array) -> Cluster:
    used = np.unique(jacobian.indices).astype(np.intp)
    return Cluster(used, np.asarray(jacobian[:, used].toarray()), residual)


def _clusters_of_members(solution: Solution, clusters: Mapping[str, Index], name: str) -> Index | None:
    """Return the cluster of each member of a block; None if one is used by several, or by no cluster."""
    block = solution.blocks[name]
    cluster = np.full(len(block.members), -1, dtype=np.intp)
    used = [
        (np.ravel(group.observations.index[name]), clusters[group.name])
        for group in solution.groups
        if group.name in clusters and name in group.chain.blocks
    ]
    for members, index in used:
        cluster[members] = index
    # a member of two clusters has kept the number of the last one, which differs for its other readings
    alike = all((cluster[members] == index).all() for members, index in used)
    return cluster if alike and (cluster >= 0)[block.free.any(axis=1)].all() else None


def _without_member(linear: LinearGroup, solution: Solution, rows: Index) -> Cluster:
    """Return the rows of some readings by the reduced unknowns, with the eliminated members removed."""
    known = solution.covariance_or_raise()
    weights = known.eliminated.weights
    n, width = len(rows), known.layout.width
    full = np.zeros((linear.residual.shape[0], n, width + 1))
    for touch in linear.touches:
        jacobian = touch.jacobian[:, :, rows]
        members = np.broadcast_to(touch.index, (linear.residual.shape[1],))[rows]
        if touch.block == known.layout.eliminated:
            # the member follows by -W for each unit of the reduced unknowns
            full[:, :, :-1] -= np.einsum("dsn,nsw->dnw", jacobian, weights[members])
            continue
        columns = known.layout.columns[touch.block][members]
        for i in range(columns.shape[1]):
            full[:, np.arange(n), np.where(columns[:, i] >= 0, columns[:, i], width)] += jacobian[:, i]
    residual = linear.residual[:, rows].ravel()
    return Cluster(np.arange(width), full[:, :, :-1].reshape(len(residual), width), residual)


def _selected(linear: LinearGroup, layout: Layout, rows: Index) -> Cluster:
    """Return the rows of some readings."""
    placed = [(layout.columns[touch.block][touch.index[rows]], touch.jacobian) for touch in linear.touches]
    used = np.unique(np.concatenate([columns.ravel() for columns, _ in placed])) if placed else np.zeros(0, np.intp)
    used = used[used >= 0]
    d, n = linear.residual.shape[0], len(rows)
    full = np.zeros((d, n, len(used) + 1))
    for columns, jacobian in placed:
        # fixed entries go to a column of their own, which is dropped
        at = np.where(columns >= 0, np.searchsorted(used, columns), len(used))
        for i in range(at.shape[1]):
            full[:, np.arange(n), at[:, i]] += jacobian[:, i, rows]
    return Cluster(used, full[:, :, :-1].reshape(d * n, len(used)), linear.residual[:, rows].ravel())


def _joined(parts: Sequence[Cluster]) -> Cluster:
    """Return the rows of one cluster in all groups."""
    if len(parts) == 1:
        return parts[0]
    used = np.unique(np.concatenate([part.columns for part in parts]))
    full = [np.zeros((len(part.residual), len(used))) for part in parts]
    for rows, part in zip(full, parts, strict=True):
        rows[:, np.searchsorted(used, part.columns)] = part.jacobian
    return Cluster(used, np.concatenate(full), np.concatenate([part.residual for part in parts]))
