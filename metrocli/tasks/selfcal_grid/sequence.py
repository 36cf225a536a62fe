"""The sequence of Dang, Lee and Kim beside the joint adjustment.

Views without a shift have their mountings from a rigid fit of the readings (their eq. 6), on the assumption that
neither field has rigid motion; the artefact error then drops out of the differences against view 1 (eq. 7-9), from
which the machine error follows together with the mountings of the shifted views. Their algebra is not printed; least
squares with equal weights stands for it. Differences against one view are correlated, which it does not know: its loss.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.coupled_fields import Design, adjust_fields, design_of
from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.adjust.sparse.bordered_factor import BorderedFactor, bordered_factor
from metrocli.adjust.sparse.nested_dissection import Sparse
from metrocli.adjust.sparse.partition import Partition
from metrocli.errors import InputError, UndeterminedError
from metrocli.geometry.poses import rotation_of
from metrocli.instruments import ball_grid as bg
from metrocli.table import Table
from metrocli.tasks.selfcal_grid.problem import Problem

if TYPE_CHECKING:
    from metrocli.table import Values

_DRAWS = 20


@dataclass(frozen=True)
class _Sequence:
    """Differences against the first view, and how the machine error follows from them."""

    differences: Sparse
    """From whitened readings to differences"""
    jacobian: Sparse
    """Of the differences by machine error and mountings of shifted views"""
    reduction: BorderedFactor

    def machine(self, readings: Array) -> Array:
        """Return the machine error from whitened readings with the unshifted views fitted, (net,) or (net, k)."""
        return self.reduction.solve(self.jacobian.T @ (self.differences @ readings))[: self.reduction.sizes.net]


def in_sequence(problem: Problem) -> Table:
    """Return the noise gain and the machine errors' difference for both ways, a row each.

    Both are compared without rigid motion and scale. The noise gain is the root mean square change of the machine
    error for readings of pure noise, over that noise, from 20 draws. InputError where no view is without a shift, from
    which to count differences.
    """
    design = design_of(problem.fields)
    if design.null.shape[1] > 13 - problem.scale_given:
        raise UndeterminedError(
            "the views leave more open than rigid motions and scale: there is nothing to compare; run the job without "
            "--compare to see what"
        )
    joint = adjust_fields(problem.fields, design).solution.blocks[bg.MACHINE].values
    places = _grid_places(problem, design)
    sequence = _sequence(problem, design)
    own = _shape(problem, joint.ravel()[_on_grid(problem)])
    other = _shape(problem, sequence.machine(_reduced_readings(problem))[places])
    gains = noise_gains(problem, np.random.default_rng(0), _DRAWS)
    columns: dict[str, Values] = {
        "way": np.array(["joint", "views fitted first, differences"]),
        "noise_gain": np.array(gains),
        "rms_machine_error": np.array([_rms(own), _rms(other)]),
        "rms_difference": np.array([0.0, _rms(other - own)]),
        "largest_difference": np.array([0.0, float(np.abs(other - own).max())]),
    }
    return Table(columns, {name: "mm" for name in columns if name not in ("way", "noise_gain")})


def noise_gains(problem: Problem, rng: np.random.Generator, draws: int) -> tuple[float, float]:
    """Return the noise gain of the machine error, joint and in sequence, from draws of pure noise at the design."""
    design = design_of(problem.fields)
    observations = problem.readings.observations
    noise = rng.normal(0.0, 1.0, (3, observations.count, draws))
    whole = np.zeros((design.jacobian.shape[0], draws))
    whole[: 3 * observations.count] = noise.reshape(-1, draws)
    places = _grid_places(problem, design)
    own = _shape(problem, design.solve(design.jacobian.T @ whole)[places])
    fitted = _without_mountings(problem, noise).reshape(-1, draws)
    other = _shape(problem, _sequence(problem, design).machine(fitted)[places])
    sigma = float(observations.sigma.mean())
    return _rms(own) / sigma, _rms(other) / sigma


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def _on_grid(problem: Problem) -> Index:
    free = problem.fields.blocks[bg.MACHINE].free & (problem.grid.within > 0)[:, None]
    return np.flatnonzero(free.ravel())


def _grid_places(problem: Problem, design: Design) -> Index:
    return design.partition.columns[bg.MACHINE].ravel()[_on_grid(problem)]


def _sequence(problem: Problem, design: Design) -> _Sequence:
    from scipy.sparse import csr_array, hstack

    parts, count = design.partition, 3 * problem.readings.observations.count
    jacobian = design.jacobian[:count]
    local = jacobian[:, parts.net : parts.net + parts.local].tocsr()
    rows, unknown, sign = np.repeat(np.arange(count), np.diff(local.indptr)), local.indices, np.sign(local.data)
    view = np.tile(problem.readings.observations.index[bg.VIEW], 3)
    reference = np.full(parts.local, -1, dtype=np.intp)
    first = next((n for n, one in enumerate(problem.views) if not one.shift.any()), None)
    if first is None:
        raise InputError("the sequence needs a view without a shift to count differences from")
    base = view[rows] == first
    reference[unknown[base]] = np.flatnonzero(base)
    pairs = np.flatnonzero((view[rows] != first) & (reference[unknown] >= 0))
    others = reference[unknown[pairs]]
    n = np.arange(len(pairs))
    at = (np.concatenate([n, n]), np.concatenate([rows[pairs], rows[others]]))
    differences = csr_array((np.concatenate([sign[pairs], -sign[others]]), at), shape=(len(pairs), count))
    shifted = np.array([bool(one.shift.any()) for one in problem.views])
    border = parts.columns[bg.VIEW][shifted].ravel()
    wanted = differences @ hstack([jacobian[:, : parts.net], jacobian[:, border]], format="csr")
    sizes = Partition(parts.net, 0, parts.net + len(border), {})
    seats = np.zeros((parts.net, 3))
    columns = parts.columns[bg.MACHINE]
    seats[columns[columns >= 0]] = bg.folded(problem.grid.sites)[columns >= 0]
    return _Sequence(differences, wanted, bordered_factor(wanted, sizes, seats))


def _shape(problem: Problem, machine: Array) -> Array:
    """Return machine errors on the grid, (3 sites, ...), without rigid motion and scale: what both ways determine."""
    places = problem.grid.site_places
    motions = np.concatenate([bg.rigid(places), places[:, :, None]], axis=2).reshape(-1, 7)[_on_grid(problem)]
    return np.asarray(machine - motions @ np.linalg.lstsq(motions, machine, rcond=None)[0])


def _reduced_readings(problem: Problem) -> Array:
    """Return the whitened readings minus their nominal places, each unshifted view fitted and turned back (3n,)."""
    group = problem.readings
    observations = group.observations
    residual = group.residuals(problem.fields.blocks)
    turns = rotation_of(problem.fields.blocks[bg.VIEW].values)[observations.index[bg.VIEW]]
    back = np.einsum("nba,bn->an", turns, residual)
    return np.asarray(observations.whitened(back)).reshape(-1)


def _without_mountings(problem: Problem, noise: Array) -> Array:
    """Return noise (3, n, k) without the rigid motion that the fit of each unshifted view takes from it."""
    index = problem.readings.observations.index
    left = noise.copy()
    for n, view in enumerate(problem.views):
        if view.shift.any():
            continue
        rows = np.flatnonzero(index[bg.VIEW] == n)
        motions = bg.rigid(problem.grid.site_places[index[bg.MACHINE][rows]]).reshape(-1, 6)
        own = noise[:, rows].transpose(1, 0, 2).reshape(-1, noise.shape[2])
        rest = own - motions @ np.linalg.lstsq(motions, own, rcond=None)[0]
        left[:, rows] = rest.reshape(len(rows), 3, -1).transpose(1, 0, 2)
    return left
