"""Order of elimination for a sparse normal matrix: nested dissection by the places of its unknowns (George 1973).

Unknowns at one place are kept together. A part is cut by a plane in the space of places; those on one side that touch
the other side are the separator, eliminated after both sides. Right for any places, fast where near means coupled.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.observations import Index, Mask

Sparse = Any
"""A scipy.sparse.csr_array; scipy is imported where it is used, and has no types"""

_LEAF = 200
"""Parts of fewer unknowns are not cut"""
_BALANCE = 0.3
"""Neither side of a cut is to have less than this share, where that can be had"""
_PART, _BORDER = 200.0, 2.0
"""Cost of eliminating a part of n unknowns with a border of b: `_PART (n^2 + _BORDER n b)`; fits parts of 1e3 to 1e5"""


@dataclass(frozen=True)
class Front:
    """Unknowns eliminated together, and the later ones that they touch."""

    pivots: Index
    border: Index
    """In the order of their elimination"""
    children: tuple[int, ...]
    """Places in the list of fronts of those whose borders end here"""

    @property
    def unknowns(self) -> Index:
        """Pivots, then border."""
        return np.concatenate([self.pivots, self.border])


@dataclass(frozen=True)
class _Graph:
    """Places, and which of them are coupled."""

    places: Array
    touching: Sparse
    weights: Array
    """Unknowns at each place"""
    directions: Array
    """Normals of the planes that cut, (directions, k)"""


@dataclass(frozen=True)
class _Cut:
    cost: float
    left: Index
    right: Index
    separator: Index


@dataclass
class _Node:
    places: Index
    children: tuple[int, ...]


def dissect(matrix: Sparse, places: Array) -> list[Front]:
    """Return the fronts of a symmetric sparse matrix, children before parents; places is (unknowns, k), whole numbers.

    The last front is the root, whose border is empty; where the matrix falls apart there are several roots.
    """
    graph, at = _graph(matrix, places)
    nodes: list[_Node] = []
    _dissected(graph, np.arange(len(graph.weights)), np.zeros(0, dtype=np.intp), nodes)
    members = np.split(np.argsort(at, kind="stable"), np.cumsum(np.bincount(at))[:-1])
    return _fronts(graph, nodes, members)


def _graph(matrix: Sparse, places: Array) -> tuple[_Graph, Index]:
    from scipy.sparse import csr_array

    distinct, at = np.unique(places, axis=0, return_inverse=True)
    at = at.reshape(-1)
    n, m = len(at), len(distinct)
    coupled = matrix.tocoo()
    pairs = np.unique(at[coupled.row].astype(np.int64) * m + at[coupled.col])
    rows, columns = pairs // m, pairs % m
    apart = rows != columns
    touching = csr_array((np.ones(int(apart.sum())), (rows[apart], columns[apart])), shape=(m, m))
    directions = [d for d in product((-1, 0, 1), repeat=places.shape[1]) if next((x for x in d if x), 0) > 0]
    weights = np.bincount(at, minlength=m).astype(float)
    assert weights.sum() == n
    return _Graph(distinct.astype(float), touching, weights, np.array(directions, dtype=float)), at


def _dissected(graph: _Graph, part: Index, border: Index, nodes: list[_Node]) -> tuple[int, ...]:
    """Append the nodes of a part, and return its roots."""
    cut = _best_cut(graph, part, border) if graph.weights[part].sum() > _LEAF else None
    if cut is None:
        nodes.append(_Node(part, ()))
        return (len(nodes) - 1,)
    around = np.concatenate([border, cut.separator])
    children: tuple[int, ...] = ()
    for side in (cut.left, cut.right):
        children += _dissected(graph, side, _touched(graph, around, side), nodes)
    if not cut.separator.size:
        return children
    nodes.append(_Node(cut.separator, children))
    return (len(nodes) - 1,)


def _touched(graph: _Graph, around: Index, part: Index) -> Index:
    inside = np.zeros(len(graph.weights))
    inside[part] = 1.0
    return np.asarray(around[(graph.touching @ inside)[around] > 0])


def _best_cut(graph: _Graph, part: Index, border: Index) -> _Cut | None:
    inner = graph.touching[part][:, part]
    outer = graph.touching[part][:, border].T.tocsr()
    found = [
        cut
        for direction in graph.directions
        for cut in _cuts(graph, part, border, (inner, outer), graph.places[part] @ direction)
    ]
    total = graph.weights[part].sum()
    weights = graph.weights
    even = [cut for cut in found if min(weights[cut.left].sum(), weights[cut.right].sum()) > _BALANCE * total]
    return min(even or found, key=lambda cut: cut.cost, default=None)


def _cuts(graph: _Graph, part: Index, border: Index, touching: tuple[Sparse, Sparse], height: Array) -> list[_Cut]:
    inner, outer = touching
    levels = np.unique(height)[:-1]
    if not levels.size:
        return []
    left = height[:, None] <= levels
    beside = np.asarray(inner @ left.astype(float)) > 0
    beyond = np.asarray(inner @ (~left).astype(float)) > 0
    cuts = []
    for separator, low, high in ((left & beyond, left & ~beyond, ~left), (~left & beside, left, ~left & ~beside)):
        weights = graph.weights[part]
        s, a, b = weights @ separator, weights @ low, weights @ high
        near = graph.weights[border]
        shared = near.sum()
        c, d = (near @ (np.asarray(outer @ side.astype(float)) > 0) if border.size else 0.0 * s for side in (low, high))
        own = s**3 / 3 + s * s * shared + s * shared**2
        cost = own + _PART * (a * a + _BORDER * a * (c + s) + b * b + _BORDER * b * (d + s))
        cost[(a == 0) | (b == 0)] = np.inf
        best = int(np.argmin(cost))
        for level in {best, _most_even(a, b, cost)}:
            if np.isfinite(cost[level]):
                chosen = (part[low[:, level]], part[high[:, level]], part[separator[:, level]])
                cuts.append(_Cut(float(cost[level]), *chosen))
    return cuts


def _most_even(a: Array, b: Array, cost: Array) -> int:
    """Return the cheapest of the balanced cuts of one direction, or the most even one."""
    share = np.minimum(a, b) / (a + b)
    balanced = share > _BALANCE
    return int(np.argmin(np.where(balanced, cost, np.inf))) if balanced.any() else int(np.argmax(share))


def _fronts(graph: _Graph, nodes: list[_Node], members: list[Index]) -> list[Front]:
    turn = np.empty(len(graph.weights), dtype=np.intp)
    for i, node in enumerate(nodes):
        turn[node.places] = i
    borders: list[Mask] = []
    fronts = []
    empty = np.zeros(0, dtype=np.intp)
    for i, node in enumerate(nodes):
        reach = np.zeros(len(turn), dtype=bool)
        for row in node.places:
            reach[graph.touching.indices[graph.touching.indptr[row] : graph.touching.indptr[row + 1]]] = True
        for child in node.children:
            reach |= borders[child]
        reach &= turn > i
        borders.append(reach)
        border = np.flatnonzero(reach)
        border = border[np.argsort(turn[border], kind="stable")]
        fronts.append(
            Front(
                np.concatenate([members[p] for p in node.places]),
                np.concatenate([empty, *(members[p] for p in border)]),
                tuple(child for child in node.children if borders[child].any()),
            )
        )
    return fronts
