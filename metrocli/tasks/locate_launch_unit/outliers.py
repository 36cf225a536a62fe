"""Readings too far off for chance: found one after the other, each without those before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import critical_value
from metrocli.adjust.solution import Solution, residuals_of

_SHARE = 4
"""At most one reading in so many is called an outlier"""
_FEW = 2
"""Degrees of freedom, and readings of a group, that must be left"""


@dataclass(frozen=True)
class Outlier:
    """A reading that does not fit the others."""

    group: str
    pose: str
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

    Each reading is tested against the noise of the others (external studentisation), at least the declared noise; the
    readings that an outlier had pulled along become innocent when it is out.
    """
    total = sum(group.observations.count for group in solution.groups if group.name in names)
    critical, found = critical_value(total), list[Outlier]()
    while len(found) < total // _SHARE and solution.dof > _FEW:
        worst, row = _worst(solution, names)
        others = max(solution.cost - worst.test**2, 0.0) / (solution.dof - 1)
        if worst.test <= critical * np.sqrt(max(others, 1.0)):
            break
        fewer = _without(solution.blocks, solution.groups, worst.group, row)
        if fewer is None:
            break
        solution, found = fewer, [*found, worst]
    unit = np.sqrt(max(solution.cost / solution.dof, 1.0)) if solution.dof > 0 else 1.0
    return Screened(solution, tuple(replace(one, test=float(one.test / unit)) for one in found), critical)


def _worst(solution: Solution, names: Sequence[str]) -> tuple[Outlier, int]:
    """Return the reading with the largest |w|, and its row."""
    found = []
    for group in solution.groups:
        if group.name in names:
            w = np.abs(residuals_of(solution, group).normalised[0])
            row = int(np.argmax(w))
            found.append((Outlier(group.name, group.observations.keys["pose"][row], float(w[row])), row))
    return max(found, key=lambda one: one[0].test)


def _without(blocks: Mapping[str, Block], groups: Sequence[Group], name: str, row: int) -> Solution | None:
    """Return the solution without a reading; None where the others would not do."""
    left = []
    for group in groups:
        if group.name == name:
            if group.observations.count <= _FEW:
                return None
            group = group.selected(np.arange(group.observations.count) != row)
        left.append(group)
    solution = adjust(blocks.values(), left)
    return solution if solution.covariance is not None else None
