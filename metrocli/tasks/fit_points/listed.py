"""Points of a list or of a result, and how well they are known: by axis, each with covariances, or jointly."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, joint_prior, prior, priors
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index, Mask
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.fit_points.settings import COVARIANCES, ESTIMATED
from metrocli.tasks.shared.lists import refuse, sigmas
from metrocli.uncertainty.predicted import has_points, points_of

# a standard deviation of 1e-5 for all points cost the covariance 1e-4 of its value, by rounding (docs/decisions/258)
_SHARE = 1e-6
"""Variance of the readings of a point, relative to the least of the point, or to the mean of a joint covariance"""


@dataclass(frozen=True)
class Spread:
    """How well the n points of a list or of a result are known."""

    covariance: Array
    """Of each point (n, 3, 3) mm^2: a variance is 0 where the coordinate is exact, nan where nothing is known"""
    joint: Array | None = None
    """Of all coordinates, (3n, 3n) mm^2, where points have errors in common"""

    @property
    def sigma(self) -> Array:
        """Standard deviations of the coordinates (n, 3): 0 exact, nan unknown."""
        return np.asarray(np.sqrt(np.einsum("nkk->nk", self.covariance)))

    @property
    def correlated(self) -> bool:
        """Whether coordinates have covariances."""
        return self.joint is not None or bool(_mixed(self.covariance).any())

    def of(self, rows: Index) -> Spread:
        """Return the spread of some of the points."""
        entries = (3 * rows[:, None] + np.arange(3)).ravel()
        joint = None if self.joint is None else self.joint[np.ix_(entries, entries)]
        return Spread(self.covariance[rows], joint)

    def among(self, rows: Index, count: int) -> Spread:
        """Return the spread with these points at `rows` of `count`; of the others nothing is known."""
        covariance, joint = np.full((count, 3, 3), np.nan), None
        covariance[rows] = self.covariance
        if self.joint is not None:
            entries = (3 * rows[:, None] + np.arange(3)).ravel()
            joint = np.full((3 * count, 3 * count), np.nan)
            joint[np.ix_(entries, entries)] = self.joint
        return Spread(covariance, joint)

    @cached_property
    def shared_out(self) -> tuple[Spread, Array]:
        """Return the spread less a small part that is alike in all directions, and that part (n,) [mm^2].

        Readings of the points have that part. So points are unknowns beside readings that have an error, and the sum is
        what the list states. Directions without an error, as those that a datum fixes, get one of this size.
        """
        known, unit = self.sigma > 0, np.eye(3)
        if self.joint is not None:
            entries = np.flatnonzero(known)
            values, vectors = np.linalg.eigh(self.joint[np.ix_(entries, entries)])
            part = _SHARE * float(values.mean()) if len(values) else 0.0
            joint = self.joint.copy()
            joint[np.ix_(entries, entries)] = (vectors * np.maximum(values - part, part)) @ vectors.T
            return Spread(self.covariance, joint), np.full(len(known), part)
        # an exact direction would make the least eigenvalue 0: in its place stands the largest variance of the point
        plain = np.where(known, self.sigma, 0.0).max(axis=1, initial=0.0) ** 2
        both = known[:, :, None] & known[:, None, :]
        least = np.linalg.eigvalsh(np.where(both, self.covariance, plain[:, None, None] * unit))[:, 0]
        parts = _SHARE * least
        return Spread(self.covariance - np.where(both, parts[:, None, None] * unit, 0.0)), parts

    def own(self, noise: float | str) -> Array:
        """Return the covariance of each point (n, 3, 3); unknown variances are `noise^2`, nan if it is estimated."""
        variance = np.nan if noise == ESTIMATED else float(noise) ** 2
        unknown = np.isnan(self.sigma)[:, None, :] * np.eye(3, dtype=bool)
        return np.where(unknown, variance, np.nan_to_num(self.covariance))

    def observing(self, block: Block) -> Iterator[Group]:
        """Yield what the list observes of a block of its points, whose values are those of the list."""
        if self.joint is not None:
            members, columns = np.nonzero(block.free & (self.sigma > 0))
            if members.size:
                entries = 3 * members + columns
                yield joint_prior([(block, members, columns)], self.joint[np.ix_(entries, entries)])
            return
        whole = _mixed(self.covariance) & block.free.all(axis=1)
        if whole.any():
            rows = np.flatnonzero(whole)
            yield _of_each(prior(block, rows), self.covariance[rows])
        yield from priors(block, self.sigma, block.free & ~whole[:, None])


def listed_points(points: Table | Result) -> tuple[Table, Spread]:
    """Return the points of a list or of a result, and how well they are known.

    Raises InputError for covariances that cannot be.
    """
    if isinstance(points, Result):
        return _of_result(points)
    covariance = np.eye(3) * (sigmas(points) ** 2)[:, None, :]
    for name in COVARIANCES:
        a, b = ("xyz".index(axis) for axis in name[4:6])
        covariance[:, a, b] = covariance[:, b, a] = np.nan_to_num(points.numbers(name, 0.0))
    mixed, known = _mixed(covariance), np.einsum("nkk->nk", covariance) > 0
    least = np.linalg.eigvalsh(np.where(np.isfinite(covariance), covariance, np.eye(3)))[:, 0]
    alone = mixed & ~known.all(axis=1)
    refuse(
        points,
        {
            "covariances need a standard deviation of x, y and z, above zero": alone,
            "covariances are larger than the standard deviations allow (not positive definite)": mixed
            & ~alone
            & (least <= 0),
        },
    )
    return points, Spread(covariance)


def table_of(points: Table | Result) -> Table:
    """Return the table of points of a list or of a result; raises InputError for a result without points."""
    if not isinstance(points, Result):
        return points
    if not has_points(points):
        raise InputError("the result among the inputs has no points with a covariance: a camera needs `rig: network`")
    return points.tables["points"]


def _of_result(points: Result) -> tuple[Table, Spread]:
    table, places = table_of(points), points_of(points)
    return table, Spread(places.covariance, places.joint if places.common.shape[2] else None)


def _mixed(covariance: Array) -> Mask:
    """Return which points have covariances between their coordinates, (n,)."""
    return np.asarray((np.nan_to_num(covariance) * (1 - np.eye(3)) != 0).any(axis=(1, 2)))


def _of_each(group: Group, covariance: Array) -> Group:
    """Return a prior of whole members with a covariance of each, (n, 3, 3)."""
    read = group.observations
    observations = Observations(
        read.readings,
        read.sigma,
        read.index,
        np.moveaxis(covariance, 0, -1),
        read.keys,
        components=read.components,
    )
    return Group(f"{group.name}, whole", group.chain, observations)
