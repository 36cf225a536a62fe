"""The sequence of Dang, Lee and Kim beside the joint adjustment: mountings of the views on the full grid fitted first.

Views without a shift have their mountings from a rigid fit of the readings (their eq. 6), on the assumption that neither
field has rigid motion; these are then held, and the rest (eq. 7-9, with the mounting of the shifted views) is adjusted.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.coupled import FieldSolution, adjust_fields, design_of
from metrocli.instruments import ball_grid as bg
from metrocli.table import Table
from metrocli.tasks.grid_problem import Problem

if TYPE_CHECKING:
    from metrocli.table import Values

_DRAWS = 20


def in_sequence(problem: Problem) -> Table:
    """Return sigma0, the noise gain and the fields' difference for both ways, a row each.

    The noise gain is the root mean square change of the machine error for readings of pure noise, over that noise,
    from 20 draws.
    """
    joint, sequential = adjust_fields(problem.fields), adjust_fields(_held(problem).fields)
    change = sequential.solution.blocks[bg.MACHINE].values - joint.solution.blocks[bg.MACHINE].values
    gains = noise_gains(problem, np.random.default_rng(0), _DRAWS)
    columns: dict[str, Values] = {
        "way": np.array(["joint", "views fitted first"]),
        "sigma0": np.array([_sigma0(joint, joint), _sigma0(sequential, joint)]),
        "noise_gain": np.array(gains),
        "rms_difference": np.array([0.0, float(np.sqrt((change**2).mean()))]),
        "largest_difference": np.array([0.0, float(np.abs(change).max())]),
    }
    return Table(columns, {"rms_difference": "mm", "largest_difference": "mm"})


def _sigma0(found: FieldSolution, joint: FieldSolution) -> float:
    return float(np.sqrt(found.solution.cost / joint.solution.dof)) if joint.solution.dof > 0 else float("nan")


def _held(problem: Problem) -> Problem:
    """Return the problem with the mountings of the unshifted views held where the start, a rigid fit, has them."""
    block = problem.fields.blocks[bg.VIEW]
    shifted = np.array([bool(view.shift.any()) for view in problem.views])
    blocks = {**problem.fields.blocks, bg.VIEW: replace(block, free=block.free & shifted[:, None])}
    return replace(problem, fields=replace(problem.fields, blocks=blocks))


def noise_gains(problem: Problem, rng: np.random.Generator, draws: int) -> tuple[float, float]:
    """Return the noise gain of the machine error, joint and in sequence, from draws of pure noise at the design."""
    joint = design_of(problem.fields)
    held = design_of(_held(problem).fields)
    observations = problem.readings.observations
    noise = rng.normal(0.0, 1.0, (3, observations.count, draws))
    lengths = np.zeros((joint.jacobian.shape[0] - 3 * observations.count, draws))
    whole = np.concatenate([noise.reshape(-1, draws), lengths])
    places = joint.partition.columns[bg.MACHINE]
    sites = problem.grid.within > 0
    own = joint.solve(joint.jacobian.T @ whole)[places[sites].ravel()]
    fitted = np.concatenate([_without_mountings(problem, noise).reshape(-1, draws), lengths])
    other = held.solve(held.jacobian.T @ fitted)[held.partition.columns[bg.MACHINE][sites].ravel()]
    return _rms(own, observations.sigma), _rms(other, observations.sigma)


def _rms(values: Array, sigma: Array) -> float:
    return float(np.sqrt((values**2).mean()) / sigma.mean())


def _without_mountings(problem: Problem, noise: Array) -> Array:
    """Return noise (3, n, k) without the rigid motion that the fit of each unshifted view takes from it."""
    index = problem.readings.observations.index
    left = noise.copy()
    for n, view in enumerate(problem.views):
        if view.shift.any():
            continue
        rows = np.flatnonzero(index[bg.VIEW] == n)
        motions = bg.rigid(problem.grid.sites[index[bg.MACHINE][rows]]).reshape(-1, 6)
        own = noise[:, rows].transpose(1, 0, 2).reshape(-1, noise.shape[2])
        rest = own - motions @ np.linalg.lstsq(motions, own, rcond=None)[0]
        left[:, rows] = rest.reshape(len(rows), 3, -1).transpose(1, 0, 2)
    return left
