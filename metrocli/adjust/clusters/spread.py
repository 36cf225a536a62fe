"""What the readings of each cluster see of the shared unknowns, and what their errors change in them.

Method: docs/algorithms/cluster-robust-covariance.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from metrocli.adjust.decompositions import thin_svd
from metrocli.arrays import Array
from metrocli.frozen import dataclass

_UNDETERMINED = 1e-9
"""Share of a direction that the other clusters determine, below which it is left out: its residuals are rounding"""
_NONE = 1e-18
"""Strength below which readings do not act in a direction"""


@dataclass(frozen=True)
class Excess:
    """How much more than white noise errors vary in the directions u in which readings see the first unknowns.

    The covariance of the readings of a cluster is `Omega = I + u diag(excess) u'` with `F_1 = u diag(t) w'` and
    `1 + excess = (1 + level) (1 + size t^2)`.
    """

    level: float = 0.0
    """The part that is the same in all directions, as of errors that vary smoothly"""
    size: float = 0.0
    """Variance of the first unknowns between clusters, in that of their estimates for the noise in these directions"""

    def at(self, strength: Array) -> Array:
        """Return the excess in directions of a strength `t^2`."""
        return np.asarray((1 + self.level) * (1 + self.size * strength) - 1)


@dataclass(frozen=True)
class ClusterDirections:
    """One cluster in coordinates in which the shared unknowns have the covariance 1, without its own unknowns.

    Its rows are `F = u diag(sizes) directions'` with orthonormal u and directions.
    """

    directions: Array
    """(coordinates, k)"""
    sizes: Array
    """(k,), below 1"""
    residual: Array
    """Its residuals along u, `u'r`, (k,)"""
    alone: Array
    """Directions that no other cluster determines, in which its residuals are zero, (coordinates, k')"""

    @classmethod
    def of(cls, rows: Array, residual: Array) -> ClusterDirections:
        """Return a cluster from its rows and residuals."""
        u, sizes, vt = thin_svd(rows)
        # a singular value of 1: all information about that direction is in this cluster, which fits it exactly
        kept = 1 - sizes**2 > _UNDETERMINED
        return cls(vt[kept].T, sizes[kept], u[:, kept].T @ residual, vt[~kept].T)

    @cached_property
    def rows(self) -> Array:
        """`u'F`, (k, coordinates)."""
        return self.sizes[:, None] * self.directions.T


@dataclass(frozen=True)
class ActingDirections:
    """The directions in which the readings of a cluster see the first unknowns, `F_1 = u diag(t) w'`."""

    u: Array
    """(k, k'), orthonormal"""
    strength: Array
    """`t^2`, (k',)"""

    @classmethod
    def of(cls, projected: ClusterDirections, first: slice) -> ActingDirections:
        """Return those of a cluster; `first` are the coordinates of the first unknowns."""
        u, sizes, _ = thin_svd(projected.rows[:, first])
        strength = sizes**2
        return cls(u[:, strength > _NONE], strength[strength > _NONE])

    def covariance(self, excess: Excess, exponent: float = 1.0) -> Array:
        """Return a power of `Omega = I + u diag(excess) u'` in the coordinates of the cluster, (k, k)."""
        more = (1 + excess.at(self.strength)) ** exponent - 1
        return np.asarray(np.eye(len(self.u)) + (self.u * more) @ self.u.T)


@dataclass(frozen=True)
class ClusterSpread:
    """What the errors of one cluster change in the coordinates, with the covariance that is expected of them.

    All matrices are by its directions v.
    """

    projected: ClusterDirections
    expected: Array
    """`u' Omega u`, (k, k)"""
    weight: Array
    """`A = Omega^1/2 (Omega^1/2 B Omega^1/2)^-1/2 Omega^1/2`, B the covariance of its residuals, (k, k)"""

    @classmethod
    def of(cls, projected: ClusterDirections, expected: Array, root: Array, whole: Array) -> ClusterSpread:
        """Return a cluster with `Omega` and its square root.

        `whole` is the covariance of the coordinates for the expected errors of all readings.
        """
        square = projected.sizes**2
        # cov(r) = Omega - F F' Omega - Omega F F' + F V F', in the directions u, in which F F' is diag(sizes^2)
        of_residuals = (
            expected - square[:, None] * expected - expected * square + projected.rows @ whole @ projected.rows.T
        )
        return cls(projected, expected, root @ _inverse_root(root @ of_residuals @ root) @ root)

    @cached_property
    def change(self) -> Array:
        """What its errors contribute to the coordinates, `F' A r`, (coordinates,)."""
        return np.asarray(self.projected.rows.T @ (self.weight @ self.projected.residual))

    @cached_property
    def information(self) -> Array:
        """`F' Omega F`: the covariance of `change` for the expected errors."""
        return np.asarray(self.projected.rows.T @ self.expected @ self.projected.rows)

    @cached_property
    def levers(self) -> tuple[Array, Array]:
        """`x` and `y`, (k, k), with `F' A F = v x v'` and `F' A Omega F = v y v'`."""
        sizes = self.projected.sizes
        left = sizes[:, None] * self.weight
        return np.asarray(left * sizes), np.asarray(left @ self.expected * sizes)


def _inverse_root(matrix: Array) -> Array:
    """Return the inverse square root of a symmetric matrix; directions that are zero stay so."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    kept = values > np.finfo(float).eps * max(float(values.max(initial=0.0)), np.finfo(float).tiny)
    return np.asarray((vectors[:, kept] / np.sqrt(values[kept])) @ vectors[:, kept].T)


def spreads(
    clusters: Sequence[ClusterDirections], acting: Sequence[ActingDirections], excess: Excess, prior: Array
) -> tuple[ClusterSpread, ...]:
    """Return what the errors of clusters change; `prior` is the information of rows whose errors are independent."""
    expected = [directions.covariance(excess) for directions in acting]
    parts = [cluster.rows.T @ omega @ cluster.rows for cluster, omega in zip(clusters, expected, strict=True)]
    whole = np.sum(parts, axis=0) + prior
    return tuple(
        ClusterSpread.of(cluster, omega, directions.covariance(excess, 0.5), whole)
        for cluster, omega, directions in zip(clusters, expected, acting, strict=True)
    )


def products(clusters: Sequence[ClusterSpread], whole: Array, lines: Array, part: slice) -> tuple[Array, Array, float]:
    """Return what the variance of a quadratic form of the changes is made of, for the expected errors.

    With `C_cd` the covariance of the changes of two clusters, l a line and E the coordinates of a part, these are
    `sum (l' C_cd l)^2` (lines,), `sum l' C_cd E C_dc l` (lines,), and `sum tr(E C_cd E C_dc)`. It is
    `C_cd = X_c G X_d - X_c Y_d' - Y_c X_d'` with the levers X and Y and the whole covariance G, and `F' Omega F` for
    a cluster with itself.
    """
    # a = R X, b = R P, y = R Y with P = X G - Y and R'R = v' E v, so that R C_cd R' = a_c b_d' - y_c a_d'
    x_lines, y_lines, a, b, y = [], [], [], [], []
    for cluster in clusters:
        v, (x, by_errors) = cluster.projected.directions, cluster.levers
        inside = v.T @ lines
        x_lines.append(v @ (x @ inside))
        y_lines.append(v @ (by_errors.T @ inside))
        # only `root' root` enters, so the fewer rows of R do where there are more coordinates than directions
        root = np.linalg.qr(v[part], mode="r") if part.stop - part.start > v.shape[1] else v[part]
        a.append(root @ x @ v.T)
        y.append(root @ by_errors @ v.T)
        b.append(a[-1] @ whole - y[-1])
    h = np.array(x_lines)
    g = np.einsum("ij,cjl->cil", whole, h) - np.array(y_lines)
    pairs = np.einsum("cil,dil->lcd", h, g, optimize=True) - np.einsum(
        "cil,dil->lcd", np.array(y_lines), h, optimize=True
    )
    all_a, all_b, all_y = np.concatenate(a), np.concatenate(b), np.concatenate(y)
    aa, ay, ab, bb, yy = all_a.T @ all_a, all_a.T @ all_y, all_a.T @ all_b, all_b.T @ all_b, all_y.T @ all_y
    lengths = np.einsum("cil,ij,cjl->l", g, aa, g, optimize=True) + np.einsum("cil,ij,cjl->l", h, yy, h, optimize=True)
    lengths -= 2 * np.einsum("cil,ij,cjl->l", g, ay, h, optimize=True)
    norms = float((aa * bb).sum() - 2 * (ay * ab.T).sum() + (yy * aa).sum())
    # the formula is for two clusters; with itself a cluster also has its own covariance, which replaces it here
    for c, cluster in enumerate(clusters):
        itself = cluster.information
        along = itself @ lines
        pairs[:, c, c] = (lines * along).sum(axis=0)
        lengths += (along[part] ** 2).sum(axis=0) - ((a[c] @ g[c] - y[c] @ h[c]) ** 2).sum(axis=0)
        norms += float((itself[part, part] ** 2).sum() - ((a[c] @ b[c].T - y[c] @ a[c].T) ** 2).sum())
    return (pairs**2).sum(axis=(1, 2)), lengths, norms
