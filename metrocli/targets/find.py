"""Finding the targets of a pattern in an image."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

import numpy as np

from metrocli.arrays import Array, Index, Picture
from metrocli.frozen import dataclass
from metrocli.targets.pattern import Pattern


@dataclass(frozen=True)
class FoundTargets:
    """Targets found in one image; pixel (0, 0) is the centre of the first pixel."""

    targets: tuple[str, ...]
    uv: Array
    """Image coordinates (n, 2) in pixels."""
    sigma: Array
    """Standard deviation per axis (n,) in pixels, from the residuals of the grey values; NaN if it is not known."""
    axes: Array
    """Semi-axes (n, 2) of the ellipses in pixels, the longer first; NaN for targets that are not ellipses."""
    angle: Array
    """Direction (n,) of the longer semi-axis in radians, from u towards v; NaN for targets that are not ellipses."""
    reason: str = ""
    """Message for the user: why nothing was found, or what was left out."""

    def __len__(self) -> int:
        return len(self.targets)

    def __getitem__(self, rows: Sequence[int] | Index) -> FoundTargets:
        """Return the sightings of these rows."""
        rows = np.asarray(rows, dtype=np.intp)
        names = tuple(self.targets[row] for row in rows)
        return FoundTargets(names, self.uv[rows], self.sigma[rows], self.axes[rows], self.angle[rows], self.reason)


def nothing(reason: str) -> FoundTargets:
    """Return empty sightings with the reason."""
    return FoundTargets((), np.empty((0, 2)), np.empty(0), np.empty((0, 2)), np.empty(0), reason)


def mirrored(board: str, shown: int, what: str) -> FoundTargets:
    """Return empty sightings of an image in which a board is found only after it was mirrored."""
    hint = "turn off the mirroring of the camera's software, and take the images again"
    return nothing(f"no {board}: the image is mirrored, {shown} {what} are found in its mirror image; {hint}")


def points(targets: Sequence[str], uv: Array, sigma: Array) -> FoundTargets:
    """Return sightings of targets that are not ellipses."""
    absent = np.full((len(uv), 2), np.nan)
    return FoundTargets(tuple(targets), uv, sigma, absent, absent[:, 0])


MODULES = {
    "chessboard": "chessboard",
    "circles": "circles",
    "asymmetric-circles": "circles",
    "charuco": "charuco",
    "aprilgrid": "aprilgrid",
    "coded-rings": "coded_rings",
    "dot": "dot",
}
"""Module of each type of pattern; each has `find(pattern, picture) -> Sightings`."""


def find(pattern: Pattern, picture: Picture) -> FoundTargets:
    """Return the targets in a grey image (height, width) of 8 or 16 bits, or nothing with the reason."""
    module = import_module(f"metrocli.targets.{MODULES[pattern.type]}")
    sightings: FoundTargets = module.find(pattern, picture)
    return sightings
