"""How much a misfit of the readings that no adjustment shows can mean in the volume, at worst."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from metrocli.adjust.dense_jacobian import Unknowns, normal_matrix, unit_noise, unknowns_of
from metrocli.adjust.model.blocks import Block
from metrocli.arrays import Array
from metrocli.instruments.axes.rotary import Combinations
from metrocli.instruments.machine import TOOL
from metrocli.instruments.tracer import AIR, STOP
from metrocli.tasks.calibrate_machine.problem import NETWORK, MachineProblem
from metrocli.tasks.calibrate_machine.volume import rows_over_volume

_ROUNDING = 1e-12
"""Share of the largest square below which one is rounding"""
_LOOSE = 1e6
"""Factor on the standard deviations of conditions that makes their weights like those of readings of 1 mm"""


def worst_ratio(problem: MachineProblem) -> float:
    """Return the largest ratio of the error in the volume to the misfit of the readings, both root mean square.

    `max |G v| / |J v|` over all errors v that the tables can describe. G maps v to the error in the volume after the
    best rigid motion, J to the readings after the fit of the tracker's frame. What only a prior
    holds, such as the index of the air, stays as it is, and so do the errors that an earlier calibration gives. Returns
    inf if J does not see what moves the tool.
    """
    blocks = {name: _without(block, problem.given) for name, block in problem.blocks.items()}
    names = [name for name, block in blocks.items() if block.free.any() and name not in (TOOL, STOP, AIR, NETWORK)]
    unknowns = unknowns_of(blocks, names)
    if unknowns.size == 0:
        return 0.0
    weight = problem.per_reading / problem.per_reading.sum()
    unit = _angles_as_lengths(problem)[:, None] / np.sqrt(weight)
    # conditions of tables with weights like those of readings, which saves digits
    conditions = [group for group in problem.groups if isinstance(group.chain.links[0], Combinations)]
    loose = [group.with_noise_times(_LOOSE) for group in conditions]
    path = normal_matrix([unit_noise(problem.readings, unit), *loose], blocks, unknowns)
    volume = volume_matrix(problem, unknowns)
    # columns of one size: shifts in mm and turns in rad differ by many decades
    scale = 1 / np.sqrt(np.maximum(np.diag(path), 1e-300))
    values, vectors = np.linalg.eigh(path * scale[:, None] * scale)
    unseen, moves = values < _ROUNDING * values[-1], volume * scale[:, None] * scale
    # what only a list holds, such as the turn of all reflectors with the stations, is seen by no reading
    if np.abs(vectors[:, unseen].T @ moves @ vectors[:, unseen]).max(initial=0.0) > _ROUNDING * np.trace(moves):
        return float("inf")
    root = vectors[:, ~unseen] / np.sqrt(values[~unseen])
    return float(np.sqrt(max(np.linalg.eigvalsh(root.T @ moves @ root)[-1], 0.0)))


def _without(block: Block, given: Collection[str]) -> Block:
    """Return a block in which some of its columns are no unknowns."""
    return replace(block, free=block.free & ~np.isin(block.columns, list(given))) if given else block


def _angles_as_lengths(problem: MachineProblem) -> Array:
    """Return the size of each component that counts as 1 mm; for angles the lever is half the volume's diagonal."""
    lever = problem.machine.diagonal / 2
    return np.array(
        [1 / lever if name in ("ea", "eb", "ec") else 1.0 for name in problem.readings.observations.components]
    )


def volume_matrix(problem: MachineProblem, unknowns: Unknowns) -> Array:
    """Return the matrix (unknowns, unknowns) of the mean square displacement in the volume as a quadratic form.

    The mean is over the volume and the measured tools, without rigid motion.
    """
    machine, blocks = problem.machine, problem.blocks
    grids = np.concatenate([rows_over_volume(machine, blocks, tool, unknowns) for tool in problem.tools_used], axis=1)
    flat = grids.reshape(-1, unknowns.size)
    return np.asarray(flat.T @ flat / grids.shape[1])
