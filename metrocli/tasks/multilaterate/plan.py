"""What a planned multilateration will determine.

It predicts the uncertainty of points and distances and the errors of lengths that stay hidden, and ranks places for one
more tracer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from metrocli import units
from metrocli.adjust.robust import critical_value
from metrocli.adjust.solution import Solution, residuals_of
from metrocli.effects.estimates import estimates
from metrocli.errors import UndeterminedError
from metrocli.instruments import tracer as t
from metrocli.plan import Plan
from metrocli.result import Estimate
from metrocli.table import Table
from metrocli.tasks.multilaterate import KIND, layout_faults
from metrocli.tasks.multilaterate.layout import PlannedNetwork, Ranking, ranked, root_mean_square, worst_direction
from metrocli.tasks.multilaterate.uncontrolled import scale_warnings, uncontrolled
from metrocli.tasks.shared.statistics import estimates_of_block, reliability
from metrocli.tasks.shared.uncontrolled import in_words
from metrocli.units import roughly
from metrocli.words import counted

_HEAD = "tracers, and distances of points along lines through the volume:"
_FEWEST_CHECKED = 4
"""Number of lengths of a point that reveals a wrong length but does not identify it"""
_TOLD = 3
"""Number of places for one more tracer in the summary"""
_UNCONTROLLED = 0.01
"""Redundancy below which a test of the length is useless: its minimal detectable error exceeds 40 sigma"""


def planned(layout: PlannedNetwork, candidates: Table | None) -> Plan:
    """Return what a layout will determine.

    Raises UndeterminedError, with what would determine the points, if the layout does not.
    """
    ranking = ranked(layout, candidates)
    if not layout_faults.is_determined(layout.network, layout.solution):
        best = _best(ranking)
        raise UndeterminedError("\n".join([layout_faults.explained(layout.network, layout.solution), *best]))
    lengths, hidden = _lengths(layout), uncontrolled(layout.network)
    tables = {"points": _points(layout), "reliability": lengths, "candidates": ranking.table, "not_controlled": hidden}
    return Plan(
        KIND.name,
        (
            *_quality(layout),
            *_of_part(layout),
            *_of_lengths(layout, lengths),
            *_best(ranking),
            *in_words(hidden),
            "",
            _HEAD,
        ),
        (*_tracers(layout.solution), *_lines(layout), *estimates(layout.network.effects, layout.solution)),
        tables,
        warnings=(
            *layout.network.warnings,
            *scale_warnings(layout.network, layout.solution),
            *layout_faults.warnings(layout.network, layout.solution),
        ),
    )


def _points(layout: PlannedNetwork) -> Table:
    std = np.sqrt(np.maximum(np.einsum("mii->mi", layout.covariances), 0.0))
    places = {"point": layout.names, "x y z [mm]": layout.places, "sx sy sz [mm]": std}
    return Table.of({**places, "worst [mm]": worst_direction(layout.covariances)})


def _lengths(layout: PlannedNetwork) -> Table:
    """Return redundancy, minimal detectable error and external reliability of each length."""
    group = layout.network.lengths
    residuals, critical = residuals_of(layout.solution, group), critical_value(group.observations.count)
    table = Table.of({**group.observations.keys, "sigma [mm]": group.observations.stds[0]})
    return table.joined(reliability(layout.solution, group, residuals, critical))


def _tracers(solution: Solution) -> tuple[Estimate, ...]:
    block, units = solution.blocks[t.TRACER], (("mm",),) * 3
    places = replace(block, free=block.free & (np.arange(block.size) < 3))
    return estimates_of_block(places, solution.std(t.TRACER), units, lambda tracer, name: f"{tracer}.{name}")


def _lines(layout: PlannedNetwork) -> Iterator[Estimate]:
    """Yield the distances of points at opposite ends of the volume: along its axes and its diagonals."""
    points, names = layout.places, layout.names
    middle, half = (points.max(axis=0) + points.min(axis=0)) / 2, np.ptp(points, axis=0) / 2
    pairs = set()
    for direction in [*np.eye(3), *(np.array([1.0, y, z]) for y, z in product((1, -1), repeat=2))]:
        ends = middle - half * direction, middle + half * direction
        a, b = (int(np.argmin(np.linalg.norm(points - end, axis=1))) for end in ends)
        if a != b and (a, b) not in pairs:
            pairs.add((a, b))
            yield Estimate(f"{names[a]} - {names[b]}", *layout.distance(a, b), "mm")


def _quality(layout: PlannedNetwork) -> Iterator[str]:
    worst, ratio = worst_direction(layout.covariances), layout_faults.weakness(layout.network, layout.solution)
    name, m = layout.names[int(np.argmax(worst))], len(layout.network.blocks[t.TRACER].members)
    yield (
        f"{len(layout.names)} points from {m} tracers: coordinates to "
        f"{roughly(root_mean_square(layout.covariances), 'um')} (root mean square), the worst point {name} to "
        f"{roughly(float(worst.max()), 'um')} in its worst direction"
    )
    yield f"coordinates are {units.two_digits(ratio)} times as uncertain as lengths (1 to 3 is good)"


def _of_part(layout: PlannedNetwork) -> Iterator[str]:
    """Yield what the growth of the part does to the points that are predicted here, or to those probed on it."""
    part = layout.settings.part
    if part is None:
        return
    yield part.note
    if layout.part is None:
        yield "the growth and its uncertainty come to the corrected points; those here are the places of the replay"


def _of_lengths(layout: PlannedNetwork, lengths: Table) -> Iterator[str]:
    """Yield which errors of single lengths the tests will detect, and which they will not."""
    least, moves = lengths.numbers("detectable"), lengths.numbers("moves_point")
    yield (
        f"minimal detectable error of one length: {roughly(float(np.median(least)), 'um')} in the median "
        "(level of significance 5 % for all lengths together, 80 % power)"
    )
    row = int(np.argmax(np.where(np.isfinite(moves), moves, np.inf)))
    name = f"{lengths.texts('point')[row]}/{lengths.texts('tracer')[row]}"
    if np.isfinite(moves[row]):
        yield f"an error of that size moves its point by up to {roughly(moves[row], 'um')} ({name})"
    poor = int((lengths.numbers("redundancy") < _UNCONTROLLED).sum())
    if poor:
        few = counted(poor, "length", "are")
        yield f"{few} hardly controlled by the others (redundancy below {_UNCONTROLLED:g}), such as {name}"
    if (layout.network.seen[layout.network.unknown] == _FEWEST_CHECKED).any():
        yield "with four tracers a wrong length shows at its point but cannot be identified; a fifth would identify it"


def _best(ranking: Ranking) -> Iterator[str]:
    """Yield the best places for one more tracer."""
    table = ranking.table
    if not len(table):
        yield f"one more tracer alone would not help: {ranking.tried} places were tried"
        return
    yield f"one more tracer would serve best at ({ranking.tried} places tried):"
    for row in range(min(_TOLD, len(table))):
        place = ", ".join(f"{table.numbers(axis)[row]:.0f}" for axis in "xyz")
        rms, worst, gain, gain_worst = (
            float(table.numbers(name)[row]) for name in ("rms", "worst", "gain_rms", "gain_worst")
        )
        gains = "" if np.isnan(gain) else f" ({gain:.0%} and {gain_worst:.0%} less)"
        yield (
            f"  {table.texts('candidate')[row]} ({place}) mm: coordinates to {roughly(rms, 'um')}, "
            f"the worst point to {roughly(worst, 'um')}{gains}"
        )
