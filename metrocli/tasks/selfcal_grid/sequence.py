"""The sequence of Dang, Lee and Kim, for comparison with the joint adjustment.

A rigid fit of the readings gives the mountings of views without a shift (their eq. 6). It assumes that neither field
has rigid motion. The artefact error then drops out of the differences against view 1 (eq. 7-9). The differences give
the machine error together with the mountings of the shifted views. The paper does not print this step; least squares
with equal weights stands for it. Differences against one view are correlated. The sequence neglects this, which
increases its noise gain.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.coupled_fields import FieldDesign, adjust_fields, design_of
from metrocli.adjust.sparse.bordered_factor import BorderedFactor, bordered_factor
from metrocli.adjust.sparse.nested_dissection import Sparse
from metrocli.adjust.sparse.partition import Partition
from metrocli.arrays import Array, Index
from metrocli.errors import InputError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.geometry.poses import rotation_of
from metrocli.instruments import ball_grid as bg
from metrocli.table import Table
from metrocli.tasks.selfcal_grid.problem import GridProblem

_DRAWS = 20


@dataclass(frozen=True)
class _Sequence:
    """Differences against the first view without a shift, and the least squares that gives the machine error."""

    differences: Sparse
    """Matrix from whitened readings to differences"""
    jacobian: Sparse
    """Derivatives of the differences by machine error and mountings of shifted views"""
    reduction: BorderedFactor

    def machine(self, readings: Array) -> Array:
        """Return the machine error, (net,) or (net, k), from whitened readings after the fit of unshifted views."""
        return self.reduction.solve(self.jacobian.T @ (self.differences @ readings))[: self.reduction.sizes.net]


def in_sequence(problem: GridProblem) -> Table:
    """Return a table with one row for the joint adjustment and one for the sequence.

    Each row has the noise gain, the size of the machine error, and its difference from the joint adjustment. Rigid
    motion and scale are removed from both. The noise gain is the root mean square machine error from readings of pure
    noise, over that noise, from 20 draws.
    Raises InputError if every view has a shift, and UndeterminedError if more than rigid motion and scale is open.
    """
    design = design_of(problem.fields)
    if design.null.shape[1] > 13 - problem.scale_given:
        raise UndeterminedError(
            "the views leave more undetermined than rigid motions and scale, so the two ways cannot be compared; run "
            "the job without --compare to see what is undetermined"
        )
    joint = adjust_fields(problem.fields, design).solution.blocks[bg.MACHINE].values
    places = _grid_places(problem, design)
    sequence = _sequence(problem, design)
    own = _shape(problem, joint.ravel()[_on_grid(problem)])
    other = _shape(problem, sequence.machine(_reduced_readings(problem))[places])
    gains = noise_gains(problem, np.random.default_rng(0), _DRAWS)
    return Table.of(
        {
            "way": ["joint", "views fitted first, differences"],
            "noise_gain": gains,
            "rms_machine_error [mm]": [_rms(own), _rms(other)],
            "rms_difference [mm]": [0.0, _rms(other - own)],
            "largest_difference [mm]": [0.0, float(np.abs(other - own).max())],
        }
    )


def noise_gains(problem: GridProblem, rng: np.random.Generator, draws: int) -> tuple[float, float]:
    """Return the noise gains of the machine error, joint and in sequence, from draws of pure noise."""
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


def _on_grid(problem: GridProblem) -> Index:
    free = problem.fields.blocks[bg.MACHINE].free & (problem.grid.within > 0)[:, None]
    return np.flatnonzero(free.ravel())


def _grid_places(problem: GridProblem, design: FieldDesign) -> Index:
    return design.partition.columns[bg.MACHINE].ravel()[_on_grid(problem)]


def _sequence(problem: GridProblem, design: FieldDesign) -> _Sequence:
    from scipy.sparse import csr_array, hstack

    parts, count = design.partition, 3 * problem.readings.observations.count
    jacobian = design.jacobian[:count]
    local = jacobian[:, parts.net : parts.net + parts.local].tocsr()
    rows, unknown, sign = np.repeat(np.arange(count), np.diff(local.indptr)), local.indices, np.sign(local.data)
    view = np.tile(problem.readings.observations.index[bg.VIEW], 3)
    reference = np.full(parts.local, -1, dtype=np.intp)
    first = next((n for n, view in enumerate(problem.views) if not view.shift.any()), None)
    if first is None:
        raise InputError("the sequence needs a view without a shift as the reference of its differences")
    base = view[rows] == first
    reference[unknown[base]] = np.flatnonzero(base)
    pairs = np.flatnonzero((view[rows] != first) & (reference[unknown] >= 0))
    others = reference[unknown[pairs]]
    n = np.arange(len(pairs))
    at = (np.concatenate([n, n]), np.concatenate([rows[pairs], rows[others]]))
    differences = csr_array((np.concatenate([sign[pairs], -sign[others]]), at), shape=(len(pairs), count))
    shifted = np.array([bool(view.shift.any()) for view in problem.views])
    border = parts.columns[bg.VIEW][shifted].ravel()
    wanted = differences @ hstack([jacobian[:, : parts.net], jacobian[:, border]], format="csr")
    sizes = Partition(parts.net, 0, parts.net + len(border), {})
    seats = np.zeros((parts.net, 3))
    columns = parts.columns[bg.MACHINE]
    seats[columns[columns >= 0]] = bg.folded(problem.grid.sites)[columns >= 0]
    return _Sequence(differences, wanted, bordered_factor(wanted, sizes, seats))


def _shape(problem: GridProblem, machine: Array) -> Array:
    """Return machine errors on the grid, (3 sites, ...), without rigid motion and scale, which both ways determine."""
    places = problem.grid.site_places
    motions = np.concatenate([bg.rigid(places), places[:, :, None]], axis=2).reshape(-1, 7)[_on_grid(problem)]
    return np.asarray(machine - motions @ np.linalg.lstsq(motions, machine, rcond=None)[0])


def _reduced_readings(problem: GridProblem) -> Array:
    """Return the whitened residuals (3n,), turned back by the rotation of their view."""
    group = problem.readings
    observations = group.observations
    residual = group.residuals(problem.fields.blocks)
    turns = rotation_of(problem.fields.blocks[bg.VIEW].values)[observations.index[bg.VIEW]]
    back = np.einsum("nba,bn->an", turns, residual)
    return np.asarray(observations.whitened(back)).reshape(-1)


def _without_mountings(problem: GridProblem, noise: Array) -> Array:
    """Return noise (3, n, k) without the rigid motion that the fit of each unshifted view absorbs."""
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
