"""The points of a network: all that a file names, their listed places, and how well these are known."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.errors import InputError, all_faults
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.adjust_network.settings import Files
from metrocli.tasks.shared.lists import matched, sigmas
from metrocli.uncertainty.predicted import POINTS_COVARIANCE, points_of
from metrocli.words import listed


@dataclass(frozen=True)
class KnownPoints:
    """All points of a network, with their listed places and how well these are known."""

    names: tuple[str, ...]
    listed: Array
    """(points, 3) mm, nan for a point that is in no list"""
    sigma: Array
    """(points, 3): 0 exact, a number a prior, nan unknown"""
    covariance: Array | None = None
    """Joint covariance of the coordinates `given`, (k, k)"""
    given: tuple[Index, Index] = field(default_factory=lambda: (np.zeros(0, dtype=np.intp),) * 2)
    """Points and columns of the coordinates with a joint covariance, (k,) each"""

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.names)


def known_points(files: Files) -> KnownPoints:
    """Return all points that a file names: those of the list come first; raises InputError that lists every fault."""
    return _with_covariance(KnownPoints(*_points(files)), files)


def _points(files: Files) -> tuple[tuple[str, ...], Array, Array]:
    """Return names, listed places and sigmas of all points that a file names: those of the list come first."""
    table, sigma = _table_of_points(files.points), np.zeros((0, 3))
    names: list[str] = []
    place = np.zeros((0, 3))
    if table is not None:
        names, place = list(table.texts("point")), table.stacked("xyz")
        sigma = sigmas(table) if not isinstance(files.points, Result) else _spread(files.points, len(names))
    columns = [(files.sightings, "point"), (files.lengths, "point"), (files.bars, "from"), (files.bars, "to")]
    columns += [(files.heights, "from"), (files.heights, "to"), (files.stations, "over")]
    known = set(names)
    every = [table.texts(column) for table, column in columns if table is not None and column in table]
    more = [name for name in dict.fromkeys(name for names in every for name in names) if name and name not in known]
    unknown = np.full((len(more), 3), np.nan)
    return (*names, *more), np.concatenate([place, unknown]), np.concatenate([sigma, unknown])


def _table_of_points(points: Table | Result | None) -> Table | None:
    if not isinstance(points, Result):
        return points
    if "points" not in points.tables:
        raise InputError("the result among the inputs has no table of points: a camera needs `rig: network`")
    return points.tables["points"]


def _spread(points: Result, count: int) -> Array:
    """Return the standard uncertainties of the points of a result; nan where it has none."""
    whole = points.arrays.get(POINTS_COVARIANCE)
    return np.full((count, 3), np.nan) if whole is None else np.sqrt(np.einsum("nkk->nk", np.asarray(whole)))


def _with_covariance(known: KnownPoints, files: Files) -> KnownPoints:
    """Return the points with the joint covariance of their given coordinates, if a file or a result has one."""
    if isinstance(files.points, Result):
        return _joint_of_result(known, files.points)
    table = files.covariance
    if table is None:
        return known
    ends = []
    with all_faults() as each:
        for end in "ab":
            with each():
                point = matched(table, f"point_{end}", known.names, "the points")
                axis = matched(table, f"axis_{end}", ("x", "y", "z"), "x, y, z")
                ends.append(3 * point + axis)
    entries = np.unique(np.concatenate(ends))
    matrix = np.zeros((len(entries), len(entries)))
    first, second = (np.searchsorted(entries, end) for end in ends)
    matrix[first, second] = matrix[second, first] = table.numbers("covariance_mm2")
    member, column = np.divmod(entries, 3)
    missing = np.isnan(known.sigma[member, column])
    if missing.any():
        what = [f"{known.names[i]} {'xyz'[k]}" for i, k in zip(member[missing], column[missing], strict=True)]
        raise InputError([table.fault(f"coordinates without a sigma in the list of points: {listed(what, 5)}")])
    if not (np.linalg.eigvalsh(matrix) > 0).all():
        raise InputError(
            [table.fault("the covariance is not positive definite", "check its signs, and that each variance is there")]
        )
    return KnownPoints(known.names, known.listed, known.sigma, matrix, (member, column))


def _joint_of_result(known: KnownPoints, points: Result) -> KnownPoints:
    if POINTS_COVARIANCE not in points.arrays:
        return known
    joint = points_of(points).joint
    # a free network has a singular covariance, which is no prior: its points stay a list
    if not (np.linalg.eigvalsh(joint) > 1e-9 * np.trace(joint) / len(joint)).all():
        return known
    rows = np.arange(len(joint))
    return KnownPoints(known.names, known.listed, known.sigma, joint, (rows // 3, rows % 3))
