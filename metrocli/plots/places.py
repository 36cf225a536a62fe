"""Points, tracers and cameras of a result in space, with deviations, covariances and residuals."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.plots.images.cameras import cameras_of
from metrocli.plots.plotted_points import PlottedPoints
from metrocli.result import Result
from metrocli.table import Table

_XYZ = ("x", "y", "z")


def places_of(result: Result) -> tuple[PlottedPoints, ...]:
    """Return the points of a result with deviations and covariances, then its instruments."""
    parts = [
        _points(result),
        *_grids(result),
        _volume(result),
        _instruments(result, "tracers", "tracer"),
        _instruments(result, "stations", "station"),
    ]
    return tuple(
        points for points in (*parts, *cameras_of(result), *_launch(result)) if points is not None and len(points.at)
    )


def _points(result: Result) -> PlottedPoints | None:
    table = result.tables.get("points")
    if table is None or not all(name in table for name in _XYZ):
        return None
    errors = ("error_x", "error_y", "error_z")
    vectors = _if_any(table.stacked(errors)) if errors[0] in table else None
    covariance = result.arrays.get("points_covariance")
    if covariance is None or covariance.shape != (len(table), 3, 3):
        covariance = _of_stds(table, ("sx", "sy", "sz"))
    covariance = None if covariance is None else _if_any(covariance)
    name = "error of the mover (listed minus measured)" if vectors is not None else ""
    key = next(name for name in table if table.columns[name].dtype.kind in "US")
    return PlottedPoints("points", tuple(table.texts(key)), table.stacked(_XYZ), vectors, name, covariance)


def _if_any(values: Array) -> Array | None:
    """Return deviations or covariances, or None if all are 0: those of points that are given."""
    return values if np.any(values) else None


def _of_stds(table: Table, names: tuple[str, str, str]) -> Array | None:
    if names[0] not in table:
        return None
    return np.asarray(table.stacked(names)[:, :, None] ** 2 * np.eye(3))


def _grids(result: Result) -> list[PlottedPoints]:
    """Return the machine error of a ball grid at its sites (`correction` has them in mm, with the opposite sign)."""
    error, site = result.tables.get("machine_error"), result.tables.get("correction")
    if error is None or site is None or len(error) != len(site):
        return []
    names = tuple(f"({i}, {j}, {k})" for i, j, k in error.stacked(("i", "j", "k")).astype(int).tolist())
    stds = _of_stds(error, ("s_ex", "s_ey", "s_ez"))
    return [
        PlottedPoints(
            "sites", names, site.stacked(_XYZ), error.stacked(("ex", "ey", "ez")), "error of the machine", stds
        )
    ]


def _volume(result: Result) -> PlottedPoints | None:
    """Return the error of the first tool on the grid of the volume, where X, Y and Z span one."""
    table = result.tables.get("volume")
    if table is None or not {"tool", *_XYZ} <= set(table) or not len(table):
        return None
    tools = table.columns["tool"]
    rows = np.flatnonzero(tools == tools[0])
    own = Table({name: table.columns[name][rows] for name in table}, table.units)
    at = own.stacked(_XYZ)
    names = tuple(f"({x:g}, {y:g}, {z:g})" for x, y, z in at.tolist())
    errors = own.stacked(("ex", "ey", "ez"))
    kept = np.flatnonzero(np.isfinite(errors).all(axis=1))
    if not len(kept):
        return None
    stds = _of_stds(own, ("s_ex", "s_ey", "s_ez"))
    what = f"error of the {named('tool', str(tools[0]))} (actual minus commanded)"
    chosen = tuple(names[row] for row in kept)
    return PlottedPoints("grid", chosen, at[kept], errors[kept], what, stds[kept] if stds is not None else None)


def named(kind: str, name: str) -> str:
    """Return "tool 'T1'", or "tool" where it has no name."""
    return f"{kind} '{name}'" if name else kind


def _instruments(result: Result, name: str, key: str) -> PlottedPoints | None:
    table = result.tables.get(name)
    if table is None or key not in table or not all(axis in table for axis in _XYZ):
        return None
    kept = np.isfinite(table.stacked(_XYZ)).all(axis=1)
    names = tuple(np.array(table.texts(key))[kept].tolist())
    return PlottedPoints(name, names, table.stacked(_XYZ)[kept])


def _launch(result: Result) -> list[PlottedPoints]:
    """Return the place of a launch unit with its covariance, and the receiver at the other end of each beam."""
    beams, known = result.tables.get("beams"), {estimate.name: n for n, estimate in enumerate(result.estimates)}
    if result.kind != "locate-launch-unit" or beams is None or not set(_XYZ) <= set(known):
        return []
    rows = [known[name] for name in _XYZ]
    at = np.array([[result.estimates[row].value for row in rows]])
    covariance = result.covariance[np.ix_(rows, rows)][None]
    receivers = at + beams.numbers("length")[:, None] * beams.stacked(("wx", "wy", "wz"))
    along = np.stack([np.broadcast_to(at, receivers.shape), receivers], axis=1)[:, None]
    return [
        PlottedPoints("launch unit", ("launch unit",), at, covariance=covariance),
        PlottedPoints("receiver in each pose", tuple(beams.texts("pose")), receivers, lines=along),
    ]
