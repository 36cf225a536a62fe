"""Score tests of a measurement without some of its readings.

Method: docs/algorithms/selection-and-levels.md (gain).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.linear.basis import Basis
from metrocli.diagnosis.linear.candidates import Family
from metrocli.diagnosis.linear.columns import Remembered
from metrocli.diagnosis.linear.fitted_columns import (
    FittedColumns,
    FittedParts,
    Key,
    Left,
    nothing_fitted,
    orthonormalised,
)
from metrocli.diagnosis.linear.projection import VISIBLE
from metrocli.diagnosis.linear.quadratics import whitening
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Carried:
    """A member of a fit to all rows, with what is needed to fit it to some of them."""

    key: Key
    columns: Array
    """Its columns without the local unknowns, (rows, p)"""
    shared: Array
    """Products of the shared columns with them, (k, p)"""
    products: Sequence[Array]
    """Products of each family's columns with them, (alternatives, q, p)"""
    norms: Array
    """Norm of each of its whole columns, (p,)"""


def carried(test_set: ScoreTests, fit: FittedParts, members: Iterable[tuple[int, Key]]) -> list[Carried]:
    """Return members of a fit, each given by the number of its part and by family and alternative."""
    basis, found = test_set.system.basis, []
    for number, (family, alternative) in members:
        visible = test_set.visible(family, alternative)
        turn = fit.parts[number] * np.maximum(np.linalg.norm(visible, axis=0), 1e-300)
        shared = test_set.along_shared[family][alternative].T
        products = [
            fit.along((i, own.columns.count), own.columns) @ turn + along @ shared
            for i, (own, along) in enumerate(zip(test_set.families, test_set.along_shared, strict=True))
        ]
        norms = test_set.families[family].raw[alternative]
        found.append(Carried((family, alternative), visible + basis.shared @ shared, shared, products, norms))
    return found


def without_rows(test_set: ScoreTests, out: Index, members: Sequence[Carried] = ()) -> tuple[ScoreTests, FittedColumns]:
    """Return the score tests without some rows, and the fit without further columns there.

    Products of all candidates with some members, which the rest is likely to show as well, are remembered there.

    The rows left out hold all readings of the local members that they use, so the local unknowns of the other rows do
    not change. The shared columns of the rest are made orthonormal anew, and their part is taken from all other
    columns. Rows keep their numbers; those left out are zero. The effective numbers of tests stay those of the whole
    measurement. Effects that scatter throughout are not sought in the rest.

    Products need the rows left out only. The Gram matrix of columns G is
    `G'G + C'C - H - (C - D)' T T' (C - D)`. The product with the residual r is `G'r - F - (C - D)' T T' s`. C are the
    products of the shared columns with G, D those of their rows left out, F those of G with r there. H is the Gram
    matrix of the rows left out without their local columns, s the product of the other rows of the shared columns with
    r. T makes the shared columns of the rest orthonormal.
    """
    rest = _rest(test_set, out, members)
    by_family = [[one.products[i] for one in members] for i in range(len(test_set.families))]
    products = test_set.families, test_set.along_shared, test_set.along_residual, by_family
    families, known, beside = zip(*map(rest.cut, *products), strict=True)
    keys = [(i, own.columns.count) for i, own in enumerate(families)]
    remembered = Remembered()
    for number, one in enumerate(members):
        visible = np.where(rest.kept[:, None], one.columns, 0.0) - rest.shared @ rest.inside[number]
        if (np.linalg.norm(visible, axis=0) > VISIBLE * one.norms).all():
            remembered.visible[one.key] = visible
            remembered.products[one.key] = dict(zip(keys, (its[number] for its in beside), strict=True))
    system = test_set.system
    basis = replace(system.basis, local=system.basis.local * rest.kept[:, None], shared=rest.shared)
    there = np.where(test_set.places >= 0, rest.kept[test_set.places], False)
    unit = np.eye(test_set.places.shape[1]) * there[:, :, None]
    fewer = replace(
        test_set,
        system=replace(system, basis=basis, residual=rest.residual, idle=system.idle + len(out)),
        families=families,
        blocks=unit - basis.products(test_set.places, test_set.places),
        excluded=test_set.excluded | ~there.any(axis=1),
        throughout=(),
        remembered=remembered,
    )
    start = nothing_fitted(fewer.system)
    start.known.families |= dict(zip(keys, known, strict=True))
    return fewer, start


@dataclass(frozen=True)
class _Rest:
    """The shared columns and the residual of the rows that are left, and what the others take from all products."""

    kept: Mask
    local: Basis
    """The local columns of the rows left out"""
    lost: Array
    """Shared columns, residual and members in the rows left out, side by side"""
    ends: Index
    """Where the residual and each member begin in it"""
    turn: Array
    """T"""
    shared: Array
    """The shared columns of the rest, orthonormal, (rows, k)"""
    residual: Array
    """Without the shared columns, (rows,)"""
    amounts: Array
    """`T' s`"""
    inside: Sequence[Array]
    """Products of the shared columns of the rest with each member, (k, p)"""

    def cut(
        self, family: Family, along: Array, right: Array, products: Sequence[Array]
    ) -> tuple[Family, Left, list[Array]]:
        """Return a family in the rest, what it shows there, and its products with each member."""
        own = family.columns.of_rows(~self.kept)
        of_shared, of_residual, *of_members = np.split(own.products(self.lost), self.ends, axis=2)
        left = (along - of_shared) @ self.turn
        gram = family.gram + along @ np.swapaxes(along, 1, 2) - own.grams(self.local) - left @ np.swapaxes(left, 1, 2)
        # what only the rows left out show is zero, not the rounding of a difference
        seen = np.einsum("kqq->kq", gram) > (VISIBLE * family.raw) ** 2
        gram *= seen[:, :, None] * seen[:, None, :]
        still = Left(gram, (right - of_residual[:, :, 0] - left @ self.amounts) * seen)
        beside = [one - own - left @ its for one, own, its in zip(products, of_members, self.inside, strict=True)]
        return replace(family, columns=family.columns.only(self.kept), gram=gram), still, beside


def _rest(test_set: ScoreTests, out: Index, members: Sequence[Carried]) -> _Rest:
    system = test_set.system
    kept = np.ones(system.rows, dtype=bool)
    kept[out] = False
    gone = system.basis.at(out)
    several = [gone.shared, system.residual[out, None], *(one.columns[out] for one in members)]
    # directions that only the rows left out show are no longer there; of many readings one table of them is made
    turn, even = whitening(system.basis.gram_of_shared - gone.gram_of_shared, VISIBLE**2)
    shared = system.basis.shared @ turn
    shared[out] = 0.0
    if not even:
        shared, again = orthonormalised(shared, VISIBLE)
        turn = turn @ again
    residual = np.where(kept, system.residual, 0.0)
    amounts = shared.T @ residual
    residual -= shared @ amounts
    return _Rest(
        kept,
        replace(gone, shared=gone.shared[:, :0]),
        np.concatenate(several, axis=1),
        np.cumsum([one.shape[1] for one in several])[:-1],
        turn,
        shared,
        residual,
        amounts,
        [turn.T @ (one.shared - gone.shared.T @ one.columns[out]) for one in members],
    )
