"""The evidence of fixed columns, given the unknowns and the random parts of a state.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.evidence.prices import gain_of_columns
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Given:
    """Products of the columns of fixed parts, without what unknowns and random parts take of them."""

    gram: Array
    """(k, k)"""
    right: Array
    """With what these leave of the residual, (k,)"""
    squares: float
    """Squares of the residual that these leave"""
    dof: float
    ranks: tuple[int, ...]
    """Number of columns of each part"""

    def _columns(self, parts: Sequence[int]) -> Array:
        ends = np.cumsum([0, *self.ranks])
        return np.concatenate([np.arange(ends[j], ends[j + 1]) for j in parts] or [np.zeros(0, dtype=np.intp)])

    def evidence(self, parts: Sequence[int]) -> float:
        """Return the sum of the evidence of some parts, each beside those before it."""
        at = self._columns(parts)
        if not at.size:
            return 0.0
        ranks = [self.ranks[j] for j in parts]
        return _in_turn(self.gram[np.ix_(at, at)], self.right[at], ranks, self.squares, self.dof)


def _in_turn(gram: Array, right: Array, ranks: Sequence[int], squares: float, dof: float) -> float:
    """Return the sum of the evidence of fixed columns, each beside those before it."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    unit = gram / scale / scale[:, None]
    lower = np.linalg.cholesky(unit + 1e-12 * np.eye(len(unit)))
    found = np.linalg.solve(lower, right / scale) ** 2
    # a column that depends on those before it explains nothing
    found = np.where(np.diag(lower) > 1e-5, found, 0.0)
    total, at = 0.0, 0
    for rank in ranks:
        t = float(found[at : at + rank].sum())
        total += float(gain_of_columns(np.array(t), np.array(rank), squares, dof))
        squares, dof, at = max(squares - t, 1e-300), dof - rank, at + rank
    return total
