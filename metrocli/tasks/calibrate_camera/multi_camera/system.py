"""Several cameras fixed to each other as one adjustment: one more pose between the targets and each lens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.clusters.robust import FROM_RESIDUALS
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, priors
from metrocli.arrays import Array
from metrocli.effects.links.lens_shape import SHAPE, LensShape
from metrocli.effects.model import Model, Place
from metrocli.effects.modelled import Modelled
from metrocli.errors import InputError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments.lenses.lens import PARAMETERS
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.build import build, needed, target_datum
from metrocli.tasks.calibrate_camera.multi_camera.start import CalibratedCamera, all_in_first, pose_between
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.readings import scale_bars, units_doubted
from metrocli.tasks.calibrate_camera.settings import OneOfSeveral, Settings
from metrocli.tasks.calibrate_camera.shape.spline import extended, shape_of
from metrocli.tasks.calibrate_camera.starts import robustly
from metrocli.tasks.shared.images.adjustment import IMAGES
from metrocli.tasks.shared.images.eccentricity import corrected
from metrocli.tasks.shared.images.exposures import IMAGE, Exposures, exposures
from metrocli.tasks.shared.images.settings import SPLINE
from metrocli.tasks.shared.images.sightings import Sighted, placed
from metrocli.words import in_a_row

_COMMON = 4
"""Fewest targets that lay the network of one camera onto that of another"""


@dataclass(frozen=True)
class CameraSystem(Modelled):
    """Several cameras, ready to adjust."""

    rig: str
    cameras: Mapping[str, OneOfSeveral]
    exposed: Exposures
    sighted: Sighted
    alone: Mapping[str, CameraProblem]
    """The calibration of each camera by its own readings, adjusted: the start of all"""

    @property
    def images(self) -> Group:
        """The image points of all cameras."""
        return self.model.group(IMAGES)

    @property
    def conventions(self) -> tuple[str, ...]:
        """The convention of each lens."""
        return tuple(camera_settings.convention for camera_settings in self.cameras.values())

    @property
    def shapes(self) -> list[LensShape]:
        """The links of the shapes of lenses."""
        links = self.images.chain.links
        return [link for link in links if isinstance(link, LensShape) and link.member is not None]

    def size(self, name: str) -> tuple[int, int]:
        """Return width and height [px] of the images of a camera."""
        return self.cameras[name].image_size or (0, 0)

    @property
    def largest_size(self) -> tuple[int, int]:
        """Width and height [px] of the widest images."""
        return max((self.size(name) for name in self.cameras), key=max)


def system_of(
    settings: Settings, cameras: Mapping[str, OneOfSeveral], sighted: Sighted, bars: Table | None
) -> CameraSystem:
    """Return the adjustment of all cameras with its starting values, from the calibration of each.

    `bars` are calibrated distances between targets of a network. Raises InputError and UndeterminedError as `build`,
    `exposures`, `connected` and `pose_between`.
    """
    exposed = exposures({name: several.images for name, several in cameras.items()}, sighted.images)
    if exposed.unused:
        raise InputError(f"no image of {in_a_row(exposed.unused)} shows enough targets; check `cameras: images`")
    # targets placed by a CMM are one frame for all cameras
    order = connected(exposed) if settings.rig != "cmm" else [(c, 0) for c in range(1, len(cameras))]
    size = 1.0
    alone = calibrated_alone(settings, cameras, sighted)
    each = list(alone.values())
    if settings.rig == "network":
        each = _in_first_frame(each, order)
        size = _size_by_bars(each[0], bars) if np.isnan(sighted.targets.sigma).all() else 1.0
        each = [_resized(problem, size) for problem in each]
        sighted = placed(sighted, needed(settings.rig, sighted.targets))
    seen = [_seen(exposed, i, problem) for i, problem in enumerate(each)]
    points = size * sighted.targets.points
    held = all_in_first([(c, beside, pose_between(seen[beside], seen[c], points)) for c, beside in order], len(each))
    blocks = _blocks(settings.rig, exposed, each, (seen, held))
    targets = sighted.targets
    free = np.broadcast_to(blocks[camera.TARGET].free, targets.points.shape)
    chain = camera.chain(settings.rig, *(problem.convention for problem in each))
    group = Group(IMAGES, chain, exposed.readings(sighted.observations))
    # the frame is that of the list: the places where the cameras stand alone have left it
    listed = blocks[camera.TARGET].with_values(points)
    datum = target_datum(settings.rig, listed, several=True) if free.any() else None
    places = {"image": Place(sighted.images, IMAGE), "target": Place(targets.names, camera.TARGET)}
    places["camera"] = Place(exposed.cameras, camera.LENS)
    seen_in = np.bincount(sighted.target, minlength=len(targets.names))
    known = (*priors(blocks[camera.TARGET], targets.sigma, free), *scale_bars(bars, targets.names, seen_in))
    model = Model(blocks, (group, *known), datum, (IMAGES,), places, nominal={camera.TARGET: targets.points})
    for number, problem in enumerate(each):
        name = exposed.cameras[number]
        shown = shape_of(problem, settings.noise not in FROM_RESIDUALS) if cameras[name].model == SPLINE else None
        if shown is not None:
            link, covariance = shown
            model = extended(model, replace(link, block=f"{SHAPE} {name}", member=number), covariance)
    # a target of a network that one camera does not place is placed by all together
    problems = each if settings.rig != "network" else ()
    warnings = (*sighted.warnings, *(line for problem in problems for line in problem.sighted.warnings))
    warnings += units_doubted(size)
    system = CameraSystem(model, settings.rig, cameras, exposed, replace(sighted, warnings=warnings), alone)
    if not sighted.eccentric:
        return system
    others = tuple(group for group in model.groups if group.name != IMAGES)
    group, consistent = corrected(model.group(IMAGES), dict(model.blocks), others, datum, targets.radius)
    return system.with_model(model.with_group(group).with_blocks(consistent))


def calibrated_alone(
    settings: Settings, cameras: Mapping[str, OneOfSeveral], sighted: Sighted
) -> dict[str, CameraProblem]:
    """Return the calibration of each camera by its own readings."""
    exposed = exposures({name: several.images for name, several in cameras.items()}, sighted.images)
    each = (_alone(settings.rig, entry, of_camera(sighted, exposed, i)) for i, entry in enumerate(cameras.items()))
    return dict(zip(cameras, each, strict=True))


def _alone(rig: str, camera_of: tuple[str, OneOfSeveral], sighted: Sighted) -> CameraProblem:
    """Return the calibration of one camera, by values that its wrong readings do not spoil."""
    name, settings = camera_of
    try:
        return robustly(build(rig, settings, sighted))
    except UndeterminedError as error:
        raise UndeterminedError(f"camera {name}: {error}") from error


def _in_first_frame(each: Sequence[CameraProblem], order: Sequence[tuple[int, int]]) -> list[CameraProblem]:
    """Return free networks of single cameras in the frame and the scale of the first, by the targets that two place.

    The list of targets gives each of them a frame that is as good as the list.
    """
    laid = list(each)
    for number, beside in order:
        mine, theirs = laid[number], laid[beside]
        here, there = (problem.blocks[camera.TARGET].values for problem in (mine, theirs))
        least = needed("network", mine.sighted.targets)
        rays = [np.bincount(problem.sighted.target, minlength=len(here)) for problem in (mine, theirs)]
        common = (rays[0] >= least) & (rays[1] >= least)
        if common.sum() < _COMMON:
            continue
        pose, scale = poses.fit_similarity(here[common], there[common])
        views = mine.blocks[camera.VIEW].values * np.repeat([scale, 1.0], 3)
        moved = {
            camera.VIEW: poses.compose(np.broadcast_to(pose, views.shape), views),
            camera.TARGET: poses.apply(pose, scale * here),
        }
        laid[number] = mine.with_blocks(
            {**mine.blocks, **{name: mine.blocks[name].with_values(values) for name, values in moved.items()}}
        )
    return laid


def _size_by_bars(problem: CameraProblem, bars: Table | None) -> float:
    """Return by what scale bars are longer than distances of the listed targets, which may have any scale; else 1."""
    names = problem.sighted.targets.names
    if bars is None or not {*bars.texts("from"), *bars.texts("to")} <= set(names):
        return 1.0
    at = problem.blocks[camera.TARGET].values
    ends = (at[[names.index(name) for name in bars.texts(column)]] for column in ("from", "to"))
    listed = np.linalg.norm(np.subtract(*ends), axis=1)
    return float(np.median(bars.numbers("length") / np.maximum(listed, 1e-300)))


def _resized(problem: CameraProblem, size: float) -> CameraProblem:
    views, targets = problem.blocks[camera.VIEW], problem.blocks[camera.TARGET]
    larger = replace(targets, values=size * targets.values, reach=size * targets.reach)
    farther = views.with_values(views.values * np.repeat([size, 1.0], 3))
    return problem.with_blocks({**problem.blocks, camera.VIEW: farther, camera.TARGET: larger})


def _seen(exposed: Exposures, number: int, problem: CameraProblem) -> CalibratedCamera:
    values = problem.blocks[camera.view_name(problem.rig)].values
    places = poses.inverse(values) if problem.rig == "board" else values
    lens = problem.blocks[camera.LENS].named()
    exposure = exposed.exposure[exposed.camera == number]
    if problem.rig == "cmm":
        # one pose serves all images: it is one exposure
        exposure = np.zeros(1, dtype=np.intp)
    focal = float(lens.get("f", lens.get("fx", 0.0)))
    names = problem.sighted.images[: len(exposure)]
    return CalibratedCamera(exposed.cameras[number], names, exposure, places, focal, max(problem.image_size))


def _blocks(
    rig: str, exposed: Exposures, each: Sequence[CameraProblem], placed: tuple[Sequence[CalibratedCamera], Array]
) -> dict[str, Block]:
    seen, held = placed
    rows = [problem.blocks[camera.TARGET] for problem in each]
    counts = np.array([np.bincount(problem.sighted.target, minlength=len(rows[0].members)) for problem in each])
    points = np.array([row.values for row in rows])[counts.argmax(axis=0), np.arange(counts.shape[1])]
    free = np.any([np.broadcast_to(row.free, row.values.shape) for row in rows], axis=0)
    extent = 2 * float(rows[0].reach.max())
    views = _views(seen, held, 1 if rig == "cmm" else len(exposed.names))
    distance = float(np.median(np.linalg.norm(views[:, :3], axis=1)))
    name, members = camera.view_name(rig), exposed.names if rig != "cmm" else ("",)
    values = poses.inverse(views) if rig == "board" else views
    return {
        camera.LENS: _lenses(exposed.cameras, [problem.blocks[camera.LENS] for problem in each]),
        camera.MOUNT: camera.mount_block(held, exposed.cameras, distance),
        name: camera.view_block(values, members, distance, name, "exposure" if rig != "cmm" else ""),
        camera.TARGET: camera.target_block(points, rows[0].members, free, extent),
    }


def _views(seen: Sequence[CalibratedCamera], held: Array, count: int) -> Array:
    """Return the pose of the first camera in the frame of the targets at each exposure, by the first that sees them."""
    views = np.full((count, 6), np.nan)
    for calibrated, mount in zip(seen, held, strict=True):
        back = poses.inverse(mount)
        new = np.isnan(views[calibrated.exposure, 0])
        at = poses.compose(calibrated.places, np.broadcast_to(back, calibrated.places.shape))
        views[calibrated.exposure[new]] = at[new]
    return views


def _lenses(cameras: Sequence[str], blocks: Sequence[Block]) -> Block:
    """Return the lenses of all cameras as one block; a parameter that a camera lacks is 0 and fixed."""
    named = {name for block in blocks for name in block.columns}
    columns = tuple(name for name in PARAMETERS if name in named)
    values = np.array([[block.named().get(name, 0.0) for name in columns] for block in blocks])
    free = np.array(
        [[name in block.columns and block.free[0, block.column(name)] for name in columns] for block in blocks]
    )
    reach = [max(block.reach[block.column(name)] for block in blocks if name in block.columns) for name in columns]
    return Block(camera.LENS, values, columns, tuple(cameras), free, np.array(reach), noun="camera")


def of_camera(sighted: Sighted, exposed: Exposures, camera: int) -> Sighted:
    """Return the sightings of one camera."""
    mine = exposed.camera == camera
    observations = sighted.observations.selected(mine[sighted.view])
    view = (np.cumsum(mine) - 1)[observations.index["view"]]
    names = tuple(name for name, own in zip(sighted.images, mine, strict=True) if own)
    return replace(sighted, images=names, observations=observations.with_index({"view": view}), warnings=())


def connected(exposed: Exposures) -> list[tuple[int, int]]:
    """Return each camera but the first with the one by which its pose is found, nearer ones first.

    Raises UndeterminedError if a camera has no exposure in common with any that is connected to the first.
    """
    count = len(exposed.cameras)
    there = [exposed.exposure[exposed.camera == number] for number in range(count)]
    shared = np.array([[len(np.intersect1d(exposures, other)) for other in there] for exposures in there])
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
