"""The result of a self-calibration: error fields with uncertainty, undetermined directions, views, residuals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.effects.estimates import estimates
from metrocli.effects.estimates import tables as effect_results
from metrocli.frozen import dataclass
from metrocli.geometry.poses import EULER, euler_form
from metrocli.instruments import ball_grid as bg
from metrocli.result import Estimate, Result, ShownTable
from metrocli.table import Table
from metrocli.tasks.selfcal_grid import KIND
from metrocli.tasks.selfcal_grid import warnings as grid_warnings
from metrocli.tasks.selfcal_grid.determination.undetermined import Open
from metrocli.tasks.selfcal_grid.error_map import Covariance, SiteErrors, Smooth, error_map, smooth
from metrocli.tasks.selfcal_grid.lengths import LargestLengthError, largest
from metrocli.tasks.selfcal_grid.problem import GridProblem
from metrocli.tasks.selfcal_grid.solve import AdjustedGrid, LeftOut
from metrocli.tasks.selfcal_grid.warnings import uncontrolled
from metrocli.tasks.shared.statistics import Statistics, basic_statistics, noise_notes, residual_table
from metrocli.tasks.shared.uncontrolled import TABLE, in_words
from metrocli.units import find_unit, with_std
from metrocli.words import in_a_row

_UNITS = ("mm", "mm", "mm", "rad", "rad", "rad")
_KEPT = 4_000_000
"""Largest number of elements of a covariance matrix that is written"""
_CONTROLLED = 1e-6
"""Redundancy of a view below which it is a rounding error"""


@dataclass(frozen=True)
class _Field:
    """A solved error field at the places that have readings."""

    indices: Index
    values: Array
    std: Array
    """inf where the views leave it undetermined"""


def report(solved: AdjustedGrid, left_open: Open, left_out: Sequence[LeftOut], points: Table | None) -> Result:
    """Return the result of a solved self-calibration."""
    machine, artefact = _field(solved, bg.MACHINE), _field(solved, bg.ARTEFACT)
    form, length = _forms(solved, machine)
    mountings, covariance = _mountings(solved)
    groups = solved.problem.fields.groups
    effects, effect_arrays = effect_results(solved.problem.effects, solved.field_solution)
    hidden = uncontrolled(solved.problem)
    tables = {
        "machine_error": _table(machine),
        "artefact_error": _table(artefact),
        "correction": _correction(solved, machine),
        "undetermined": _undetermined(left_open),
        "views": _views(solved, left_out),
        "residuals": _residuals(solved),
        **({"lengths": residual_table(solved.residuals[1], groups[1])} if len(groups) > 1 else {}),
        "suspects": _suspects(solved),
        "rejected": _rejected(solved),
        TABLE: hidden,
        **effects,
        **({"length_error": length.table} if length else {}),
    }
    if points is not None:
        tables["map"] = error_map(points, _at_sites(solved, machine), _of_machine(solved), form)
    statistics, length_note = _statistics(solved, left_open, machine, length)
    return Result(
        kind=KIND.name,
        title="",
        estimates=(*mountings, *estimates(solved.problem.effects, solved.field_solution)),
        covariance=covariance,
        statistics=statistics,
        tables=tables,
        arrays=_arrays(solved, machine, form) | effect_arrays,
        warnings=(*solved.problem.warnings, *grid_warnings.warnings(solved, left_open, machine.std, left_out)),
        doubts=tuple(grid_warnings.contradicting(solved)),
        shown=(ShownTable("views"), *((ShownTable("suspects"),) if len(solved.suspects.rows) else ())),
        notes=(
            *left_open.sentences(),
            *noise_notes(solved.solution),
            *length_note,
            *_smooth_note(form),
            *in_words(hidden),
        ),
    )


def _forms(solved: AdjustedGrid, machine: _Field) -> tuple[Smooth | None, LargestLengthError | None]:
    """Return the smooth form and the length errors; both are None if a part of the field is undetermined."""
    if not np.isfinite(machine.std).all():
        return None, None
    sites = _at_sites(solved, machine)
    return smooth(sites, _of_machine(solved)), largest(sites.places, machine.values)


def _residuals(solved: AdjustedGrid) -> Table:
    """Return the residuals with the place in the machine, a site of the grid, where each reading was taken."""
    grid, read = solved.problem.grid, solved.problem.readings.observations
    table = residual_table(solved.residuals[0], solved.problem.readings)
    at = np.repeat((grid.sites * grid.pitch)[read.index[bg.MACHINE]], len(read.components), axis=0)
    return table.joined({"x y z [mm]": at})


def _at_sites(solved: AdjustedGrid, machine: _Field) -> SiteErrors:
    return SiteErrors(machine.indices, solved.problem.grid.pitch, machine.values, machine.std)


def _field(solved: AdjustedGrid, name: str) -> _Field:
    """Return a field at its measured places; the machine error includes sites outside the grid."""
    block = solved.solution.blocks[name]
    indices = solved.problem.grid.sites if name == bg.MACHINE else solved.problem.grid.balls
    seen: Mask = np.asarray(block.free.all(axis=1))
    std = np.where(solved.determined[name], solved.design.std(name), np.inf)
    return _Field(indices[seen], block.values[seen], std[seen])


def _table(field: _Field) -> Table:
    errors = {"ex ey ez [mm]": field.values, "s_ex s_ey s_ez [mm]": field.std}
    return Table.of({"i j k": field.indices.astype(np.int64), **errors})


def _correction(solved: AdjustedGrid, field: _Field) -> Table:
    """Return the correction to add to a reading near each site, which is minus the machine error."""
    places = np.asarray(field.indices * solved.problem.grid.pitch, dtype=float)
    correction = {"add_x add_y add_z [mm]": -field.values, "s_add_x s_add_y s_add_z [mm]": field.std}
    return Table.of({"x y z [mm]": places, **correction})


def _of_machine(solved: AdjustedGrid) -> Covariance:
    """Return a function for the covariance of weighted machine errors, component by component."""
    from scipy.sparse import csr_array

    block = solved.solution.blocks[bg.MACHINE]
    places = solved.design.partition.columns[bg.MACHINE][block.free.all(axis=1)]

    def covariance(weights: Array) -> Array:
        given, width = csr_array(weights), solved.design.partition.width
        rows = [
            csr_array((given.data, column[given.indices], given.indptr), shape=(len(weights), width))
            for column in places.T
        ]
        return np.stack([solved.design.covariance(each) for each in rows])

    return covariance


def _mountings(solved: AdjustedGrid) -> tuple[list[Estimate], Array]:
    """Return the estimated mountings, and the covariance of mountings and effect parameters."""
    columns = solved.design.partition.columns
    block, places = solved.solution.blocks[bg.VIEW], columns[bg.VIEW].ravel()
    effects = [columns[effect.block].ravel() for effect in solved.problem.effects]
    covariance = solved.field_solution.between(np.concatenate([part[part >= 0] for part in (places, *effects)]))
    std = np.zeros(len(places))
    std[places >= 0] = np.sqrt(np.diag(covariance))[: int((places >= 0).sum())]
    std[~solved.determined[bg.VIEW].ravel()] = np.inf
    values, names = euler_form(block.values).ravel(), [f"{view}.{name}" for view in block.members for name in EULER]
    rows = zip(names, values.tolist(), std.tolist(), _UNITS * len(block.members), strict=True)
    return [Estimate(*row) for row, place in zip(rows, places, strict=True) if place >= 0], covariance


def _undetermined(left_open: Open) -> Table:
    rows = [("rigid motion of the machine error", 6), ("rigid motion of the artefact error", 6)]
    rows += [("common scale", 1)] if left_open.scale else []
    rows += [(family.pattern, family.count) for family in left_open.families]
    return Table.of_rows(("pattern", "directions"), rows)


def _views(solved: AdjustedGrid, left_out: Sequence[LeftOut]) -> Table:
    """Return the fit of each view, within the adjustment and against the other views."""
    group, residuals = solved.problem.readings, solved.residuals[0]
    view = group.observations.index[bg.VIEW]
    count = len(solved.problem.views)
    square = np.bincount(view, (residuals.values**2).sum(axis=0), count)
    chi2 = np.bincount(view, ((residuals.values / residuals.sigma) ** 2).sum(axis=0), count)
    share = np.bincount(view, residuals.redundancy.sum(axis=0), count)
    readings = np.bincount(view, minlength=count)
    table = Table.of(
        {
            "view": [view.name for view in solved.problem.views],
            "readings": readings,
            "rms [mm]": np.sqrt(square / np.maximum(3 * readings, 1)),
            "chi2": chi2,
            "redundancy": share,
            "sigma0": np.sqrt(chi2 / np.where(share > _CONTROLLED, share, np.nan)),
        }
    )
    if not left_out:
        return table
    fall = {"left_out_chi2": [left.chi2 for left in left_out], "left_out_dof": [left.dof for left in left_out]}
    return table.joined({**fall, "left_out_p": [left.p_value for left in left_out]})


def _keys_of(problem: GridProblem, rows: Sequence[int]) -> dict[str, list[str]]:
    keys = problem.readings.observations.keys
    return {f"{key} [text]": [values[row] for row in rows] for key, values in keys.items()}


def _suspects(solved: AdjustedGrid) -> Table:
    rows = solved.suspects.rows
    order = np.argsort(-solved.suspects.tests)
    components = np.abs(solved.residuals[0].normalised[:, rows]).argmax(axis=0)
    keys = _keys_of(solved.problem, rows[order].tolist())
    of = {"component [text]": ["xyz"[n] for n in components[order]], "w": solved.suspects.tests[order]}
    return Table.of({**keys, **of})


def _rejected(solved: AdjustedGrid) -> Table:
    keys = _keys_of(solved.whole, [row for row, _ in solved.rejected])
    return Table.of({**keys, "w": [test for _, test in solved.rejected]})


def _arrays(solved: AdjustedGrid, machine: _Field, form: Smooth | None) -> dict[str, Array]:
    arrays: dict[str, Array] = {"pitch": np.array([solved.problem.grid.pitch])}
    if form is not None:
        arrays |= {
            "smooth/degree": np.array([float(form.degree)]),
            "smooth/coefficients": form.coefficients,
            "smooth/covariance": form.covariance,
            "smooth/misfit": form.misfit,
            "smooth/centre": form.centre,
            "smooth/half": form.half,
        }
    if (3 * len(machine.indices)) ** 2 <= _KEPT:
        from scipy.sparse import eye_array

        free = solved.solution.blocks[bg.MACHINE].free.all(axis=1)
        columns = solved.design.partition.columns[bg.MACHINE][free].ravel()
        arrays["machine_error_covariance"] = solved.design.covariance(
            eye_array(solved.design.partition.width, format="csr")[columns]
        )
    return arrays


def _statistics(
    solved: AdjustedGrid, left_open: Open, machine: _Field, length: LargestLengthError | None
) -> tuple[Statistics, tuple[str, ...]]:
    rms = float(np.sqrt((solved.residuals[0].values ** 2).mean()))
    finite = np.isfinite(machine.std)
    noise = float(solved.problem.readings.observations.sigma.mean())
    # as of a plan: a site beyond the grid has few readings, and what the grid states does not depend on it
    on_grid = finite & (np.abs(machine.indices) <= solved.problem.grid.half).all(axis=1, keepdims=True)
    gain = float(np.sqrt((machine.std[on_grid] ** 2).mean()) / noise) if on_grid.any() else float("inf")
    statistics = basic_statistics(solved.solution, {"mm": rms}) | {
        "undetermined": left_open.count,
        "noise_gain": gain,
        "rejected": len(solved.rejected),
        "critical_w": solved.suspects.critical,
    }
    if finite.all():
        statistics |= {
            "largest_machine_error": {"mm": float(np.linalg.norm(machine.values, axis=1).max())},
            "rms_machine_error": {"mm": float(np.sqrt((machine.values**2).mean()))},
            "rms_artefact_error": {"mm": float(np.sqrt((solved.solution.blocks[bg.ARTEFACT].values ** 2).mean()))},
        }
    if length is None:
        return statistics, ()
    um, std = find_unit("um", "length"), _length_std(solved, length)
    statistics |= {"largest_length_error": {"mm": length.error}, "largest_length_error_std": {"mm": std}}
    ends = [", ".join(map(str, machine.indices[n].tolist())) for n in (length.first, length.second)]
    reach = " apart from the common scale" if left_open.scale else ""
    value = with_std(um.outside(length.error), um.outside(std))
    note = (
        f"largest length error between sites{reach}: {value} um (standard uncertainty of this length), "
        f"from ({ends[0]}) to ({ends[1]}); noise raises the largest of all pairs of {length.sites} sites"
    )
    return statistics, (note,)


def _length_std(solved: AdjustedGrid, length: LargestLengthError) -> float:
    from scipy.sparse import csr_array

    block = solved.solution.blocks[bg.MACHINE]
    places = solved.design.partition.columns[bg.MACHINE][block.free.all(axis=1)]
    row = np.zeros((1, solved.design.partition.width))
    row[0, places[length.second]], row[0, places[length.first]] = length.direction, -length.direction
    return float(np.sqrt(max(solved.design.covariance(csr_array(row))[0, 0], 0.0)))


def _smooth_note(form: Smooth | None) -> tuple[str, ...]:
    if form is None:
        return ()
    um = find_unit("um", "length")
    shown = [(axis, value) for axis, value in zip("xyz", form.misfit.tolist(), strict=True) if value]
    beyond = in_a_row([f"{um.outside(value):.2g} um in {axis}" for axis, value in shown]) if shown else "none shows"
    words = f"rms error at sites left out of the fit, beyond their noise: {beyond}"
    return (f"smooth form: polynomial of degree {form.degree}, {words}",)
