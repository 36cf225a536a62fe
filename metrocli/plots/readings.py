"""The residuals of any result in one form, whatever its tables are called."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.shared.images.calibrated import CAMERAS, stated_cameras
from metrocli.tasks.shared.images.exposures import exposures

_TABLES = ("residuals", "angles", "distances", "lengths")
"""Tables of residuals: by the kind of its readings for a launch unit, and of calibrated lengths for a ball grid"""
_KEYS = (
    "image",
    "target",
    "point",
    "tracer",
    "station",
    "time",
    "pose",
    "view",
    "leg",
    "line",
    "at",
    "reading",
    "component",
)
_COUNTED, _COMMANDED = ("i", "j", "k"), ("x", "y", "z")
"""Columns of the ball of an artefact, and of the commanded place in mm"""
_ENDS = (("i1", "j1", "k1"), ("i2", "j2", "k2"))
"""Columns of the balls at the ends of a length"""


@dataclass(frozen=True)
class PlottedResiduals:
    """Normalised residuals (reading minus model) of one kind, with what they may depend on."""

    table: Table
    kind: str
    """Name of the table where a result has several"""
    part: str
    """Ending of the columns: "" or "_a", "_b" where a row has several residuals"""
    w: Array
    """Normalised residuals; nan where no other reading checks the reading"""
    covariates: dict[str, Array] = field(default_factory=dict)

    @property
    def checked(self) -> Mask:
        """Which readings have a normalised residual."""
        return np.isfinite(self.w)

    def name(self, row: int) -> str:
        """Return what identifies a reading: "view01/r00c00/u", "1/ball (2, -1, 0)/x", "28 at (0, 50, 0) mm a"."""
        cells = [(key, str(self.table.columns[key][row])) for key in _KEYS if self._is_key(key)]
        names = [text for key, text in cells if text and key != "component"]
        names += [f"ball {self._triple(keys, row)}" for keys in (_COUNTED, *_ENDS) if self._has(keys)]
        names += [text for key, text in cells if key == "component"]
        place = f" at {self._triple(_COMMANDED, row)} mm" if self._has(_COMMANDED) else ""
        return "/".join(names) + place + self.part.replace("_", " ")

    def _has(self, keys: tuple[str, ...]) -> bool:
        return all(key in self.table for key in keys)

    def _triple(self, keys: tuple[str, ...], row: int) -> str:
        return f"({', '.join(f'{float(self.table.columns[key][row]):g}' for key in keys)})"

    def places(self, most: int) -> Iterator[tuple[str, Mask]]:
        """Yield each place, such as "tracer LT2", with its readings; kinds of more than `most` places are left out."""
        for key in filter(self._is_key, _KEYS):
            cells = self.table.columns[key]
            names = np.unique(cells)
            if 1 < len(names) <= most:
                yield from ((f"{key} {name}", cells == name) for name in names)

    def _is_key(self, key: str) -> bool:
        return key in self.table and self.table.columns[key].dtype.kind in "US"


def residuals_of(result: Result) -> list[PlottedResiduals]:
    """Return the residuals of a result, one set for each table and component of a row; empty if it has none."""
    names = [name for name in _TABLES if name in result.tables]
    return [residuals for name in names for residuals in _of_table(result.tables[name], name if len(names) > 1 else "")]


def _of_table(table: Table, kind: str) -> Iterator[PlottedResiduals]:
    for column in table:
        if not column.startswith("residual") or not len(table):
            continue
        part = column.removeprefix("residual")
        if f"normalised{part}" not in table:
            continue
        yield PlottedResiduals(table, kind, part, table.numbers(f"normalised{part}"), _covariates(table))


def _covariates(table: Table) -> dict[str, Array]:
    """Return what residuals may depend on, by the end of the figure's name."""
    columns = {"time": "t", "temperature": "temp", "length": "reading", "x": "x", "y": "y", "z": "z"}
    held = {name: table.numbers(column) for name, column in columns.items() if _is_number(table, column)}
    if "component" in table or table.units.get("reading") != "mm":  # a coordinate, or an angle
        held.pop("length", None)
    return {name: values for name, values in held.items() if np.ptp(values) > 0}


def _is_number(table: Table, column: str) -> bool:
    if column not in table or table.columns[column].dtype.kind != "f":
        return False
    return bool(np.isfinite(table.numbers(column)).all())


@dataclass(frozen=True)
class ImageResiduals:
    """Residual vectors of an image: one row for each reading of u and v."""

    table: Table
    rows: Index
    """(n,) row of u in the table"""
    places: Array
    """(n, 2) px"""
    vectors: Array
    """(n, 2) reading minus model, px"""
    w: Array
    """(n, 2)"""
    size: tuple[float, float]
    """Width and height of the image, px; those of the part with readings if the result has no image size"""
    whole: bool
    """Whether the size is that of the image"""
    centre: tuple[float, float]
    """Principal point, or the middle of the image"""
    camera: str = ""
    """Of several cameras"""

    def name(self, k: int) -> str:
        """Return the image and target of a reading."""
        row = self.rows[k]
        return "/".join(str(self.table.columns[key][row]) for key in ("image", "target") if key in self.table)


def image_residuals(result: Result) -> list[ImageResiduals]:
    """Return the residual vectors of a result of images, for each of several cameras; empty if it has none."""
    table = result.tables.get("residuals")
    if table is None or not len(table) or "component" not in table or table.units.get("residual") != "px":
        return []
    component = table.columns["component"].astype(str)
    u, v = np.flatnonzero(component == "u"), np.flatnonzero(component == "v")
    if len(u) != len(v) or not len(u):
        return []
    both = [np.stack([table.numbers(name)[u], table.numbers(name)[v]], axis=1) for name in _VECTORS]
    if CAMERAS in result.tables and "camera" in result.tables:
        return list(_of_cameras(result, table, u, both))
    places, vectors, w = both
    given = [result.statistics.get(name) for name in ("image_width", "image_height")]
    size = [float(entry) for entry in given if isinstance(entry, int | float)]
    whole = len(size) == len(given)
    width, height = size if whole else (places.max(axis=0) * _MARGIN).tolist()
    known = {estimate.name: estimate.value for estimate in result.estimates}
    centre = known.get("cx", (width - 1) / 2), known.get("cy", (height - 1) / 2)
    return [ImageResiduals(table, u, places, vectors, w, (width, height), whole, centre)]


def _of_cameras(result: Result, table: Table, rows: Index, values: list[Array]) -> Iterator[ImageResiduals]:
    cameras = stated_cameras(result)
    names, image = np.unique(table.columns["image"][rows].astype(str), return_inverse=True)
    camera = exposures({camera.name: camera.images for camera in cameras}, names.tolist()).camera[image]
    for number, calibrated in enumerate(cameras):
        seen = camera == number
        places, vectors, w = (part[seen] for part in values)
        centre = calibrated.lens["cx"], calibrated.lens["cy"]
        size = float(calibrated.size[0]), float(calibrated.size[1])
        yield ImageResiduals(table, rows[seen], places, vectors, w, size, True, centre, calibrated.name)


_VECTORS = ("reading", "residual", "normalised")
_MARGIN = 1.05


def radial(residuals: ImageResiduals) -> tuple[Array, Array, Array]:
    """Return radius (n,) px, and w of each reading along the radius and across it, (n,) each.

    With e the unit vector from the principal point, along is w·e and across is w·(-e_y, e_x).
    """
    away = residuals.places - residuals.centre
    radius = np.hypot(*away.T)
    e = np.where(radius[:, None] > 0, away / np.maximum(radius, 1e-300)[:, None], [1.0, 0.0])
    return radius, (residuals.w * e).sum(axis=1), residuals.w[:, 1] * e[:, 0] - residuals.w[:, 0] * e[:, 1]
