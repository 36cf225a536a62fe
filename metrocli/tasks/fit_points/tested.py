"""The residuals of a best fit against its noise, and the points that do not fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.groups import Group, ReadBlock, ReadEntries
from metrocli.adjust.robust import FitQuality, Suspects, suspects
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.table import Table
from metrocli.tasks.fit_points.problem import PLACE, POINT, PointPairs
from metrocli.tasks.shared.statistics import residual_table

_CONTROLLED = 1e-6
"""Redundancy from which a reading has a test of its own"""


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
    factor = solution.sigma0 if problem.estimated and solution.dof > 0 else 1.0
    exact = problem.estimated and factor * problem.start_noise <= problem.rounding
    rounding, factor = (problem.rounding, 0.0) if exact else (0.0, factor)
    groups = [group for group in solution.groups if group.name in "xyz"]
    of_points = [group for group in solution.groups if {POINT, PLACE} & group.observations.index.keys()]
    every = {group.name: _residuals(solution, group) for group in of_points}
    read = [residual_table(_in_noise(every[group.name], factor), group) for group in groups]
    found = suspects(
        _merged(list(every.values())), FitQuality(solution.cost, solution.dof, noise_known=not problem.estimated)
    )
    rows = np.concatenate([_rows(group, len(problem.names)) for group in of_points])
    certain = replace(solution, covariance=solution.covariance_or_raise().scaled(factor**2))
    return Tested(certain, factor, rounding, Table.stack(read), found.critical, _largest(found, rows))


def _residuals(solution: Solution, group: Group) -> Residuals:
    """Return residuals, and the tests of coordinates, also where these are correlated.

    `w_i = (P v)_i / sqrt((P - P Q P)_ii)`, P the inverse of the covariance of the coordinates, Q their covariance after
    the adjustment: the test of an error in one of them (Baarda 1968, Kok 1984).
    """
    residuals = residuals_of(solution, group)
    if group.observations.covariance is None:
        return residuals
    (link,) = group.chain.links
    assert isinstance(link, ReadBlock | ReadEntries)
    index, after = group.observations.index[link.block], solution.covariance_or_raise()
    if isinstance(link, ReadEntries):
        members, columns = link.entries(index)
        entries = members * solution.blocks[link.block].size + columns
        known = after.of(link.block)[np.ix_(entries, entries)][None]
    else:
        known = after.members(link.block)[index]
    weight = np.linalg.inv(np.moveaxis(group.observations.covariance, -1, 0))
    test = (weight @ residuals.values.T[:, :, None])[:, :, 0]
    variance = np.einsum("nkk->nk", weight - weight @ known @ weight)
    own = np.einsum("nkk->nk", weight)
    redundancy = np.clip(variance / own, 0.0, 1.0)
    controlled = redundancy > _CONTROLLED
    normalised = np.where(controlled, test / np.sqrt(np.where(controlled, variance, 1.0)), 0.0)
    return replace(residuals, redundancy=redundancy.T, normalised=normalised.T)


def _in_noise(residuals: Residuals, factor: float) -> Residuals:
    """Return residuals relative to the noise that is found: that of the adjustment times a factor; 0: no noise.

    They are not controlled where the errors are those of the measured points, whose own list tests them.
    """
    controlled = (residuals.redundancy > _CONTROLLED) & (factor > 0)
    normalised = np.where(controlled, residuals.normalised / (factor or 1.0), np.nan)
    return replace(residuals, sigma=residuals.sigma * factor, normalised=normalised)


def _merged(read: list[Residuals]) -> Residuals:
    """Return the residuals of all coordinates, group by group and axis by axis, as readings of one component."""
    parts = ("values", "sigma", "redundancy", "normalised")
    return Residuals(
        *(np.concatenate([_flat(getattr(residuals, part), residuals) for residuals in read])[None] for part in parts)
    )


def _flat(values: Array, residuals: Residuals) -> Array:
    return np.broadcast_to(values, residuals.values.shape).ravel()


def _rows(group: Group, points: int) -> Index:
    """Return the row of each coordinate of a group: that of a measured point, or `points` and more for a place."""
    link = group.chain.links[0]
    if isinstance(link, ReadEntries):
        rows = link.entries(group.observations.index[link.block])[0]
    else:
        block = PLACE if isinstance(link, ReadBlock) and link.block == PLACE else POINT
        rows = np.tile(np.ravel(group.observations.index[block]), len(group.observations.readings))
    return rows + points if getattr(link, "block", POINT) == PLACE else rows


def _largest(found: Suspects, rows: Index) -> dict[int, float]:
    order = np.argsort(-found.tests)
    worst: dict[int, float] = {}
    for row, test in zip(rows[found.rows[order]].tolist(), found.tests[order].tolist(), strict=True):
        worst.setdefault(row, test)
    return worst
