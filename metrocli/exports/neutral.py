"""Error tables as plain CSV, with their standard uncertainties: `error,position_mm,value_um,std_um`."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from metrocli import units
from metrocli.exports.compensation import Texts
from metrocli.exports.error_tables import AXES, Array, ErrorTables

_UNITS = {"um": ("length", "errors.csv"), "urad": ("angle", "errors-angles.csv")}


def texts_of(tables: ErrorTables) -> Texts:
    """Return displacements, angles and squareness, each as the text of a CSV file."""
    head = [f"# {line}" for line in _head(tables)]
    texts = {}
    for unit, (dimension, name) in _UNITS.items():
        wanted = [name for name in tables.curves if (name[1] in AXES) == (unit == "um")]
        rows = [row for error in wanted for row in _rows(tables, error, units.find_unit(unit, dimension))]
        if rows:
            texts[name] = "\n".join([*head, f"error,position_mm,value_{unit},std_{unit}", *rows, ""])
    if tables.squareness:
        angle = units.find_unit("urad", "angle")
        rows = [
            f"{name},{angle.outside(value):.6g},{angle.outside(tables.squareness_std.get(name, np.nan)):.3g}"
            for name, value in tables.squareness.items()
        ]
        texts["squareness.csv"] = "\n".join([*head, "error,value_urad,std_urad", *rows, ""])
    return texts


def _head(tables: ErrorTables) -> Iterable[str]:
    yield from tables.notes()
    yield f"axes from the workpiece to the tool: {tables.order}; tool {tables.tool} mm"
    yield "straightness is free of its end-point line; squareness is the angle of these lines"


def _rows(tables: ErrorTables, name: str, unit: units.Unit) -> Iterable[str]:
    curve = tables.curves[name]
    std: Array = curve.std if curve.std is not None else np.full(len(curve.values), np.nan)
    for at, value, spread in zip(curve.positions.tolist(), curve.values.tolist(), std.tolist(), strict=True):
        yield f"{name},{at:.6f},{unit.outside(value):.6f},{unit.outside(spread):.6f}"
