"""Readings too far off for chance: found one after the other, each without those before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.blocks import Block
from metrocli.adjust.groups import Group
from metrocli.adjust.robust import critical_value
from metrocli.adjust.solution import Solution, residuals_of

_SHARE = 4
"""At most one reading in so many is called an outlier"""
_FEW = 2
"""Degrees of freedom that must be left"""


@dataclass(frozen=True)
class Outlier:
    """A reading that does not fit the others."""

    group: str
    component: int
    row: int
    test: float
    """|w| over the noise of the readings that are no outliers, at least the declared one"""


@dataclass(frozen=True)
class Screened:
    """What is left when the outliers are out, and the outliers, the largest first."""

    solution: Solution
    outliers: tuple[Outlier, ...]
    critical: float


def screened(solution: Solution, names: Sequence[str]) -> Screened:
    """Take outliers out of the named groups, the largest |w| first, until none is beyond chance (5 % over all).

    Each reading is tested against the noise of the others (external studentisation), at least the declared noise; a
    reading taken out has an infinite standard deviation, so that those it had pulled along become innocent.
    """
    total = sum(group.observations.readings.size for group in solution.groups if group.name in names)
    critical, found = critical_value(total), list[Outlier]()
    while len(found) < total // _SHARE and solution.dof > _FEW:
        worst = _worst(solution, names)
        others = max(solution.cost - worst.test**2, 0.0) / (solution.dof - 1)
        if worst.test <= critical * np.sqrt(max(others, 1.0)):
            break
        fewer = _without(solution.blocks, solution.groups, worst)
        if fewer.covariance is None:
            break
        solution, found = fewer, [*found, worst]
    unit = np.sqrt(max(solution.cost / solution.dof, 1.0)) if solution.dof > 0 else 1.0
    return Screened(solution, tuple(replace(one, test=float(one.test / unit)) for one in found), critical)


def _worst(solution: Solution, names: Sequence[str]) -> Outlier:
    """Return the reading with the largest |w|."""
    found = []
    for group in solution.groups:
        if group.name in names:
            w = np.abs(residuals_of(solution, group).normalised)
            component, row = np.unravel_index(int(np.argmax(w)), w.shape)
            found.append(Outlier(group.name, int(component), int(row), float(w[component, row])))
    return max(found, key=lambda one: one.test)


def _without(blocks: Mapping[str, Block], groups: Sequence[Group], out: Outlier) -> Solution:
    left = []
    for group in groups:
        if group.name == out.group:
            sigma = group.observations.sigma.copy()
            sigma[out.component, out.row] = np.inf
            group = group.with_observations(replace(group.observations, sigma=sigma))
        left.append(group)
    return adjust(blocks.values(), left)
