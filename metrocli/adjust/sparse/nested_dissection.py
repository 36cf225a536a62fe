"""Order of elimination for a sparse normal matrix: nested dissection by the places of its unknowns (George 1973).

A part is cut by a plane in the space of places. Eliminated after both sides is the least set of unknowns that every
coupling across the plane touches, from the largest matching of these couplings (Koenig 1931; Pothen, Fan 1990). Right
for any places, fast where near means coupled.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, product
from typing import Any

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask

Sparse = Any
"""A scipy.sparse.csr_array; scipy is imported where it is used, and has no types"""

_LEAF = 300
"""Parts of so many unknowns or fewer are not cut"""
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
    """Which unknowns are coupled, each with itself too, and where they are."""

    coupled: Sparse
    places: Index
    directions: Index
    """Normals of the planes that cut, (directions, k)"""


@dataclass(frozen=True)
class _Links:
    """Couplings of unknowns with those of a part, one after the other; every unknown has one at least."""

    starts: Index
    """First link of each unknown"""
    ends: Index
    """Number in the part of the other unknown"""

    def reach(self, level: Index) -> tuple[Index, Index]:
        """Return the lowest and the highest level that each unknown is linked to."""
        levels = level[self.ends]
        return np.minimum.reduceat(levels, self.starts), np.maximum.reduceat(levels, self.starts)

    def matrix(self, size: int) -> Sparse:
        """Return 1 for each link, (unknowns, size)."""
        from scipy.sparse import csr_array

        pointers = np.append(self.starts, len(self.ends))
        return csr_array((np.ones(len(self.ends), dtype=np.int8), self.ends, pointers), shape=(len(self.starts), size))


@dataclass(frozen=True)
class _Part:
    """Unknowns that are still to be cut, with the later ones that they touch."""

    unknowns: Index
    border: Index
    inner: _Links
    outer: _Links
    """From the border"""

    @staticmethod
    def of(coupled: Sparse, unknowns: Index) -> _Part:
        """Return a part of a graph."""
        number = np.full(coupled.shape[0], -1, dtype=np.intp)
        number[unknowns] = np.arange(len(unknowns))
        rows = coupled[unknowns]
        border = np.unique(rows.indices[number[rows.indices] < 0])
        return _Part(unknowns, border, _links(rows, number), _links(coupled[border], number))

    @property
    def is_leaf(self) -> bool:
        """Whether it is not cut."""
        return len(self.unknowns) <= _LEAF

    @property
    def rows(self) -> Index:
        """The unknown at which each inner link begins."""
        return np.repeat(np.arange(len(self.unknowns)), np.diff(self.inner.starts, append=len(self.inner.ends)))


def _links(rows: Sparse, number: Index) -> _Links:
    ends = number[rows.indices]
    inside = ends >= 0
    return _Links(np.concatenate([[0], np.cumsum(inside)])[rows.indptr[:-1]], ends[inside])


@dataclass(frozen=True)
class _Plane:
    """A plane across a part, the best of its direction."""

    left: Mask
    """What lies on its left"""
    uneven: bool
    cost: float
    """Of the cut along it, at most"""


@dataclass(frozen=True)
class _Cut:
    """Sides of a part and what separates them, by their numbers in the part."""

    left: Index
    right: Index
    separator: Index


def dissect(matrix: Sparse, places: Array) -> list[Front]:
    """Return the fronts of a symmetric sparse matrix, children before parents; places is (unknowns, k), whole numbers.

    The last front is the root, whose border is empty; where the matrix falls apart there are several roots.
    """
    fronts: list[Front] = []
    _dissected(_graph(matrix, places), np.arange(len(places)), fronts)
    turn = _turns(fronts, len(places))
    return [Front(_sorted(one.pivots, turn), _sorted(one.border, turn), one.children) for one in fronts]


def connected(matrix: Sparse) -> list[Index]:
    """Return the unknowns of each piece of a symmetric sparse matrix that hangs together."""
    from scipy.sparse.csgraph import connected_components

    _, piece = connected_components(matrix, directed=False)
    return np.split(np.argsort(piece, kind="stable"), np.cumsum(np.bincount(piece))[:-1])


def _sorted(unknowns: Index, turn: Index) -> Index:
    return unknowns[np.argsort(turn[unknowns])]


def _graph(matrix: Sparse, places: Array) -> _Graph:
    from scipy.sparse import csr_array, eye_array

    pattern = csr_array((np.ones(matrix.nnz, dtype=np.int8), matrix.indices, matrix.indptr), shape=matrix.shape)
    coupled = (pattern + eye_array(len(places), dtype=np.int8, format="csr")).tocsr()
    directions = [d for d in product((-1, 0, 1), repeat=places.shape[1]) if next((x for x in d if x), 0) > 0]
    return _Graph(coupled, np.rint(places).astype(np.intp), np.array(directions))


def _dissected(graph: _Graph, unknowns: Index, fronts: list[Front]) -> tuple[int, ...]:
    """Append the fronts of a part, their unknowns in no order yet, and return its roots."""
    part = _Part.of(graph.coupled, unknowns)
    pieces = _pieces(part)
    if len(pieces) > 1:
        return tuple(root for piece in pieces for root in _dissected(graph, unknowns[piece], fronts))
    cut = _best_cut(graph, part)
    if cut is None:
        fronts.append(Front(unknowns, part.border, ()))
    else:
        children = tuple(root for side in (cut.left, cut.right) for root in _dissected(graph, unknowns[side], fronts))
        fronts.append(Front(unknowns[cut.separator], part.border, children))
    return (len(fronts) - 1,)


def _pieces(part: _Part) -> list[Index]:
    """Return what of a part hangs together, by numbers in the part; small pieces are bundled, a leaf stays whole."""
    if part.is_leaf:
        return [np.arange(len(part.unknowns))]
    half, bundles = _LEAF // 2, []
    pieces = sorted(connected(part.inner.matrix(len(part.unknowns))), key=len)
    small = sum(len(piece) <= half for piece in pieces)
    # what begins in the same half of a leaf stays below a whole one
    sizes = [len(piece) for piece in pieces[:small]]
    begins = (np.cumsum(sizes, dtype=np.intp) - sizes) // half
    for _, numbers in groupby(range(small), key=lambda n: int(begins[n])):
        bundles.append(np.concatenate([pieces[n] for n in numbers]))
    return bundles + pieces[small:]


def _best_cut(graph: _Graph, part: _Part) -> _Cut | None:
    """Return the cut along the plane that promises most of those that leave something on both sides, if any does."""
    if part.is_leaf:
        return None
    planes = sorted(_planes(graph, part), key=lambda plane: (plane.uneven, plane.cost))
    return next((cut for cut in (_cut(part, plane.left) for plane in planes) if cut.left.size and cut.right.size), None)


def _planes(graph: _Graph, part: _Part) -> Iterator[_Plane]:
    """Yield the best plane of each direction."""
    n, border = len(part.unknowns), len(part.border)
    for direction in graph.directions:
        height = graph.places[part.unknowns] @ direction
        level = height - height.min()
        if not level.any():
            continue
        (low, high), (nearest, farthest) = part.inner.reach(level), part.outer.reach(level)
        left, first, last, near, far = (_up_to(levels, level) for levels in (level, low, high, nearest, farthest))
        separator, touched = np.minimum(left - last, first - left), (near, border - far)
        costs = _cost((left, n - left), separator, touched, border)
        share = np.minimum(left, n - left) / n
        uneven = bool((share <= _BALANCE).all())
        best = int(np.argmax(share) if uneven else np.argmin(np.where(share > _BALANCE, costs, np.inf)))
        yield _Plane(level <= best, uneven, float(costs[best]))


def _up_to(levels: Index, level: Index) -> Index:
    """Return how many of some levels are not above each but the last."""
    return np.cumsum(np.bincount(levels, minlength=int(level.max()) + 1))[:-1]


def _cost(sides: tuple[Index, Index], separator: Index, touched: tuple[Index, Index], border: int) -> Array:
    """Return the costs of cuts, from the numbers of unknowns of their parts and of the border that the sides touch."""
    own = separator**3 / 3 + separator**2 * border + separator * border**2
    (a, b), (c, d) = sides, (number + separator for number in touched)
    return np.asarray(own + _PART * (a * (a + _BORDER * c) + b * (b + _BORDER * d)))


def _cut(part: _Part, left: Mask) -> _Cut:
    """Return the cut between what is left and the rest, with the least separator."""
    rows, columns = part.rows, part.inner.ends
    across = left[rows] & ~left[columns]
    between = np.zeros(len(left), dtype=bool)
    between[_cover(rows[across], columns[across])] = True
    return _Cut(np.flatnonzero(left & ~between), np.flatnonzero(~left & ~between), np.flatnonzero(between))


def _cover(rows: Index, columns: Index) -> Index:
    """Return the least set of unknowns that every link has an end in; no unknown is both a row and a column.

    Of a largest matching, the rows that no alternating path from an unmatched row reaches, and the columns that one
    does (Koenig).
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    (left, i), (right, j) = (np.unique(side, return_inverse=True) for side in (rows, columns))
    links = csr_array((np.ones(len(i), dtype=np.int8), (i, j)), shape=(len(left), len(right)))
    partner = maximum_bipartite_matching(links, perm_type="column")
    back = np.full(len(right), -1)
    back[partner[partner >= 0]] = np.flatnonzero(partner >= 0)
    reached, through = partner < 0, np.zeros(len(right), dtype=bool)
    new = np.flatnonzero(reached)
    while new.size:
        met = np.unique(links[new].indices)
        met = met[~through[met]]
        through[met] = True
        new = back[met]
        reached[new] = True
    return np.concatenate([left[~reached], right[through]])


def _turns(fronts: Sequence[Front], count: int) -> Index:
    """Return the turn of each unknown: front after front, within one those together that the same descendants touch.

    The unknowns of a front that a descendant touches then stand in few runs.
    """
    code, scale = np.zeros(count), np.ones(count)
    at = np.empty(count, dtype=np.intp)
    for i in reversed(range(len(fronts))):
        at[fronts[i].pivots] = i
        borders = [fronts[child].border for child in fronts[i].children]
        if not borders:
            continue
        side = np.repeat(np.linspace(0.0, 1.0, len(borders)), [len(border) for border in borders])
        touched, which, times = np.unique(np.concatenate(borders), return_inverse=True, return_counts=True)
        code[touched] += scale[touched] * np.bincount(which, side) / times
        scale[touched] /= 2 * len(borders)
    turn = np.empty(count, dtype=np.intp)
    turn[np.lexsort((code, at))] = np.arange(count)
    return turn
