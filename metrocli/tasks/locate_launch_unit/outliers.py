"""Outliers among the readings: they are found one after the other, each without those found before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import critical_value
from metrocli.adjust.solution import Solution, residuals_of
from metrocli.frozen import dataclass

_SHARE = 4
"""At most one reading in this many is called an outlier"""
_FEW = 2
"""Degrees of freedom, and readings of a group, that must remain"""


@dataclass(frozen=True)
class Outlier:
    """A reading that does not fit the others."""

    group: str
    pose: str
    test: float
    """|w| relative to the noise of the other readings, which is at least the declared noise"""


@dataclass(frozen=True)
class Screened:
    """The solution without the outliers, and the outliers, the largest first."""

    solution: Solution
    outliers: tuple[Outlier, ...]
    critical: float
    """Bound of |w| for an outlier"""
    noise: float
    """Noise of the readings without outliers, in units of the declared one, at least 1: to it the tests refer"""


def screened(solution: Solution, names: Sequence[str]) -> Screened:
    """Remove outliers from the named groups, the largest |w| first, until all pass the test at 5 % for all together.

    Each reading is tested against the noise of the others, at least the declared noise (external studentisation). A
    reading that fails only because of an outlier passes once the outlier is removed.
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
    noise = float(np.sqrt(max(solution.cost / solution.dof, 1.0))) if solution.dof > 0 else 1.0
    return Screened(solution, tuple(replace(one, test=one.test / noise) for one in found), critical, noise)


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
    """Return the solution without one reading; None if the others do not determine it."""
    left = []
    for group in groups:
        if group.name == name:
            if group.observations.count <= _FEW:
                return None
            group = group.selected(np.arange(group.observations.count) != row)
        left.append(group)
    solution = adjust(blocks.values(), left)
    return solution if solution.covariance is not None else None
