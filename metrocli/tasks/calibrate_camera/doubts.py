"""Why a calibrated camera must not be used: what it holds against its readings, and what does not describe them.

A noise that follows the residuals shows none of them, and poses take up most of a wrong one. So the readings are
adjusted once more with these values free.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli import units
from metrocli.adjust.adjustment import adjust
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.instruments import camera
from metrocli.instruments.camera import TARGET
from metrocli.tasks.calibrate_camera.other_lenses import fisheye_instead
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.settings import CameraSettings
from metrocli.tasks.calibrate_camera.wrong_images.strange import FEW_VIEWS, not_found
from metrocli.tasks.calibrate_camera.wrong_images.turned import turned_images
from metrocli.tasks.shared.images.adjustment import AdjustedImages
from metrocli.tasks.shared.images.tables import FEW, root_mean_square, scatter
from metrocli.words import listed

_AXES = ("cx", "cy")
_FAR = 0.1
"""Distance from the middle, as a share of the image size, beyond which the image size is doubted"""
_CERTAIN = 4.0
"""Standard deviations from which a difference is significant"""


@dataclass(frozen=True)
class PrincipalPoint:
    """Where the readings see the principal point, (2,) [px]."""

    image_size: tuple[int, int]
    held: Array
    """Where the job holds it; NaN on an axis on which it is estimated"""
    seen: Array
    std: Array

    @property
    def allowed(self) -> Array:
        """Errors of the held coordinates that the readings do not exclude [px], 0 for those that are estimated."""
        return np.where(np.isnan(self.held), 0.0, _CERTAIN * self.std)

    def doubts(self) -> list[str]:
        """Return that a held coordinate is far from where the readings see it."""
        return [self._contradicted()] if (self._wrong & (self._off > _FAR)).any() else []

    def warnings(self) -> list[str]:
        """Return that a held coordinate is not where the readings see it, or an estimated one far from the middle."""
        if self._wrong.any():
            return [] if self.doubts() else [self._contradicted()]
        middle = (np.array(self.image_size) - 1) / 2
        far = np.abs(self.seen - middle) - _CERTAIN * self.std > _FAR * np.array(self.image_size)
        if not far.any():
            return []
        crossed = np.abs(self.seen - middle[::-1]) - _CERTAIN * self.std <= _FAR * np.array(self.image_size)
        size = "check image_size: the coverage is computed from it"
        check = "are the columns u and v exchanged?" if crossed.all() else size
        return [
            f"the principal point {_point(self.seen)} px lies far from the middle {_point(middle)} px of an "
            f"image of {self.image_size[0]} x {self.image_size[1]} px: {check}"
        ]

    @property
    def _off(self) -> Array:
        """Differences of held coordinates as shares of the image size, NaN for estimated ones."""
        return np.asarray(np.abs(self.seen - self.held) / np.array(self.image_size))

    @property
    def _wrong(self) -> Mask:
        return np.asarray(np.abs(self.seen - self.held) > _CERTAIN * self.std)

    def _contradicted(self) -> str:
        at = np.where(np.isnan(self.held), self.seen, self.held)
        return (
            f"the principal point is held at {_point(at)} px, but the readings see it at "
            f"({', '.join(map(units.with_std, self.seen, self.std))}) px: estimate cx and cy, or check image_size, "
            "whose middle they are by default"
        )


def principal_point(problem: CameraProblem, adjusted: AdjustedImages) -> PrincipalPoint | None:
    """Return where the readings see the principal point, None if they do not determine it."""
    solution = adjusted.solution
    lens = solution.blocks[camera.LENS]
    at = [lens.columns.index(name) for name in _AXES]
    held = np.where(lens.free[0, at], np.nan, lens.values[0, at])
    # a wrong image size holds the principal point wrongly and no residual shows it: it is freed and compared
    # (docs/decisions/101-principal-point-against-image-size.md)
    if not lens.free[0, at].all():
        free = [name for name, is_free in zip(lens.columns, lens.free[0], strict=True) if is_free]
        model = problem.with_blocks(solution.blocks).with_estimate([*free, *_AXES])
        solution = adjust(model.blocks.values(), [adjusted.group, *problem.others], problem.datum)
        if not solution.outcome.good:
            return None
    block = solution.blocks[camera.LENS]
    std = np.sqrt(np.diag(solution.covariance_or_raise().of(camera.LENS)))[at]
    factor = np.sqrt(solution.cost / solution.dof) if adjusted.noise is not None and solution.dof else 1.0
    return PrincipalPoint(problem.image_size, held, block.values[0, at], std * factor)


def _point(uv: Array) -> str:
    return f"({uv[0]:.1f}, {uv[1]:.1f})"


_MUCH = 0.5
"""Share of the squared residuals below which a held value is doubted (decision 134)"""
_CENTRE = ("cx", "cy")
"""Tested against the image size"""


def misplaced(problem: CameraProblem, adjusted: AdjustedImages) -> list[str]:
    """Return which listed targets most of their images contradict, if these make up most of the squared residuals."""
    group, names = adjusted.group, problem.sighted.targets.names
    if problem.blocks[TARGET].free.any() or adjusted.residuals is None:
        return []
    index = group.observations.index[TARGET]
    seen, off = (np.bincount(rows, minlength=len(names)) for rows in (index, index[adjusted.suspects.rows]))
    wrong = (2 * off > seen) & (off > FEW_VIEWS)
    squares = (group.observations.whitened(adjusted.residuals.values) ** 2).sum(axis=0)
    if squares[wrong[index]].sum() <= _MUCH * squares.sum():
        return []
    each = [f"{names[i]} in {off[i]} of {seen[i]} images" for i in np.flatnonzero(wrong).tolist()]
    return [
        f"readings of {listed(each)} contradict the place that is listed, and make up most of the squared residuals: "
        "correct the list"
    ]


def held_doubts(problem: CameraProblem, settings: CameraSettings, adjusted: AdjustedImages) -> list[str]:
    """Return that the squared residuals are less than half with the held lens values free."""
    solution = adjusted.solution
    held = [name for name in settings.given() if name not in (*settings.estimate, *_CENTRE)]
    if not held:
        return []
    model = problem.with_blocks(solution.blocks).with_estimate([*settings.estimate, *held])
    freed = adjust(model.blocks.values(), [adjusted.group, *problem.others], problem.datum)
    if not freed.outcome.good or freed.cost >= _MUCH * solution.cost:
        return []
    known, estimated = (state.blocks[camera.LENS].named() for state in (solution, freed))
    fixed = ", ".join(f"{name} is held at {known[name]:g}, but the readings see {estimated[name]:.4g}" for name in held)
    return [
        f"{fixed}: with {' and '.join(held)} free the squared residuals are {freed.cost / solution.cost:.2g} times as "
        "large; estimate what is held, or correct it"
    ]


def too_near(problem: CameraProblem, adjusted: AdjustedImages, pixel_size: float | None) -> list[str]:
    """Return why a camera must not be used whose targets are nearer than its focal length: a lens has no image there.

    The distance of the camera [mm] is the median of the views, to the middle of the targets or the origin of the board.
    """
    blocks = adjusted.solution.blocks
    lens = blocks[camera.LENS].named()
    place = blocks[camera.view_name(problem.rig)].values[:, :3]
    seen = blocks[TARGET].values[np.unique(adjusted.group.observations.index[TARGET])]
    middle = np.zeros(3) if problem.rig == "board" else seen.mean(axis=0)
    far = float(np.median(np.linalg.norm(place - middle, axis=1)))
    focal = (pixel_size or 0.0) * float(lens.get("f", lens.get("fx", 0.0)))
    if far >= focal:
        return []
    return [
        f"the targets are {units.sized(far, 'length')} from the camera, nearer than its focal length of "
        f"{units.sized(focal, 'length')}, where a lens has no image: check the unit of the targets, or the pitch, "
        "and pixel_size"
    ]


_MISFIT = 5.0
"""Residuals so many times as large as the scatter of neighbouring points are not noise"""


def unmodelled(adjusted: AdjustedImages, image: Index, size: tuple[int, int]) -> list[str]:
    """Return why a camera must not be used whose residuals are smooth in each image, and many times their scatter.

    A noise that follows the residuals takes such a misfit for noise of the points (decision 171). `image` is the image
    of each reading, `size` that of images [px].
    """
    if adjusted.noise is None or adjusted.structured is not None:
        return []
    observations = adjusted.group.observations
    residuals, readings = adjusted.known_residuals().values, observations.readings
    residuals = residuals if observations.ratios is None else residuals / observations.ratios
    many = (np.bincount(image) >= FEW)[image]
    if not many.any():
        return []
    whole, alone = root_mean_square(residuals[:, many]), scatter(residuals, readings, image, size)
    # fitting lenses have ratios of 1.0 to 2.3, lenses without their distortion 7 to 10
    # (docs/decisions/171-lenses-that-do-not-fit.md)
    if whole <= _MISFIT * alone:
        return []
    return [
        f"residuals of {whole:.2g} px (root mean square) are smooth in each image, where the points scatter by "
        f"{alone:.2g} px: the lens model, or the list of targets, does not describe these images. The stated "
        "uncertainties do not hold. --compare shows which lens model fits best, `metrocli diagnose` what else is wrong"
    ]


_POOR = 2.0
"""sigma0 above which another lens model is tried"""


def why_not(
    problem: CameraProblem,
    settings: CameraSettings,
    adjusted: AdjustedImages,
    centre: PrincipalPoint | None,
    folded: Sequence[str],
) -> list[str]:
    """Return the doubts about a camera; `folded` has where its lens model folds over among the readings.

    It holds its principal point or other values against the readings. Or its targets are nearer than its focal length,
    or the lens model maps two directions to one pixel among the readings, or some image points were not found, or it
    does not describe the images.
    """
    residuals = adjusted.group.residuals(adjusted.solution.blocks)
    lost = not_found(problem, adjusted.group, residuals)
    image = adjusted.group.observations.index[camera.VIEW]
    smooth = [] if lost else unmodelled(adjusted, image, problem.image_size)
    poor = lost or smooth or folded or adjusted.solution.sigma0 > _POOR
    if poor and (other := fisheye_instead(problem, settings, root_mean_square(residuals))):
        return other
    near = too_near(problem, adjusted, settings.pixel_size)
    held = held_doubts(problem, settings, adjusted)
    turned = [] if lost or smooth else turned_images(problem, adjusted)
    elsewhere = [] if lost else misplaced(problem, adjusted)
    of_centre = centre.doubts() if centre is not None else []
    return [*turned, *lost, *elsewhere, *smooth, *of_centre, *held, *near, *folded]
