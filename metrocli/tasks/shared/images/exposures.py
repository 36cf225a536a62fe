"""Which camera took an image, and at which exposure: the part of its name that * stands for."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Index
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.instruments.camera import LENS, MOUNT
from metrocli.words import in_a_row, listed

IMAGE = "image"
"""Index of the observations that gives the image of each reading; `view` gives its exposure"""


@dataclass(frozen=True)
class Exposures:
    """The exposures of one camera, or of several that are fixed to each other."""

    names: tuple[str, ...]
    cameras: tuple[str, ...]
    camera: Index
    """Camera of each image, (images,)"""
    exposure: Index
    """Exposure of each image, (images,)"""

    def readings(self, observations: Observations) -> Observations:
        """Return readings whose view is their exposure; IMAGE is then their image, and lens and mount their camera."""
        image = observations.index["view"]
        # a single camera keeps blocks of one member, which need no index
        of_camera = dict.fromkeys((LENS, MOUNT), self.camera[image]) if len(self.cameras) > 1 else {}
        return observations.with_index({**of_camera, IMAGE: image, "view": self.exposure[image]})

    @property
    def unused(self) -> tuple[str, ...]:
        """The cameras that took no image."""
        return tuple(name for number, name in enumerate(self.cameras) if not (self.camera == number).any())


def exposures(cameras: Mapping[str, str], images: Sequence[str]) -> Exposures:
    """Return the camera and the exposure of each image.

    `cameras` are names of images with one *, by camera; a camera with an empty one takes none. All images of a single
    camera, `*`, are exposures. Raises InputError for images of no camera or of two.
    """
    taken = [_taken(cameras, image) for image in images]
    wrong = [image for image, matches in zip(images, taken, strict=True) if len(matches) != 1]
    if wrong:
        known = in_a_row([f"{name} {shape}" for name, shape in cameras.items() if shape])
        raise InputError([Fault(f"images of no camera, or of two: {listed(wrong, 5)}", hint=f"cameras have {known}")])
    names, exposure = np.unique([matches[0][1] for matches in taken], return_inverse=True)
    camera = np.array([matches[0][0] for matches in taken], dtype=np.intp)
    return Exposures(tuple(names.tolist()), tuple(cameras), camera, exposure)


def exposure_of(cameras: Mapping[str, str], name: str) -> str:
    """Return the exposure of an image; a name that is that of no image is an exposure."""
    taken = _taken(cameras, name)
    return taken[0][1] if len(taken) == 1 else name


def _taken(cameras: Mapping[str, str], image: str) -> list[tuple[int, str]]:
    """Return the cameras that could have taken an image, each with the exposure."""
    shapes = ("(.*)".join(map(re.escape, shape.split("*"))) for shape in cameras.values())
    return [(number, match[1]) for number, shape in enumerate(shapes) if (match := re.fullmatch(shape, image))]
