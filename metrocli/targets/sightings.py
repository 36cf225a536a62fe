"""The targets found in one image: names and image coordinates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from metrocli.frozen import dataclass
from metrocli.targets.ellipses import Fitted

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Sightings:
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

    def __getitem__(self, rows: Sequence[int] | npt.NDArray[np.intp]) -> Sightings:
        """Return the sightings of these rows."""
        rows = np.asarray(rows, dtype=np.intp)
        names = tuple(self.targets[row] for row in rows)
        return Sightings(names, self.uv[rows], self.sigma[rows], self.axes[rows], self.angle[rows], self.reason)


def nothing(reason: str) -> Sightings:
    """Return empty sightings with the reason."""
    return Sightings((), np.empty((0, 2)), np.empty(0), np.empty((0, 2)), np.empty(0), reason)


def points(targets: Sequence[str], uv: Array, sigma: Array) -> Sightings:
    """Return sightings of targets that are not ellipses."""
    absent = np.full((len(uv), 2), np.nan)
    return Sightings(tuple(targets), uv, sigma, absent, absent[:, 0])


def of_ellipses(targets: Sequence[str], fits: Sequence[Fitted], reason: str = "") -> Sightings:
    """Return sightings of fitted ellipses."""
    found = [(*fit.ellipse.centre, fit.sigma, fit.ellipse.long, fit.ellipse.short, fit.ellipse.angle) for fit in fits]
    table = np.array(found, dtype=float).reshape(-1, 6)
    return Sightings(tuple(targets), table[:, :2], table[:, 2], table[:, 3:5], table[:, 5], reason)
