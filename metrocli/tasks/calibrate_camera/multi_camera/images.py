"""The images of one of several cameras, and by which exposures all of them are connected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.errors import UndeterminedError
from metrocli.tasks.shared.images.exposures import Exposures
from metrocli.tasks.shared.images.sightings import Sighted
from metrocli.words import in_a_row


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
    there = [exposed.exposure[exposed.camera == number] for number in range(count)]
    shared = np.array([[len(np.intersect1d(one, other)) for other in there] for one in there])
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
