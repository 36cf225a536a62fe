"""Images that share a state of the camera, as kinds of place: turned alike, or taken in one series."""

from __future__ import annotations

import re
from collections.abc import Sequence
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
"""Fewest images of each direction, and of each series"""
SERIES = "series"
"""Kind of place: its names are how the file names begin, or the times [s] since when images were taken"""
_PAUSE = 10.0
"""A pause between two series, in median times between images"""
_Groups = tuple[tuple[str, ...], Index]
"""Names of groups, and the number of the group of each view; a single group does not count"""


def with_groups(model: Model, rig: str) -> Model:
    """Return a model that knows which images are turned alike, and which were taken in one series.

    A kind of place has no names where the images are not turned in steps of 90 degrees, or are one series.
    """
    observations = model.readings[0].observations
    view, names = observations.index["view"], model.places["image"].names
    single: _Groups = (("",), np.zeros(len(names), dtype=np.intp))
    turns = single
    if rig != "cmm":
        values = model.blocks[camera.view_name(rig)].values
        turns = _of_views(poses.rotation_of(values if rig == "board" else poses.inverse(values)))
    series = _by_name(names)
    if len(series[0]) < 2 and (times := observations.conditions.get("t")) is not None:
        first = np.zeros(len(names))
        first[view] = times
        series = _by_pauses(first)
    groups = {TURN: turns, SERIES: series}
    index = {kind: number[view] for kind, (_, number) in groups.items()}
    grouped = observations.with_index(index)
    places = {kind: Place(names if len(names) > 1 else (), kind) for kind, (names, _) in groups.items()}
    return replace(model.with_group(model.readings[0].with_observations(grouped)), places={**model.places, **places})


def _by_name(names: Sequence[str]) -> _Groups:
    """Return the groups of views whose names begin alike up to their last number: day1_07.png, day2_01.png."""
    stems = [re.sub(r"\.[A-Za-z][A-Za-z0-9]{1,4}$", "", name) for name in names]
    return _groups([re.sub(r"\d+[^\d]*$", "", stem) or "numbers only" for stem in stems])


def _by_pauses(times: Array) -> _Groups:
    """Return the groups of views that long pauses separate, by the time (views,) [s]."""
    order = np.argsort(times, kind="stable")
    gaps = np.diff(times[order])
    # the median counts only the images that were not taken at once
    usual = float(np.median(gaps[gaps > 0])) if (gaps > 0).any() else np.inf
    number = np.zeros(len(times), dtype=np.intp)
    number[order] = np.concatenate([[0], np.cumsum(gaps > _PAUSE * usual)])
    first = [float(times[number == group].min()) for group in range(int(number.max(initial=0)) + 1)]
    return _groups([f"from {first[group]:.12g} s" for group in number.tolist()])


def _groups(labels: Sequence[str]) -> _Groups:
    """Return groups of equal labels, that of most views first; views with too few of their own are of this one."""
    names, number, counts = np.unique(np.array(labels, dtype=str), return_inverse=True, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    kept = [*order[:1].tolist(), *(group for group in order[1:].tolist() if counts[group] >= _FEWEST)]
    place = np.zeros(len(names), dtype=np.intp)
    place[kept] = np.arange(len(kept))
    return tuple(names[kept].tolist()), place[number]


def _of_views(rotations: Array) -> _Groups:
    """Return the names of the directions, that of most images first, and the number of the direction of each view.

    The turn of a view is the direction in its image of that axis of the targets whose directions lie nearest to
    multiples of 90 degrees: `|mean exp(4 i angle)|` is largest.
    """
    seen = rotations[:, :2, :]
    angles = np.arctan2(seen[:, 1], seen[:, 0])
    even = np.exp(4j * angles).mean(axis=0)
    best = int(np.argmax(np.abs(even)))
    one_direction: _Groups = (("0",), np.zeros(len(angles), dtype=np.intp))
    # single images have no state of their own: no held-out image could confirm it
    # (docs/decisions/147-states-of-groups-of-images.md)
    if len(angles) < _FEWEST_IMAGES or np.abs(even[best]) < _EVEN:
        return one_direction
    number = np.round((angles[:, best] - np.angle(even[best]) / 4) / (np.pi / 2)).astype(np.intp)
    number = (number - int(np.argmax(np.bincount(number % 4, minlength=4)))) % 4
    counts = np.bincount(number, minlength=4)
    there = np.flatnonzero(counts)
    if counts[there].min() < _FEWEST:
        return one_direction
    return tuple(str(90 * group) for group in there.tolist()), np.searchsorted(there, number)
