"""The camera: blocks and forward models of its three calibrations (board, cmm, network), and of several lenses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.model.chain import Chain, Link, LinkContext, Step
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.adjust.movements import Affine, of_members, of_points
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.frames import FromFrame, PointOf, ToFrame
from metrocli.instruments.lenses.lens import UNITS, Lens, LensBackward

LENS, VIEW, TARGET, TAPER, MOUNT = "lens", "view", "target", "camera", "mount"
"""Blocks: lens parameters, a pose for each image, target coordinates, pose of the camera in the reference frame, and
the pose of each of several cameras in the frame of the first"""

_TURN = 0.5
"""Plausible reach of a rotation [rad], and relative reach of a focal length or a distance."""


def lens_block(values: Mapping[str, float], free: Sequence[str], image_size: Sequence[int]) -> Block:
    """Return the block of lens parameters, (1, k); those in `free` are estimated."""
    reach = []
    for name in values:
        size = float(max(image_size))
        of_focal = {"f": _TURN, "fx": _TURN, "fy": _TURN}.get(name, 0.0) * values[name]
        # distortion has no plausible size of its own: what is left open there shows in the image
        reach.append(of_focal or (size if UNITS.get(name) == "px" else np.inf))
    return Block(
        LENS,
        np.array([list(values.values())]),
        tuple(values),
        free=np.isin(list(values), list(free)),
        reach=np.array(reach),
    )


def view_block(values: Array, images: Sequence[str], distance: float, name: str = VIEW, noun: str = "image") -> Block:
    """Return the block of poses, (images, 6), with a plausible reach of the working distance and half a radian."""
    reach = np.array([_TURN * distance] * 3 + [_TURN] * 3)
    return Block(name, values, poses.COLUMNS, tuple(images), reach=reach, space=Space.POSE, noun=noun)


def target_block(points: Array, names: Sequence[str], free: Array | bool, extent: float) -> Block:
    """Return the block of target coordinates, (targets, 3), with the extent of the targets as plausible reach."""
    return Block(
        TARGET,
        points,
        ("x", "y", "z"),
        tuple(names),
        free=np.asarray(free),
        reach=np.array(_TURN * extent),
        noun="target",
    )


def mount_block(values: Array, cameras: Sequence[str], distance: float) -> Block:
    """Return the block of poses of several cameras in the frame of the first, (cameras, 6), which is fixed."""
    free = np.ones(values.shape, dtype=bool)
    # poses are in the frame of the first camera, whose own pose is the identity
    free[0] = False
    reach = np.array([distance] * 3 + [np.pi] * 3)
    return Block(MOUNT, values, poses.COLUMNS, tuple(cameras), free, reach, Space.POSE, noun="camera")


def lens_link(*conventions: str) -> Link:
    """Return the lens link of the convention of each camera, 'forward', 'backward' or 'fisheye'."""
    links = [
        LensBackward(LENS) if convention == "backward" else Lens(LENS, convention == "fisheye")
        for convention in conventions
    ]
    return links[0] if len(set(conventions)) == 1 else LensOfEach(LENS, tuple(links), MOUNT)


def to_camera(rig: str, several: bool = False) -> tuple[Link, ...]:
    """Return the links from a target to the camera frame.

    For board, the pose of a view transforms from the board to the camera. For cmm and network, the pose is that of the
    camera in the frame of the targets: one for all images (cmm) or one for each (network). Where several cameras are
    fixed to each other, it is the pose of the first, and one more link leads to the camera.
    """
    if rig == "board":
        out = FromFrame(VIEW, Quantity.POINT_ON_BOARD, Quantity.POINT_IN_CAMERA)
        return (PointOf(TARGET, Quantity.POINT_ON_BOARD), *of_first(out, several))
    targets = Quantity.POINT_ON_TARGETS
    into = ToFrame(TAPER if rig == "cmm" else VIEW, targets, Quantity.POINT_IN_CAMERA)
    return (PointOf(TARGET, targets), *of_first(into, several))


def of_first(link: ToFrame | FromFrame, several: bool) -> tuple[Link, ...]:
    """Return the link to a camera, or to the first of several and from there to each."""
    if not several:
        return (link,)
    rig = Quantity.POINT_IN_RIG
    return (replace(link, gives=rig), ToFrame(MOUNT, rig, Quantity.POINT_IN_CAMERA))


def chain(rig: str, *conventions: str) -> Chain:
    """Return the forward model of an image point, of one camera or of several, each with the convention of its lens."""
    return Chain((*to_camera(rig, len(conventions) > 1), lens_link(*conventions)))


def view_name(rig: str) -> str:
    """Return the name of the block of poses for a kind of calibration."""
    return TAPER if rig == "cmm" else VIEW


FREEDOMS = (
    "shift along x",
    "shift along y",
    "shift along z",
    "rotation about x",
    "rotation about y",
    "rotation about z",
    "scale",
)


def list_datum(targets: Block, takes_part: Array, pose: str, scale: bool) -> Datum:
    """Return the inner constraints of an unknown list in a frame whose poses (block `pose`) are unknown, too.

    The list keeps its mean place and rotation, and with `scale` its size. A point `R X + d` stays where it is if X
    moves by `a x X + t`, d by `-R t`, and if R turns by `-R a`. It stays in its direction if X and d grow alike.
    """
    points = of_points(scale)

    def movements(blocks: Mapping[str, Block]) -> dict[str, Array]:
        values = blocks[pose].values
        rotation = poses.rotation_of(values)
        moves = np.zeros((*values.shape, len(points.shift)))
        moves[:, :3, :3] = moves[:, 3:, 3:6] = -rotation
        moves[:, :3, 6:] = values[:, :3, None]
        moved = {TARGET: points.at(blocks[TARGET].values, slice(None)), pose: moves}
        if MOUNT in blocks and scale:
            held = blocks[MOUNT].values
            moved[MOUNT] = np.zeros((*held.shape, len(points.shift)))
            # distances between the cameras grow with the list
            moved[MOUNT][:, :3, 6] = held[:, :3]
        return moved

    return Datum(TARGET, targets.values, takes_part, movements, FREEDOMS[: len(points.shift)])


def network_datum(targets: Block, takes_part: Array, several: bool = False) -> Datum:
    """Return the inner constraints of a free network: the datum targets keep their mean place, rotation and scale.

    Distances between `several` cameras that are fixed to each other grow with the scale.
    """
    points, size = of_points(scale=True), len(poses.COLUMNS)
    movements = {TARGET: points, VIEW: of_members(size, points, turns=slice(3, 6))}
    if several:
        grows = np.zeros((len(FREEDOMS), size, size))
        grows[-1, :3, :3] = np.eye(3)
        movements[MOUNT] = Affine(grows, np.zeros((len(FREEDOMS), size)))
    return Datum(TARGET, targets.values, takes_part, movements, FREEDOMS)


@dataclass(frozen=True)
class LensOfEach(OfBlock):
    """Link to the image of a point in the camera, by the lens of the camera that took it."""

    block: str
    lenses: tuple[Link, ...]
    """The link of each camera"""
    by: str
    """The block with a member for each camera; an effect on the lens may give it other members"""
    takes = Quantity.POINT_IN_CAMERA
    gives = Quantity.IMAGE_POINT

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return (u, v) [px] (2, n), with derivatives by the point (2, 3, n) and the parameters (2, size, n)."""
        # not by the member of the lens: an effect may have given each reading its own (docs/decisions/259)
        camera, member, o = local.index(self.by), local.index(self.block), local.observations
        taken: list[int] = np.unique(camera).tolist()
        if len({self.lenses[number] for number in taken}) == 1:
            return self.lenses[taken[0]].step(value, local)
        n, size = o.count, local.blocks[self.block].size
        uv, by_point, by_lens = np.empty((2, n)), np.zeros((2, 3, n)), np.zeros((2, size, n))
        for lens in dict.fromkeys(self.lenses[number] for number in taken):
            # by equality: cameras of one convention share their link and are taken together
            mine = np.isin(camera, [number for number in taken if self.lenses[number] == lens])
            own = Observations(o.readings[:, mine], o.sigma[:, mine], {self.block: member[mine]})
            step = lens.step(value[:, mine], LinkContext(local.blocks, own, local.wanted))
            uv[:, mine] = step.value
            if step.by_input is not None:
                by_point[:, :, mine] = step.by_input
            if self.block in step.by_block:
                by_lens[:, :, mine] = step.by_block[self.block]
        if not local.wanted:
            return Step(uv)
        return Step(uv, by_point, {self.block: by_lens} if self.block in local.wanted else {})
