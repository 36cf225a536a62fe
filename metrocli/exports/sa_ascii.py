"""Points as SpatialAnalyzer reads them: lines `Target x y z` in mm, comments begin with //.

Source: SpatialAnalyzer User Manual, Exporting ASCII Formatted Points. The import of this name reads them back.
"""

from __future__ import annotations

from metrocli.errors import InputError
from metrocli.exports import Exported
from metrocli.result import Result

_DIGITS = 6
"""Decimals of a coordinate: nanometres"""


def files(result: Result) -> Exported:
    """Return points.txt; raises InputError for a result without points, and for names with blanks."""
    points = result.tables.get("points")
    if points is None or not {"point", "x", "y", "z"} <= set(points):
        raise InputError("the result has no points for SpatialAnalyzer")
    names = points.texts("point")
    odd = [name for name in names if len(name.split()) != 1]
    if odd:
        raise InputError(f"names of targets have no blanks in this format: '{odd[0]}'")
    places = points.stacked("xyz").tolist()
    rows = [
        f"{name} {' '.join(f'{value:.{_DIGITS}f}' for value in row)}" for name, row in zip(names, places, strict=True)
    ]
    return {"points.txt": "\n".join(["// target x y z, in mm", *rows, ""])}
