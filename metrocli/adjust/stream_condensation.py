"""Dense readings condensed to few, without loss for a model that is quadratic in each cell.

A parabola fitted to the points of a cell by least squares is evaluated at the three Gauss nodes of these points. The
three values are uncorrelated, and the weight of each is its weight in Gauss quadrature (Golub and Welsch 1969). So
they give the same normal equations as all points. Method: docs/algorithms/stream-condensation.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass

_NODES = 3
_SPREAD = 1e-6
"""Cells whose points are too clumped for a parabola (smallest pivot of the moment matrix below this) give their mean"""


@dataclass(frozen=True)
class Condensed:
    """Condensed readings, in the order of their cells."""

    cell: Index
    x: Array
    values: Array
    """(channels, m)"""
    weight: Array
    """Number of original readings that each one represents (m,)"""
    misfit: Array
    """Sum of squares of the original readings about the parabolas of their cells, for each channel"""
    dof: int
    """Degrees of freedom of that sum, the same for each channel"""


@dataclass(frozen=True)
class _Cells:
    """Readings in the order of their cells."""

    cell: Index
    starts: Index
    """Index of the first reading of each cell that has readings"""
    x: Array
    values: Array

    @property
    def counts(self) -> Index:
        return np.diff(np.append(self.starts, len(self.x)))

    def sums(self, of: Array) -> Array:
        return np.add.reduceat(of, self.starts, axis=-1)


def condense(x: Array, values: Array, cell: Index) -> Condensed:
    """Condense readings `values` (channels, n) at positions x (n,) in cells (n,) to at most three for each cell.

    Cells of up to three points stay as they are; cells whose points are too clumped give their mean.
    """
    order = np.argsort(cell, kind="stable")
    ordered = cell[order]
    # cells are numbered from 0: before them stands -1, so that the first reading begins a cell
    starts = np.flatnonzero(np.diff(ordered, prepend=-1))
    cells = _Cells(ordered, starts, x[order], values[:, order])
    counts = cells.counts
    scaled, moments = _moments(cells)
    fit = (counts > _NODES) & (_smallest_pivot(moments) > _SPREAD)
    few = counts <= _NODES
    pieces = [_parabolas(cells, scaled, moments, fit), _as_they_are(cells, few), _means(cells, scaled, ~fit & ~few)]
    number, position, condensed, weight = (np.concatenate(arrays, axis=-1) for arrays in zip(*pieces, strict=True))
    # differences from the mean of the cell keep the digits that squares of large readings would lose
    mean = scaled.mean[:, np.searchsorted(ordered[starts], number)]
    total = ((cells.values - np.repeat(scaled.mean, counts, axis=1)) ** 2).sum(axis=1)
    misfit = np.maximum(total - ((condensed - mean) ** 2 * weight).sum(axis=1), 0.0)
    # each condensed reading takes one degree of freedom of its cell: three for a parabola, one for a mean
    used = np.where(few, counts, np.where(fit, _NODES, 1)).sum()
    inside = np.lexsort((position, number))
    dof = int(counts.sum() - used)
    return Condensed(number[inside], position[inside], condensed[:, inside], weight[inside], misfit, dof)


@dataclass(frozen=True)
class _ScaledCells:
    """Scaling of each cell to -1..1, `u = (x - centre) / half`, with moments of its readings."""

    centre: Array
    half: Array
    mean: Array
    """(channels, cells)"""
    right: Array
    """Means of u^k (y - mean), (channels, cells, 3)"""


def _moments(cells: _Cells) -> tuple[_ScaledCells, Array]:
    """Return the scaling, and the means of u^0 ... u^5 in each cell, (cells, 6)."""
    counts = cells.counts
    low, high = (function.reduceat(cells.x, cells.starts) for function in (np.minimum, np.maximum))
    centre, half = (low + high) / 2, np.maximum((high - low) / 2, 1e-300)
    u = (cells.x - np.repeat(centre, counts)) / np.repeat(half, counts)
    mean = cells.sums(cells.values) / counts
    left = cells.values - np.repeat(mean, counts, axis=1)
    power, moments, right = np.ones_like(u), [], []
    for k in range(2 * _NODES):
        # the Jacobi matrix of Golub and Welsch for three nodes needs moments up to u^5
        moments.append(cells.sums(power) / counts)
        if k < _NODES:
            right.append(cells.sums(left * power) / counts)
        power = power * u
    return _ScaledCells(centre, half, mean, np.stack(right, axis=-1)), np.stack(moments, axis=-1)


def _hankel(moments: Array, first: int) -> Array:
    """Return the matrices of the moments of `u^(first + i + j)`, (cells, 3, 3)."""
    return np.stack([moments[:, first + i : first + i + _NODES] for i in range(_NODES)], axis=1)


def _smallest_pivot(moments: Array) -> Array:
    """Return the smallest pivot of each moment matrix, 0 if it is singular."""
    a = _hankel(moments, 0)
    # pivots of [[1, m1, m2], [m1, m2, m3], [m2, m3, m4]] when it is eliminated: the first is always 1
    variance = a[:, 1, 1] - a[:, 0, 1] ** 2
    safe = np.maximum(variance, 1e-300)
    last = a[:, 2, 2] - a[:, 0, 2] ** 2 - (a[:, 1, 2] - a[:, 0, 1] * a[:, 0, 2]) ** 2 / safe
    return np.asarray(np.maximum(np.minimum(variance, last), 0.0))


_Piece = tuple[Index, Array, Array, Array]
"""Cell, position, values and weight of condensed readings"""


def _parabolas(cells: _Cells, scaled: _ScaledCells, moments: Array, chosen: Mask) -> _Piece:
    """Return the fitted parabolas of the chosen cells at their Gauss nodes, with the Gauss weights.

    With M = R R' the moment matrix, the nodes are the eigenvalues of `R^-1 M1 R^-T`, M1 the moments one power up.
    """
    numbers = np.flatnonzero(chosen)
    root = np.linalg.cholesky(_hankel(moments[numbers], 0))
    inverse = np.linalg.inv(root)
    nodes, _ = np.linalg.eigh(inverse @ _hankel(moments[numbers], 1) @ np.swapaxes(inverse, 1, 2))
    # the orthonormal polynomials of each cell at its nodes
    basis = nodes[..., None] ** np.arange(_NODES) @ np.swapaxes(inverse, 1, 2)
    # the weight of a Gauss node is one over the sum of their squares there
    weight = cells.counts[numbers, None] / (basis**2).sum(axis=2)
    fitted = np.einsum("mjk,mkl,cml->cmj", basis, inverse, scaled.right[:, numbers])
    values = fitted + scaled.mean[:, numbers, None]
    position = scaled.centre[numbers, None] + scaled.half[numbers, None] * nodes
    cell = np.repeat(cells.cell[cells.starts[numbers]], _NODES)
    return cell, position.ravel(), values.reshape(len(values), -1), weight.ravel()


def _as_they_are(cells: _Cells, chosen: Mask) -> _Piece:
    """Return all readings of the chosen cells, each with weight 1."""
    rows = np.flatnonzero(np.repeat(chosen, cells.counts))
    return cells.cell[rows], cells.x[rows], cells.values[:, rows], np.ones(len(rows))


def _means(cells: _Cells, scaled: _ScaledCells, chosen: Mask) -> _Piece:
    """Return one reading for each chosen cell: the means of position and values."""
    numbers = np.flatnonzero(chosen)
    position = cells.sums(cells.x)[numbers] / cells.counts[numbers]
    return cells.cell[cells.starts[numbers]], position, scaled.mean[:, numbers], cells.counts[numbers].astype(float)
