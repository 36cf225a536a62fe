"""Two rows of the poses that are exchanged, sought where no start meets the targets."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np

from metrocli.arrays import Index
from metrocli.errors import InputError
from metrocli.instruments.spindle_camera import Rays, start_pose

_BETTER, _GOOD = 5.0, 0.01
"""Two poses are named if the angle is so many times smaller then, and at most this [rad]"""
_MOST = 30
"""Most images among which they are sought: the pairs grow with the square of their number"""
_SAMPLED, _TURNS, _RANKED = 3, 5, 3
"""Readings of an image and turns that rank the pairs, and how many of these are tried with all readings"""


def refuse_exchanged(
    names: tuple[str, ...], image: Index, misfit: float, lines: Callable[[Index, Index], list[Rays]]
) -> None:
    """Raise InputError if the sightings fit far better with the poses of two images exchanged.

    `image` (n,) is that of each reading, `misfit` the angle as it stands [rad]. `lines` returns the rays of some
    readings, with the poses of the images in another order, for each clamping angle to try.
    """
    if len(names) > _MOST:
        return
    every = [np.flatnonzero(image == number) for number in range(len(names))]
    some = np.concatenate([own[np.linspace(0, len(own) - 1, min(_SAMPLED, len(own))).astype(int)] for own in every])

    def exchanged(pair: tuple[int, int]) -> Index:
        order = np.arange(len(names))
        order[list(pair)] = pair[::-1]
        return order

    def roughly(pair: tuple[int, int]) -> float:
        return min(start_pose(rays, _TURNS, again=False)[1] for rays in lines(exchanged(pair), some))

    def tried(pair: tuple[int, int]) -> float:
        return min(start_pose(rays)[1] for rays in lines(exchanged(pair), np.arange(len(image))))

    # a start from all readings takes up to a hundred times as long, which hundreds of pairs are not worth
    ranked = sorted(combinations(range(len(names)), 2), key=roughly)[:_RANKED]
    best, pair = min(((tried(pair), pair) for pair in ranked), default=(np.inf, (0, 0)))
    if best * _BETTER < misfit and best < _GOOD:
        first, second = (names[number] for number in pair)
        raise InputError(
            f"the poses of images {first} and {second} are exchanged: with this corrected, the lines of sight "
            f"meet the targets to {1000 * best:.2g} mrad; exchange their names in the file of poses, or those of the "
            "images"
        )
