"""The patch of a mesh that each point belongs to, where the nearest one may not be its own.

A point far inside the ideal part and close to an edge is nearer to another patch than to its own. It lies off the
level of that patch, and at the level of its own. Method: docs/algorithms/overstock-fit.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from metrocli.geometry.surfaces import Array, Index
from metrocli.tasks.fit_part.levels import LIMIT, medians, robust_step, scatter_of
from metrocli.tasks.fit_part.stock import Apart, Stock

_ROUNDS = 20
_LEVELLED = 2
"""Robust steps before each round: the patches need not be parallel to the raw surfaces where the search ended"""
_BESIDE = 2.0
"""How far a point may be from its own patch, relative to the largest overstock: it may lie beyond two edges"""
_EACH = 500
"""Points of each patch from which the levels are found, at most"""


def on_own_patches(stock: Stock, patches: Apart, into: Array) -> tuple[Stock, npt.NDArray[np.bool_]]:
    """Return points on patches that are alone, each on the one nearby whose level it has, and which have one (n,).

    The levels are medians after a robust step of the pose (6,) in which each patch has its own. With some points of
    each patch both are found anew until no point changes its patch. Then all points follow.
    """
    alone, count = replace(stock, nominal=patches), len(patches.names)
    some = alone.of(_some_of_each(alone.surface))
    for _ in range(_ROUNDS):
        for _ in range(_LEVELLED):
            local = some.at(into)
            step, _ = robust_step(local.rows, local.overstock, some.surface, count)
            into = local.moved(into, step)
        level = medians(some.at(into).overstock, some.surface, count)
        surface = _of_nearest_level(some, patches, into, level)
        if np.array_equal(surface, some.surface):
            break
        some = replace(some, surface=surface)
    found = replace(alone, surface=_of_nearest_level(alone, patches, into, level))
    off = found.at(into).overstock - level[found.surface]
    return found, np.abs(off) <= LIMIT * scatter_of(off, found.surface, count, np.zeros(len(off)))


def _some_of_each(surface: Index) -> Index:
    """Return the rows of some points of each surface, drawn at random."""
    order = np.random.default_rng(1).permutation(len(surface))
    order = order[np.argsort(surface[order], kind="stable")]
    place = np.arange(len(order)) - np.searchsorted(surface[order], surface[order])
    return np.sort(order[place < _EACH])


def _of_nearest_level(stock: Stock, patches: Apart, into: Array, level: Array) -> Index:
    """Return the patch of each point (n,) from whose level (S,) it is least far; nan is that of one without points."""
    local = stock.at(into)
    row, patch = patches.beside(local.points, stock.surface, _BESIDE * float(np.abs(local.overstock).max()))
    beside = patches.shape(local.points[row], patch).distance
    row, patch = np.append(np.arange(len(local.points)), row), np.append(stock.surface, patch)
    off = np.abs(np.append(local.overstock, beside) - level[patch])
    order = np.lexsort((off, row))
    _, first = np.unique(row[order], return_index=True)
    return np.asarray(patch[order[first]])
