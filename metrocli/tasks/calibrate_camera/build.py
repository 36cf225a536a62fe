"""From settings and readings of a camera to blocks and groups with starting values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, priors
from metrocli.adjust.robust import typical
from metrocli.arrays import Array, Index
from metrocli.effects.model import Model, Place
from metrocli.errors import InputError
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments.camera_start import TargetImages, plane_frame, start
from metrocli.instruments.fisheye_start import start_of_fisheye
from metrocli.instruments.lenses.distortion import DISTORTION, PRISM, RATIONAL, TILT, undistort
from metrocli.instruments.lenses.lens import plane_point
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.image_groups import with_groups
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.readings import check_targets, readings, scale_bars
from metrocli.tasks.calibrate_camera.settings import CameraSettings
from metrocli.tasks.calibrate_camera.starts import better_poses, robustly, without_strays
from metrocli.tasks.shared.images.adjustment import IMAGES
from metrocli.tasks.shared.images.eccentricity import corrected
from metrocli.tasks.shared.images.sightings import Sighted, check_inside, placed
from metrocli.tasks.shared.images.target_list import TargetCoordinates, images_needed
from metrocli.words import listed

_GUESSES = (1.0, 0.5, 2.0, 4.0, 8.0)
"""Focal lengths to try, in units of the longer side of the image, if the start from the views fails"""
_LOST = 0.02
"""A median residual above this share of the longer side of the image means that the start failed"""
_STEPS = 1000
"""Most steps to the values from which a lens with rational and prism terms starts"""


def build(rig: str, settings: CameraSettings, sighted: Sighted, bars: Table | None = None) -> CameraProblem:
    """Return the adjustment with its starting values, found from the readings alone.

    Raises InputError if readings do not fit the image size or the list of targets, and UndeterminedError if the
    targets cannot determine a pose.
    """
    size = settings.image_size
    if size is None:
        raise InputError("camera: image_size is missing; give the width and height of the images, e.g. [2592, 1944]")
    sighted = check_inside(sighted, np.array(size)[:, None])
    sighted = placed(sighted, needed(rig, sighted.targets))
    check_targets(rig, sighted)
    targets = sighted.targets
    values = _lens_values(settings, size)
    focal, views = _start(rig, settings.convention, sighted, values, size)
    for name in ("f", "fx", "fy"):
        if name in values and name not in settings.given():
            values[name] = focal
    extent = float(np.ptp(targets.points[np.unique(sighted.target)], axis=0).max())
    seen = np.bincount(sighted.target, minlength=len(targets.names))
    free = (targets.sigma != 0) & (seen > 0)[:, None]
    distance = float(np.median(np.linalg.norm(views[:, :3], axis=1)))
    images: tuple[str, ...] = sighted.images if rig != "cmm" else ("",)
    blocks = {
        camera.LENS: camera.lens_block(values, settings.estimate, size),
        camera.view_name(rig): camera.view_block(
            views, images, distance, camera.view_name(rig), "image" if rig != "cmm" else ""
        ),
        camera.TARGET: camera.target_block(targets.points, targets.names, free, extent),
    }
    group = Group(IMAGES, camera.chain(rig, settings.convention), readings(sighted, rig))
    others = (*priors(blocks[camera.TARGET], targets.sigma, free), *scale_bars(bars, targets.names, seen))
    datum = target_datum(rig, blocks[camera.TARGET]) if free.any() else None
    places = {"image": Place(sighted.images, "view"), "target": Place(targets.names, camera.TARGET)}
    nominal = {camera.TARGET: targets.points}
    model = Model(blocks, (group, *others), datum, (IMAGES,), places, nominal=nominal)
    problem = CameraProblem(model, rig, settings.convention, size, sighted)
    started = _better_start(problem, settings)
    started = started.with_model(with_groups(started.model, rig))
    if not sighted.eccentric:
        return started
    group, consistent = corrected(started.images, started.blocks, started.others, datum, targets.radius)
    return started.with_model(started.model.with_group(group).with_blocks(consistent))


def needed(rig: str, targets: TargetCoordinates) -> Index:
    """Return the fewest images that place each target, (targets,)."""
    return np.maximum(images_needed(targets), 2 if rig == "network" else 1)


def target_datum(rig: str, targets: Block, several: bool = False) -> Datum | None:
    """Return the inner constraints on the unknown targets; None with rig cmm, whose reference frame is theirs."""
    takes_part = np.broadcast_to(targets.free, targets.values.shape).any(axis=1).astype(float)
    if rig == "board":
        return camera.list_datum(targets, takes_part, camera.VIEW, scale=True)
    return camera.network_datum(targets, takes_part, several) if rig == "network" else None


def _lens_values(settings: CameraSettings, size: tuple[int, int]) -> dict[str, float]:
    given = settings.given()
    wanted = set(settings.estimate) | set(given)
    values: dict[str, float] = {}
    for name in ("f", "aspect", "fx", "fy", "cx", "cy", "skew", *DISTORTION):
        if name in wanted or name in ("cx", "cy") or (name == "f" and not wanted & {"fx", "fy"}):
            values[name] = given.get(name, 0.0)
    for name, extent in (("cx", size[0]), ("cy", size[1])):
        values[name] = given.get(name, (extent - 1) / 2)
    return values


def _start(
    rig: str, convention: str, sighted: Sighted, values: Mapping[str, float], size: Sequence[int]
) -> tuple[float, Array]:
    known = values.get("f") or values.get("fx") or None
    centre = np.array([values["cx"], values["cy"]])
    uv = sighted.observations.readings
    view, views = (np.zeros_like(sighted.view), 1) if rig == "cmm" else (sighted.view, len(sighted.images))
    if convention == "fisheye":
        scene = TargetImages(sighted.targets.points, uv, sighted.target, view, views)
        focal, started = start_of_fisheye(scene, values, known, float(max(size)))
        return focal, started if rig == "board" else poses.inverse(started)
    if known and any(values.get(name) for name in DISTORTION):
        x, y = undistort(*plane_point(values, uv[0], uv[1]), values)
        uv = np.nan_to_num(np.stack([x * known + centre[0], y * known + centre[1]]))
    scene = TargetImages(sighted.targets.points, uv, sighted.target, view, views)
    focal, started = start(scene, centre, known, float(max(size)))
    return focal, started if rig == "board" else poses.inverse(started)


def _better_start(problem: CameraProblem, settings: CameraSettings) -> CameraProblem:
    """Return the problem at a start that fits the readings.

    If the first start ends far from the readings, other focal lengths are tried. Rational and prism terms come last,
    in steps: a richer model starts from the solution of the simpler one that it contains.
    """
    last = PRISM if problem.convention == "fisheye" else (*RATIONAL, *PRISM)
    simple = [name for name in settings.estimate if name not in (*last, *TILT)]
    best = robustly(problem.with_estimate(simple))
    if "f" not in settings.given() and "fx" not in settings.given():
        for guess in _GUESSES:
            if _misfit(best) < (False, _LOST * max(problem.image_size)):
                break
            retried = _retried(problem, guess * max(problem.image_size))
            attempt = robustly(retried.with_estimate(simple))
            best = min(best, attempt, key=_misfit)
    best = _unmirrored(without_strays(problem.blocks[camera.TARGET].values, best, _resected))
    if set(RATIONAL) & set(settings.estimate) and set(PRISM) & set(settings.estimate):
        best = _roughly(best.with_estimate([name for name in settings.estimate if name not in PRISM]))
    return best.with_estimate(settings.estimate)


def robustly_started(problem: CameraProblem, settings: CameraSettings) -> bool:
    """Return whether the values of a built problem come from a robust start with all its unknowns and readings."""
    richer = {*(() if problem.convention == "fisheye" else RATIONAL), *PRISM, *TILT} & set(settings.estimate)
    return not (richer or problem.effects or problem.sighted.eccentric)


def _unmirrored(problem: CameraProblem) -> CameraProblem:
    """Take the better of the two poses of each view of a flat board; warn of views where neither is better."""
    board = problem.sighted.targets.points[np.unique(problem.sighted.target)]
    frame, planar = plane_frame(board)
    if problem.rig != "board" or not planar:
        return problem
    turned = better_poses(dict(problem.blocks), problem.images, board, poses.rotation_of(frame)[2])
    message = (
        f"the readings do not separate the tilt of {len(turned.undecided)} views from its mirror image "
        f"(the board is small or far away): {listed(turned.undecided)}",
    )
    sighted = replace(problem.sighted, warnings=problem.sighted.warnings + (message if turned.undecided else ()))
    turned_back = problem.with_blocks({**problem.blocks, camera.VIEW: turned.views})
    return replace(turned_back, sighted=sighted)


def _roughly(problem: CameraProblem) -> CameraProblem:
    """Adjust all readings with their declared weights, without a covariance."""
    control = StoppingRule(limit=_STEPS, covariance=False)
    solution = adjust(problem.blocks.values(), [problem.images, *problem.others], problem.datum, control)
    return problem.with_blocks({**problem.blocks, **solution.blocks})


def _misfit(problem: CameraProblem) -> tuple[bool, float]:
    """Return whether some reading cannot be predicted, and the median residual [px], which few gross errors raise."""
    unpredicted = not np.isfinite(problem.images.residuals(problem.blocks)).all()
    return unpredicted, typical(problem.images, problem.blocks)


def _resected(problem: CameraProblem, targets: Array) -> CameraProblem:
    """Return a calibration with its targets at places (n, 3), and with poses found anew by these and its lens."""
    name = camera.view_name(problem.rig)
    sighted = replace(problem.sighted, targets=replace(problem.sighted.targets, points=targets))
    _, views = _start(problem.rig, problem.convention, sighted, problem.blocks[camera.LENS].named(), problem.image_size)
    values = {name: views, camera.TARGET: targets}
    return problem.with_blocks(
        {**problem.blocks, **{key: problem.blocks[key].with_values(value) for key, value in values.items()}}
    )


def _retried(problem: CameraProblem, focal: float) -> CameraProblem:
    """Return the problem at another focal length [px], with poses found anew."""
    lens = problem.blocks[camera.LENS]
    values = {**lens.named(), **{name: focal for name in lens.columns if name in ("f", "fx", "fy")}}
    plain = {**values, **dict.fromkeys(DISTORTION, 0.0)}
    _, views = _start(problem.rig, problem.convention, problem.sighted, plain, problem.image_size)
    name = camera.view_name(problem.rig)
    return problem.with_blocks(
        {
            **problem.blocks,
            camera.LENS: lens.with_values(np.array([list(values.values())])),
            name: problem.blocks[name].with_values(views),
        }
    )
