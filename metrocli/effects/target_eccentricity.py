"""The image of a circle's centre is not the centre of the circle's image: perspective moves the ellipse's centre."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrocli.adjust.blocks import Array, Block
from metrocli.adjust.chain import Chain, Link, Local, Step, through
from metrocli.adjust.quantities import Quantity
from metrocli.instruments.frames import PointOf

NAME = "target-eccentricity"


def block(factor: float = 1.0) -> Block:
    """Return the factor on the effect, 1 in full and 0 for none, fixed."""
    return Block(NAME, np.array([[factor]]), ("factor",), free=np.array(False))


@dataclass(frozen=True)
class TargetEccentricity:
    """Replaces a target's centre P by the point whose image is the centre of the circle's image.

    A circle of radius r with normal n has the dual conic `P P' - r^2 (I - n n')` in the plane Z = 1, so the centre of its
    ellipse is the image of `P - r^2 (e_z - n n_z) / Z`: exact for any tilt. The normal is carried by `tip`, the chain
    that takes the end of the target's normal into the camera.
    """

    tip: Chain
    """From the target's centre plus its unit normal to the camera"""
    takes = gives = Quantity.POINT_IN_CAMERA

    @property
    def blocks(self) -> tuple[str, ...]:
        """The factor, and the poses that turn the normal."""
        return (NAME, *self.tip.blocks)

    def step(self, value: Array, local: Local) -> Step:
        """Return the moved point (3, n) with derivatives by the point, the factor and the poses; needs `radius` [mm] of each reading."""
        wanted = local.wanted.intersection(self.tip.blocks)
        steps = self.tip.steps(local.blocks, local.observations, wanted)
        normal = steps[-1].value - value
        z, up = value[2], normal[2]
        strength = np.nan_to_num(local.observations.conditions["radius"]) ** 2 / z
        factor = local.rows(NAME)[0]
        across = -normal * up
        across[2] += 1.0
        shift = across * strength
        by_normal = np.eye(3)[:, :, None] * up
        by_normal[:, 2] += normal
        by_normal = by_normal * strength * factor
        by_point = np.eye(3)[:, :, None] - by_normal
        by_point[:, 2] += shift * factor / z
        by_block = {name: through(by_normal, inner) for name, inner in self.tip.derivatives(steps, wanted).items()}
        if NAME in local.wanted:
            by_block[NAME] = -shift[:, None]
        return Step(value - factor * shift, by_point, by_block)


def link(to_camera: tuple[Link, ...]) -> TargetEccentricity:
    """Return the effect for a chain that begins with these links: the circles lie in z = const of the targets' frame."""
    first = to_camera[0]
    if not isinstance(first, PointOf):
        raise ValueError("the chain does not begin with the targets' points")
    return TargetEccentricity(Chain((PointOf(first.block, first.gives, (0.0, 0.0, 1.0)), *to_camera[1:])))
