"""Layouts that are undetermined or weak: what is wrong with them, for messages, and what would correct it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from metrocli import units
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, extents
from metrocli.doubt import MOST_REJECTED
from metrocli.effects.estimates import absorbed
from metrocli.errors import UndeterminedError
from metrocli.instruments import tracer as t
from metrocli.tasks.multilaterate.problem import TracerNetwork
from metrocli.words import listed

APART = "lengths, points and tracers do not belong together (units, axes, names)"
TOO_WEAK, WEAK = 300.0, 10.0
"""Ratios of the uncertainty of points to that of lengths: above the first it is an error, above the second a warning"""
_THIN = 0.02
"""Points whose thickness is below this share of their extent lie on a line or in a plane"""
_CLOSE = 0.05
"""Tracers closer together than this share of the layout stand nearly at one place"""
_FEW = 6
"""Number of points per tracer, and of tracers in one plane, that suffices"""


def weakness(network: TracerNetwork, solution: Solution) -> float:
    """Return the ratio of the uncertainty of points to that of lengths, both root mean squares; 1 to 3 is good."""
    if solution.covariance is None:
        return float("inf")
    spread = np.einsum("mii->m", solution.covariance.members(t.POINT))[network.seen > 0].mean() / 3
    return float(np.sqrt(max(spread, 0.0)) / np.sqrt((network.lengths.observations.stds**2).mean()))


def is_determined(network: TracerNetwork, solution: Solution) -> bool:
    """Return whether the layout determines the points well enough for a result."""
    if solution.undetermined or solution.outcome is Outcome.TOO_FEW:
        return False
    return solution.covariance is None or weakness(network, solution) <= TOO_WEAK


def must_carry(network: TracerNetwork, solution: Solution, whole: TracerNetwork) -> None:
    """Raise UndeterminedError if the lengths in use do not determine the points; `whole` has those left out too."""
    if is_determined(network, solution):
        return
    count, used = whole.lengths.observations.count, network.lengths.observations.count
    if count - used > MOST_REJECTED * count:
        # not the layout is to blame: lengths that contradict each other like this call for another reading of the files
        raise UndeterminedError(
            f"{count - used} of {count} lengths contradict each other; without them the points are not determined\n"
            f"  why: {APART}",
            float("inf"),
        )
    raise UndeterminedError(explained(network, solution), solution.misfit)


def warnings(network: TracerNetwork, solution: Solution) -> list[str]:
    """Return a warning for each cause of weakness in a layout that determines its points."""
    ratio = weakness(network, solution)
    if ratio <= WEAK:
        return []
    return [
        f"the layout is weak, points are {units.two_digits(ratio)} times as uncertain as lengths: {reason}"
        for reason in reasons(network, solution)
    ]


def explained(network: TracerNetwork, solution: Solution) -> str:
    """Return the message of what is undetermined, why, and what would determine it."""
    lines = [
        f"the layout does not determine the points: {solution.observations} readings, {solution.unknowns} unknowns"
    ]
    lines += [f"  undetermined: {combination}" for combination in solution.undetermined[:3]]
    if not solution.undetermined and solution.covariance is not None:
        lines.append(f"  points are {units.two_digits(weakness(network, solution))} times as uncertain as lengths")
    lines += [f"  why: {reason}" for reason in reasons(network, solution)]
    return "\n".join(lines)


def reasons(network: TracerNetwork, solution: Solution) -> list[str]:
    """Return the reasons why the layout of a network is undetermined or weak."""
    hidden = absorbed(network.effects, solution, network.datum) if solution.undetermined else ()
    if hidden:
        return [
            f"{added.label} cannot be separated from the other unknowns of this job, which absorb it; "
            f"leave it out; what would separate it: {added.effect.reveal}"
            for added in hidden
        ]
    causes = [*_counts(network, solution), *_shapes(network)] or [*_strayed(network, solution)]
    return causes or ["the tracers see the points from too few directions; add tracers or points far from the others"]


def _counts(network: TracerNetwork, solution: Solution) -> Iterator[str]:
    tracers, index = network.blocks[t.TRACER], network.lengths.observations.index
    m, fewest = len(tracers.members), 3 if network.absolute and not network.unknown.all() else 4
    if m < fewest and not (~tracers.free[:, :3]).all():
        kind = "absolute distances" if network.absolute else "length changes"
        there_are = "there is 1 tracer" if m == 1 else f"there are {m} tracers"
        yield f"{there_are}; positions from {kind} need {fewest} or more, not in one plane{_three(network)}"
    per_tracer = int(tracers.free.sum()) / m
    there = int((network.seen > 0).sum())
    needed = math.ceil((per_tracer * m - 6) / (m - 3)) if m > 3 else 0
    if solution.dof < 0 and there < needed:
        yield f"too few points: {there}, where {m} tracers need {needed}, and more for a check"
    few = [name for name, n in zip(network.blocks[t.POINT].members, network.seen, strict=True) if 0 < n < 3]
    if few and network.unknown[network.seen > 0].any():
        yield (
            f"points read by fewer than three tracers: {listed(few)}; `outliers: remove` leaves them out, or read them "
            "with more tracers"
        )
    reads = np.bincount(index[t.TRACER], minlength=m)
    poor = [f"{name} ({n})" for name, n in zip(tracers.members, reads, strict=True) if n < _FEW]
    if poor:
        yield f"tracers that read too few points for their place: {listed(poor)}; use six or more, spread in space"


def _strayed(network: TracerNetwork, solution: Solution) -> Iterator[str]:
    """Yield tracers that an adjustment put far from their listed places: a layout that it made is not to blame."""
    tracers = solution.blocks[t.TRACER]
    if not len(network.listed_at):
        return
    gap = np.linalg.norm(tracers.values[:, :3] - network.listed_at, axis=1)
    far = np.flatnonzero(gap > _span(network.listed_at))
    if far.size:
        places = listed([f"{tracers.members[i]} ({gap[i]:.3g} mm)" for i in far])
        cause = "lengths of one tracer are wrong, or a list"
        yield f"the lengths put tracers far from their listed places: {places}; {cause}"


def _three(network: TracerNetwork) -> str:
    known = "where points or tracers are known (sigma_mm)"
    return f"; three suffice {known}" if network.absolute and network.unknown.all() else ""


def _shapes(network: TracerNetwork) -> Iterator[str]:
    tracers, points = network.blocks[t.TRACER], network.blocks[t.POINT].values[network.seen > 0]
    if not len(points):
        return
    if _flat(points, 1):
        yield "the points lie on a line: add points away from it in two directions"
        return
    if _flat(points, 2):
        yield "the points lie in one plane: add points out of it"
    places, m = tracers.values[:, :3], len(tracers.members)
    near = [(i, j) for i in range(m) for j in range(i) if _gap(places, i, j) < _CLOSE * _span(places)]
    for i, j in near:
        yield (
            f"tracers {tracers.members[j]} and {tracers.members[i]} stand nearly at one place "
            f"({_gap(places, i, j):.3g} mm apart): set them further apart"
        )
    if not near and 3 < m < _FEW and _flat(places, 2):
        yield (
            f"the {m} tracers stand in one plane (within {_thickness(places, 2):.3g} mm): "
            "move one out of it by a large part of their distances, or use six"
        )


def _gap(places: Array, i: int, j: int) -> float:
    return float(np.linalg.norm(places[i] - places[j]))


def _span(points: Array) -> float:
    return float(np.linalg.norm(extents(points)))


def _thickness(points: Array, dimensions: int) -> float:
    """Return how far points lie from their centroid (0), best line (1) or best plane (2), root mean square."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(spread[dimensions:].max(initial=0.0) / np.sqrt(len(points)))


def _flat(points: Array, dimensions: int) -> bool:
    return _thickness(points, dimensions) < _THIN * _thickness(points, 0)
