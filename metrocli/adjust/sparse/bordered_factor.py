"""Factor of the normal matrix of an adjustment of fields, with its undetermined directions.

The local unknowns are eliminated first, then the net, then the border. If the net is singular by itself (some
combinations of its unknowns change no reading), its null space Z is found by inverse iteration. As many unknowns are
then held, chosen so that `P' Z` is regular, P selecting them. `(S + t P P')^-1` is then a generalised inverse of S:
`S S^- S = S`. The border is small and is inverted by its eigenvalues. Method: docs/algorithms/nested-dissection.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from metrocli.adjust.decompositions import pivoted_qr
from metrocli.adjust.sparse.cholesky import SparseCholesky, factor
from metrocli.adjust.sparse.nested_dissection import Sparse, connected, dissect
from metrocli.adjust.sparse.partition import Partition
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass

_STIFFNESS = 1e-9
"""Relative stiffness that makes a singular net regular for the inverse iteration"""
_SINGULAR = 1e-9
"""Pivots and eigenvalues below this fraction of the diagonal are rounding"""
_MOST = 900
"""Largest number of undetermined directions of the net"""


class OpenDesignError(Exception):
    """A design leaves more directions undetermined than can be listed."""


@dataclass(frozen=True)
class BorderedFactor:
    """Factors of the normal matrix, reduced step by step."""

    sizes: Partition
    diagonal: Array
    """D, (local,)"""
    towards_net: Sparse
    """N_lg, (local, net)"""
    towards_border: Array
    """N_lb, (local, border)"""
    matrix: Sparse
    """S, the matrix of the net without the local unknowns"""
    net: SparseCholesky
    weights: Array
    """`S^-1 B` with B the part of N_gb left after the local unknowns are eliminated, (net, border)"""
    border: Array
    """T^-1 without its undetermined directions, (border, border)"""
    null: Array
    """Z, all undetermined directions, (unknowns, k)"""

    @cached_property
    def inverse(self) -> Sparse:
        """Entries of S^-1 at the entries of S."""
        return self.net.inverse(self.matrix)

    def solve(self, right: Array) -> Array:
        """Return a solution of `N x = right`; the part of the right side along undetermined directions is ignored."""
        flat = right.reshape(len(right), -1)
        g, rest = self.sizes.net, self.sizes.net + self.sizes.local
        local = flat[g:rest] / self.diagonal[:, None]
        net = self.net.solve(flat[:g] - self.towards_net.T @ local)
        border = self.border @ (
            flat[rest:] - self.towards_border.T @ local - self.weights.T @ (flat[:g] - self.towards_net.T @ local)
        )
        net = net - self.weights @ border
        local = local - (self.towards_net @ net + self.towards_border @ border) / self.diagonal[:, None]
        return np.concatenate([net, local, border]).reshape(right.shape)

    def variances(self, rows: Sparse) -> Array:
        """Return `diag(R Q R')` for rows R that combine unknowns coupled by a reading, (n,)."""
        net, scaled, outer = self._shared(rows)
        own = np.asarray(scaled.multiply(scaled).sum(axis=1)).ravel()
        return np.asarray(own + self._spread(net) + np.einsum("nb,nb->n", outer @ self.border, outer))

    def covariance(self, rows: Sparse) -> Array:
        """Return `R Q R'` for any rows, (n, n)."""
        net, scaled, outer = self._shared(rows)
        half = self.net.forward(net.T.toarray())
        return np.asarray((scaled @ scaled.T).toarray() + half.T @ half + outer @ self.border @ outer.T)

    def _shared(self, rows: Sparse) -> tuple[Sparse, Sparse, Array]:
        """Return the rows transformed to independent parts: net, local unknowns over the root of D, and border.

        The weights of the net and of the border include what the eliminated unknowns pass on.
        """
        g, rest = self.sizes.net, self.sizes.net + self.sizes.local
        net, local, border = rows[:, :g], rows[:, g:rest], rows[:, rest:]
        scaled = local.multiply(1 / self.diagonal).tocsr()
        net = (net - scaled @ self.towards_net).tocsr()
        outer = border.toarray() - scaled @ self.towards_border - net @ self.weights
        return net, local.multiply(1 / np.sqrt(self.diagonal)).tocsr(), outer

    def _spread(self, rows: Sparse) -> Array:
        """Return `diag(R S^-1 R')` from the known entries of the inverse."""
        counts, size = np.diff(rows.indptr), self.inverse.shape[0]
        total = np.zeros(rows.shape[0])
        keys = np.repeat(np.arange(size), np.diff(self.inverse.indptr)) * size + self.inverse.indices
        columns = rows.indices.astype(np.int64)
        for a in range(int(counts.max(initial=0))):
            for b in range(a + 1):
                # rows that have a non-zero number a; those before it exist as well
                has = np.flatnonzero(counts > a)
                first, second = rows.indptr[has] + a, rows.indptr[has] + b
                at = np.searchsorted(keys, columns[first] * size + columns[second])
                # a pair that is missing at the end would be past the keys; rows of coupled unknowns have none
                product = rows.data[first] * rows.data[second] * self.inverse.data[np.minimum(at, len(keys) - 1)]
                total[has] += product if a == b else 2 * product
        return total


def bordered_factor(jacobian: Sparse, sizes: Partition, places: Array) -> BorderedFactor:
    """Return the factor of `J'J`.

    Raises OpenDesignError if the net has more than `_MOST` undetermined directions.
    """
    g, rest = sizes.net, sizes.net + sizes.local
    by_net, by_local, by_border = jacobian[:, :g], jacobian[:, g:rest], jacobian[:, rest:]
    diagonal = np.asarray(by_local.multiply(by_local).sum(axis=0)).ravel()
    towards_net = (by_local.T @ by_net).tocsr()
    towards_border = (by_local.T @ by_border).toarray()
    share = towards_net.multiply(1 / diagonal[:, None]).tocsr()
    own = by_net.T @ by_net
    # the last term has the pattern of the second without cancellation: the selected inverse needs these entries
    matrix = _sum(own, -(towards_net.T @ share), 0.0 * (abs(towards_net).T @ abs(share)))
    right = (by_net.T @ by_border).toarray() - share.T @ towards_border
    net, open_net = _factored(matrix, places, float(own.diagonal().max()))
    weights = net.solve(right)
    corner = (by_border.T @ by_border).toarray() - towards_border.T @ (towards_border / diagonal[:, None])
    alone = np.asarray(by_border.multiply(by_border).sum(axis=0)).ravel()
    border, open_border = _border(corner - right.T @ weights, alone)
    null_net = np.concatenate([open_net, -weights @ open_border], axis=1)
    null_border = np.concatenate([np.zeros((len(corner), open_net.shape[1])), open_border], axis=1)
    null_local = -(towards_net @ null_net + towards_border @ null_border) / diagonal[:, None]
    null = np.concatenate([null_net, null_local, null_border])
    return BorderedFactor(sizes, diagonal, towards_net, towards_border, matrix, net, weights, border, null)


def _sum(*matrices: Sparse) -> Sparse:
    """Return the sum with every entry that one of the matrices has, even where they cancel: readings couple these."""
    from scipy.sparse import coo_array

    parts = [matrix.tocoo() for matrix in matrices]
    places = (np.concatenate([part.row for part in parts]), np.concatenate([part.col for part in parts]))
    total = coo_array((np.concatenate([part.data for part in parts]), places), shape=matrices[0].shape).tocsr()
    total.sort_indices()
    return total


def _factored(matrix: Sparse, places: Array, largest: float) -> tuple[SparseCholesky, Array]:
    """Return the factor of the net, with unknowns held if it is singular, and its undetermined directions (n, k).

    `largest` is the largest entry of the diagonal before the local unknowns were eliminated.
    """
    fronts = dissect(matrix, places)
    try:
        factored = factor(matrix, fronts)
        # pivots are squares of the factor's diagonal; a tiny one passes the factorisation and ruins the inverse
        if factored.weakest**2 > _SINGULAR * largest:
            return factored, np.zeros((matrix.shape[0], 0))
    except np.linalg.LinAlgError:
        pass
    # just stiff enough for a factor: each solution multiplies open directions by the inverse of it, others by less
    everywhere = np.full(matrix.shape[0], _STIFFNESS * largest)
    opened = _open(matrix, factor(_with_diagonal(matrix, everywhere), fronts), largest)
    held = _holding(opened, matrix.shape[0])
    # one unit of stiffness for each open direction holds it and adds nothing to what is determined
    return factor(_with_diagonal(matrix, held * largest), fronts), _side_by_side(opened, matrix.shape[0])


def _with_diagonal(matrix: Sparse, added: Array) -> Sparse:
    from scipy.sparse import diags_array

    return _sum(matrix, diags_array(added, format="csr"))


def _holding(opened: _Opened, count: int) -> Array:
    """Return 1 at the unknowns that are held so that no direction stays open, else 0, (count,)."""
    held = np.zeros(count)
    for piece, directions in opened:
        # pivots are the unknowns that the open directions move most independently
        _, _, order = pivoted_qr(directions.T)
        held[piece[order[: directions.shape[1]]]] = 1.0
    return held


_Opened = list[tuple[Index, Array]]
"""The unknowns of connected pieces of a net, and their undetermined directions (unknowns of the piece, k)"""


def _open(matrix: Sparse, net: SparseCholesky, largest: float) -> _Opened:
    """Return the undetermined directions of a singular net, by inverse iteration on more and more vectors.

    If the net falls into pieces, they are found piece by piece; the same columns serve all pieces at once.
    """
    pieces = connected(matrix)
    # a fixed seed: the same job has the same datum and the same last digits in each run
    rng, count = np.random.default_rng(0), 32
    while True:
        vectors = rng.normal(size=(matrix.shape[0], count))
        # a direction with an eigenvalue of ten times the stiffness loses 1e4 against open ones in four rounds
        for _ in range(4):
            vectors = _orthonormal(net.solve(vectors), pieces)
        directions = list(_lowest(matrix, vectors, pieces, largest))
        if sum(each.shape[1] for each in directions) > _MOST:
            raise OpenDesignError(f"more than {_MOST} directions are open")
        # as many open directions as vectors means that there may be more: then with three times as many
        if all(each.shape[1] < count or len(each) <= count for each in directions):
            return [(piece, own) for piece, own in zip(pieces, directions, strict=True) if own.shape[1]]
        count *= 3


def _orthonormal(vectors: Array, pieces: list[Index]) -> Array:
    """Return vectors made orthonormal over each piece: as many as it has unknowns, the others zero."""
    whole = np.zeros_like(vectors)
    for piece in pieces:
        # a piece of k unknowns has k directions at most, and more columns would be dependent
        own = np.linalg.qr(vectors[piece, : len(piece)])[0]
        whole[piece, : own.shape[1]] = own
    return whole


def _lowest(matrix: Sparse, vectors: Array, pieces: list[Index], largest: float) -> Iterator[Array]:
    """Yield for each piece the undetermined directions in the span of its vectors, (unknowns of the piece, k)."""
    applied = matrix @ vectors
    for piece in pieces:
        own = vectors[piece, : len(piece)]
        values, mix = np.linalg.eigh(own.T @ applied[piece, : len(piece)])
        yield own @ mix[:, values < _SINGULAR * largest]


def _side_by_side(opened: _Opened, count: int) -> Array:
    """Return the directions of single pieces as columns over all unknowns, (count, k)."""
    whole = np.zeros((count, sum(directions.shape[1] for _, directions in opened)))
    at = 0
    for piece, directions in opened:
        whole[piece, at : at + directions.shape[1]] = directions
        at += directions.shape[1]
    return whole


def _border(matrix: Array, alone: Array) -> tuple[Array, Array]:
    """Return the inverse of the border's matrix without its undetermined directions, and these directions."""
    # by what each unknown has before the net is eliminated: afterwards its diagonal may be rounding alone
    scale = 1 / np.sqrt(np.where(alone > 0, alone, 1.0))
    values, vectors = np.linalg.eigh(matrix * scale[:, None] * scale)
    opened = values < _SINGULAR
    kept = vectors[:, ~opened]
    inverse = (kept / values[~opened]) @ kept.T
    return inverse * scale[:, None] * scale, vectors[:, opened] * scale[:, None]
