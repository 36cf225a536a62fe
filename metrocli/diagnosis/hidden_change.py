"""The largest change of the delivered result that an effect makes without being found.

Method: docs/algorithms/selection-and-levels.md (what a measurement can see).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrocli.adjust.model.blocks import Array, Space
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear.candidates import Alternative, Family
from metrocli.diagnosis.linear.projection import FLAT, VISIBLE, System

POWER = 0.95
"""Probability with which an effect is found that changes the result by more"""
_MOST_NUMBERS = 4_000_000
"""Unknowns times readings above which only the own member of each reading is considered"""
_NOTHING = 1e-9
"""Change of the result, relative to the change of all readings, that is rounding"""


@dataclass(frozen=True)
class HiddenChange:
    """The largest change of the delivered result that is not found with 95 % power, and the member it moves."""

    size: float
    """Length of the change over the columns of the member, in the unit of the block"""
    member: str = ""
    """Name of the member that moves most, such as the point"""


def hidden_change(
    job: AdjustedJob, system: System, family: Family, chosen: Sequence[int], gram: Array, reach: Array
) -> HiddenChange:
    """Return the largest change of a delivered member by undetected sizes theta of some alternatives of a family.

    theta is undetected in a direction of its Gram matrix A = G'MG with eigenvalue v while `t^2 v < lambda s^2`, with
    the non-centrality lambda of 95 % power in `reach`[:, 0] (alternatives,) times the variance of the noise. In no
    direction does it exceed `reach`[:, 1], in plausible sizes: directions that the readings do not show end there.
    The change of member m is `S_m theta`; its largest length is the spectral norm of S_m times the semi-axes.
    """
    at = list(chosen)
    scale = np.where(family.raw[at] > 0, family.raw[at], 1.0)
    values, vectors = np.linalg.eigh(gram[at] / (scale[:, :, None] * scale[:, None, :]))
    seen = values > np.maximum(VISIBLE**2, FLAT * values[:, -1:])
    # columns of `axes` are directions of the parameters with unit length in the scaled Gram matrix
    axes = vectors / scale[:, :, None]
    plausible = np.stack([_plausible(family.alternatives[i]) for i in at])
    farthest = reach[:, 1, None] / np.linalg.norm(axes / plausible[:, :, None], axis=1)
    shown = np.sqrt(reach[:, 0, None] / np.where(seen, values, 1.0))
    axes = axes * np.where(seen, np.minimum(shown, farthest), farthest)[:, None, :]
    shift = _shifts(job, system, family.absorbed[:, at])
    shift = np.where(_is_rounding(system, shift, scale), 0.0, shift)
    moved = np.einsum("mckq,kqp->kmcp", shift, axes)
    return _largest(job, moved)


def hidden_by_readings(job: AdjustedJob, system: System, rows: Index, errors: Array) -> HiddenChange:
    """Return the largest change of the delivered result by one of some errors of single rows, in their sigma."""
    if len(rows) * system.layout.width > _MOST_NUMBERS and system.is_local(job.delivered.block):
        return _of_own_members(job, system, rows, errors)
    moved = _shifts(job, system, system.basis.rows(rows).T[:, :, None] * errors[:, None])
    return _largest(job, np.moveaxis(moved, 2, 0))


def _of_own_members(job: AdjustedJob, system: System, rows: Index, errors: Array) -> HiddenChange:
    """Return the largest change of the member that a row concerns, such as its point: others move far less."""
    moved = system.solver.own_change(system.basis, rows)[:, list(job.delivered.columns)] * errors[:, None]
    sizes = np.linalg.norm(moved, axis=1)
    best = int(np.argmax(sizes))
    return HiddenChange(
        float(sizes[best]), job.model.blocks[job.delivered.block].members[system.basis.member[rows[best]]]
    )


def _plausible(alternative: Alternative) -> Array:
    """Return the largest usual size of each column of an alternative, (parameters,)."""
    effect = alternative.effect
    if effect.space is Space.WAVE:
        # both steps are lengths of the phasor
        return np.full(len(alternative.parameters), effect.plausible)
    first = effect.parameters[0].dimension
    known = {p.name: effect.plausible if p.dimension == first else p.plausible for p in effect.parameters}
    return np.array([known[name] for name in alternative.parameters])


def _shifts(job: AdjustedJob, system: System, absorbed: Array) -> Array:
    """Return the change of the delivered members by unit parameters, (members, columns, alternatives, parameters)."""
    entries = [system.entries(name)[:, list(job.delivered.columns)] for name in job.delivered.blocks]
    places = np.concatenate(entries)
    moved = system.solver.change(absorbed)[np.maximum(places, 0)]
    return np.where((places >= 0)[:, :, None, None], moved, 0.0)


def _is_rounding(system: System, shift: Array, scale: Array) -> Array:
    typical = float(np.median(system.scale[system.measured]))
    return np.asarray(np.linalg.norm(shift, axis=(0, 1)) < _NOTHING * typical * scale)


def _largest(job: AdjustedJob, moved: Array) -> HiddenChange:
    """Return the largest spectral norm of (alternatives, members, columns, directions)."""
    squares = (moved**2).sum(axis=(2, 3))
    if not squares.size or squares.max() == 0:
        return HiddenChange(0.0)
    # the spectral norm is at least the Frobenius norm over the root of the rank, so few matrices need it
    kept = np.argwhere(squares >= squares.max() / min(moved.shape[2:]))
    norms = np.linalg.norm(moved[kept[:, 0], kept[:, 1]], 2, axis=(1, 2))
    best = int(np.argmax(norms))
    members = [name for block in job.delivered.blocks for name in job.model.blocks[block].members]
    return HiddenChange(float(norms[best]), members[int(kept[best, 1])])
