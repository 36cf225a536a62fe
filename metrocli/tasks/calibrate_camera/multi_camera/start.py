"""Where several cameras stand to each other, from each one's own calibration; pairs of images that do not fit.

At exposure i camera c is at `P_ci` in the frame of the targets. Fixed cameras have one `M = P_ai^-1 P_ci` at all i.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.tasks.calibrate_camera.wrong_images.turned import mirrored, on_the_other_side

_NEAR = 0.02
"""Share of the longer side of the image by which targets may be off where a right pair of images predicts them"""
_MOST = 0.5
"""Share of the pairs that must fit one pose"""
_CANDIDATES, _TRIED = 12, 40
"""Images of one camera, and of the other, all pairs of which are tried"""


@dataclass(frozen=True)
class CalibratedCamera:
    """One camera with its images, as its own calibration found them."""

    name: str
    images: tuple[str, ...]
    exposure: Index
    """(images,)"""
    places: Array
    """Its poses in the frame of the targets, (images, 6)"""
    focal: float
    """[px]"""
    size: int
    """Longer side of the image [px]"""

    @property
    def limit(self) -> float:
        """By how much targets may be off where a right pair of images predicts them [px]."""
        return _NEAR * self.size


def pose_between(first: CalibratedCamera, second: CalibratedCamera, points: Array) -> Array:
    """Return the pose (6,) of the second camera in the frame of the first, from the pair of images that fits best.

    `points` (n, 3) are the targets. Raises InputError that names the pairs of images that do not fit the others.
    """
    _, at, to = np.intersect1d(first.exposure, second.exposure, return_indices=True)
    held = poses.compose(poses.inverse(first.places[at]), second.places[to])
    off = np.array([_off(pose, first.places[at], second.places[to], second.focal, points) for pose in held])
    best = int(np.lexsort((np.median(off, axis=1), -(off <= second.limit).sum(axis=1)))[0])
    fits = off[best] <= second.limit
    if not fits.all():
        pose = held[best] if fits.mean() >= _MOST else _by_all(first, second, points)
        strangers = list(_strangers(first, second, points, pose, (at, to)))
        # a pose that few pairs fit is chance
        lines = [line for line, _ in strangers] if fits.mean() >= _MOST or any(known for _, known in strangers) else []
        raise InputError([Fault(_refusal(first, second, lines, len(at)), hint="rename the images, or leave them out")])
    chosen: Array = held[best]
    return chosen


def _off(pose: Array, first: Array, second: Array, focal: float, points: Array) -> Array:
    """Return by how much the second camera sees targets elsewhere than poses of the first predict, rms (images,) px."""
    predicted = poses.compose(first, np.broadcast_to(pose, first.shape))
    rays = [poses.apply(poses.inverse(places)[:, None], points) for places in (predicted, second)]
    units = [ray / np.linalg.norm(ray, axis=2, keepdims=True) for ray in rays]
    return np.asarray(focal * np.sqrt(((units[0] - units[1]) ** 2).sum(axis=2).mean(axis=1)))


def _refusal(first: CalibratedCamera, second: CalibratedCamera, lines: Sequence[str], pairs: int) -> str:
    if not lines:
        return (
            f"{second.name} has no one place beside {first.name}: their images contradict each other. Did a camera "
            "move? Images are paired by what * stands for in their names (`cameras: images`)"
        )
    text = f"{len(lines)} of {pairs} images of {second.name} were not taken with those of {first.name}"
    return f"{text}: {'; '.join(lines[:6])}{'; ...' if lines[6:] else ''}"


def _strangers(
    first: CalibratedCamera, second: CalibratedCamera, points: Array, pose: Array, pairs: tuple[Index, Index]
) -> Iterator[tuple[str, bool]]:
    """Yield each image that does not fit its partner, the one with which it was taken, and whether that is known."""
    sides = [on_the_other_side(camera.places[:, :3], points) for camera in (first, second)]
    for i, j in zip(*pairs, strict=True):
        there = np.broadcast_to(second.places[j], first.places.shape)
        off = _off(pose, first.places, there, second.focal, points)
        if off[i] > second.limit:
            fits = int(np.argmin(off))
            known = bool(off[fits] <= second.limit)
            other = f", but with {first.images[fits]}" if known else ""
            named = ((first.images[i], sides[0][i]), (second.images[j], sides[1][j]))
            behind = [image for image, there in named if there]
            yield (
                f"{second.images[j]} not with {first.images[i]}{other}{f' ({mirrored(behind)})' if behind else ''}",
                known,
            )


def _by_all(first: CalibratedCamera, second: CalibratedCamera, points: Array) -> Array:
    """Return the pose with which the most images of the second camera fit any image of the first."""
    few = points[:: max(len(points) // 4, 1)]
    begins, ends = _thinned(first.places, _CANDIDATES), _thinned(second.places, _TRIED)
    tried = [poses.compose(poses.inverse(begin), other) for begin in begins for other in ends]

    def matching(pose: Array) -> int:
        all_of = (np.broadcast_to(end, first.places.shape) for end in ends)
        off = (_off(pose, first.places, places, second.focal, few) for places in all_of)
        return sum(bool((misfit <= second.limit).any()) for misfit in off)

    return max(tried, key=matching)


def _thinned(values: Array, most: int) -> Array:
    return np.asarray(values[np.unique(np.linspace(0, len(values) - 1, min(most, len(values))).astype(int))])


def all_in_first(between: Sequence[tuple[int, int, Array]], count: int) -> Array:
    """Return the poses (cameras, 6) in the frame of the first, of poses of cameras in that of another, in order."""
    in_first = np.zeros((count, 6))
    for camera, beside, pose in between:
        in_first[camera] = poses.compose(in_first[beside], pose)
    return in_first
