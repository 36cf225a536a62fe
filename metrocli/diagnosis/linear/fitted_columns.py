"""Columns fitted in addition to the unknowns of the model; any of them can be removed again.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.linear.projection import VISIBLE, System
from metrocli.diagnosis.linear.quadratics import whitening

if TYPE_CHECKING:
    from metrocli.diagnosis.linear.columns import Columns

Key = tuple[int, int]
"""Number of a family and of its alternatives"""
PRIOR = 2.0
"""Weight of the declared noise in degrees of freedom: it matters with few readings, not with many"""


@dataclass(frozen=True)
class Left:
    """What a fit leaves of the candidates of a family."""

    gram: Array
    """Gram matrices of their columns without the fitted ones, (alternatives, q, q)"""
    right: Array
    """Products of their columns with the residual, (alternatives, q)"""

    def of(self, chosen: Sequence[int]) -> Left:
        """Return that of some alternatives."""
        return Left(self.gram[list(chosen)], self.right[list(chosen)])

    def with_columns(self, along: Array, amounts: Array) -> Left:
        """Return what is left beside more orthonormal columns b.

        `along` are the products of the candidates with b, (alternatives, q, p), and `amounts` those of b with the
        residual before, (p,).
        """
        return Left(self.gram - along @ np.swapaxes(along, 1, 2), self.right - along @ amounts)

    def without_columns(self, along: Array, amounts: Array) -> Left:
        """Return what is left where orthonormal columns b are removed; arguments as in `with_columns`."""
        return Left(self.gram + along @ np.swapaxes(along, 1, 2), self.right + along @ amounts)


@dataclass
class Known:
    """What a fit leaves of the candidates, as far as it was computed."""

    families: dict[Key, Left] = field(default_factory=dict)
    readings: Array | None = None
    """Gram matrices of the readings' unit errors, (readings, d, d)"""
    gains: tuple[Array, Array] | None = None
    """Reduction of the sum of squares by an error of each reading, and the rank of that error, (readings,) each"""


@dataclass(frozen=True)
class FittedColumns:
    """Columns fitted in addition to the unknowns: an orthonormal basis of their visible part, and the residual."""

    columns: Array
    """Orthonormal columns of a fit without parts, (rows, k)"""
    whole: Array
    """The residual (rows,), that of the fit with all parts where some are removed"""
    squares: float
    """Sum of squares of the residual, with the part that the declared noise adds (`prior`)"""
    dof: float
    prior: float = PRIOR
    """The part of the squares that the declared noise adds"""
    parts: FittedParts | None = None
    """The parts of which it has all, or some"""
    turns: tuple[Array, Array] | None = None
    """From the basis of all parts to that of the parts in the fit (k, j), and to that of those removed (k, p)"""
    known: Known = field(default_factory=Known, compare=False, repr=False)
    """Cache of what the fit leaves of the candidates"""

    @cached_property
    def basis(self) -> Array:
        """The orthonormal basis, (rows, k + j)."""
        if self.parts is None:
            return self.columns
        own = self.parts.basis if self.turns is None else self.parts.basis @ self.turns[0]
        before = self.parts.start.basis
        return np.concatenate([before, own], axis=1) if before.shape[1] else own

    @property
    def width(self) -> int:
        """Number of columns of the basis."""
        if self.parts is None:
            return int(self.columns.shape[1])
        own = self.parts.width if self.turns is None else self.turns[0].shape[1]
        return self.parts.start.width + int(own)

    @cached_property
    def residual(self) -> Array:
        """The residual, (rows,)."""
        if self.parts is None or self.turns is None:
            return self.whole
        removed = self.turns[1]
        return np.asarray(self.whole + self.parts.basis @ (removed @ (removed.T @ self.parts.amounts)))

    def with_columns(self, columns: Array) -> FittedColumns:
        """Return the fit with more columns (rows, q); directions not visible beside the others are ignored."""
        return FittedParts(self).with_part(columns).fitted

    def beside(self, columns: Array) -> Array:
        """Return columns (rows, q) without their part in the fitted basis, which need not be made for it."""
        if self.parts is None:
            return np.asarray(columns - self.columns @ (self.columns.T @ columns)) if self.columns.shape[1] else columns
        along = self.parts.basis.T @ columns
        if self.turns is not None:
            along = self.turns[0] @ (self.turns[0].T @ along)
        return np.asarray(self.parts.start.beside(columns) - self.parts.basis @ along)

    def alone(self) -> FittedColumns:
        """Return the fit for other candidates: without what is known of these, and of its parts."""
        return FittedColumns(self.basis, self.residual, self.squares, self.dof, self.prior)


@dataclass(frozen=True)
class FittedParts:
    """Parts of several columns each, fitted together in addition to a model.

    Each part is stored by its coordinates in a common orthonormal basis, so that the basis without some parts follows
    by a rotation. So do the products of the candidates with it, which need all rows once for each column of the basis.
    """

    start: FittedColumns
    held: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """Orthonormal columns in whose span all parts lie, (rows, m)"""
    turn: Array | None = None
    """From these to the basis of all parts, (m, k); None if they are the basis"""
    parts: tuple[Array, ...] = ()
    """Coordinates of each part's unit columns, (k, q)"""
    before: tuple[Mapping[Key, Array], Array | None] | None = field(default=None, compare=False, repr=False)
    """Products of candidates with another basis, and the turn (m, j) from it to the first j columns; None if equal"""
    products: dict[Key, Array] = field(default_factory=dict, compare=False, repr=False)
    """Cache of the products of candidates with the basis, (alternatives, q, k)"""
    known: Known = field(default_factory=Known, compare=False, repr=False)
    """Cache of what the fit of all parts leaves of the candidates"""

    @cached_property
    def basis(self) -> Array:
        """Orthonormal basis of all parts, (rows, k); few fits without some parts need it."""
        return self.held if self.turn is None else self.held @ self.turn

    @property
    def width(self) -> int:
        """Number of columns of the basis."""
        return int((self.held if self.turn is None else self.turn).shape[1])

    @cached_property
    def amounts(self) -> Array:
        """The products of the basis with the residual at the start, (k,)."""
        along = self.held.T @ self.start.residual
        return np.asarray(along if self.turn is None else self.turn.T @ along)

    @cached_property
    def residual(self) -> Array:
        """The residual beside all parts, (rows,)."""
        return self.start.residual - self.held @ (self.amounts if self.turn is None else self.turn @ self.amounts)

    @property
    def fitted(self) -> FittedColumns:
        """The model with all parts in it."""
        # not kept: a fit holds its parts, and a circle of two would hold the basis until the garbage is collected
        if not self.parts:
            return self.start
        start, squares = self.start, float(self.residual @ self.residual) + self.start.prior
        dof = start.dof - len(self.amounts)
        return FittedColumns(start.columns, self.residual, squares, dof, start.prior, self, None, self.known)

    def along(self, key: Key, columns: Columns) -> Array:
        """Return the products of the columns of a family with the basis, (alternatives, q, k)."""
        if key not in self.products:
            known = np.zeros((columns.count, columns.parameters, 0))
            if self.before is not None and key in self.before[0]:
                known = self.before[0][key] if self.before[1] is None else self.before[0][key] @ self.before[1]
            if known.shape[2] < self.width:
                new = columns.products(self.basis[:, known.shape[2] :])
                known = np.concatenate([known, new], axis=2)
            self.products[key] = known
        return self.products[key]

    def with_part(self, columns: Array, products: Mapping[Key, Array] | None = None) -> FittedParts:
        """Return the fit with one more part (rows, q); directions not visible beside the others are ignored.

        `products` are those of candidates with its columns, as far as known, (alternatives, parameters, q).
        """
        basis = self.basis if self.parts else np.zeros((len(columns), 0))
        norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        own = self.start.beside(columns / norms)
        inside = basis.T @ own
        left = self.start.beside(own - basis @ inside)
        left = left - basis @ (basis.T @ left)
        new, turn = orthonormalised(left, VISIBLE)
        grown = [np.pad(part, ((0, new.shape[1]), (0, 0))) for part in self.parts]
        part = np.concatenate([inside, new.T @ left])
        before = (self.products, None) if self.products else self.before
        found = FittedParts(self.start, np.concatenate([basis, new], axis=1), None, (*grown, part), before)
        if products and not self.start.width:
            known = self.products if self.parts else {key: one[:, :, :0] for key, one in products.items()}
            for key in products.keys() & known.keys():
                added = (products[key] / norms - known[key] @ inside) @ turn
                found.products[key] = np.concatenate([known[key], added], axis=2)
        return found

    def without(self, numbers: Collection[int]) -> FittedColumns:
        """Return the model without some parts."""
        turns = self._turned(numbers)
        along = turns[1].T @ self.amounts
        larger = self.fitted
        squares, dof = larger.squares + float(along @ along), larger.dof + len(along)
        return FittedColumns(self.start.columns, larger.residual, squares, dof, self.start.prior, self, turns)

    def only(self, numbers: Collection[int]) -> FittedParts:
        """Return the fit of some of the parts."""
        gone = set(range(len(self.parts))) - set(numbers)
        kept, _ = self._turned(gone)
        parts = tuple(kept.T @ part for number, part in enumerate(self.parts) if number not in gone)
        if not parts:
            return FittedParts(self.start)
        before = (self.products, kept) if self.products else self.before
        if before is not None and before[0] is not self.products:
            before = _turned_to(before, kept)
        turn = kept if self.turn is None else self.turn @ kept
        return FittedParts(self.start, self.held, turn, parts, before)

    def _turned(self, gone: Collection[int]) -> tuple[Array, Array]:
        """Return orthonormal directions of the basis that stay without the parts `gone`, and those that are removed."""
        k = self.width
        left = [part for number, part in enumerate(self.parts) if number not in gone]
        inside = np.concatenate(left, axis=1) if left else np.zeros((k, 0))
        values, vectors = np.linalg.eigh(inside @ inside.T)
        seen = values > VISIBLE**2
        return vectors[:, seen], vectors[:, ~seen]


def _turned_to(
    before: tuple[Mapping[Key, Array], Array | None], kept: Array
) -> tuple[Mapping[Key, Array], Array] | None:
    """Return products with another basis, and the turn to some directions of this one; None if they lack columns."""
    products, turn = before
    if turn is None:
        turn = np.eye(next((one.shape[2] for one in products.values()), 0))
    return (products, turn @ kept) if turn.shape[1] == len(kept) else None


def orthonormal(columns: Array, least: float) -> Array:
    """Return an orthonormal basis of the span of columns (rows, q), of singular values above `least`."""
    return orthonormalised(columns, least)[0]


def orthonormalised(columns: Array, least: float) -> tuple[Array, Array]:
    """Return an orthonormal basis (rows, k) of the span of columns (rows, q), and the turn (q, k) that gives it.

    It uses the eigenvectors of the Gram matrix (as Cholesky QR does), which is far faster than an SVD for many rows;
    twice where their sizes differ much. Directions of singular values below `least` are left out.
    """
    bound, turn = least**2, np.eye(columns.shape[1])
    for _ in range(2):
        step, even = whitening(columns.T @ columns, bound)
        columns, turn, bound = columns @ step, turn @ step, 0.0
        if even:
            break
    return columns, turn


def nothing_fitted(system: System) -> FittedColumns:
    """Return the fit without additional columns; a declared noise larger than the residuals counts as theirs."""
    r = system.residual
    squares = float(r @ r)
    # a declaration that is too large would otherwise hide effects: it adds at most what the residuals have
    prior = PRIOR * min(1.0, squares / max(system.dof, 1))
    return FittedColumns(np.zeros((system.rows, 0)), r, squares + prior, system.dof + PRIOR, prior)
