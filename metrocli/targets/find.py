"""Find a pattern in an image: the entry point, with the table of pattern types.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metrocli.imageset import Picture
    from metrocli.targets.pattern import Pattern
    from metrocli.targets.sightings import Sightings

MODULES = {
    "chessboard": "chessboard",
    "circles": "circles",
    "asymmetric-circles": "circles",
    "charuco": "charuco",
    "coded-rings": "coded_rings",
    "dot": "dot",
}
"""Module of each type of pattern; each has `find(pattern, picture) -> Sightings`."""


def find(pattern: Pattern, picture: Picture) -> Sightings:
    """Return the targets in a grey image (height, width) of 8 or 16 bits, or nothing with the reason."""
    module = import_module(f"metrocli.targets.{MODULES[pattern.type]}")
    found: Sightings = module.find(pattern, picture)
    return found
