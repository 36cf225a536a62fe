"""Whitened rows of an adjustment by cluster, such as the image of each reading, with the unknowns that each uses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.groups import Linear
from metrocli.adjust.model.observations import Index, Mask
from metrocli.adjust.schur.layout import Layout, without_elimination
from metrocli.adjust.solution import Solution


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
class Rows:
    """The rows of all clusters, and those whose errors are independent."""

    layout: Layout
    of_clusters: tuple[Cluster, ...]
    others: tuple[Cluster, ...]

    @property
    def common(self) -> Mask:
        """The unknowns that all clusters use, (unknowns,)."""
        return np.asarray(self._counts == len(self.of_clusters))

    @property
    def shared(self) -> Mask:
        """The unknowns of more than one cluster or of other rows, (unknowns,)."""
        found: Mask = self._counts > 1
        for one in self.others:
            found[one.columns] = True
        return found

    @property
    def _counts(self) -> Index:
        """How many clusters use each unknown."""
        counts = np.zeros(self.layout.width, dtype=np.intp)
        for one in self.of_clusters:
            counts[one.columns] += 1
        return counts


def rows_of(solution: Solution, clusters: Mapping[str, Index]) -> Rows:
    """Return the rows at a solution; `clusters` has the cluster (n,) of each reading of some groups, by group."""
    layout = without_elimination(solution.blocks)
    linear = {group.name: group.linear(solution.blocks, layout.wanted) for group in solution.groups}
    numbers = np.unique(np.concatenate([np.unique(index) for index in clusters.values()]))
    of_clusters = tuple(
        _joined([_selected(linear[name], layout, np.flatnonzero(index == at)) for name, index in clusters.items()])
        for at in numbers.tolist()
    )
    others = tuple(
        _selected(one, layout, np.arange(one.residual.shape[1])) for name, one in linear.items() if name not in clusters
    )
    return Rows(layout, of_clusters, others)


def _selected(linear: Linear, layout: Layout, rows: Index) -> Cluster:
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
