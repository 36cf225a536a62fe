"""Where stations and tools lie: in a plane, on a line or at one place, so that they leave something open."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array

_FLAT = 0.02
"""Places whose spread square to a line or plane is below this share of their largest spread lie in it"""


def line_of(places: Array) -> Array | None:
    """Return the unit vector along the line on which places (n, 3) lie; None if they do not lie on one line."""
    spread, ways = _spread(places)
    if not spread[0] or spread[1] > _FLAT * spread[0]:
        return None
    way = ways[0]
    # a line has no sense: its largest component is made positive
    return np.asarray(way * np.sign(way[np.argmax(np.abs(way))]) + 0.0)


def stations_lie(places: Array) -> str:
    """Return in words how few stations (n, 3) there are, or that they lie on a line or in a plane; else empty."""
    if len(places) < 3:
        return "there is only one station" if len(places) == 1 else "there are only two stations"
    spread, _ = _spread(places)
    if spread[1] <= _FLAT * spread[0]:
        return f"the {len(places)} stations lie on one line"
    return f"the {len(places)} stations lie in one plane" if spread[2] <= _FLAT * spread[0] else ""


def cure_of(stations: Array | None) -> str:
    """Return what to measure where the errors in the volume are not determined; stations are None without lengths."""
    if stations is None:
        return "measure lines in other directions (`metrocli plan` proposes them)"
    lie = stations_lie(stations)
    cure = "add stations that see the tool from other directions (`metrocli plan` proposes them)"
    return f"{lie}: {cure}" if lie else cure


def _spread(places: Array) -> tuple[Array, Array]:
    _, spread, ways = np.linalg.svd(places - places.mean(axis=0))
    return np.concatenate([spread, np.zeros(3 - len(spread))]), ways
