"""Tests of a named effect against each candidate: how alike they are, and whether both are needed.

With G the columns of a candidate beside the fit, N those of the named effect, and v what N explains, only the products
G'G, G'N and G'v are needed. Method: docs/algorithms/selection-and-levels.md (confidence sets).
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.linear.distributions import log_levels
from metrocli.diagnosis.linear.fitted_columns import FittedColumns
from metrocli.diagnosis.linear.quadratics import quadratic, ranks_of, roots
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Named:
    """A named effect beside a fit."""

    columns: Array
    """N, its visible columns without their part in the fitted basis, (rows, q)"""
    scale: Array
    """Norms of its whole columns, (q,)"""
    explained: Array
    """v, what it explains of the residual, (rows,)"""


def against(test_set: ScoreTests, family: int, fitted: FittedColumns, named: Named) -> tuple[Array, Array]:
    """Return the cosine of v with the span of G, and ln of the p-value of N beside the fit and G, (alternatives,) each.

    With the fit and G, N has the Gram matrix `N'N - N'G (G'G)^+ G'N` and the products `N'r - N'G (G'G)^+ G'r`.
    """
    one = test_set.families[family]
    right = np.concatenate([named.columns, fitted.residual[:, None], named.explained[:, None]], axis=1)
    products = one.columns.products(right)
    root = roots(test_set.left(family, fitted).gram, one.raw)
    # coordinates of N, of the residual and of v in an orthonormal basis of G
    along = np.swapaxes(root, 1, 2) @ products
    inside, gains = along[:, :, :-2], (along[:, :, -2] ** 2).sum(axis=1)
    size = max(float(np.linalg.norm(named.explained)), 1e-300)
    cosine = np.linalg.norm(along[:, :, -1], axis=1) / size
    left = named.columns.T @ named.columns - np.swapaxes(inside, 1, 2) @ inside
    rest = named.columns.T @ fitted.residual - np.einsum("kgq,kg->kq", inside, along[:, :, -2])
    gain, rank = quadratic(left, rest, np.broadcast_to(named.scale, rest.shape))
    share, ranks, found = gain / np.maximum(fitted.squares - gains, 1e-300), ranks_of(root), np.zeros(len(gain))
    for q in np.unique(ranks):
        found[ranks == q] = log_levels(share[ranks == q], rank[ranks == q], fitted.dof - float(q))
    return np.minimum(cosine, 1.0), found
