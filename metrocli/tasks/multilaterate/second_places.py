"""Points and tracers with a second place that fits their lengths as well, and the noise that tests refer to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.solution import Residuals, Solution
from metrocli.arrays import Array
from metrocli.tasks.multilaterate.problem import LENGTHS, TracerNetwork
from metrocli.tasks.shared.mirror import Mirrored, mirrored, of_points, of_tracers

EQUAL = 1e-4
"""Tests of a point that differ by less than this share are equal"""


def second_places(network: TracerNetwork, solution: Solution, noise: float) -> list[Mirrored]:
    """Return tracers and points with a second place; `noise` is a factor on the standard deviations of lengths.

    In a free network the list of points fixes the frame. Points that it decides for are left out there.
    """
    group = next(group for group in solution.groups if group.name == LENGTHS)
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
