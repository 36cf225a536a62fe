"""A calibrated camera, or several, as input of an alignment: lens, pose in the taper, and their joint covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group, joint_prior
from metrocli.arrays import Array
from metrocli.effects.links.lens_shape import SHAPE, Knots, KnownShape, LensShape
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.imageset import ImageSet
from metrocli.instruments import spindle_camera as spindle
from metrocli.instruments.camera import LENS, MOUNT, TAPER, mount_block
from metrocli.instruments.lenses.lens import PARAMETERS, focal
from metrocli.result import Result
from metrocli.tasks.shared.images.calibrated import DIRECTIONS, SHAPE_COVARIANCE, StatedCamera, stated_cameras
from metrocli.tasks.shared.images.exposures import Exposures, exposures
from metrocli.tasks.shared.images.settings import (
    CalibratedLens,
    CameraFile,
    CameraOfRig,
    Extrinsics,
    OfCameraFile,
    StatedShape,
)
from metrocli.words import in_a_row

_UNNAMED = 'the calibration does not state which images {} take: write `cameras: {{{}: "NAME*.png", ...}}`'


@dataclass(frozen=True)
class CameraModel:
    """A calibrated camera in a taper, or several that are fixed to each other, of which the first is in the taper."""

    cameras: tuple[StatedCamera, ...]
    taper: Array
    """Pose of the camera, or of the first, in the taper (6,)"""
    entries: tuple[tuple[str, str], ...] = ()
    """Camera and estimate (lens parameter, or x y z alpha beta gamma) of each row of the covariance"""
    covariance: Array | None = None
    """None: the camera is exact"""
    directions: Array | None = None
    """D (coefficients, k) of what is not known of the shape of a lens, `D w`; None without a shape"""
    warnings: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the cameras; that of a single one is empty."""
        return tuple(camera.name for camera in self.cameras)

    @property
    def several(self) -> bool:
        """Whether several cameras are fixed to each other."""
        return len(self.cameras) > 1

    @property
    def sizes(self) -> Array:
        """Width and height [px] of the images of each camera, (cameras, 2)."""
        return np.array([camera.size for camera in self.cameras], dtype=float)

    @property
    def mounts(self) -> Array:
        """The pose of each camera in the frame of the first, (cameras, 6)."""
        return np.stack([np.zeros(6) if camera.pose is None else camera.pose for camera in self.cameras])

    @property
    def in_taper(self) -> Array:
        """The pose of each camera in the taper, (cameras, 6)."""
        return np.stack([self.taper, *(poses.compose(self.taper, mount) for mount in self.mounts[1:])])

    @property
    def images(self) -> dict[str, str]:
        """The names of the images of each camera, with one *."""
        return {camera.name: camera.images for camera in self.cameras}

    def exposed(self, images: Sequence[str]) -> Exposures:
        """Return the camera and the exposure of each image; raises InputError for images of no camera or of two."""
        return exposures(self.images, images)

    def with_images(self, images: Mapping[str, str] | None) -> CameraModel:
        """Return the model with these names of images, by camera; cameras that are not named take none.

        Raises InputError for a camera that is not known, and if nothing states the names.
        """
        if images is None:
            if not any(self.images.values()):
                raise InputError(_UNNAMED.format(in_a_row(self.names), self.names[0]))
            return self
        if not self.several:
            raise InputError("cameras: the calibration is of a single camera, which took all images: leave it out")
        if strange := [name for name in images if name not in self.names]:
            message = f"cameras: the calibration has no {in_a_row(strange)}"
            raise InputError([Fault(message, hint=f"it has {in_a_row(self.names)}")])
        named = tuple(replace(camera, images=images.get(camera.name, "")) for camera in self.cameras)
        return replace(self, cameras=named)

    def must_fit(self, images: ImageSet) -> None:
        """Raise InputError if the images do not have the size with which their camera was calibrated."""
        exposed = self.exposed(images.names)
        for number, camera in enumerate(self.cameras):
            own = [name for name, by in zip(images.names, exposed.camera, strict=True) if by == number]
            if own and images.size_of(own) != tuple(camera.size):
                (width, height), (w, h) = images.size_of(own), camera.size
                of = f"the camera {camera.name}".rstrip()
                raise InputError(f"the images are {width} x {height} px, {of} was calibrated with {w} x {h} px")

    def blocks(self) -> dict[str, Block]:
        """Return the blocks of lens, taper and, for several, mount; free if the calibration gives their covariance."""
        named = {name for camera in self.cameras for name in camera.lens}
        # the effect radial-distortion needs k1, even if the calibration has none
        columns = tuple(name for name in PARAMETERS if name in named or name == "k1")
        values = np.array([[camera.lens.get(name, 0.0) for name in columns] for camera in self.cameras])
        free = np.array([[(camera, name) in self.entries for name in columns] for camera in self.names])
        placed = np.array((self.names[0], "x") in self.entries)
        made = [
            Block(LENS, values, columns, self.names, free, noun="camera"),
            Block(TAPER, self.taper[None], poses.COLUMNS, free=placed, space=Space.POSE),
            *([self._mounts()] if self.several else []),
        ]
        return {block.name: block for block in (*made, *self._shape_block())}

    def _mounts(self) -> Block:
        """Return the block of the poses of several cameras, fixed if they are given without uncertainty."""
        block = mount_block(self.mounts, self.names, np.inf)
        known = np.array([[(name, key) in self.entries for key in poses.EULER] for name in self.names])
        return replace(block, free=block.free & known)

    def _shape_block(self) -> list[Block]:
        """Return the block of the shape of a lens: the shift that is known, once, and what is not known of it."""
        if self.directions is None:
            return []
        values = np.eye(1, 1 + self.directions.shape[1])
        columns = ("known", *(f"w{k}" for k in range(1, values.shape[1])))
        return [Block(SHAPE, values, columns, free=values == 0)]

    def chain(self, spread: Array | None = None) -> Chain:
        """Return the forward model of an image point; `spread` as for `spindle_camera.chain`."""
        whole = spindle.chain(*(camera.convention for camera in self.cameras), spread=spread)
        shape = self.cameras[0].shape
        if shape is None or self.directions is None:
            return whole
        return whole.spliced([LensShape(shape.knots, np.column_stack([shape.coefficients.ravel(), self.directions]))])

    def prior(self) -> list[Group]:
        """Return the calibration as a correlated observation, so that its covariance enters the adjustment.

        The covariance is for Euler angles; the adjustment needs it for its rotation steps.
        """
        if self.covariance is None:
            return []
        blocks, to_step = self.blocks(), np.eye(len(self.covariance))
        for name, pose in zip(self.names, [self.taper, *self.mounts[1:]], strict=True):
            at = [i for i, (of, entry) in enumerate(self.entries) if of == name and entry in poses.EULER]
            if at:
                to_step[np.ix_(at, at)] = np.linalg.inv(poses.euler_form_by_step(pose))
        placed = [self._place(blocks, *entry) for entry in self.entries]
        rows = [[i for i, (block, _, _) in enumerate(placed) if block == name] for name in blocks]
        order = [i for of_block in rows for i in of_block]
        parts = [
            (blocks[name], np.array([placed[i][1] for i in chosen]), np.array([placed[i][2] for i in chosen]))
            for name, chosen in zip(blocks, rows, strict=True)
            if chosen
        ]
        return [joint_prior(parts, (to_step @ self.covariance @ to_step.T)[np.ix_(order, order)])]

    def _place(self, blocks: Mapping[str, Block], camera: str, name: str) -> tuple[str, int, int]:
        """Return block, member and column of an entry."""
        number = self.names.index(camera)
        if name in poses.EULER:
            return MOUNT if number else TAPER, number, poses.EULER.index(name)
        block = LENS if name in blocks[LENS].columns else SHAPE
        return block, number, blocks[block].column(name)


def camera_of(source: Result | CameraFile, more: OfCameraFile | None = None) -> CameraModel:
    """Return the camera of a calibration result or of a YAML file; raises InputError without its pose in the taper."""
    if isinstance(source, CameraFile):
        return camera_of_file(source, more or OfCameraFile())
    if more is not None:
        raise InputError("camera: the result of calibrate-camera states its place and its covariance: leave it out")
    return camera_of_result(source)


def camera_of_file(file: CameraFile, more: OfCameraFile) -> CameraModel:
    """Return the camera of a YAML file, exact but for the job's uncertainties; raises InputError without extrinsics."""
    e = more.extrinsics or file.extrinsics
    if e is None:
        raise InputError(
            "the camera file has no extrinsics, the pose of the camera in the taper: "
            "e.g. camera: {extrinsics: {x: -2.1 mm, y: .., z: .., alpha: -0.003 rad, ..}}"
        )
    std = {name: value for name, value in vars(more.uncertainty).items() if value} if more.uncertainty else {}
    cameras, entries = list[StatedCamera](), list[tuple[str, str]]()
    each: Mapping[str, CalibratedLens] = file.cameras or {"": file}
    # the lenses of several cameras share their parameters
    apart = any(camera.fx is not None for camera in each.values())
    for name, camera in each.items():
        width, height = camera.image_size
        given = {"cx": (width - 1) / 2, "cy": (height - 1) / 2, **camera.given()}
        if apart and "f" in given:
            given["fx"], given["fy"] = focal(given)
            del given["f"]
        lens = {key: given[key] for key in PARAMETERS if key in given}
        if strange := [key for key in std if key in ("f", "fx", "fy") and key not in lens]:
            raise InputError(f"camera: uncertainty: the camera file has no {' '.join(strange)}")
        lens = {key: lens.get(key, 0.0) for key in PARAMETERS if key in lens or key in std}
        entries += [(name, key) for key in (*lens, *(() if cameras else poses.EULER)) if key in std]
        pose = _pose(camera.pose) if isinstance(camera, CameraOfRig) and camera.pose else None
        shape = None if camera.shape is None else _shape(camera.image_size, camera.shape)
        images = "" if name else "*"
        cameras.append(StatedCamera(name, lens, camera.convention, camera.image_size, images, pose, shape))
    ordered = [std[key] for _, key in entries]
    exact = (
        f"the camera file of {file.program} states no covariance: it counts as exact; "
        "camera: {uncertainty: {f: 1 px, ...}} gives its standard uncertainties",
    )
    covariance = np.diag(ordered) ** 2 if ordered else None
    warnings = exact if file.program and not ordered else ()
    known = cameras[0].shape
    exactly = None if known is None else np.zeros((known.coefficients.size, 0))
    return CameraModel(tuple(cameras), _pose(e), tuple(entries), covariance, exactly, warnings)


def _shape(size: tuple[int, int], stated: StatedShape) -> KnownShape:
    return KnownShape(Knots(size, stated.knots), np.array([stated.du, stated.dv]))


def _pose(e: Extrinsics) -> Array:
    return poses.pose_from_euler(np.array([e.x, e.y, e.z]), np.array([e.alpha, e.beta, e.gamma]))


def camera_of_result(result: Result) -> CameraModel:
    """Return the camera of a calibration result, or its cameras, with their covariance.

    Raises InputError unless its rig is cmm, and for a lens whose shape has no covariance.
    """
    if result.statistics.get("rig") != "cmm":
        raise InputError(
            f"the camera was calibrated with rig {result.statistics.get('rig')}; "
            "only rig cmm determines its place in the taper"
        )
    estimated = {estimate.name: (row, estimate.value) for row, estimate in enumerate(result.estimates)}
    cameras, entries, rows = tuple(stated_cameras(result)), list[tuple[str, str]](), list[int]()
    first, *_ = prefixes = [f"{camera.name}." if camera.name else "" for camera in cameras]
    for camera, prefix in zip(cameras, prefixes, strict=True):
        known = [key for key in (*camera.lens, *poses.EULER) if prefix + key in estimated]
        entries += [(camera.name, key) for key in known]
        rows += [estimated[prefix + key][0] for key in known]
    at, covariance = np.array([estimated[first + key][1] for key in poses.EULER]), result.covariance
    directions = result.arrays.get(DIRECTIONS)
    if directions is None and any(camera.shape is not None for camera in cameras):
        raise InputError("the result does not state how uncertain the shape of the lens is: calibrate the camera anew")
    if directions is not None:
        covariance, shape = result.arrays[SHAPE_COVARIANCE], range(directions.shape[1])
        entries += [("", f"w{k + 1}") for k in shape]
        rows += [len(covariance) - len(shape) + k for k in shape]
    taper = poses.pose_from_euler(at[:3], at[3:])
    return CameraModel(cameras, taper, tuple(entries), covariance[np.ix_(rows, rows)], directions)
