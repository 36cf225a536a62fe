"""Images taken with the camera turned by 90, 180 or 270 degrees about its viewing axis, as a kind of place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.effects.model import Model, Place
from metrocli.geometry import poses
from metrocli.instruments import camera

TURN = "turn"
"""Kind of place: its names are angles in degrees, about the direction that most images have"""
_EVEN, _FEWEST_IMAGES = 0.7, 6
"""Least concentration of the directions at multiples of 90 degrees: less has a camera that is turned freely"""
_FEWEST = 2
"""Fewest images of each direction"""


def with_turns(model: Model, rig: str) -> Model:
    """Return a model that knows which images are turned; without names where they are not in steps of 90 degrees."""
    observations = model.readings[0].observations
    view = observations.index["view"]
    names: tuple[str, ...] = ("0",)
    turn: Index = np.zeros(int(view.max(initial=0)) + 1, dtype=np.intp)
    if rig != "cmm":
        values = model.blocks[camera.view_name(rig)].values
        names, turn = _of_views(poses.rotation_of(values if rig == "board" else poses.inverse(values)))
    turned = replace(observations, index={**observations.index, TURN: turn[view]})
    places = {**model.places, TURN: Place(names if len(names) > 1 else (), TURN)}
    return replace(model.with_group(model.readings[0].with_observations(turned)), places=places)


def _of_views(rotations: Array) -> tuple[tuple[str, ...], Index]:
    """Return the names of the directions, that of most images first, and the number of the direction of each view.

    The turn of a view is the direction in its image of that axis of the targets whose directions lie nearest to
    multiples of 90 degrees: `|mean exp(4 i angle)|` is largest.
    """
    seen = rotations[:, :2, :]
    angles = np.arctan2(seen[:, 1], seen[:, 0])
    even = np.exp(4j * angles).mean(axis=0)
    best = int(np.argmax(np.abs(even)))
    one_direction: tuple[tuple[str, ...], Index] = (("0",), np.zeros(len(angles), dtype=np.intp))
    if len(angles) < _FEWEST_IMAGES or np.abs(even[best]) < _EVEN:
        return one_direction
    number = np.round((angles[:, best] - np.angle(even[best]) / 4) / (np.pi / 2)).astype(np.intp)
    number = (number - int(np.argmax(np.bincount(number % 4, minlength=4)))) % 4
    counts = np.bincount(number, minlength=4)
    there = np.flatnonzero(counts)
    if counts[there].min() < _FEWEST:
        return one_direction
    return tuple(str(90 * one) for one in there.tolist()), np.searchsorted(there, number)
