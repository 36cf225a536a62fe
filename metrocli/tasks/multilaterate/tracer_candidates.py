"""Ranking of places for one more tracer in a planned measurement."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.frozen import dataclass
from metrocli.table import Table
from metrocli.tasks.multilaterate.layout import Layout, root_mean_square, worst_direction
from metrocli.tasks.multilaterate.layout_faults import carries

if TYPE_CHECKING:
    from metrocli.table import Values

_ACROSS, _BEYOND = 5, 0.5
"""Grid that is tried if no candidates are listed: places along each axis, and share by which it exceeds the volume"""
_CLEAR = 0.1
"""Grid places nearer to the volume than this share of it are left out, since a tracer there is in the way"""
_THICK = 0.2
"""Least thickness assumed for the volume, as a share of its largest side"""
_MOST = 300
"""Largest number of points used to compare candidates"""


@dataclass(frozen=True)
class Ranking:
    """Candidates for one more tracer, the best first."""

    table: Table
    """candidate, x, y, z, rms, worst, gain_rms, gain_worst: uncertainties of the points with it, and relative gains"""
    tried: int
    """Number of candidates compared"""


def ranked(layout: Layout, candidates: Table | None) -> Ranking:
    """Rank places for one more tracer by the root mean square uncertainty of the points with it.

    Candidates with which the points stay undetermined are left out. If none are listed, a grid around the points is
    tried.
    """
    names, places = _places(layout) if candidates is None else _listed(candidates)
    part = _part(layout)
    before = np.array(_worth(part))
    more = [part.with_tracer(f"candidate {name}", place) for name, place in zip(names, places, strict=True)]
    with_it = np.array([_worth(one) for one in more]).reshape(-1, 2)
    order = np.argsort(with_it[:, 0], kind="stable")[: int(np.isfinite(with_it[:, 0]).sum())]
    gain = 1 - with_it[order] / before if np.isfinite(before).all() else np.full((len(order), 2), np.nan)
    columns: dict[str, Values] = {"candidate": np.array(names, dtype=str)[order]}
    columns |= {axis: places[order, i] for i, axis in enumerate("xyz")}
    columns |= {name: with_it[order, i] for i, name in enumerate(("rms", "worst"))}
    columns |= {f"gain_{name}": gain[:, i] for i, name in enumerate(("rms", "worst"))}
    return Ranking(Table(columns, dict.fromkeys(("x", "y", "z", "rms", "worst"), "mm")), len(names))


def _worth(layout: Layout) -> tuple[float, float]:
    """Return the uncertainty of the points, root mean square and worst; inf if they are undetermined."""
    if not carries(layout.network, layout.solution) or layout.solution.covariance is None:
        return float("inf"), float("inf")
    return root_mean_square(layout.covariances), float(worst_direction(layout.covariances).max())


def _listed(candidates: Table) -> tuple[list[str], Array]:
    return candidates.texts("candidate"), candidates.stacked("xyz")


def _places(layout: Layout) -> tuple[list[str], Array]:
    """Return names and places of a grid around the points, without those in the volume."""
    points = layout.planned.points.stacked("xyz")
    low, high = points.min(axis=0), points.max(axis=0)
    side = np.maximum(high - low, _THICK * (high - low).max())
    middle = (low + high) / 2
    steps = np.linspace(-0.5 - _BEYOND, 0.5 + _BEYOND, _ACROSS)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    outside = grid[np.abs(grid).max(axis=1) > 0.5 + _CLEAR]
    return [f"C{i + 1}" for i in range(len(outside))], middle + outside * side


def _part(layout: Layout) -> Layout:
    """Return the layout with some of its points, evenly spread over their list, and with all known points."""
    n = len(layout.planned.points)
    if n <= _MOST:
        return layout
    even = np.linspace(0, n - 1, _MOST).astype(np.intp)
    chosen = np.union1d(even, np.flatnonzero(~layout.network.unknown))
    return replace(layout, planned=layout.planned.of_points(chosen))
