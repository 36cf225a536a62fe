"""Which camera took an image, and at which exposure: the part of its name that * stands for."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.arrays import Index
from metrocli.errors import Fault, InputError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.tasks.calibrate_camera.settings import OneOfSeveral
from metrocli.tasks.shared.images.sightings import Sighted
from metrocli.words import in_a_row, listed


@dataclass(frozen=True)
class Exposures:
    """The exposures of several cameras."""

    names: tuple[str, ...]
    cameras: tuple[str, ...]
    camera: Index
    """Camera of each image, (images,)"""
    exposure: Index
    """Exposure of each image, (images,)"""

    def image(self, camera: int, exposure: int) -> int:
        """Return the number of the image of a camera at an exposure, -1 without one."""
        found = np.flatnonzero((self.camera == camera) & (self.exposure == exposure))
        return int(found[0]) if found.size else -1

    def common(self, first: int, second: int) -> Index:
        """Return the exposures of which both cameras have an image."""
        both = (self.exposure[self.camera == number] for number in (first, second))
        return np.asarray(np.intersect1d(*both))


def exposures(cameras: Mapping[str, OneOfSeveral], images: Sequence[str]) -> Exposures:
    """Return the camera and the exposure of each image.

    Raises InputError for images of no camera or of two, and for cameras without an image.
    """
    shapes = {
        name: re.compile("(.*)".join(map(re.escape, several.images.split("*")))) for name, several in cameras.items()
    }
    numbered = [
        [(number, match[1]) for number, shape in enumerate(shapes.values()) if (match := shape.fullmatch(image))]
        for image in images
    ]
    wrong = [image for image, matches in zip(images, numbered, strict=True) if len(matches) != 1]
    if wrong:
        known = in_a_row([f"{name} {several.images}" for name, several in cameras.items()])
        raise InputError([Fault(f"images of no camera, or of two: {listed(wrong, 5)}", hint=f"cameras have {known}")])
    camera = np.array([matches[0][0] for matches in numbered], dtype=np.intp)
    names, exposure = np.unique([matches[0][1] for matches in numbered], return_inverse=True)
    empty = [name for number, name in enumerate(cameras) if not (camera == number).any()]
    if empty:
        raise InputError(f"no image of {in_a_row(empty)} shows enough targets; check `cameras: images`")
    return Exposures(tuple(names.tolist()), tuple(cameras), camera, exposure)


def of_camera(sighted: Sighted, exposed: Exposures, camera: int) -> Sighted:
    """Return the sightings of one camera."""
    mine = exposed.camera == camera
    observations = sighted.observations.selected(mine[sighted.view])
    view = (np.cumsum(mine) - 1)[observations.index["view"]]
    names = tuple(name for name, own in zip(sighted.images, mine, strict=True) if own)
    observations = replace(observations, index={**observations.index, "view": view})
    return replace(sighted, images=names, observations=observations, warnings=())


def connected(exposed: Exposures) -> list[tuple[int, int]]:
    """Return each camera but the first with the one by which its pose is found, nearer ones first.

    Raises UndeterminedError if a camera has no exposure in common with any that is connected to the first.
    """
    count = len(exposed.cameras)
    shared = np.array([[len(exposed.common(a, b)) for b in range(count)] for a in range(count)])
    reached, pairs = [0], list[tuple[int, int]]()
    while len(reached) < count:
        others = [number for number in range(count) if number not in reached]
        among = shared[np.ix_(others, reached)]
        if not among.any():
            alone, rest = (in_a_row([exposed.cameras[i] for i in some]) for some in (others, reached))
            raise UndeterminedError(
                f"{alone} and {rest} have no exposure in common, so nothing places them in one frame.\n"
                "  Images of one exposure have the same text for * in their names (`cameras: images`).\n"
                "  what would determine it: images of both at once that show the targets"
            )
        i, j = np.unravel_index(int(among.argmax()), among.shape)
        pairs.append((others[int(i)], reached[int(j)]))
        reached.append(others[int(i)])
    return pairs
