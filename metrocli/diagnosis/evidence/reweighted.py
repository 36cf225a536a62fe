"""The products of a state after the weights of some rows have changed, from these rows alone.

Weights `1 + d` of some rows change the products `Y'Y` of columns that are free of the local unknowns, whose orthonormal
columns are L, member by member:

    Y'Y + Y'DY - Y'DL (I + L'DL)^+ L'DY

D and all products on the right have these rows only. D = -I leaves the rows out. Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.evidence.gain import PREDICTED
from metrocli.diagnosis.evidence.likelihood import Fit, Products
from metrocli.diagnosis.evidence.products import local_columns
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.basis import Basis, members_of_equal_size
from metrocli.diagnosis.linear.quadratics import solved
from metrocli.frozen import dataclass

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

_SHOWN = 1e-9
"""Weight of a direction of local unknowns, in that before, below which no row shows it any more; or share of rows of a
member below which its other rows say all of them"""


@dataclass(frozen=True)
class Reweighted:
    """The products of a state after the weights of some rows have changed."""

    products: Products
    """With the shared unknowns"""
    log_det: float
    """ln of the determinant by which the products of the local unknowns have changed"""
    lost: int
    """Number of directions of local unknowns that no row shows any more"""
    member: Index
    """Local member of each of the rows, -1 if it has none, (rows,)"""
    shared: Array
    """What the local unknowns leave of the shared columns, and last of the residual, (rows, p + 1)"""
    local: Array
    """What they leave of the columns of single members, (rows, k)"""
    absorbed: Array
    """Share of each row that the local unknowns absorb, (rows,)"""

    @classmethod
    def of(cls, state: State, rows: Index, change: Array) -> Reweighted:
        """Return the products after the weights of some rows, which are 1, have changed, (rows,)."""
        m, known = state.measurement, _with_unknowns(state)
        every = np.concatenate([state.shared_columns(rows), local_columns(m, state.random)[rows]], axis=1)
        p, weight = len(known.right), change[:, None]
        basis = m.system.basis.of_members.at(rows)
        member, shape = basis.member, (basis.members, basis.local.shape[1], every.shape[1])
        # rows without a member have the number -1, whose local columns belong to somebody else
        lever = np.where(member[:, None] >= 0, basis.local, 0.0)
        order = np.argsort(member, kind="stable")
        begins = np.searchsorted(member[order], np.arange(basis.members + 1))
        squared = np.eye(shape[1]) + _sums(lever[:, :, None] * (weight * lever)[:, None, :], order, begins)
        values, vectors = np.linalg.eigh(squared)
        shown = values > _SHOWN
        root = vectors * np.where(shown, values, np.inf)[:, None] ** -0.5
        inverse = root @ np.swapaxes(root, 1, 2)
        inside = basis.coordinates(weight * every).reshape(shape)
        solved = inverse @ inside
        taken = inside[:, :, : p + 1].reshape(-1, p + 1).T @ solved[:, :, : p + 1].reshape(-1, p + 1)
        shared = every[:, : p + 1]
        # of columns with themselves, which takes half the time, where all weights have changed alike
        alike = np.ptp(change) == 0
        grown = (change[0] * (shared.T @ shared) if alike else shared.T @ (weight * shared)) - taken
        products = replace(
            known,
            gram=known.gram + grown[:p, :p],
            right=known.right + grown[:p, p],
            squares=known.squares + float(grown[p, p]),
        )
        left = every - basis.combined(np.asarray(solved.reshape(-1, shape[2]), dtype=float))
        absorbed = np.einsum("rq,rqs,rs->r", lever, inverse[member], lever) if basis.members else np.zeros(len(rows))
        if shape[2] > p + 1:
            at = m.system.basis.member[rows]
            numbers, mixed, own = np.flatnonzero(np.bincount(at[at >= 0])), known.mixed.copy(), known.own.copy()
            for number, some, w, x in zip(numbers, np.split(order, begins)[1:-1], inside, solved, strict=True):
                more = every[some, p + 1 :].T @ (weight[some] * every[some]) - w[:, p + 1 :].T @ x
                mixed[number] += more[:, : p + 1]
                own[number] += more[:, p + 1 :]
            products, member = replace(products, own=own, mixed=mixed), at
        log_det, lost = float(np.log(values[shown]).sum()), int((~shown).sum())
        return cls(products, log_det, lost, member, left[:, : p + 1], left[:, p + 1 :], absorbed)

    def left(self, fit: Fit, columns: Index | slice = slice(-1)) -> tuple[Array, Array]:
        """Return the share of each row that a fit of all or some columns absorbs, and its residual.

        Both are those of a row of weight 1.
        """
        absorbed, residual, inside = self._beside(fit, columns)
        return absorbed + np.einsum("pr,pr->r", inside, inside), residual

    def predicted(self, fit: Fit, columns: Index) -> tuple[Array, Array, Array]:
        """Return the errors with which a fit of other rows predicts these, their shares, and variances.

        Directions of which the others say nothing, such as the pose of an image that is held out, are taken off: each
        row has a share of what remains.
        """
        absorbed, residual, inside = self._beside(fit, columns)
        variances, shares = 1 + absorbed + np.einsum("pr,pr->r", inside, inside), np.ones(len(residual))
        if (variances > PREDICTED).any():
            hidden = _hidden_directions(inside, PREDICTED)
            residual = residual - hidden @ (hidden.T @ residual)
            shares = np.maximum(1 - np.einsum("rk,rk->r", hidden, hidden), 0.0)
            # before the squares are summed: their difference would be that of large numbers
            known = inside - (inside @ hidden) @ hidden.T
            variances = 1 + absorbed + np.einsum("pr,pr->r", known, known)
        return residual, shares, variances

    def _beside(self, fit: Fit, columns: Index | slice) -> tuple[Array, Array, Array]:
        """Return the share of each row that single members absorb, its residual, and coordinates in the shared columns.

        The coordinates (p, rows) are those of a fit of all or some columns.
        """
        x, residual, absorbed = self.shared[:, columns], self.shared[:, -1], self.absorbed
        if self.local.shape[1]:
            scaled, x = self.local * np.exp(fit.logs[fit.products.of_local] / 2), np.array(x)
            residual, absorbed = residual.copy(), absorbed.copy()
            for member in np.unique(self.member[self.member >= 0]).tolist():
                rows, shown = self.member == member, fit.shown[member]
                errors = scaled[rows] @ fit.half[member].T
                x[rows] -= errors @ shown[:, :-1]
                residual[rows] -= errors @ shown[:, -1]
                absorbed[rows] += (errors**2).sum(axis=1)
        return absorbed, residual - x @ fit.sizes, solved(fit.lower, x.T)


def _hidden_directions(inside: Array, least: float) -> Array:
    """Return the orthonormal directions y, (n, k), of coordinates X (p, n) with `y'X'X y` above `least`.

    Those of `X X'` are the same, and take less time where there are more rows than columns.
    """
    from scipy.linalg import eigh

    p, n = inside.shape
    if not p:
        return np.zeros((n, 0))
    gram = inside @ inside.T if p < n else inside.T @ inside
    values, vectors = eigh(gram, subset_by_value=(least, np.inf), check_finite=False)
    return np.asarray(inside.T @ (vectors / np.sqrt(values)) if p < n else vectors)


def directions_without(basis: Basis, rows: Index) -> tuple[Array, csr_matrix]:
    """Return columns U, (all rows, rows): without some rows `M - U U'` is left of what was `M = I - b b'`, b local.

    `U = M_h R`, with the columns M_h of these rows and `R R' = M_hh^+`, the second returned, member by member: rows of
    different members have nothing in common. A member all of whose rows are left out has no inverse.
    """
    from scipy.sparse import csr_matrix

    member, every = basis.member[rows], np.arange(len(rows))
    alone = every[member < 0]
    places, values = [(alone, alone)], [np.ones(len(alone))]
    for _, at in members_of_equal_size(member, basis.members):
        local = basis.local[rows[at]]
        left, vectors = np.linalg.eigh(np.eye(at.shape[1]) - local @ np.swapaxes(local, 1, 2))
        root = vectors * np.where(left > _SHOWN, left, np.inf)[:, None] ** -0.5 @ np.swapaxes(vectors, 1, 2)
        places.append((np.repeat(at, at.shape[1], axis=1).ravel(), np.tile(at, at.shape[1]).ravel()))
        values.append(root.ravel())
    numbers = tuple(np.concatenate(indices) for indices in zip(*places, strict=True))
    turn = csr_matrix((np.concatenate(values), numbers), shape=(len(rows), len(rows)))
    unit = csr_matrix((np.ones(len(rows)), (rows, every)), shape=(len(basis.local), len(rows)))
    return ((unit - basis.sparse @ basis.sparse[rows].T) @ turn).toarray(), turn


def _sums(values: Array, order: Index, begins: Index) -> Array:
    """Return the sums of values (rows, ...) of each member; rows without a member come first in the order."""
    # each member here has rows of its own: reduceat would give a value, and not 0, for an empty one
    if len(begins) < 2:
        return np.zeros((0, *values.shape[1:]))
    return np.asarray(np.add.reduceat(values[order], begins[:-1], axis=0))


def _with_unknowns(state: State) -> Products:
    """Return the products of a state with the shared unknowns, which are orthonormal, and free of the others."""
    known = state.fit.products
    if not state.members_are_free:
        return known
    k, p = state.measurement.system.basis.shared.shape[1], len(known.right)
    gram = np.eye(k + p)
    gram[k:, k:] = known.gram
    of_shared = np.concatenate([np.full(k, -1), known.of_shared])
    # the residual is free of the unknowns, so that its products with them are 0
    right, mixed = np.concatenate([np.zeros(k), known.right]), np.zeros((*known.mixed.shape[:2], k + p + 1))
    parts = (("unknowns", k), *known.parts)
    return replace(known, gram=gram, right=right, unknowns=k, of_shared=of_shared, mixed=mixed, parts=parts)
