"""Places that a result predicts, with their joint covariance: reached by a calibrated machine, or listed by name."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import cross_matrix
from metrocli.result import Result
from metrocli.table import Table
from metrocli.uncertainty.calibrated_machine import error_motion, outside
from metrocli.uncertainty.comparison import POINTS, TABLES_COVARIANCE
from metrocli.uncertainty.turning_machine import tips, turns
from metrocli.words import suggestion

COMMON, CORE, POINTS_COVARIANCE = "points_common", "points_core", "points_covariance"
_IN_MACHINE = ("align-part",)
"""Kinds of job whose points are in the frame of a machine, where they are measured too"""


@dataclass(frozen=True)
class PredictedPlaces:
    """Places in the frame of the result: two have covariance `C_a K C_b'`, each has `C_a K C_a' + O_a`."""

    values: Array
    """(n, 3) mm"""
    common: Array
    """C (n, 3, k)"""
    core: Array
    """K (k, k)"""
    own: Array
    """O (n, 3, 3) mm^2"""

    @cached_property
    def covariance(self) -> Array:
        """Covariance of each place (n, 3, 3) mm^2."""
        return self.own + shared(self.common, self.core)

    @property
    def joint(self) -> Array:
        """Covariance of all coordinates, point by point (3n, 3n) mm^2."""
        n = len(self.values)
        common, points = self.common.reshape(3 * n, -1), np.arange(n)
        joint = common @ self.core @ common.T
        joint.reshape(n, 3, n, 3)[points, :, points, :] += self.own
        return np.asarray(joint)

    def of(self, rows: Index | Mask) -> PredictedPlaces:
        """Return some of the places."""
        return PredictedPlaces(self.values[rows], self.common[rows], self.core, self.own[rows])


def has_points(result: Result) -> bool:
    """Return whether a result has points with their covariance."""
    return POINTS in result.tables and POINTS_COVARIANCE in result.arrays


def in_machine(result: Result) -> bool:
    """Return whether the points of a result are in the frame of a machine, which no fit of a check may move."""
    return result.kind in _IN_MACHINE


def reached(result: Result, commanded: Table) -> PredictedPlaces:
    """Return where the tool of a calibrated machine is on the workpiece at commanded positions.

    Its covariance is that of the error tables and of the tool vectors. Tables that are not determined count as zero,
    as in the result. Raises InputError for positions outside the axes, and for tools without a prediction.
    """
    tools = result.tables["tools"]
    which = _tools(tools, commanded, [] if turns(result) else outside(result, commanded))
    place, by_entry, by_vector = tips(result, commanded, which) if turns(result) else _shifted(result, commanded, which)
    # each place has the columns of all tools, of which those of others are zero
    by_tool = by_vector[:, :, None, :] * (which[:, None] == np.arange(len(tools)))[:, None, :, None]
    common = np.concatenate([by_entry, by_tool.reshape(len(which), 3, -1)], axis=2)
    entries, size = len(by_entry[0, 0]), common.shape[2]
    core = np.zeros((size, size))
    core[:entries, :entries] = result.arrays[TABLES_COVARIANCE]
    core[entries:, entries:] = np.diag(tools.stacked(("sx", "sy", "sz")).ravel() ** 2)
    return PredictedPlaces(place, common, core, np.zeros((len(which), 3, 3)))


def _shifted(result: Result, commanded: Table, tool: Index) -> tuple[Array, Array, Array]:
    """Return `p + T + d(p)` (n, 3) of three linear axes, with derivatives by the entries of tables and by the tool."""
    position, vectors = commanded.stacked(("x", "y", "z")).T, result.tables["tools"].stacked(("x", "y", "z"))[tool]
    motion, by_motion = error_motion(result, position, vectors.T)
    return position.T + vectors + motion[:, :3], by_motion[:, :3], np.eye(3)[None]


def tool_vectors(result: Result, commanded: Table) -> Array:
    """Return the vector of the tool of each commanded position (n, 3) [mm]; raises InputError for unknown tools."""
    tools = result.tables["tools"]
    return tools.stacked(("x", "y", "z"))[_tools(tools, commanded, [])]


def listed(result: Result, names: Table, columns: tuple[str, ...]) -> tuple[PredictedPlaces, ...]:
    """Return the points of a result that each of some columns names; raises InputError for names that it lacks."""
    points = result.tables[POINTS]
    known = {name: i for i, name in enumerate(points.texts("point"))}
    faults: list[Fault] = []
    for column in columns:
        cells = names.texts(column)
        missing = [row for row, name in enumerate(cells) if name not in known]
        faults += names.faults_at(
            missing,
            lambda row, cells=cells, column=column: f"the result has no point '{cells[row]}' (column '{column}')",  # type: ignore[misc]
            lambda row, cells=cells: suggestion(cells[row], known) if len(known) < 1000 else None,  # type: ignore[misc]
        )
    if faults:
        raise InputError(faults)
    every = points_of(result)
    rows = [np.array([known[name] for name in names.texts(column)], dtype=np.intp) for column in columns]
    return tuple(every.of(at) for at in rows)


def points_of(result: Result) -> PredictedPlaces:
    """Return the points of a result; without factors of their joint covariance they are taken as independent."""
    values = result.tables[POINTS].stacked(("x", "y", "z"))
    whole = np.asarray(result.arrays[POINTS_COVARIANCE], dtype=float)
    common, core = result.arrays.get(COMMON), result.arrays.get(CORE)
    if common is None or core is None:
        return independent(values, whole)
    # what the factors do not explain is each point's own
    return PredictedPlaces(values, common, core, whole - shared(common, core))


def shared(common: Array, core: Array) -> Array:
    """Return `C K C'` of each place, common (n, 3, k), core (k, k) -> (n, 3, 3)."""
    # one product for all places: one for each would read the core n times
    product = (common.reshape(3 * len(common), len(core)) @ core).reshape(common.shape)
    return np.asarray(product @ np.swapaxes(common, 1, 2))


def independent(values: Array, covariance: Array) -> PredictedPlaces:
    """Return places (n, 3) with independent errors of covariance (n, 3, 3)."""
    return PredictedPlaces(values, np.zeros((len(values), 3, 0)), np.zeros((0, 0)), covariance)


def after_fit(places: PredictedPlaces, own: Array) -> Array:
    """Return the covariance of each place after a fit of shift and turn, (n, 3, 3).

    `P Q P`, P = I - B B' with B (3n, 6) an orthonormal basis of the small motions of all points; only its blocks of
    single points are computed. `own` is O, with the variances of a measurement where a deviation from it is meant.
    """
    n = len(own)
    centred = places.values - places.values.mean(axis=0)
    motions = np.zeros((n, 3, 6))
    # turns by the size of the part: columns of one order keep the QR exact
    motions[:, :, :3], motions[:, :, 3:] = np.eye(3), cross_matrix(centred) / np.abs(centred).max()
    basis = np.linalg.qr(motions.reshape(-1, 6))[0].reshape(n, 3, 6)
    common = places.common - basis @ np.einsum("nia,nik->ak", basis, places.common)
    moved = own @ basis
    fitted = basis @ np.einsum("nia,nib->ab", basis, moved)
    crossed = moved @ np.swapaxes(basis, 1, 2)
    left = own - crossed - np.swapaxes(crossed, 1, 2) + fitted @ np.swapaxes(basis, 1, 2)
    return np.asarray(common @ places.core @ np.swapaxes(common, 1, 2) + left)


def _tools(tools: Table, commanded: Table, faults: list[Fault]) -> Index:
    """Return the number of the tool of each row; raises InputError with the faults found before and its own.

    A tool that its job gave no name stands for the one that the points name.
    """
    names = tools.texts("tool")
    if "tool" not in commanded and len(names) > 1:
        hint = f"add a column 'tool' with {', '.join(names)}"
        faults = [*faults, commanded.fault("the machine has several tools, and the points name none", hint)]
    cells = commanded.texts("tool") if "tool" in commanded else [names[0]] * len(commanded)
    if names == [""]:
        if len(set(cells)) > 1:
            what = f"the points have {len(set(cells))} tools ({', '.join(sorted(set(cells)))}), and the result has one"
            faults = [*faults, commanded.fault(what, "hold the points of each tool against a result that has it")]
        cells = [""] * len(commanded)
    open_ones = {name for name, good in zip(names, tools.columns["predictable"], strict=True) if not good}
    faults = [
        *faults,
        *commanded.faults_at(
            [row for row, name in enumerate(cells) if name not in names],
            lambda row: f"the result has no tool '{cells[row]}' (column 'tool')",
            lambda row: suggestion(cells[row], names),
        ),
        *commanded.faults_at(
            [row for row, name in enumerate(cells) if name in open_ones],
            lambda row: f"the result does not determine the errors of tool '{cells[row]}'",
            lambda row: f"predicted are: {', '.join(name for name in names if name not in open_ones)}",
        ),
    ]
    if faults:
        raise InputError(faults)
    return np.array([names.index(name) for name in cells], dtype=np.intp)
