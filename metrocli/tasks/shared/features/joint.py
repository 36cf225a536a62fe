"""Joint covariance of many points that share the errors of a few unknowns."""

from __future__ import annotations

from typing import Any

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.tasks.shared.part import Part


@dataclass(frozen=True)
class JointCovariance:
    """Covariance of corrected points: `C_a K C_b'`, plus P for points of one replay, plus `o_a I` for each point.

    K is the covariance of what all points share, such as the tracers, the datum and the tips; C are the derivatives by
    it. A replay is the reflector's stop at the place of a probed point: points that were probed there share its error.
    """

    common: Array
    """C, (n, 3, k)"""
    core: Array
    """K, (k, k)"""
    replay: Index
    """Row of the replay of each point (n,)"""
    of_replay: Array
    """P of each replay, (replays, 3, 3)"""
    own_variance: Array
    """o, variance of each coordinate of each point (n,)"""

    def of_points(self) -> Array:
        """Return the covariance of each point, (n, 3, 3)."""
        shared = self.common @ self.core @ np.swapaxes(self.common, 1, 2)
        return np.asarray(shared + self.of_replay[self.replay] + self.own_variance[:, None, None] * np.eye(3))

    def at_reference(self, part: Part, points: Array) -> JointCovariance:
        """Return the covariance of the points (n, 3) of a part at 20 degC; they share the error of its growth."""
        common, core = part.of_factors(points, self.common, self.core)
        shrunk = part.shrinkage**2
        return JointCovariance(common, core, self.replay, self.of_replay * shrunk, self.own_variance * shrunk)

    def propagated(self, derivative: Any) -> Array:
        """Return `D Q D'` for a sparse derivative D (m, 3n) by the coordinates of all points; Q is never formed."""
        from scipy.sparse import block_diag, csr_array

        by_shared = derivative @ self.common.reshape(3 * len(self.replay), -1)
        # 1 from each coordinate of a point to that of its replay: D times this sums over the points of each replay
        at_replay = (3 * self.replay[:, None] + np.arange(3)).ravel()
        entries = np.ones(len(at_replay)), (np.arange(len(at_replay)), at_replay)
        by_replay = derivative @ csr_array(entries, shape=(len(at_replay), 3 * len(self.of_replay)))
        replays = block_diag(list(self.of_replay), format="csr")
        weighted = derivative.multiply(np.repeat(self.own_variance, 3)[None, :])
        independent = by_replay @ replays @ by_replay.T + weighted @ derivative.T
        return np.asarray(by_shared @ self.core @ by_shared.T + independent.toarray())
