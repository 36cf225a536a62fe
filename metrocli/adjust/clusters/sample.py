"""What the errors of each cluster of readings change, and the covariance of all unknowns that follows from it.

Method: docs/algorithms/cluster-robust-covariance.md.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from metrocli.adjust.clusters.likelihood import Likelihood, most_likely
from metrocli.adjust.clusters.rows import ClusterRows
from metrocli.adjust.clusters.spread import (
    ActingDirections,
    ClusterDirections,
    ClusterSpread,
    Excess,
    products,
    spreads,
)
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass

_MOSTLY = 0.5
"""Share of a variance from a single cluster above which it has the degrees of freedom of the factor"""
_TINY = 1e-300
"""Divisor in the place of 0"""
_RANK = 1e-12
"""Smallest eigenvalue of a correlation matrix that is not a movement of a free network"""


@dataclass(frozen=True)
class ClusterUnknowns:
    """Unknowns that only one cluster uses, such as the pose of an image: `o = noise + K s`, s the shared unknowns."""

    columns: Index
    noise: Array
    """Their covariance with the shared unknowns held, for independent errors, (k, k)"""
    by_shared: Array
    """K, (k, shared)"""


@dataclass(frozen=True)
class ClusterSample:
    """What the errors of each cluster change, and the covariance that follows from it.

    All is in coordinates z with `s = L z`, in which the shared unknowns s have the covariance 1 for independent errors.
    """

    shared: Mask
    """The unknowns of more than one cluster, (unknowns,)"""
    root: Array
    """L with `L L'` the covariance of the shared unknowns for independent errors, (shared, coordinates)"""
    parts: tuple[slice, ...]
    """Coordinates of the first unknowns (the lens), then the further ones of the others (points)"""
    clusters: tuple[ClusterSpread, ...]
    own: tuple[ClusterUnknowns, ...]
    prior: Array
    """P, the information of the rows whose errors are independent, (coordinates, coordinates)"""
    excess: Excess
    """How much larger the errors expected in the first coordinates are than white noise"""
    grows: bool = True
    """Whether the errors of what only one cluster determines grow as those of the shared unknowns do"""

    @classmethod
    def of(cls, white: Array, rows: ClusterRows, first: Mask, dof: float, grows: bool = True) -> ClusterSample:
        """Return the sample of an adjustment; `white` is the covariance of its shared unknowns for independent errors.

        `first` (unknowns,) are those in which errors may exceed white noise; their variances have a factor of their
        own. `dof` are the degrees of freedom of the adjustment. `grows` is whether what only one cluster determines
        has the factor of the others.
        """
        shared = rows.shared
        root, parts = _root(white, first[shared])
        numbers = np.cumsum(shared) - 1
        projected, own = [], []
        for cluster in rows.of_clusters:
            # unknowns of this cluster alone are projected out, as a pose is of the rows of its image
            common = shared[cluster.columns]
            at = numbers[cluster.columns[common]]
            basis, triangle = np.linalg.qr(cluster.jacobian[:, ~common])
            coupling = basis.T @ cluster.jacobian[:, common]
            projected.append(
                ClusterDirections.of((cluster.jacobian[:, common] - basis @ coupling) @ root[at], cluster.residual)
            )
            inverse = np.linalg.inv(triangle)
            by_shared = np.zeros((len(triangle), len(root)))
            by_shared[:, at] = -inverse @ coupling
            own.append(ClusterUnknowns(cluster.columns[~common], inverse @ inverse.T, by_shared))
        known = [cluster.jacobian @ root[numbers[cluster.columns]] for cluster in rows.others]
        prior = (
            np.sum([jacobian.T @ jacobian for jacobian in known], axis=0) if known else np.zeros((root.shape[1],) * 2)
        )
        square = float(sum(cluster.residual @ cluster.residual for cluster in (*rows.of_clusters, *rows.others)))
        has_first = first[shared].any()
        acting = [ActingDirections.of(cluster, parts[0]) for cluster in projected]
        # without first unknowns an excess is the same as a factor on all errors
        excess = most_likely(Likelihood.of(projected, acting, square, dof)) if has_first else Excess()
        return cls(shared, root, parts, spreads(projected, acting, excess, prior), tuple(own), prior, excess, grows)

    @cached_property
    def expected(self) -> Array:
        """T, the covariance that the expected errors of the clusters give, `sum F' Omega F`."""
        return np.asarray(np.sum([cluster.information for cluster in self.clusters], axis=0))

    @cached_property
    def white(self) -> float:
        """Sum of the variances that white noise of the clusters gives, `tr sum F'F`."""
        return float(sum((cluster.projected.sizes**2).sum() for cluster in self.clusters))

    @cached_property
    def empirical(self) -> Array:
        """W, the covariance that the errors of the clusters give as they are, `sum change change'` (CR2)."""
        changes = np.array([cluster.change for cluster in self.clusters])
        return np.asarray(changes.T @ changes)

    @cached_property
    def factors(self) -> tuple[float, ...]:
        """`tr W_pp / tr T_pp` of each part p: how many times the expected variance the clusters have."""
        empirical, expected = np.diag(self.empirical), np.diag(self.expected)
        return tuple(
            float(empirical[part].sum() / expected[part].sum()) if expected[part].sum() > 0 else 1.0
            for part in self.parts
        )

    @cached_property
    def factor(self) -> float:
        """`tr W / tr sum F'F`: how many times the variance of white noise the clusters have, on average."""
        return float(np.trace(self.empirical) / self.white)

    @property
    def own_factor(self) -> float:
        """Factor, at least 1, on the variance that independent errors give to what only one cluster determines."""
        return max(self.factor, 1.0) if self.grows else 1.0

    @cached_property
    def alone(self) -> Array:
        """The covariance that independent errors give to what only one cluster determines."""
        return np.asarray(
            np.sum([cluster.projected.alone @ cluster.projected.alone.T for cluster in self.clusters], axis=0)
        )

    @cached_property
    def shrinkage_target(self) -> Array:
        """What W is shrunk towards: T, each part scaled to its variance in W by its factor."""
        scale = np.concatenate(
            [
                np.full(part.stop - part.start, factor**0.5)
                for part, factor in zip(self.parts, self.factors, strict=True)
            ]
        )
        return np.asarray(self.expected * scale * scale[:, None])

    @cached_property
    def shrinkage(self) -> float:
        """Share of the shrinkage target, `min(1, (sum |z|^4 - |W|^2/m) / |W - target|^2)` (Ledoit and Wolf 2004)."""
        squares, m = np.array([cluster.change @ cluster.change for cluster in self.clusters]), len(self.clusters)
        # sum over clusters of |z z' - W/m|^2, the scatter of their outer products
        scatter = float((squares**2).sum() - (self.empirical**2).sum() / m)
        distance = float(((self.empirical - self.shrinkage_target) ** 2).sum())
        return min(scatter / distance, 1.0) if distance > 0 else 1.0

    def of_coordinates(self) -> Array:
        """Return the covariance of the coordinates: shrunk, with the priors, and in no direction below 1."""
        matrix = (
            (1 - self.shrinkage) * self.empirical
            + self.shrinkage * self.shrinkage_target
            + self.prior
            + self.own_factor * self.alone
        )
        values, vectors = np.linalg.eigh(matrix)
        # 1 is the covariance for independent errors in these coordinates: no standard uncertainty falls below it
        return np.asarray((vectors * np.maximum(values, 1.0)) @ vectors.T)

    def of_shared(self) -> Array:
        """Return the covariance of the shared unknowns, (shared, shared)."""
        return np.asarray(self.root @ self.of_coordinates() @ self.root.T)

    def covariance(self) -> Array:
        """Return the covariance of all unknowns, (unknowns, unknowns)."""
        common = np.flatnonzero(self.shared)
        v = self.of_shared()
        if len(common) == len(self.shared):
            return v
        columns = np.concatenate([unknowns.columns for unknowns in self.own])
        by_shared = np.concatenate([unknowns.by_shared for unknowns in self.own])
        mixed = by_shared @ v
        full = np.zeros((len(self.shared),) * 2)
        full[np.ix_(common, common)] = v
        full[np.ix_(columns, common)], full[np.ix_(common, columns)] = mixed, mixed.T
        full[np.ix_(columns, columns)] = mixed @ by_shared.T
        for unknowns in self.own:
            full[np.ix_(unknowns.columns, unknowns.columns)] += self.own_factor * unknowns.noise
        return (full + full.T) / 2

    def dof(self, columns: Index) -> Array:
        """Return the degrees of freedom of the variances of some unknowns, (k,).

        Satterthwaite's `2 E^2 / Var` of the estimated variance, a quadratic form of the residuals, for the expected
        errors (Bell and McCaffrey 2002). An unknown counts for the part that it depends on most; those of a single
        cluster have the degrees of freedom of the least certain factor.
        """
        numbers = np.cumsum(self.shared) - 1
        lines = self.root[numbers[columns[self.shared[columns]]]].T
        lines = lines / np.linalg.norm(lines, axis=0)
        weights = np.array([(lines[part] ** 2).sum(axis=0) for part in self.parts])
        by_part = [self._dof(lines, part, factor) for part, factor in zip(self.parts, self.factors, strict=True)]
        # what one cluster alone determines shows nothing of its own errors, so it borrows the factor and its certainty
        of_own = min(alone for _, alone in by_part)
        dofs = np.full(len(columns), of_own)
        shared = np.choose(weights.argmax(axis=0), [dofs for dofs, _ in by_part])
        alone = (lines * (self.alone @ lines)).sum(axis=0) > _MOSTLY
        dofs[self.shared[columns]] = np.where(alone, of_own, shared)
        return dofs

    def _dof(self, lines: Array, part: slice, factor: float) -> tuple[Array, float]:
        """Return the degrees of freedom of the variances along lines (coordinates, k), and of the factor of a part."""
        # the form is sum z' M z over the changes z, with M = own l l' + rest E, E the coordinates of the part
        trace = float(np.diag(self.expected)[part].sum())
        along = (lines * (self.expected @ lines)).sum(axis=0)
        own, rest = 1 - self.shrinkage, self.shrinkage * along / trace
        pairs, lengths, norms = products(self.clusters, self.expected + self.prior, lines, part)
        variance = 2 * (own**2 * pairs + 2 * own * rest * lengths + rest**2 * norms)
        mean = factor * along + (lines * (self.prior @ lines)).sum(axis=0)
        return 2 * mean**2 / np.maximum(factor**2 * variance, _TINY), trace**2 / norms


def _root(white: Array, first: Mask) -> tuple[Array, tuple[slice, ...]]:
    """Return L, (shared, coordinates), with `L L'` the covariance of the shared unknowns for independent errors.

    The first coordinates are those of the first unknowns (mask over the shared ones); the further ones are what the
    others have besides. Also returns the slices of both, without empty ones.
    """
    std = np.sqrt(np.diag(white))
    rest, roots, parts, place = white / std[:, None] / std, [], [], 0
    for rows in (np.flatnonzero(first), np.flatnonzero(~first)):
        values, vectors = np.linalg.eigh(rest[np.ix_(rows, rows)])
        # a free network has as many zero eigenvalues as its datum has conditions
        kept = values > _RANK * len(white)
        root = rest[:, rows] @ vectors[:, kept] / np.sqrt(values[kept])
        # without what the first unknowns explain of the others: further coordinates are independent of them
        rest = rest - root @ root.T
        roots.append(root)
        parts.append(slice(place, place + root.shape[1]))
        place += root.shape[1]
    return std[:, None] * np.concatenate(roots, axis=1), tuple(part for part in parts if part.stop > part.start)
