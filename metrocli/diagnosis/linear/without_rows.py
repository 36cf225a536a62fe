"""Score tests of a measurement without some of its readings.

Method: docs/algorithms/selection-and-levels.md (gain).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.linear.candidates import Family
from metrocli.diagnosis.linear.fitted_columns import (
    FittedColumns,
    Left,
    nothing_fitted,
    orthonormalised,
)
from metrocli.diagnosis.linear.projection import VISIBLE
from metrocli.diagnosis.linear.quadratics import whitening
from metrocli.diagnosis.linear.score_tests import Remembered, ScoreTests


def without_rows(test_set: ScoreTests, out: Index) -> tuple[ScoreTests, FittedColumns]:
    """Return the score tests without some rows, and the fit without further columns there.

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
    system = test_set.system
    kept = np.ones(system.rows, dtype=bool)
    kept[out] = False
    gone = system.basis.at(out)
    local = replace(gone, shared=gone.shared[:, :0])
    both = np.concatenate([gone.shared, system.residual[out, None]], axis=1)
    # directions that only the rows left out show are no longer there; of many readings one table of them is made
    turn, even = whitening(system.basis.shared.T @ system.basis.shared - gone.shared.T @ gone.shared, VISIBLE**2)
    shared = system.basis.shared @ turn
    shared[out] = 0.0
    if not even:
        shared, again = orthonormalised(shared, VISIBLE)
        turn = turn @ again
    residual = np.where(kept, system.residual, 0.0)
    amounts = shared.T @ residual
    residual -= shared @ amounts

    def cut(family: Family, along: Array, right: Array) -> tuple[Family, Left]:
        own = family.columns.of_rows(~kept)
        lost = own.products(both)
        left = (along - lost[:, :, :-1]) @ turn
        gram = family.gram + along @ np.swapaxes(along, 1, 2) - own.grams(local) - left @ np.swapaxes(left, 1, 2)
        # what only the rows left out show is zero, not the rounding of a difference
        seen = np.einsum("kqq->kq", gram) > (VISIBLE * family.raw) ** 2
        gram *= seen[:, :, None] * seen[:, None, :]
        still = Left(gram, (right - lost[:, :, -1] - left @ amounts) * seen)
        return replace(family, columns=family.columns.only(kept), gram=gram), still

    families, known = zip(*map(cut, test_set.families, *test_set.basic_products), strict=True)
    basis = replace(system.basis, local=system.basis.local * kept[:, None], shared=shared)
    there = np.where(test_set.places >= 0, kept[test_set.places], False)
    unit = np.eye(test_set.places.shape[1]) * there[:, :, None]
    fewer = replace(
        test_set,
        system=replace(system, basis=basis, residual=residual, idle=system.idle + len(out)),
        families=families,
        blocks=unit - basis.products(test_set.places, test_set.places),
        excluded=test_set.excluded | ~there.any(axis=1),
        throughout=(),
        remembered=Remembered(),
    )
    start = nothing_fitted(fewer.system)
    start.known.families |= {(i, own.columns.count): known[i] for i, own in enumerate(families)}
    return fewer, start
