"""Order of elimination for a sparse normal matrix: nested dissection by the coordinates of its unknowns (George 1973).

A plane in the space of the coordinates cuts a part in two. The separator, which is eliminated after both sides, is
the smallest set of unknowns that meets every coupling across the plane. It follows from a maximum matching of these
couplings (Koenig 1931; Pothen, Fan 1990). Any coordinates give a right result; the order is fast if unknowns with
close coordinates are those that are coupled. Method: docs/algorithms/nested-dissection.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby, product
from typing import Any

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass

Sparse = Any
"""A scipy.sparse.csr_array; scipy is imported only where it is used, and has no types"""

_LEAF = 300
"""A part with so many unknowns or fewer is not cut"""
_BALANCE = 0.3
"""Smallest fraction of a part on either side of a cut, if any plane achieves it"""
_PART, _BORDER = 200.0, 2.0
"""Estimated cost of a part of n unknowns with a border of b: `_PART (n^2 + _BORDER n b)`; fitted for n of 1e3 to 1e5"""


@dataclass(frozen=True)
class Front:
    """Unknowns eliminated together (pivots), and the later ones that they are coupled with (border)."""

    pivots: Index
    border: Index
    """In the order of elimination"""
    children: tuple[int, ...]
    """Numbers of the fronts whose update matrices are added to this one"""

    @property
    def unknowns(self) -> Index:
        """The pivots, then the border."""
        return np.concatenate([self.pivots, self.border])


@dataclass(frozen=True)
class _Graph:
    """The couplings of the unknowns, each with itself too, and their coordinates."""

    coupled: Sparse
    places: Index
    directions: Index
    """Normals of the planes that may cut, (directions, k)"""


@dataclass(frozen=True)
class _Links:
    """Couplings of some unknowns with those of a part, one after the other; each unknown has at least one."""

    starts: Index
    """Index of the first link of each unknown"""
    ends: Index
    """Number in the part of the unknown at the other end"""

    def reach(self, level: Index) -> tuple[Index, Index]:
        """Return the lowest and the highest level that each unknown is linked to."""
        levels = level[self.ends]
        return np.minimum.reduceat(levels, self.starts), np.maximum.reduceat(levels, self.starts)

    def matrix(self, size: int) -> Sparse:
        """Return the links as a matrix of ones, (unknowns, size)."""
        from scipy.sparse import csr_array

        pointers = np.append(self.starts, len(self.ends))
        return csr_array((np.ones(len(self.ends), dtype=np.int8), self.ends, pointers), shape=(len(self.starts), size))


@dataclass(frozen=True)
class _Part:
    """Unknowns that are still to be cut, with the later ones that they are coupled with (border)."""

    unknowns: Index
    border: Index
    inner: _Links
    outer: _Links
    """Links of the border unknowns"""

    @staticmethod
    def of(coupled: Sparse, unknowns: Index) -> _Part:
        """Return the part of a graph with these unknowns."""
        number = np.full(coupled.shape[0], -1, dtype=np.intp)
        number[unknowns] = np.arange(len(unknowns))
        rows = coupled[unknowns]
        border = np.unique(rows.indices[number[rows.indices] < 0])
        return _Part(unknowns, border, _links(rows, number), _links(coupled[border], number))

    @property
    def is_leaf(self) -> bool:
        """Whether the part is small enough to stay whole."""
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
    """The best plane of one direction across a part."""

    left: Mask
    """Mask of the unknowns on its left side"""
    uneven: bool
    """Whether one side is smaller than `_BALANCE`"""
    cost: float
    """Upper bound of the estimated cost of this cut"""


@dataclass(frozen=True)
class _Cut:
    """The two sides of a part and their separator, by numbers in the part."""

    left: Index
    right: Index
    separator: Index


def dissect(matrix: Sparse, places: Array) -> list[Front]:
    """Return the fronts of a symmetric sparse matrix, children before parents; places is (unknowns, k), integers.

    The last front is a root, whose border is empty; there are several roots if the matrix falls into pieces.
    """
    fronts: list[Front] = []
    _dissected(_graph(matrix, places), np.arange(len(places)), fronts)
    turn = _turns(fronts, len(places))
    return [Front(_sorted(front.pivots, turn), _sorted(front.border, turn), front.children) for front in fronts]


def connected(matrix: Sparse) -> list[Index]:
    """Return the unknowns of each connected piece of a symmetric sparse matrix."""
    from scipy.sparse.csgraph import connected_components

    _, piece = connected_components(matrix, directed=False)
    return np.split(np.argsort(piece, kind="stable"), np.cumsum(np.bincount(piece))[:-1])


def _sorted(unknowns: Index, turn: Index) -> Index:
    return unknowns[np.argsort(turn[unknowns])]


def _graph(matrix: Sparse, places: Array) -> _Graph:
    from scipy.sparse import csr_array, eye_array

    pattern = csr_array((np.ones(matrix.nnz, dtype=np.int8), matrix.indices, matrix.indptr), shape=matrix.shape)
    coupled = (pattern + eye_array(len(places), dtype=np.int8, format="csr")).tocsr()
    # one of each pair of opposite normals: they cut the same planes
    directions = [d for d in product((-1, 0, 1), repeat=places.shape[1]) if next((x for x in d if x), 0) > 0]
    return _Graph(coupled, np.rint(places).astype(np.intp), np.array(directions))


def _dissected(graph: _Graph, unknowns: Index, fronts: list[Front]) -> tuple[int, ...]:
    """Append the fronts of a part, with their unknowns not yet sorted, and return the numbers of its roots."""
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
    """Return the connected pieces of a part, by numbers in the part; small ones are bundled, a leaf stays whole."""
    if part.is_leaf:
        return [np.arange(len(part.unknowns))]
    half, bundles = _LEAF // 2, []
    pieces = sorted(connected(part.inner.matrix(len(part.unknowns))), key=len)
    small = sum(len(piece) <= half for piece in pieces)
    # a piece is at most half a leaf, so pieces that begin in the same half of a leaf together stay below a whole one
    sizes = [len(piece) for piece in pieces[:small]]
    begins = (np.cumsum(sizes, dtype=np.intp) - sizes) // half
    for _, numbers in groupby(range(small), key=lambda n: int(begins[n])):
        bundles.append(np.concatenate([pieces[n] for n in numbers]))
    return bundles + pieces[small:]


def _best_cut(graph: _Graph, part: _Part) -> _Cut | None:
    """Return the best cut that leaves something on both sides, or None."""
    if part.is_leaf:
        return None
    # even cuts first: a cheap cut with almost everything on one side makes the recursion as deep as the part is long
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
        # an unknown on the left whose highest link lies on the right crosses the plane, and the other way round; so the
        # smaller of both counts is an upper bound of the separator, for all positions of the plane at once
        (low, high), (nearest, farthest) = part.inner.reach(level), part.outer.reach(level)
        left, first, last, near, far = (_up_to(levels, level) for levels in (level, low, high, nearest, farthest))
        separator, touched = np.minimum(left - last, first - left), (near, border - far)
        costs = _cost((left, n - left), separator, touched, border)
        share = np.minimum(left, n - left) / n
        uneven = bool((share <= _BALANCE).all())
        best = int(np.argmax(share) if uneven else np.argmin(np.where(share > _BALANCE, costs, np.inf)))
        yield _Plane(level <= best, uneven, float(costs[best]))


def _up_to(levels: Index, level: Index) -> Index:
    """Return how many of `levels` are at or below each level except the last, (levels - 1,)."""
    return np.cumsum(np.bincount(levels, minlength=int(level.max()) + 1))[:-1]


def _cost(sides: tuple[Index, Index], separator: Index, touched: tuple[Index, Index], border: int) -> Array:
    """Return the estimated costs of cuts, from the sizes of sides, separator, and border unknowns of each side."""
    own = separator**3 / 3 + separator**2 * border + separator * border**2
    (a, b), (c, d) = sides, (number + separator for number in touched)
    return np.asarray(own + _PART * (a * (a + _BORDER * c) + b * (b + _BORDER * d)))


def _cut(part: _Part, left: Mask) -> _Cut:
    """Return the cut along a plane with the smallest separator."""
    rows, columns = part.rows, part.inner.ends
    across = left[rows] & ~left[columns]
    between = np.zeros(len(left), dtype=bool)
    between[_cover(rows[across], columns[across])] = True
    return _Cut(np.flatnonzero(left & ~between), np.flatnonzero(~left & ~between), np.flatnonzero(between))


def _cover(rows: Index, columns: Index) -> Index:
    """Return the smallest set of unknowns that contains an end of every link; no unknown is both a row and a column.

    By Koenig's theorem these are, for a maximum matching, the rows that no alternating path from an unmatched row
    reaches, and the columns that such a path reaches.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    (left, i), (right, j) = (np.unique(side, return_inverse=True) for side in (rows, columns))
    links = csr_array((np.ones(len(i), dtype=np.int8), (i, j)), shape=(len(left), len(right)))
    partner = maximum_bipartite_matching(links, perm_type="column")
    back = np.full(len(right), -1)
    back[partner[partner >= 0]] = np.flatnonzero(partner >= 0)
    reached, through = partner < 0, np.zeros(len(right), dtype=bool)
    # alternating paths: from a row along any link to a column, from a column back along its matched link only
    new = np.flatnonzero(reached)
    while new.size:
        met = np.unique(links[new].indices)
        met = met[~through[met]]
        through[met] = True
        new = back[met]
        reached[new] = True
    return np.concatenate([left[~reached], right[through]])


def _turns(fronts: Sequence[Front], count: int) -> Index:
    """Return the position of each unknown in the order of elimination.

    Front follows front. Within a front, unknowns that the same descendants are coupled with stand together: those that
    a descendant's border contains are then in few runs of consecutive positions, which are added as slices.
    """
    code, scale = np.zeros(count), np.ones(count)
    at = np.empty(count, dtype=np.intp)
    for i in reversed(range(len(fronts))):
        at[fronts[i].pivots] = i
        borders = [fronts[child].border for child in fronts[i].children]
        if not borders:
            continue
        # digits of a number in which each level of descendants has the next one: equal codes have the same descendants
        side = np.repeat(np.linspace(0.0, 1.0, len(borders)), [len(border) for border in borders])
        touched, which, times = np.unique(np.concatenate(borders), return_inverse=True, return_counts=True)
        code[touched] += scale[touched] * np.bincount(which, side) / times
        scale[touched] /= 2 * len(borders)
    turn = np.empty(count, dtype=np.intp)
    turn[np.lexsort((code, at))] = np.arange(count)
    return turn
