"""Points of one kind in space, with what is drawn about them."""

from __future__ import annotations

from metrocli.arrays import Array
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class PlottedPoints:
    """Points of one kind."""

    kind: str
    names: tuple[str, ...]
    at: Array
    """(n, 3) mm"""
    vectors: Array | None = None
    """(n, 3) mm: deviation at each point, in its true size"""
    vector_name: str = ""
    covariance: Array | None = None
    """(n, 3, 3) mm²"""
    lines: Array | None = None
    """Lines from point to point about each, (n, k, 2, 3) mm: outlines of cameras, beams, steps of a board"""
    faint: bool = False
    """Whether only the lines are drawn, thin and below all others: beams of light"""
    named: tuple[int, ...] | None = None
    """Rows whose names are drawn where there is room, those that matter most first; without it all of a few"""
