"""Settings that calibrate-camera and align-part share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from metrocli.settings import Choice, setting
from metrocli.targets.pattern import GRIDS, Pattern

ESTIMATE = "estimate"
"""Value of `targets` with which coordinates without a standard deviation are unknowns"""


class ImageSettings(Protocol):
    """The shared settings of image jobs, as far as finding and joining of image points needs them."""

    @property
    def noise(self) -> float | str:
        """Standard deviation of an image coordinate, or 'estimated'."""

    @property
    def pattern(self) -> Pattern | None:
        """What the images show."""

    @property
    def eccentricity(self) -> str:
        """auto, correct or ignore."""


ROLLING = "rolling"
"""Shutter that reads the rows of an image one after another"""


def eccentricity_setting() -> str:
    """Return the setting for the eccentricity of circular targets."""
    text = (
        "perspective moves the centre of a circle's image: correct it (needs radii), ignore it, "
        "or auto: correct it if circles of known size are found in images"
    )
    chosen: str = setting(Choice("auto", "correct", "ignore"), text, default="auto")
    return chosen


def shutter_setting() -> str:
    """Return the setting for how the rows of an image are read."""
    text = "global: all rows of an image at once; rolling: one after another, and `diagnose` looks for motion meanwhile"
    chosen: str = setting(Choice("global", ROLLING), text, default="global")
    return chosen


def targets_setting() -> str:
    """Return the setting for coordinates of targets that have no standard deviation."""
    text = (
        "coordinates of targets without a standard deviation: exact as listed, or unknowns that start at the list, "
        "which then gives only their common place, rotation and size"
    )
    chosen: str = setting(Choice("listed", ESTIMATE), text, default="listed")
    return chosen


def image_faults(
    observations: object, images: object, pattern: Pattern | None, targets: object
) -> Iterable[tuple[str, str]]:
    """Yield (key, message) for what is missing among observations, images, targets and pattern."""
    if (observations is None) == (images is None):
        yield "inputs", "give either observations (a CSV file) or images (with a pattern), exactly one of the two"
    if images is not None and pattern is None:
        example = "pattern: {type: chessboard, columns: 9, rows: 6, pitch: 25 mm}"
        yield "inputs.images", f"images need a pattern that describes their targets, e.g. {example}"
    if targets is None and (observations is not None or (pattern is not None and pattern.type not in GRIDS)):
        yield "inputs", "the key 'targets' is missing in 'inputs': the coordinates of the targets"
