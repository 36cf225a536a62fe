"""The residuals of a best fit against its noise, and the points that do not fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.groups import Group, ReadBlock, ReadEntries
from metrocli.adjust.robust import FitQuality, suspects
from metrocli.adjust.rounds import variance_component
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.table import Table
from metrocli.tasks.fit_points.links import PLACE
from metrocli.tasks.fit_points.problem import AXES, POINT, PointPairs
from metrocli.tasks.shared.statistics import residual_table

_CONTROLLED = 2e-6
"""Redundancy from which a reading has a test of its own: more than the share of a point that its list observes"""


@dataclass(frozen=True)
class Tested:
    """A solution with the noise that it shows, and its tests."""

    solution: Solution
    """With the covariance in that noise"""
    factor: float
    """Of the noise found to that of the adjustment; 0: nothing beyond rounding"""
    rounding: float
    """Deviations that count as rounding [mm]; 0 where there are larger ones"""
    residuals: Table
    critical: float
    worst: Mapping[int, float]
    """Largest test of each point beyond the bound, the largest first, by row of the lists; places follow the points"""

    @property
    def exact(self) -> bool:
        """Whether the points fit to the rounding of their numbers."""
        return self.rounding > 0

    def suspects(self, keys: Mapping[str, Sequence[str]]) -> Table:
        """Return the table of points that do not fit, with the keys of all rows and places."""
        named = {f"{key} [text]": [names[row] for row in self.worst] for key, names in keys.items()}
        return Table.of({**named, "w": list(self.worst.values())})


def tested(problem: PointPairs, solution: Solution) -> Tested:
    """Return the tests of a best fit that is solved."""
    alone = problem.estimated and not problem.weighed
    factor = solution.sigma0 if alone and solution.dof > 0 else 1.0
    exact = alone and factor * problem.start_noise <= problem.rounding
    rounding, factor = (problem.rounding, 0.0) if exact else (0.0, factor)
    axes = [group for group in solution.groups if group.name in "xyz"]
    read = {group.name: _controlled(residuals_of(solution, group)) for group in axes}
    table = Table.stack([residual_table(_in_noise(read[group.name], factor), group) for group in axes])
    known = [group for group in solution.groups if _known(group) and group.name not in read]
    whole = {group.name: whole for group in known if (whole := _whole(solution, group)) is not None}
    single = read | {group.name: residuals_of(solution, group) for group in known if group.name not in whole}
    fit = FitQuality(solution.cost, solution.dof, noise_known=not alone)
    critical, worst = 0.0, list[tuple[float, int]]()
    for tests, together in ((single, False), (whole, True)):
        groups = [group for group in solution.groups if group.name in tests and tests[group.name].normalised.any()]
        if groups:
            merged = _merged([tests[group.name] for group in groups], together)
            suspected = suspects(merged, fit)
            rows = np.concatenate([_rows(group, len(problem.names), together) for group in groups])[suspected.rows]
            worst += zip(suspected.tests.tolist(), rows.tolist(), strict=True)
            critical = max(critical, suspected.critical)
    certain = replace(solution, covariance=solution.covariance_or_raise().scaled(factor**2))
    largest = {row: test for test, row in sorted(worst)}  # the largest of a point comes last
    ordered = dict(sorted(largest.items(), key=lambda item: -item[1]))
    return Tested(certain, factor, rounding, table, critical, ordered)


def noise_of(problem: PointPairs, solution: Solution) -> float:
    """Return the noise [mm] that the residuals of the coordinates without a standard uncertainty show.

    Raises UndeterminedError where no other reading controls them.
    """
    bare, used = problem.bare, np.isfinite(problem.nominal)
    read = [
        Residuals(*(part[:, bare[used[:, axis], axis]] for part in (r.values, r.sigma, r.redundancy, r.normalised)))
        for group in solution.groups
        if group.name in AXES
        for axis, r in ((AXES.index(group.name), residuals_of(solution, group)),)
    ]
    found = problem.start_noise * variance_component(read, "give `noise`, or a column sigma_mm")
    return max(found, problem.rounding)


def _controlled(residuals: Residuals) -> Residuals:
    """Return residuals without tests where the errors are those of the measured points, whose own list tests them."""
    return replace(residuals, normalised=np.where(residuals.redundancy > _CONTROLLED, residuals.normalised, 0.0))


def _known(group: Group) -> bool:
    """Return whether a group is what a list observes of points or places."""
    return getattr(group.chain.links[0], "block", "") in (POINT, PLACE) and len(group.chain.links) == 1


def _whole(solution: Solution, group: Group) -> Residuals | None:
    """Return the tests of whole points, (3, n), whose squares add to what the misfit loses without the point.

    v are the residuals of the coordinates, P is the inverse of their covariance, and Q their covariance after the
    adjustment. The tests are `M^-1/2 u`: u is the part of the point in `P v`, and M that in `P - P Q P` (Baarda 1968,
    test of a group of readings). None for a list that does not observe whole points.
    """
    (link,), read = group.chain.links, group.observations
    after, residuals = solution.covariance_or_raise(), residuals_of(solution, group)
    if isinstance(link, ReadEntries):
        members, columns = link.entries(read.index[link.block])
        if read.covariance is None or (np.bincount(members)[np.unique(members)] != 3).any():
            return None
        weight, entries = np.linalg.inv(read.covariance[:, :, 0]), 3 * members + columns
        force = (weight @ residuals.values[:, 0]).reshape(-1, 3)
        whole = weight - weight @ after.of(link.block)[np.ix_(entries, entries)] @ weight
        points = np.arange(len(force))
        certainty, own = (each.reshape(len(points), 3, -1, 3)[points, :, points] for each in (whole, weight))
    elif isinstance(link, ReadBlock) and len(link.columns) == 3:
        stated = np.eye(3) * read.sigma.T[:, None, :] ** 2 if read.covariance is None else read.covariance.T
        own = np.linalg.inv(stated)
        force = np.einsum("nab,bn->na", own, residuals.values)
        certainty = own - own @ after.members(link.block)[read.index[link.block]] @ own
    else:
        return None
    values, vectors = np.linalg.eigh(certainty)
    controlled = values > _CONTROLLED * np.einsum("nkk->n", own)[:, None]
    scaled = np.einsum("nba,nb->na", vectors, force) / np.sqrt(np.where(controlled, values, 1.0))
    tests = np.einsum("nab,nb->an", vectors, np.where(controlled, scaled, 0.0))
    blank = np.ones(tests.shape)
    return Residuals(tests, blank, blank, tests)


def _in_noise(residuals: Residuals, factor: float) -> Residuals:
    """Return residuals relative to the noise that is found: that of the adjustment times a factor; 0: no noise.

    They are not controlled where the errors are those of the measured points, whose own list tests them.
    """
    controlled = (residuals.redundancy > _CONTROLLED) & (factor > 0)
    normalised = np.where(controlled, residuals.normalised / (factor or 1.0), np.nan)
    return replace(residuals, sigma=residuals.sigma * factor, normalised=normalised)


def _merged(read: list[Residuals], whole: bool) -> Residuals:
    """Return the residuals of all groups as readings of one component, or as whole points."""
    parts = ("values", "sigma", "redundancy", "normalised")
    return Residuals(
        *(np.concatenate([_each(getattr(group, part), group, whole) for group in read], axis=1) for part in parts)
    )


def _each(values: Array, residuals: Residuals, whole: bool) -> Array:
    spread = np.broadcast_to(values, residuals.values.shape)
    return spread if whole else spread.reshape(1, -1)


def _rows(group: Group, points: int, whole: bool) -> Index:
    """Return the row of each test of a group: that of a measured point, or `points` and more for a place."""
    link = group.chain.links[0]
    block = PLACE if getattr(link, "block", "") == PLACE else POINT
    index = np.ravel(group.observations.index[block])
    if isinstance(link, ReadEntries):
        rows = index if whole else link.entries(group.observations.index[block])[0]
    else:
        rows = index if whole else np.tile(index, len(group.observations.readings))
    return rows + points if block == PLACE else rows
