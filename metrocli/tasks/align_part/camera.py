"""A calibrated camera as input of an alignment: lens parameters, pose in the taper, and their joint covariance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.groups import Group, joint_prior
from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.imageset import ImageSet
from metrocli.instruments.camera import LENS, TAPER
from metrocli.instruments.lenses.lens import PARAMETERS
from metrocli.result import Result
from metrocli.tasks.shared.images.settings import CameraFile, OfCameraFile


@dataclass(frozen=True)
class CameraModel:
    """A calibrated camera in a taper."""

    lens: Mapping[str, float]
    taper: Array
    """Pose of the camera in the taper (6,)"""
    image_size: tuple[int, int]
    convention: str
    estimated: tuple[str, ...] = ()
    """Lens parameters in the covariance; x y z alpha beta gamma follow them if `placed`"""
    covariance: Array | None = None
    """None: the camera is exact"""
    placed: bool = True
    """Whether the covariance has the pose in the taper"""
    warnings: tuple[str, ...] = ()

    def must_fit(self, images: ImageSet) -> None:
        """Raise InputError if the images do not have the size with which the camera was calibrated."""
        if tuple(images.size) != self.image_size:
            w, h = images.size
            raise InputError(
                f"the images are {w} x {h} px, "
                f"the camera was calibrated with {self.image_size[0]} x {self.image_size[1]} px"
            )

    def blocks(self) -> tuple[Block, Block]:
        """Return the blocks of lens and taper; free if the calibration gives their covariance, else fixed."""
        known = self.covariance is not None
        held = {"k1": 0.0, **self.lens}  # the effect radial-distortion needs k1, even if the calibration has none
        columns, values = tuple(held), np.array([list(held.values())])
        lens = Block(LENS, values, columns, free=np.isin(columns, self.estimated) if known else np.array(False))
        free = np.array(known and self.placed)
        return lens, Block(TAPER, self.taper[None], poses.COLUMNS, free=free, space=Space.POSE)

    def prior(self) -> list[Group]:
        """Return the calibration as a correlated observation, so that its covariance enters the adjustment.

        The covariance is for Euler angles; the adjustment needs it for its rotation steps.
        """
        if self.covariance is None:
            return []
        lens, taper = self.blocks()
        k = len(self.estimated)
        to_step = np.eye(len(self.covariance))
        parts = [(lens, tuple(lens.columns.index(name) for name in self.estimated))]
        if self.placed:
            to_step[k:, k:] = np.linalg.inv(poses.euler_form_by_step(self.taper))
            parts.append((taper, tuple(range(6))))
        blocks, columns = zip(*((block, chosen) for block, chosen in parts if chosen), strict=True)
        return [joint_prior(blocks, columns, to_step @ self.covariance @ to_step.T)]


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
    width, height = file.image_size
    given = {"cx": (width - 1) / 2, "cy": (height - 1) / 2, **file.given()}
    lens = {name: given[name] for name in PARAMETERS if name in given}
    std = {name: value for name, value in vars(more.uncertainty).items() if value} if more.uncertainty else {}
    if strange := [name for name in std if name in ("f", "fx", "fy") and name not in lens]:
        raise InputError(f"camera: uncertainty: the camera file has no {' '.join(strange)}")
    taper = poses.pose_from_euler(np.array([e.x, e.y, e.z]), np.array([e.alpha, e.beta, e.gamma]))
    of_lens = {name: value for name, value in std.items() if name in PARAMETERS}
    lens = {name: lens.get(name, 0.0) for name in PARAMETERS if name in lens or name in of_lens}
    ordered = [*(std[name] for name in lens if name in std), *(std[name] for name in poses.EULER if name in std)]
    exact = (
        f"the camera file of {file.program} states no covariance: it counts as exact; "
        "camera: {uncertainty: {f: 1 px, ...}} gives its standard uncertainties",
    )
    return CameraModel(
        lens,
        taper,
        file.image_size,
        file.convention,
        tuple(name for name in lens if name in std),
        np.diag(ordered) ** 2 if ordered else None,
        "x" in std,
        exact if file.program and not ordered else (),
    )


def camera_of_result(result: Result) -> CameraModel:
    """Return the camera of a calibration result, with its covariance; raises InputError unless its rig is cmm."""
    if result.statistics.get("rig") != "cmm":
        raise InputError(
            f"the camera was calibrated with rig {result.statistics.get('rig')}; "
            "only rig cmm determines its place in the taper"
        )
    if "cameras" in result.tables:
        raise InputError("align-part reads a single camera: calibrate the one in the spindle with `camera:`")
    if "lens_shape" in result.tables:
        raise InputError(
            "align-part reads no camera of the model spline: calibrate it with the model opencv or fisheye"
        )
    table = result.tables["camera"]
    lens = dict(zip(table.texts("parameter"), table.numbers("value").tolist(), strict=True))
    values = {estimate.name: estimate.value for estimate in result.estimates}
    at = np.array([values[name] for name in poses.EULER])
    size = (int(_number(result, "image_width")), int(_number(result, "image_height")))
    estimated = tuple(name for name in values if name in lens)
    delivered = len(estimated) + len(poses.EULER)
    return CameraModel(
        lens,
        poses.pose_from_euler(at[:3], at[3:]),
        size,
        str(result.statistics["convention"]),
        estimated,
        result.covariance[:delivered, :delivered],
    )


def _number(result: Result, name: str) -> float:
    value = result.statistics[name]
    if isinstance(value, (int, float)):
        return float(value)
    raise InputError(f"the camera result has no number '{name}' among its statistics")
