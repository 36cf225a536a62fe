"""The pattern of targets in images: its keys in a job or in words, and the names and places of its points."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

from metrocli.arrays import Array
from metrocli.errors import UsageError
from metrocli.frozen import dataclass
from metrocli.settings import Choice, Flag, Text, Whole, WithUnit, setting
from metrocli.words import suggestion

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

CORNERS = ("chessboard", "charuco", "aprilgrid")
"""Types of board whose points are corners."""
GRIDS = (*CORNERS, "circles", "asymmetric-circles")
"""Types whose points lie on one flat board, at known places."""
TYPES = (*GRIDS, "coded-rings", "dot")
"""All types of pattern."""

DICTIONARIES = (
    *(f"{bits}x{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    *("aruco_original", "aruco_mip_36h12", "apriltag_16h5", "apriltag_25h9", "apriltag_36h10", "apriltag_36h11"),
)
"""OpenCV's dictionaries; a larger one begins with the markers of the smaller ones with the same number of bits."""


@dataclass(frozen=True)
class Pattern:
    """The targets that the images show."""

    type: str = setting(Choice(*TYPES), "kind of targets")
    columns: int | None = setting(
        Whole(minimum=2, maximum=99),
        "points in a row of the board: inner corners of a chessboard or ChArUco board, circles of a grid; tags of an "
        "AprilTag grid",
        default=None,
    )
    rows: int | None = setting(Whole(minimum=2, maximum=99), "rows of points of the board, or of tags", default=None)
    pitch: float | None = setting(
        WithUnit("length", positive=True),
        "distance of neighbouring points, or tags; with asymmetric-circles, distance of neighbouring rows",
        default=None,
    )
    diameter: float | None = setting(
        WithUnit("length", positive=True), "diameter of the circles, or of the centre dots of coded rings", default=None
    )
    polarity: str = setting(
        Choice("either", "dark", "bright"),
        "dark targets on a bright background, bright on dark, or both",
        default="either",
    )
    marker_size: float | None = setting(
        WithUnit("length", positive=True), "side of a marker (charuco) or of a tag with its border (aprilgrid)", None
    )
    dictionary: str = setting(Choice(*DICTIONARIES), "ArUco dictionary of the markers (charuco)", default="4x4_50")
    legacy: bool = setting(
        Flag(),
        "an even number of rows of squares begins with a marker, as boards made before OpenCV 4.6 do (charuco)",
        default=False,
    )
    target: str = setting(Text(), "name of the target (dot)", default="dot")

    def faults(self) -> Iterable[tuple[str, str]]:
        """Yield (key, message) for keys that the type needs and that are missing or wrong."""
        if self.type not in GRIDS:
            return
        for key in ("columns", "rows", "pitch"):
            if getattr(self, key) is None:
                yield key, f"a pattern of type {self.type} needs {key}"
        if self.type in ("charuco", "aprilgrid"):
            if self.marker_size is None:
                yield "marker_size", f"a pattern of type {self.type} needs marker_size"
            elif self.pitch is not None and self.marker_size >= self.pitch:
                wider = "squares" if self.type == "charuco" else "distance of neighbouring tags"
                yield "marker_size", f"the markers must be smaller than the {wider} (pitch)"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the points of a board; raises ValueError if they are not given."""
        if self.rows is None or self.columns is None:
            raise ValueError(f"a pattern of type {self.type} has no rows and columns")
        corners = 2 if self.type == "aprilgrid" else 1
        return corners * self.rows, corners * self.columns


def lattice(pattern: Pattern) -> npt.NDArray[np.int64]:
    """Return the points of a board in whole steps from point to point, (n, 2) as (x, y), row by row."""
    import numpy as np

    rows, columns = pattern.shape
    row, column = (part.ravel() for part in np.mgrid[:rows, :columns])
    if pattern.type == "asymmetric-circles":
        return np.stack([2 * column + row % 2, row], axis=1)
    return np.stack([column, row], axis=1)


def names(pattern: Pattern) -> tuple[str, ...]:
    """Return the names of a board's points, row by row: r00c00, r00c01 ..."""
    rows, columns = pattern.shape
    return tuple(f"r{row:02d}c{column:02d}" for row in range(rows) for column in range(columns))


def pattern_points(pattern: Pattern) -> tuple[tuple[str, ...], Array]:
    """Return the names of a board's points and their coordinates (n, 3) in mm: x along a row, y along a column, z = 0.

    Seen from the front, x points right, y points down, and z points away from the viewer. These are also the
    directions of the frame of a camera that faces the board. Raises ValueError if the pattern has no pitch.
    """
    import numpy as np

    if pattern.pitch is None:
        raise ValueError(f"a pattern of type {pattern.type} has no pitch")
    steps = lattice(pattern)
    if pattern.type == "aprilgrid":
        flat = steps // 2 * float(pattern.pitch) + steps % 2 * float(pattern.marker_size or 0.0)
    else:
        flat = steps * float(pattern.pitch)
    return names(pattern), np.column_stack([flat, np.zeros(len(flat))])


_SIZE, _LENGTH = re.compile(r"([0-9]+)x([0-9]+)"), re.compile(r"([0-9.]+)\s*(mm|cm|um|m|in|inch)")
_SECOND = {
    "charuco": "marker_size",
    "aprilgrid": "marker_size",
    "circles": "diameter",
    "asymmetric-circles": "diameter",
}
"""Key of the second length of a board"""
_EXAMPLE = "e.g. 'chessboard 9x6 25 mm', 'charuco 11x8 15 mm 11 mm 4x4_50', 'circles 10x8 25 mm 15 mm'"


def board_in_words(board: str) -> dict[str, str]:
    """Return the keys of a pattern from type, columns x rows of its points, pitch, and what its type has more.

    Raises UsageError for words that describe no board.
    """
    kind, _, rest = board.strip().partition(" ")
    if kind not in GRIDS:
        raise UsageError(f"--board '{board}': no board '{kind}'; {suggestion(kind, GRIDS)}; {_EXAMPLE}")
    lengths = [f"{number} {unit}" for number, unit in _LENGTH.findall(rest)]
    sizes, *others = _LENGTH.sub(" ", rest).split() or [""]
    size = _SIZE.fullmatch(sizes)
    keys = ["pitch", *([_SECOND[kind]] if kind in _SECOND else [])]
    if size is None or not lengths or len(lengths) > len(keys) or len(others) > (kind == "charuco"):
        raise UsageError(
            f"--board '{board}' is not type, columns x rows, pitch, and what its type has more; {_EXAMPLE}"
        )
    words = {"type": kind, "columns": size[1], "rows": size[2], **dict(zip(keys, lengths, strict=False))}
    return words | ({"dictionary": others[0]} if others else {})
