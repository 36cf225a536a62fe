"""The restricted likelihood of a variance ratio: unknown sizes that scatter about 0, beside white noise.

Method: docs/algorithms/selection-and-levels.md (all of a kind; smooth processes).
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.linear.fitted_columns import PRIOR, FittedColumns
from metrocli.frozen import dataclass

_SEEN = 1e-4
"""Smallest eigenvalue of a direction that counts, relative to the largest"""
_GRID = np.linspace(-14.0, 14.0, 113)
"""Logarithms of the ratio of variances that are tried, relative to the one at which both parts are equal"""


@dataclass(frozen=True)
class RestrictedLikelihood:
    """The restricted likelihood of the ratio g of the variances of sizes and noise (Patterson and Thompson 1971).

    It is `-(nu ln S + sum ln(1 + g d))/2` with `S = sum y^2/(1 + g d) + rest`. Z are the visible columns of the sizes
    beside a fit, d the eigenvalues of Z'Z, y the coordinates of the residual along them.
    """

    eigenvalues: Array
    vectors: Array
    """Eigenvectors, (columns, eigenvalues)"""
    along: Array
    """Squared coordinates of the residual along the eigenvectors"""
    rest: float
    dof: float

    @classmethod
    def of(cls, base: FittedColumns, gram: Array, right: Array) -> RestrictedLikelihood:
        """Return it for columns by their Gram matrix (k, k) and products with the residual (k,) beside a fit."""
        values, vectors = np.linalg.eigh(gram)
        seen = values > _SEEN * max(float(values[-1]), 1e-300)
        along = (vectors[:, seen].T @ right) ** 2 / values[seen]
        rest = max(base.squares - float(along.sum()), 1e-300)
        return cls(values[seen], vectors[:, seen], along, rest, base.dof)

    @classmethod
    def beside(cls, base: FittedColumns, columns: Array) -> RestrictedLikelihood:
        """Return it for visible columns (rows, k) beside a fit."""
        left = base.beside(columns)
        return cls.of(base, left.T @ left, left.T @ base.residual)

    def squares(self, log_ratio: float) -> float:
        """Return S at a ratio of variances."""
        return float(self._squares(np.array([log_ratio]))[0])

    def _squares(self, log_ratios: Array) -> Array:
        return np.asarray((self.along / (1 + np.exp(log_ratios)[:, None] * self.eigenvalues)).sum(axis=1) + self.rest)

    def likelihood(self, log_ratio: float) -> float:
        """Return the restricted log-likelihood, on the scale of the evidence of a selection."""
        return float(self._likelihoods(np.array([log_ratio]))[0])

    def _likelihoods(self, log_ratios: Array) -> Array:
        grown = np.log1p(np.exp(log_ratios)[:, None] * self.eigenvalues).sum(axis=1)
        return np.asarray(-(self.dof * np.log(self._squares(log_ratios)) + grown) / 2)

    def best(self) -> float:
        """Return ln of the ratio of variances with the largest likelihood; the least one if no column is visible."""
        if len(self.eigenvalues) == 0:
            return float(_GRID[0])
        tried = _GRID - float(np.log(np.median(self.eigenvalues)))
        at = int(np.argmax(self._likelihoods(tried)))
        low, high = float(tried[max(at - 1, 0)]), float(tried[min(at + 1, len(tried) - 1)])
        for _ in range(40):
            third = (high - low) / 3
            if self.likelihood(low + third) < self.likelihood(high - third):
                low += third
            else:
                high -= third
        return (low + high) / 2

    def best_near(self, expected: float, apart: float) -> tuple[float, float]:
        """Return the likeliest ln of the ratio whose expectation and standard deviation are given, and the bend there.

        The bend is minus the second derivative of the log-likelihood, without the expectation.
        """
        tried = expected + apart * np.linspace(-4.0, 4.0, 161)
        best = float(tried[np.argmax(self._likelihoods(tried) - ((tried - expected) / apart) ** 2 / 2)])
        return best, self._bend(best)

    def _bend(self, log_ratio: float) -> float:
        step = 0.05
        low, middle, high = self._likelihoods(log_ratio + np.array([-step, 0.0, step]))
        return float((2 * middle - low - high) / step**2)

    def relative_spread(self, log_ratio: float) -> float:
        """Return the relative standard uncertainty of the standard deviation, from the curvature of the likelihood."""
        return float(0.5 / np.sqrt(max(self._bend(log_ratio), 1e-12)))

    def gain(self, log_ratio: float) -> float:
        """Return by how much the log-likelihood at a ratio exceeds that of no scatter at all."""
        return self.likelihood(log_ratio) + self.dof * float(np.log(self.rest + self.along.sum())) / 2

    def log_level(self, log_ratio: float) -> float:
        """Return ln of the level of the likelihood ratio test: half a chi-squared with one degree of freedom."""
        return log_level_of(self.gain(log_ratio))


def log_level_of(gain: float) -> float:
    """Return ln of the level of a gain by one variance: half a chi-squared with one degree of freedom."""
    from scipy.special import log_ndtr

    return float(log_ndtr(-np.sqrt(max(2 * gain, 0.0))))


def gain_of_larger_noise(base: FittedColumns) -> float:
    """Return by how much the restricted log-likelihood grows if all readings are noisier than declared, by one factor.

    It is `((nu + d) ln((S + p)/(S x + p)) + nu ln x)/2` at its maximum `x = min(1, nu p/(d S))`. S are the squares of
    the residual, p the part and d the degrees of freedom of the declared noise, x the inverse of the squared factor. It
    is large only where the readings are few, of which each then shows an effect of its own.
    """
    squares, rank = max(base.squares - base.prior, 1e-300), max(base.dof - PRIOR, 1.0)
    inverse = min(1.0, rank * base.prior / (PRIOR * squares))
    fitted = (squares + base.prior) / (squares * inverse + base.prior)
    return float((base.dof * np.log(fitted) + rank * np.log(inverse)) / 2)
