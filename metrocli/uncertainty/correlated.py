"""Random draws of correlated quantities."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.uncertainty.distributions import Distribution, Sampled

CLIP = 1e-12
"""Eigenvalues below this share of the largest are rounding errors and count as 0"""


def factor(covariance: Array) -> Array:
    """Return F (n, rank) with `F F' = covariance`; tiny negative eigenvalues count as 0."""
    std = np.sqrt(np.diag(covariance))
    scale = np.where(std > 0, std, 1.0)
    values, vectors = np.linalg.eigh(covariance / scale[:, None] / scale)
    kept = values > CLIP * max(float(values[-1]), 1.0)
    root: Array = scale[:, None] * vectors[:, kept] * np.sqrt(values[kept])
    return root


@dataclass(frozen=True)
class JointDistribution:
    """Jointly normal quantities (JCGM 101, 6.4.8), or jointly t where their dof is finite (JCGM 102, 5.3.2.4)."""

    indices: tuple[int, ...]
    factor: Array
    """(k, rank): factor factor' is the covariance"""
    dof: float = math.inf

    def __call__(self, rng: np.random.Generator, count: int) -> Sequence[tuple[int, Array]]:
        values = self.factor @ rng.standard_normal((self.factor.shape[1], count))
        if math.isfinite(self.dof):
            # one chi-square for all: they share one estimate of the noise, and would otherwise not be jointly t
            values /= np.sqrt(rng.chisquare(self.dof, count) / self.dof)
        return list(zip(self.indices, values, strict=True))


@dataclass(frozen=True)
class DrawnRows:
    """Values of an earlier evaluation, drawn row by row, which keeps their joint distribution."""

    indices: tuple[int, ...]
    shapes: tuple[Sampled, ...]

    def __call__(self, rng: np.random.Generator, count: int) -> Sequence[tuple[int, Array]]:
        rows = rng.integers(len(self.shapes[0].deviations), size=count)
        return [(i, np.asarray(shape.deviations)[rows]) for i, shape in zip(self.indices, self.shapes, strict=True)]


@dataclass(frozen=True)
class Dependent:
    """Quantities of any distributions with given correlations (Cario and Nelson 1997, "normal to anything").

    Correlated normal numbers are drawn and transformed by the quantile function of each quantity. The correlations of
    the normal numbers are chosen so that the transformed quantities have the given correlations.
    """

    indices: tuple[int, ...]
    distributions: tuple[Distribution, ...]
    factor: Array

    @classmethod
    def of(cls, indices: tuple[int, ...], distributions: Sequence[Distribution], correlation: Array) -> Dependent:
        """Return the draw of quantities with a correlation matrix.

        Raises UnreachableError if two distributions cannot have their correlation.
        """
        normal = np.eye(len(indices))
        for i in range(len(indices)):
            for j in range(i):
                wanted = float(correlation[i, j])
                try:
                    normal[i, j] = normal[j, i] = _normal_correlation(distributions[i], distributions[j], wanted)
                except UnreachableError as error:
                    error.between = (indices[i], indices[j])
                    raise
        # correlations found pair by pair need not be those of one distribution: the factor takes the nearest
        # semi-definite matrix, whose rows are scaled back to variance 1
        root = factor(normal)
        root /= np.linalg.norm(root, axis=1)[:, None]
        return cls(indices, tuple(distributions), root)

    def __call__(self, rng: np.random.Generator, count: int) -> Sequence[tuple[int, Array]]:
        from scipy.special import ndtr

        probability = ndtr(self.factor @ rng.standard_normal((self.factor.shape[1], count)))
        # a probability that rounds to 1 would give an infinite value
        np.clip(probability, 1e-300, 1 - 2**-53, out=probability)
        drawn = zip(self.indices, self.distributions, probability, strict=True)
        return [(index, distribution.quantile(p)) for index, distribution, p in drawn]


class UnreachableError(ValueError):
    """Error for two distributions that cannot have the given correlation."""

    between: tuple[int, int]
    """Their indices among the quantities"""

    def __init__(self, largest: float) -> None:
        super().__init__(f"quantities of these shapes can have a correlation up to {largest:.3g} only")


def _normal_correlation(a: Distribution, b: Distribution, wanted: float) -> float:
    """Return the correlation of two normal numbers that gives `wanted` after the quantile transformation."""
    # of two symmetric shapes of one kind 1 is reached by 1, where the quadrature would stay just below
    if wanted == 0 or (type(a) is type(b) and abs(wanted) == 1 and _symmetric(a)):
        return wanted
    nodes, weights = np.polynomial.hermite_e.hermegauss(64)
    weights = weights / weights.sum()
    first = _standard(a, nodes)
    # interpolated: the quantile function of some shapes is far too slow for 64 x 64 values in each of 50 steps
    second_grid = np.linspace(-8.5, 8.5, 4001)
    second = _standard(b, second_grid)

    def reached(rho: float) -> float:
        # the partner of a normal number with correlation rho, so that a product rule over two independent ones suffices
        partner = rho * nodes[:, None] + math.sqrt(max(1 - rho * rho, 0.0)) * nodes
        values = np.interp(partner, second_grid, second)
        return float(weights @ (first[:, None] * values) @ weights) / norm

    norm = math.sqrt(float(weights @ first**2) * float(weights @ np.interp(nodes, second_grid, second) ** 2))
    limit = math.copysign(1.0, wanted)
    largest = reached(limit)
    if abs(largest) < abs(wanted) - 1e-3:
        raise UnreachableError(largest)
    low, high = 0.0, limit
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if abs(reached(middle)) < abs(wanted) else (low, middle)
    return (low + high) / 2


def _symmetric(a: Distribution) -> bool:
    return bool(abs(float(a.quantile(np.array([0.1]))[0] + a.quantile(np.array([0.9]))[0])) < 1e-9 * a.std)


def _standard(a: Distribution, at: Array) -> Array:
    """Return the quantiles of a distribution at normal numbers, with mean 0."""
    from scipy.special import ndtr

    # an unbounded shape has an infinite value where the probability rounds to 0 or 1
    p = np.clip(ndtr(at), 1e-15, 1 - 1e-15)
    return a.quantile(p)
