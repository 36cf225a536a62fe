"""Two groups of targets of a flat board, each listed in a frame of its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.targets.homography import determines_homography, fitting_a_view, homography, projected
from metrocli.words import listed

_FEWEST = 20
"""Fewest targets of a group: fewer fit a view with distortion whatever their places"""
_ROUNDS = 5
"""Rounds in which the places on the board follow the images of all targets"""
_NEAR = (6.0, 20.0, 60.0)
"""A target belongs to a group if it is within so many times what the images differ in its place: lists are rougher"""
_ALIKE, _OWN = 0.2, 0.8
"""How far a motion of a group leaves its targets off, as a share of the motion, and the share of them it has to fit"""
_SCALE = 0.02
"""Change of scale from which a group has not only moved"""
_SHOWN = 4


def in_two_frames(names: Sequence[str], plane: Array, views: Sequence[tuple[Index, Array]]) -> list[str]:
    """Return how one group of targets, listed at `plane` (m, 2) [mm], lies against the others, if it is moved.

    Each view has the targets that it shows and their image points (n, 2). All images together show where the targets
    lie on the board, but for one homography, which the larger group determines.
    """
    places, spread = _seen_places(plane, views)
    known = np.flatnonzero(np.isfinite(places).all(axis=1))
    if len(known) < 2 * _FEWEST:
        return []
    for times in _NEAR:
        words = _words([names[i] for i in known.tolist()], plane[known], places[known], times * spread)
        if words:
            return [words]
    return []


def _words(names: Sequence[str], at: Array, seen: Array, near: float) -> str:
    """Return how one group lies against the others, which are within a distance of where they are listed; else ''."""
    fitting = fitting_a_view(at, seen, near)
    second, first = sorted((fitting, ~fitting), key=np.count_nonzero)
    if second.sum() < _FEWEST or any(fitting_a_view(at[i], seen[i], near).mean() < _OWN for i in (first, second)):
        return ""
    moved = projected(homography(seen[first], at[first]), seen[second])
    turn, shift, scale = _similarity(at[second], moved)
    by = float(np.median(np.linalg.norm(moved - at[second], axis=1)))
    off = np.linalg.norm(moved - scale * at[second] @ turn.T - shift, axis=1)
    if abs(scale - 1) > _SCALE or (off < _ALIKE * by).mean() < _OWN:
        return ""
    group, rest = (listed([names[i] for i in np.flatnonzero(mine).tolist()], _SHOWN) for mine in (second, first))
    angle = np.degrees(np.arctan2(turn[1, 0], turn[0, 0]))
    turned = f" and turned by {angle:.2g} deg" if abs(angle) > _turn_of(at[second], by) else ""
    return (
        "the list of targets has two groups, each of which agrees with the images only by itself: "
        f"{second.sum()} targets ({group}) lie {by:.2g} mm off{turned} against the other {first.sum()} ({rest}); "
        "give all rows of the list in one frame"
    )


def _seen_places(plane: Array, views: Sequence[tuple[Index, Array]]) -> tuple[Array, float]:
    """Return where the images together see the targets on the board (m, 2), and how far one of them is off it."""
    at = plane
    for _ in range(_ROUNDS):
        each = np.full((len(views), *plane.shape), np.nan)
        for i, (target, uv) in enumerate(views):
            if determines_homography(at[target]):
                each[i, target] = projected(homography(uv, at[target]), uv)
        shown = np.isfinite(each[..., 0]).sum(axis=0) > 1
        places = np.full_like(plane, np.nan)
        places[shown] = np.nanmedian(each[:, shown], axis=0)
        at = np.where(shown[:, None], places, plane)
    off = np.linalg.norm(each - places, axis=2)
    return places, float(np.nanmedian(off)) if shown.any() else np.nan


def _similarity(at: Array, to: Array) -> tuple[Array, Array, float]:
    """Return the turn (2, 2), shift (2,) and scale that take points (n, 2) to others best."""
    middle, end = at.mean(axis=0), to.mean(axis=0)
    left, size, right = np.linalg.svd((to - end).T @ (at - middle))
    hand = np.array([1.0, np.sign(np.linalg.det(left @ right))])
    turn, scale = left * hand @ right, float(size @ hand / ((at - middle) ** 2).sum())
    return turn, end - scale * turn @ middle, scale


def _turn_of(at: Array, by: float) -> float:
    """Return the angle [deg] that moves a group of points (n, 2) by a tenth of a length at its ends."""
    return float(np.degrees(0.1 * by / (np.ptp(at, axis=0).max() / 2)))
