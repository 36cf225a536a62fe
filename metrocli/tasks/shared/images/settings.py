"""What the settings of image jobs share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from metrocli.settings import Choice, setting
from metrocli.targets.pattern import GRIDS, Pattern


class ImageSettings(Protocol):
    """The settings that image jobs share."""

    @property
    def noise(self) -> float | str:
        """Standard deviation of an image coordinate, or 'estimated'."""

    @property
    def pattern(self) -> Pattern | None:
        """What the images show."""

    @property
    def eccentricity(self) -> str:
        """auto, correct or ignore."""


def eccentricity_setting() -> str:
    """Return the setting of how the eccentricity of circular targets is treated."""
    text = (
        "perspective moves the centre of a circle's image: correct it (needs radii), ignore it, "
        "or auto: correct it where images of targets of known diameter are measured"
    )
    chosen: str = setting(Choice("auto", "correct", "ignore"), text, default="auto")
    return chosen


def image_faults(
    observations: object, images: object, pattern: Pattern | None, targets: object
) -> Iterable[tuple[str, str]]:
    """Yield what is missing between observations, images, targets and pattern."""
    if (observations is None) == (images is None):
        yield "inputs", "give either observations (a CSV file) or images (with a pattern), not both and not neither"
    if images is not None and pattern is None:
        example = "pattern: {type: chessboard, columns: 9, rows: 6, pitch: 25 mm}"
        yield "inputs.images", f"images need a pattern: what they show, e.g. {example}"
    if targets is None and (observations is not None or (pattern is not None and pattern.type not in GRIDS)):
        yield "inputs", "the key 'targets' is missing in 'inputs': the coordinates of the targets"
