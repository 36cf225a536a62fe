"""Errors that no residual of a multilateration can show: the points absorb them, or a second place fits as well."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli import units
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.solution import Residuals, Solution
from metrocli.arrays import Array, extents
from metrocli.instruments import tracer as t
from metrocli.table import Table
from metrocli.tasks.multilaterate.problem import LENGTHS, TracerNetwork
from metrocli.tasks.multilaterate.readings import DISTANCES
from metrocli.tasks.shared.mirror import Mirrored, hidden_by, mirrored, of_points, of_tracers
from metrocli.tasks.shared.part import Part, taken_as_exact
from metrocli.tasks.shared.uncontrolled import AIR, AIR_WORDS, ASSUMED, ASSUMED_CONTROL, Hidden, table_of


def uncontrolled(network: TracerNetwork, part: Part | None = None, second: Sequence[Mirrored] = ()) -> Table:
    """Return effects that the points absorb, the error of the points from each, and what would control it.

    The error in `hides` is that of the plausible cause in `assumed`, and is proportional to it.
    """
    seen = network.nominal[network.seen > 0]
    extent = float(np.linalg.norm(extents(seen))) if len(seen) else 0.0
    rows = _rows(network, extent) if network.unknown[network.seen > 0].any() else ()
    return table_of((*hidden_by(second), *rows, *taken_as_exact(part, extent, "points at 20 degC")))


def scale_warnings(network: TracerNetwork, solution: Solution) -> Iterator[str]:
    """Yield a warning if only the number of tracers makes the scale of the network better than that of one tracer.

    The mean of m independent scales has the standard uncertainty `sqrt(1' Q 1) / m`, Q the covariance of the scales. It
    falls with the root of m, while an error that all tracers share, as that of one weather station, does not.
    """
    scale, block = network.scale, network.blocks[t.TRACER]
    if scale is None or scale.common is not None or len(block.members) < 2 or _scaled(network):
        return
    # the scale is the fifth column of a tracer
    scales = solution.covariance_or_raise().of(t.TRACER)[4 :: block.size, 4 :: block.size]
    mean = float(np.sqrt(max(scales.mean(), 0.0)))
    if mean < scale.uncertainty:
        own, all_together = units.sized(scale.uncertainty, "ratio"), units.sized(mean, "ratio")
        yield (
            f"the scale of the network has a standard uncertainty of {all_together}, because the scales of its "
            f"{len(block.members)} tracers, {own} each, count as independent. If they share a source, such as one "
            f"weather station, write `scale: {{uncertainty: OWN, common: {own}}}`; if not, `common: 0 ppm`"
        )


def _rows(network: TracerNetwork, extent: float) -> Iterator[Hidden]:
    growth, moved = units.parse_quantity("1.15 ppm", "ratio"), units.parse_quantity("2 um", "length")
    counted = network.air is not None and network.air.std > 0
    if not _scaled(network) and not counted:
        control = (
            "a known length (inputs: distances), or two points known by sigma_mm; temperature and pressure of the air"
        )
        yield Hidden("common error of the refractive index", AIR_WORDS, AIR * extent, control)
    elif counted and not _scaled(network):
        yield Hidden(ASSUMED, AIR_WORDS, AIR * extent, ASSUMED_CONTROL)
    yield Hidden(
        "common drift of tracers or part",
        "2 um over the measurement",
        moved,
        "closing points: the first points measured again at the end, under new names",
    )
    yield Hidden(
        "growth of part or mover",
        "0.1 K of steel (1.15 um/m)",
        growth * extent,
        "temperature of the part with each point; closing points",
    )
    yield Hidden(
        "re-seated reflector",
        "2 um in its seat",
        moved,
        "closing points measured before and after each time the reflector is touched",
    )


def _scaled(network: TracerNetwork) -> bool:
    """Return whether known lengths or places determine the scale."""
    known = int((~network.unknown & (network.seen > 0)).sum())
    # two known places are a length between them
    fixed = int((~network.blocks[t.TRACER].free[:, :3]).all(axis=1).sum())
    bars = any(group.name == DISTANCES for group in network.others)
    held = {
        i
        for group in network.others
        if group.name == DISTANCES
        for i in group.observations.index[t.POINT].ravel().tolist()
    }
    return bars or known - len(held) >= 2 or fixed >= 2


EQUAL = 1e-4
"""Tests of a point that differ by less than this share are equal"""


def second_places(network: TracerNetwork, solution: Solution, noise: float) -> list[Mirrored]:
    """Return tracers and points with a second place; `noise` is a factor on the standard deviations of lengths.

    In a free network the list of points fixes the frame. Points that it decides for are left out there.
    """
    group = solution.group(LENGTHS)
    tracers = mirrored(of_tracers(solution, group, network.listed_at), noise)
    points = mirrored(of_points(solution, group, network.nominal), noise)
    return [*tracers, *(point for point in points if network.surveyed or not point.decided)]


def at_others(blocks: Mapping[str, Block], places: Sequence[Mirrored]) -> dict[str, Block]:
    """Return blocks whose members stand at the other one of two places that fit."""
    moved = {name: block.values.copy() for name, block in blocks.items()}
    for place in places:
        moved[place.noun][place.member, :3] = place.other
    return {name: replace(block, values=moved[name]) for name, block in blocks.items()}


def noise_of_tests(solution: Solution) -> float:
    """Return the noise to which tests of single lengths refer, in units of the declared one: sigma0, but at least 1."""
    return max(1.0, float(np.nan_to_num(solution.sigma0, nan=1.0)))


def units_of_tests(solution: Solution, residuals: Residuals) -> Array:
    """Return the divisor of each |w|, (n,): the noise of the tests; for the largest |w|, that without this length."""
    w = np.abs(residuals.normalised[0])
    units = np.full(len(w), noise_of_tests(solution))
    if solution.dof > 1 and len(w):
        worst = w >= (1 - EQUAL) * w.max()
        units[worst] = max(1.0, np.sqrt(max(solution.cost - w.max() ** 2, 0.0) / (solution.dof - 1)))
    return units
