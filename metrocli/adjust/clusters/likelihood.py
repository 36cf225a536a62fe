"""How much larger errors are in the first unknowns than white noise is, by restricted likelihood.

Method: docs/algorithms/cluster-robust-covariance.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.clusters.spread import ActingDirections, ClusterDirections, Excess
from metrocli.arrays import Array
from metrocli.frozen import dataclass

_START, _MOST = 0.5, 8.0
"""First and largest `ln(1 + excess)` of both parts, in a direction of average strength; above, rounding is in it"""
_TOLERANCE = 1e-3
"""Change of -2 ln of the likelihood, for each degree of freedom, below which the search ends"""
_ROUNDING = 1e-13
"""Least information about a direction of the unknowns that the excess leaves, of 1"""


@dataclass(frozen=True)
class Likelihood:
    """Restricted likelihood of readings whose covariance within each cluster is Omega, times a factor for all."""

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
    def of(
        cls, clusters: Sequence[ClusterDirections], acting: Sequence[ActingDirections], square: float, dof: float
    ) -> Likelihood:
        """Return the likelihood from what each cluster sees, and from where the first unknowns act in it."""
        pairs = list(zip(clusters, acting, strict=True))
        seen = np.concatenate([cluster.rows.T @ directions.u for cluster, directions in pairs], axis=1)
        strength = np.concatenate([directions.strength for directions in acting])
        residual = np.concatenate([directions.u.T @ cluster.residual for cluster, directions in pairs])
        # information other than of the directions seen is 1, and adds nothing
        # R of QR has the same products, with as few rows as there are coordinates
        return cls(np.asarray(np.linalg.qr(seen, mode="r")), strength, residual, square, dof)

    def misfit(self, excess: Excess) -> float:
        """Return -2 ln of the restricted likelihood, with the factor that is most likely beside an excess."""
        more = excess.at(self.strength)
        # `Omega^-1 = I - u diag(taken) u'` (Woodbury), so that only the directions u have to be weighted anew
        taken = more / (1 + more)
        half = self.seen * np.sqrt(taken)
        information = np.eye(len(half)) - half @ half.T
        right = self.seen @ (taken * self.residual)
        values, vectors = np.linalg.eigh(information)
        # unknowns that are nearly undetermined leave a direction of rounding, which can be below 0
        values = np.maximum(values, _ROUNDING)
        square = self.square - taken @ self.residual**2 - ((vectors.T @ right) ** 2 / values).sum()
        lndet = np.log1p(more).sum() + np.log(values).sum()
        # dof ln(square) is what is left of the likelihood after its most likely common factor has been put in
        return float(lndet + self.dof * np.log(square))


def most_likely(known: Likelihood) -> Excess:
    """Return the most likely excess; both of its parts are 0 or larger."""
    from scipy.optimize import minimize

    # in units of the average strength both parts have logarithms of the same order, which L-BFGS needs
    unit = max(float(known.strength.mean()), np.finfo(float).tiny)

    def excess(logs: Array) -> Excess:
        level, size = np.expm1(logs)
        return Excess(float(level), float(size / unit))

    optimum = minimize(
        lambda logs: known.misfit(excess(logs)),
        np.full(2, _START),
        method="L-BFGS-B",
        # not below 0: errors that are smaller than white noise would make the lens surer than its readings
        bounds=[(0.0, _MOST)] * 2,
        options={"ftol": _TOLERANCE / known.dof},
    )
    return excess(optimum.x)
