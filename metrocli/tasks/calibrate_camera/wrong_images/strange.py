"""Images, targets and points of a board that contradict the others, whatever they make of an adjustment.

But for smooth distortion, a homography takes a flat board to its image (docs/targets.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments.camera_start import plane_frame
from metrocli.targets.homography import (
    determines_homography,
    fitting_a_view,
    homography,
    projected,
    seen_by_a_lens,
)
from metrocli.targets.lattice import GATE
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.wrong_images.mixed_units import in_another_unit
from metrocli.tasks.calibrate_camera.wrong_images.two_groups import in_two_frames
from metrocli.words import listed

_ENOUGH, _APART = 6, 5.0
"""Fewest readings of an image that a homography can contradict, and how many times as large its residuals are"""
_AN_IMAGE = 4
"""Fewest points of an image that may show it mirrored"""
_LOST = 0.003
"""Median residual, as a share of the longer side of the image, beyond which lens and poses were not found"""
FEW_VIEWS, _FEW_TARGETS = 2, 1 / 3
"""So many images contradict no listed place of a target, and others place a larger share of the targets than this"""
_STEP, _FEW_POINTS = 1.0, 0.05
"""A point farther from the view of the others, in steps of the board, is wrong, if no larger share of an image is"""
_LEFT = 0.5
"""Share of that distance that an adjustment leaves of a wrong point: views of others do not reach the corners of a wide
lens"""
_SHOWN = 4
"""Most targets that are named in a message"""


@dataclass(frozen=True)
class _SeenBoard:
    """One image of a flat board, with n points."""

    image: str
    target: Index
    """Targets of the points, (n,)"""
    step: float
    """Typical distance of points in the image [px]"""
    whole: float
    """Median distance of the points from the view that fits all of them best [px]"""
    off: Array
    """Distances of the points from the view that most of them fit, infinite without one, (n,) [px]"""
    fitting: Mask
    """Points that fit that view, (n,)"""
    places: Array
    """Places on the board where the points are seen, by those that fit a view, nan if none does, (n, 2)"""
    left: Array | float
    """Lengths of their residuals in an adjustment, (n,) [px]; infinite without one"""

    @property
    def fits(self) -> bool:
        """Whether most points fit a view of the board."""
        return bool(2 * self.fitting.sum() > len(self.fitting))

    @property
    def far(self) -> Index:
        """The points that are far from the view of the others, if they are few."""
        far = np.flatnonzero((self.off > _STEP * self.step) & (self.left > _LEFT * self.off))
        return far if len(far) <= max(_FEW_POINTS * len(self.off), 1) else far[:0]


def strange_images(
    problem: CameraProblem, images: Group, residuals: Array | None = None, every: bool = True
) -> list[str]:
    """Return which targets of a flat board lie elsewhere than listed, and which images or points fit no view of it.

    A few wrong points bend the view that all fit, and are no other order of the targets. Where half of the images or
    more fit no view, the list is wrong rather than they, and none is returned. `residuals` (2, n) are those of an
    adjustment. With them, and without `every`, only images whose root mean square is far above that of the others are
    examined.
    """
    rows = images.observations
    index, view = rows.index[camera.TARGET], rows.index[camera.VIEW]
    frame, planar = plane_frame(problem.sighted.targets.points[np.unique(index)])
    if problem.rig != "board" or not planar:
        return []
    plane = poses.apply(frame, problem.sighted.targets.points)[:, :2]
    views = [(index[view == i], rows.readings[:, view == i].T) for i in np.unique(view).tolist()]
    if apart := in_two_frames(problem.sighted.targets.names, plane, views):
        return apart
    seen = []
    for i in np.flatnonzero(_examined(view, None if every else residuals)).tolist():
        mine = view == i
        if determines_homography(plane[index[mine]]):
            left = np.inf if residuals is None else np.hypot(*residuals[:, mine])
            seen.append(_seen(problem.sighted.images[i], index[mine], plane, rows.readings[:, mine].T, left))
    back = poses.inverse(frame)
    if mixed := _in_another_unit(problem, seen, back):
        return mixed
    wrong = _elsewhere(seen)
    if wrong:
        return [_places(problem, {t: poses.apply(back, np.append(at, 0.0)) for t, at in wrong.items()})]
    orders = [
        f"image {board.image} fits no view of a flat board, by {board.whole:.0f} px: are its targets in another order?"
        for board in seen
        if not board.far.size and board.whole > GATE * board.step
    ]
    names = problem.sighted.targets.names
    return [*(orders if 2 * len(orders) < len(np.unique(view)) else []), *_points(seen, names)]


def _seen(image: str, target: Index, plane: Array, uv: Array, left: Array | float) -> _SeenBoard:
    """Return an image with points uv (n, 2) of some targets of a board, all of which are at `plane` (m, 2)."""
    mine, step = plane[target], float(np.sqrt(np.ptp(uv, axis=0).prod() / len(uv)))
    fitting = fitting_a_view(mine, uv, GATE * step)
    whole = float(np.median(np.linalg.norm(seen_by_a_lens(mine, uv, mine) - uv, axis=1)))
    places = np.full(mine.shape, np.nan)
    if fitting.any():
        places = projected(homography(uv[fitting], mine[fitting]), uv)
    if 2 * fitting.sum() <= len(uv):
        return _SeenBoard(image, target, step, whole, np.full(len(uv), np.inf), fitting, places, left)
    off = np.linalg.norm(seen_by_a_lens(mine[fitting], uv[fitting], mine) - uv, axis=1)
    return _SeenBoard(image, target, step, whole, off, fitting, places, left)


def _in_another_unit(problem: CameraProblem, seen: Sequence[_SeenBoard], back: Array) -> list[str]:
    """Return which targets are listed in another unit; `back` is the transformation from the plane to the list."""
    targets = problem.sighted.targets
    views = []
    for board in (board for board in seen if board.fitting.any()):
        others = board.target[~board.fitting]
        places = np.column_stack([board.places[~board.fitting], np.zeros(len(others))])
        views.append((board.target[board.fitting], others, poses.apply(back, places), targets.points[others]))
    return in_another_unit(targets.names, views)


def _elsewhere(seen: Sequence[_SeenBoard]) -> dict[int, Array]:
    """Return the targets that do not fit most images which fit otherwise, each with its place on the board (2,)."""
    fits = [board for board in seen if board.fits]
    if not fits:
        return {}
    target, fitting = (np.concatenate([getattr(board, name) for board in fits]) for name in ("target", "fitting"))
    places, count, off = np.concatenate([board.places for board in fits]), np.bincount(target), ~fitting
    missed = np.bincount(target[off], minlength=len(count))
    wrong = np.flatnonzero((2 * missed > count) & (missed > FEW_VIEWS)).tolist()
    if len(wrong) > _FEW_TARGETS * (count > 0).sum():
        return {}
    return {number: np.median(places[off & (target == number)], axis=0) for number in wrong}


def _places(problem: CameraProblem, places: Mapping[int, Array]) -> str:
    """Return which targets lie elsewhere than listed, and for some where."""
    targets = problem.sighted.targets
    each = [
        f"{targets.names[target]} is seen near {_point(place)}, listed at {_point(targets.points[target])}"
        for target, place in places.items()
    ]
    many = f"{len(places)} targets lie" if len(places) > 1 else "a target lies"
    return f"{many} elsewhere on the board than listed: {listed(each, _SHOWN)}; check the rows of the list"


def _point(place: Array) -> str:
    return f"({', '.join(f'{value:.4g}' for value in np.round(place, 1) + 0.0)}) mm"


def _points(seen: Sequence[_SeenBoard], names: Sequence[str]) -> Iterator[str]:
    """Yield the images of which a few points are far from the view that the others show."""
    for board in (board for board in seen if board.far.size):
        off = [f"{names[board.target[i]]} by {board.off[i]:.0f} px" for i in board.far.tolist()]
        yield (
            f"points of image {board.image} are off the view of the board that its other points show: "
            f"{listed(off, _SHOWN)}; correct them, or leave them out"
        )


def _examined(view: Index, residuals: Array | None) -> Mask:
    """Return which images have enough readings to be examined, and the need of it, (images,)."""
    count = np.bincount(view)
    if residuals is None:
        return np.asarray(count >= _ENOUGH)
    squares = np.bincount(view, (residuals**2).sum(axis=0)) / np.maximum(count, 1)
    return np.asarray((count >= _ENOUGH) & (squares > _APART**2 * np.median(squares[count > 0])))


def not_found(problem: CameraProblem, images: Group, residuals: Array) -> list[str]:
    """Return why a camera must not be used whose residuals (2, n) are far larger than image points are wrong.

    With `noise: estimated` they only make the noise larger: nothing else would contradict them. One image that is far
    off, such as a mirrored one, pulls all others.
    """
    off, most = np.hypot(*residuals), max(problem.image_size)
    typical, view = float(np.median(off)), images.observations.index[camera.VIEW]
    all_are_off = typical > _LOST * most
    strange = strange_images(problem, images, residuals, all_are_off)
    if all_are_off and not strange:
        network = problem.rig == "network"
        one_frame = "the right names of targets, places of all rows of their list in one frame"
        closer = "closer places of the targets, or their right names" if network else one_frame
        return [
            f"half of the image points are off by more than {typical:.3g} px ({100 * typical / most:.2g} % of the "
            "image): lens and poses were not found, or the lens model lacks distortion; "
            f"what helps: {closer}, and `camera: f`"
        ]
    if strange:
        return strange
    names, count = problem.sighted.images, np.bincount(view)
    size = {i: float(np.median(off[view == i])) for i in np.flatnonzero(count).tolist()}
    far = [i for i, median in size.items() if median > max(_LOST * most, _APART * typical)]
    # a few points show nothing of an image, and one of them that is wrong pulls those of others
    few = sorted((i for i in far if count[i] < _AN_IMAGE), key=lambda i: -size[i])[:1]
    return [
        f"points of image {names[i]} are off by {size[i]:.0f} px, those of all by {typical:.2g} px: they pull all "
        "other values: correct them, or leave them out"
        for i in few
    ] + [
        f"half of the points of image {names[i]} are off by more than {size[i]:.0f} px, those of all by {typical:.2g} "
        "px: is it mirrored, are its targets named otherwise, or does the lens model lack distortion that only it "
        "shows? It pulls all other values: correct it, leave it out, or estimate more of the distortion"
        for i in far
        if count[i] >= _AN_IMAGE
    ]
