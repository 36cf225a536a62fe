"""The patch of a mesh that each point belongs to, where the nearest one may not be its own.

A point far inside the ideal part and close to an edge is nearer to the next patch than to its own. It lies off the
level of that patch, and at the level of its own. Method: docs/algorithms/overstock-fit.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.geometry.surfaces import Array, Index
from metrocli.tasks.fit_part.levels import medians, robust_step
from metrocli.tasks.fit_part.stock import Apart, Stock

_ROUNDS = 20
_LEVELLED = 2
"""Robust steps before each round: the patches need not be parallel to the raw surfaces where the search ended"""
_BESIDE = 2.0
"""How far a point may be from its own patch, relative to the largest overstock: it may lie beyond two edges"""


def on_own_patches(stock: Stock, patches: Apart, into: Array) -> Stock:
    """Return points on patches that are alone, each on the one among the nearest and its neighbours whose level it has.

    The levels are medians after a robust step of the pose (6,) in which each patch has its own. Both are found anew
    until no point changes its patch.
    """
    alone = replace(stock, nominal=patches)
    for _ in range(_ROUNDS):
        for _ in range(_LEVELLED):
            local = alone.at(into)
            step, _ = robust_step(local.rows, local.overstock, alone.surface, len(patches.names))
            into = local.moved(into, step)
        local = alone.at(into)
        level = medians(local.overstock, alone.surface, len(patches.names))
        row, patch = patches.beside(local.points, alone.surface, _BESIDE * float(np.abs(local.overstock).max()))
        off = np.abs(patches.shape(local.points[row], patch).distance - level[patch])
        surface = _nearest_level(row, patch, off, alone.surface)
        if np.array_equal(surface, alone.surface):
            break
        alone = replace(alone, surface=surface)
    return alone


def _nearest_level(row: Index, patch: Index, off: Array, surface: Index) -> Index:
    """Return the patch of each point (n,) with the least distance from its level, nan for a patch without points."""
    order = np.lexsort((off, row))
    rows, first = np.unique(row[order], return_index=True)
    found = surface.copy()
    found[rows] = patch[order[first]]
    return found
