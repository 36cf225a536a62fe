"""Joint covariance of many points that share the errors of a few unknowns."""

from __future__ import annotations

from typing import Any

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.tasks.shared.part import Part


@dataclass(frozen=True)
class Joint:
    """Covariance of corrected points: `C_a K C_b'`, plus P for points of one replay, plus `o_a I` for each point.

    The common part is that of the tracers, the datum and the tips.
    """

    common: Array
    """C, (n, 3, k)"""
    core: Array
    """K, (k, k)"""
    replay: Index
    """Row of the replay of each point (n,)"""
    of_replay: Array
    """P of each replay, (replays, 3, 3)"""
    own: Array
    """o, variance of each coordinate of each point (n,)"""

    def each(self) -> Array:
        """Return the covariance of each point, (n, 3, 3)."""
        shared = self.common @ self.core @ np.swapaxes(self.common, 1, 2)
        return np.asarray(shared + self.of_replay[self.replay] + self.own[:, None, None] * np.eye(3))

    def at_reference(self, part: Part, at: Array) -> Joint:
        """Return the covariance of the points of a part at 20 degC, at (n, 3); they share the error of its growth."""
        common, core = part.of_factors(at, self.common, self.core)
        squared = part.shrinkage**2
        return Joint(common, core, self.replay, self.of_replay * squared, self.own * squared)

    def propagated(self, derivative: Any) -> Array:
        """Return `D Q D'` for a derivative D (m, 3n) by the coordinates of all points."""
        from scipy.sparse import block_diag, csr_array

        n = len(self.own)
        towards = derivative @ self.common.reshape(3 * n, -1)
        # sums over the points of each replay: they share its error
        places = csr_array((np.ones(3 * n), (np.arange(3 * n), (3 * self.replay[:, None] + np.arange(3)).ravel())))
        grouped = derivative @ places
        blocks = block_diag(list(self.of_replay[: places.shape[1] // 3]), format="csr")
        alone = derivative.multiply(np.repeat(self.own, 3)[None, :])
        rest = grouped @ blocks @ grouped.T + alone @ derivative.T
        return np.asarray(towards @ self.core @ towards.T + rest.toarray())
