"""Score tests of a measurement without some of its readings.

Method: docs/algorithms/selection-and-levels.md (gain).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.linear.candidates import Family
from metrocli.diagnosis.linear.fitted_columns import orthonormalised
from metrocli.diagnosis.linear.projection import VISIBLE
from metrocli.diagnosis.linear.score_tests import Remembered, ScoreTests


def without_rows(test_set: ScoreTests, out: Index) -> ScoreTests:
    """Return the score tests without some rows, which hold all readings of the local members that they use.

    The local unknowns of the other rows do not change. So the shared columns of the rest are made orthonormal anew,
    and their part is taken from all other columns. Rows keep their numbers; those left out are zero. The effective
    numbers of tests stay those of the whole measurement. Effects that scatter throughout are not sought in the rest.
    Gram matrices need the rows left out only:
    `G'G + C'C - H - (C - D)' T T' (C - D)`. C are the products of the shared columns with G, D those of their rows
    left out. H is the Gram matrix of the rows left out without their local columns. T makes the shared columns of the
    rest orthonormal.
    """
    system = test_set.system
    kept = np.ones(system.rows, dtype=bool)
    kept[out] = False
    shared = system.basis.shared.copy()
    shared[out] = 0.0
    # directions that only the rows left out show are no longer there
    shared, turn = orthonormalised(shared, VISIBLE)

    def rest(values: Array) -> Array:
        inside = np.where(kept.reshape(-1, *[1] * (values.ndim - 1)), values, 0.0)
        return np.asarray(inside - np.tensordot(shared, np.tensordot(shared.T, inside, 1), 1))

    def cut(family: Family, along: Array) -> Family:
        own = family.columns.at(~kept)
        gone = own.products(system.basis.shared)
        left = (along - gone) @ turn
        gram = family.gram + along @ np.swapaxes(along, 1, 2) - own.grams(local) - left @ np.swapaxes(left, 1, 2)
        # what only the rows left out show is zero, not the rounding of a difference
        seen = np.einsum("kqq->kq", gram) > (VISIBLE * family.raw) ** 2
        return replace(family, columns=family.columns.only(kept), gram=gram * seen[:, :, None] * seen[:, None, :])

    local = replace(system.basis, shared=system.basis.shared[:, :0])
    basis = replace(system.basis, local=system.basis.local * kept[:, None], shared=shared)
    there = np.where(test_set.places >= 0, kept[test_set.places], False)
    unit = np.eye(test_set.places.shape[1]) * there[:, :, None]
    return replace(
        test_set,
        system=replace(system, basis=basis, residual=rest(system.residual), idle=system.idle + len(out)),
        families=tuple(map(cut, test_set.families, test_set.shared_products)),
        blocks=unit - basis.products(test_set.places, test_set.places),
        excluded=test_set.excluded | ~there.any(axis=1),
        throughout=(),
        remembered=Remembered(),
    )
