"""How differently clusters of readings see the unknowns that all of them use: one variance, by restricted likelihood.

Method: docs/algorithms/cluster-robust-covariance.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.singular_values import thin_svd
from metrocli.adjust.cluster_spread import Seen
from metrocli.frozen import dataclass

_RANGE = np.log([1e-3, 1e5])
"""Range of the variance, in units in which an average direction of a cluster has twice the noise with 1"""
_TOLERANCE = 0.01
"""Of the logarithm of the variance"""


@dataclass(frozen=True)
class Deviations:
    """Restricted likelihood of readings whose covariance within a cluster is `I + size F_1 F_1'`, times a factor.

    F_1 are the derivatives by the first unknowns, in coordinates in which they have the covariance 1.
    """

    seen: Array
    """`F'u`, (basis, directions), u the directions of all clusters in which F_1 acts"""
    strength: Array
    """Eigenvalues of `F_1 F_1'`, (directions,)"""
    residual: Array
    """`u'r`, (directions,)"""
    square: float
    """Sum of all squared residuals"""
    dof: float
    """Degrees of freedom of the adjustment"""

    @classmethod
    def of(cls, clusters: Sequence[Seen], first: slice, square: float, dof: float) -> Deviations:
        """Return the likelihood from what each cluster sees; `first` are the coordinates of the first unknowns."""
        parts = [thin_svd(one.rows[:, first])[:2] for one in clusters]
        seen = np.concatenate([one.rows.T @ u for one, (u, _) in zip(clusters, parts, strict=True)], axis=1)
        strength = np.concatenate([values**2 for _, values in parts])
        residual = np.concatenate([u.T @ one.residual for one, (u, _) in zip(clusters, parts, strict=True)])
        return cls(np.linalg.qr(seen, mode="r"), strength, residual, square, dof)

    def misfit(self, size: float) -> float:
        """Return -2 ln of the restricted likelihood of a size, with the factor that is most likely beside it."""
        taken = size * self.strength / (1 + size * self.strength)
        information = np.eye(len(self.seen)) - (self.seen * taken) @ self.seen.T
        right = self.seen @ (taken * self.residual)
        square = self.square - taken @ self.residual**2 - right @ np.linalg.solve(information, right)
        lndet = np.log1p(size * self.strength).sum() + np.linalg.slogdet(information)[1]
        return float(lndet + self.dof * np.log(square))


def most_likely(clusters: Sequence[Seen], first: slice, square: float, dof: float) -> float:
    """Return the most likely size; 0 if none makes the readings more likely."""
    from scipy.optimize import minimize_scalar

    known = Deviations.of(clusters, first, square, dof)
    unit = np.log(max(float(known.strength.mean()), np.finfo(float).tiny))
    best = minimize_scalar(
        lambda log: known.misfit(float(np.exp(log - unit))),
        bounds=_RANGE,
        method="bounded",
        options={"xatol": _TOLERANCE},
    )
    return float(np.exp(best.x - unit)) if best.fun < known.misfit(0.0) else 0.0
