"""Columns fitted in addition to the unknowns of the model; any of them can be removed again.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.linear.projection import VISIBLE, System

_EVEN = 0.01
"""Eigenvalue of a Gram matrix, relative to the largest, above which its eigenvectors need no second step"""
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

        `along` are the products of the candidates with b, (alternatives, q, p), `amounts` those of b with the residual
        before, (p,).
        """
        return Left(self.gram - along @ np.swapaxes(along, 1, 2), self.right - along @ amounts)

    def without_columns(self, along: Array, amounts: Array) -> Left:
        """Return what is left without some of the columns b; `amounts` are their products with the residual after."""
        return Left(self.gram + along @ np.swapaxes(along, 1, 2), self.right + along @ amounts)


@dataclass
class Known:
    """What a fit leaves of the candidates, as far as it was computed."""

    families: dict[tuple[int, int], Left] = field(default_factory=dict)
    """By the number of the family and its alternatives"""
    readings: Array | None = None
    """Gram matrices of the readings' unit errors, (readings, d, d)"""


@dataclass(frozen=True)
class Grown:
    """How a fit grew from a smaller one, without that fit: its columns would take memory."""

    known: Known
    """What the smaller fit leaves"""
    added: Array
    """Orthonormal columns that it has not, (rows, p)"""
    amounts: Array
    """Their products with its residual, (p,)"""


@dataclass(frozen=True)
class FittedColumns:
    """Columns fitted in addition to the unknowns: an orthonormal basis of their visible part, and the residual."""

    columns: Array
    """Orthonormal, (rows, k)"""
    residual: Array
    squares: float
    """Sum of squares of the residual, with the part that the declared noise adds (`prior`)"""
    dof: float
    prior: float = PRIOR
    """The part of the squares that the declared noise adds"""
    larger: FittedColumns | None = None
    """The larger model from which columns were removed to give this one, if any"""
    freed: Array | None = None
    """Orthonormal basis of the removed columns, (rows, p)"""
    turned: tuple[Array, Array] | None = None
    """More of the basis: directions (rows, m) and what turns them into it (m, j), which few questions need"""
    grown: Grown | None = field(default=None, compare=False, repr=False)
    """How it grew from a smaller fit, if it did"""
    known: Known = field(default_factory=Known, compare=False, repr=False)
    """Cache of what the fit leaves of the candidates"""

    @cached_property
    def basis(self) -> Array:
        """The orthonormal basis, (rows, k + j)."""
        if self.turned is None:
            return self.columns
        directions, turn = self.turned
        return np.concatenate([self.columns, directions @ turn], axis=1)

    def with_columns(self, columns: Array) -> FittedColumns:
        """Return the fit with more columns (rows, q); directions not visible beside the others are ignored."""
        return FittedParts(self).with_part(columns).fitted

    def beside(self, columns: Array) -> Array:
        """Return columns (rows, q) without their part in the fitted basis."""
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))


@dataclass(frozen=True)
class FittedParts:
    """Parts of several columns each, fitted together in addition to a model.

    Each part is stored by its coordinates in a common orthonormal basis, so that the basis without some parts follows
    by a rotation.
    """

    start: FittedColumns
    basis: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """Orthonormal basis of all parts, (rows, k)"""
    parts: tuple[Array, ...] = ()
    """Coordinates of each part's unit columns, (k, q)"""
    smaller: tuple[Known, int] | None = None
    """What a fit of fewer parts leaves, and how many columns of the basis it has; None for the start"""

    @cached_property
    def fitted(self) -> FittedColumns:
        """The model with all parts in it."""
        if not self.parts:
            return self.start
        start = self.start
        amounts = self.basis.T @ start.residual
        residual = start.residual - self.basis @ amounts
        squares = float(residual @ residual) + start.prior
        basis = np.concatenate([start.basis, self.basis], axis=1)
        known, first = self._smaller
        grown = Grown(known, self.basis[:, first:], amounts[first:])
        return FittedColumns(basis, residual, squares, start.dof - len(amounts), start.prior, grown=grown)

    @property
    def _smaller(self) -> tuple[Known, int]:
        return (self.start.known, 0) if self.smaller is None else self.smaller

    def with_part(self, columns: Array) -> FittedParts:
        """Return the fit with one more part (rows, q); directions not visible beside the others are ignored."""
        basis = self.basis if self.parts else np.zeros((len(columns), 0))
        unit = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        own = unit - self.start.basis @ (self.start.basis.T @ unit)
        inside = basis.T @ own
        left = own - basis @ inside
        left = left - self.start.basis @ (self.start.basis.T @ left)
        left = left - basis @ (basis.T @ left)
        new = orthonormal(left, VISIBLE)
        grown = [np.pad(part, ((0, new.shape[1]), (0, 0))) for part in self.parts]
        part = np.concatenate([inside, new.T @ left])
        # the columns of the basis stay, so what a fit without the new ones leaves is of use
        asked = "fitted" in self.__dict__ and self.fitted.known.families
        smaller = (self.fitted.known, basis.shape[1]) if asked and self.parts else self._smaller
        return FittedParts(self.start, np.concatenate([basis, new], axis=1), (*grown, part), smaller)

    def without(self, numbers: Collection[int]) -> FittedColumns:
        """Return the model without some parts."""
        kept, freed = self._turned(numbers)
        larger, start = self.fitted, self.start
        directions = self.basis @ freed
        along = directions.T @ start.residual
        return FittedColumns(
            start.basis,
            larger.residual + directions @ along,
            larger.squares + float(along @ along),
            larger.dof + freed.shape[1],
            start.prior,
            larger,
            directions,
            (self.basis, kept),
        )

    def only(self, numbers: Collection[int]) -> FittedParts:
        """Return the fit of some of the parts."""
        gone = set(range(len(self.parts))) - set(numbers)
        kept, _ = self._turned(gone)
        parts = tuple(kept.T @ part for number, part in enumerate(self.parts) if number not in gone)
        return FittedParts(self.start, self.basis @ kept, parts) if parts else FittedParts(self.start)

    def _turned(self, gone: Collection[int]) -> tuple[Array, Array]:
        """Return orthonormal directions of the basis that stay without the parts `gone`, and those that are removed."""
        k = self.basis.shape[1]
        left = [part for number, part in enumerate(self.parts) if number not in gone]
        inside = np.concatenate(left, axis=1) if left else np.zeros((k, 0))
        values, vectors = np.linalg.eigh(inside @ inside.T)
        seen = values > VISIBLE**2
        return vectors[:, seen], vectors[:, ~seen]


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
        values, vectors = np.linalg.eigh(columns.T @ columns)
        kept = values > bound
        step = vectors[:, kept] / np.sqrt(values[kept])
        columns, turn, bound = columns @ step, turn @ step, 0.0
        if not kept.any() or values[kept][0] > _EVEN * values[-1]:
            break
    return columns, turn


def nothing_fitted(system: System) -> FittedColumns:
    """Return the fit without additional columns; a declared noise larger than the residuals counts as theirs."""
    r = system.residual
    squares = float(r @ r)
    # a declaration that is too large would otherwise hide effects: it adds at most what the residuals have
    prior = PRIOR * min(1.0, squares / max(system.dof, 1))
    return FittedColumns(np.zeros((system.rows, 0)), r, squares + prior, system.dof + PRIOR, prior)
