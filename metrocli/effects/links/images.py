"""Effects on image points: changes of the lens, and the eccentricity of circular targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace

import numpy as np

from metrocli.adjust.model.chain import Chain, LinkContext, Step
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class LensChange(OfBlock):
    """Lens parameters p change to `p (1 + m c)` or `p + a c`, c = 1 or a condition of the readings.

    m, a are the columns of its own block.
    """

    multiplied: tuple[tuple[str, ...], ...] = ()
    """For each column m: names of the lens parameters that it multiplies"""
    added: tuple[tuple[str, ...], ...] = ()
    """For each column a: names of the lens parameters to which it is added"""
    condition: str = ""
    """Name of the condition c; empty for c = 1"""
    varies: str = "lens"
    """Block of the lens"""
    takes = gives = Quantity.PARAMETERS

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the lens parameters for each reading (size, n), with derivatives by the input and its own block."""
        names, theta = local.blocks[self.varies].columns, local.rows(self.block)
        passed = local.observations.conditions[self.condition] if self.condition else np.ones(value.shape[1])
        changed = value.copy()
        by_value = np.repeat(np.eye(len(names))[:, :, None], value.shape[1], axis=2)
        by_own = np.zeros((len(names), len(theta), value.shape[1]))
        for place, name in enumerate(names):
            for column, chosen in enumerate(self.multiplied):
                if name in chosen:
                    by_own[place, column] = value[place] * passed
                    by_value[place, place] += theta[column] * passed
            for column, chosen in enumerate(self.added):
                if name in chosen:
                    by_own[place, column] = passed
            changed[place] += (by_own[place] * theta).sum(axis=0)
        return Step(changed, by_value, {self.block: by_own})


@dataclass(frozen=True)
class TargetEccentricity(OfBlock):
    """The point whose image is the centre of the ellipse, `X - k r^2 / Z (e_z - n_z n)`; column k [1] or k r^2 [mm2].

    A circle of radius r about X with normal n is the image of the unit circle under the matrix (r e1, r e2, X). This
    matrix sends one line to infinity. The image of the pole of that line is the centre of the ellipse in the plane
    Z = 1. k = 1 is the full effect.
    """

    radius: str = "radius"
    """Condition that is the radius r; empty where the column is an area, `k r^2`"""
    before: Chain = field(default_factory=lambda: Chain(()))
    """Links from the target to the camera"""
    targets: str = "target"
    """Block of the targets; circles lie in planes z = const of its frame"""
    takes = gives = Quantity.POINT_IN_CAMERA

    @property
    def blocks(self) -> tuple[str, ...]:
        """The blocks that orient the target's plane, and its own block."""
        return (*self.before.blocks, self.block)

    def within(self, before: Chain) -> TargetEccentricity:
        """Return the effect as it acts behind these links."""
        return replace(self, before=before)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n), with derivatives by the point, the factor and the blocks that orient the normal."""
        normal, turns = self._normal(local)
        factor = local.rows(self.block)[0]
        area = np.nan_to_num(local.observations.conditions[self.radius]) ** 2 if self.radius else 1.0
        share = area / value[2]
        away = -normal[2] * normal
        away[2] += 1
        by_point = np.repeat(np.eye(3)[:, :, None], value.shape[1], axis=2)
        by_point[:, 2] += factor * share / value[2] * away
        by_block = {name: _along_normal(normal, turn) * (factor * share) for name, turn in turns.items()}
        return Step(value - factor * share * away, by_point, {**by_block, self.block: (-share * away)[:, None]})

    def _normal(self, local: LinkContext) -> tuple[Array, Mapping[str, Array]]:
        """Return the normal of the target's plane in the camera (3, n), with derivatives by the blocks before.

        It is the difference of two points 1 mm apart along the normal: exact, since the links before are rigid motions.
        """
        block, wanted = local.blocks[self.targets], local.wanted.intersection(self.before.blocks)
        above = {**local.blocks, self.targets: block.with_values(block.values + np.array([0.0, 0.0, 1.0]))}
        low, high = (self.before.steps(blocks, local.observations, wanted) for blocks in (local.blocks, above))
        flat, raised = (self.before.derivatives(steps, wanted) for steps in (low, high))
        return high[-1].value - low[-1].value, {name: raised[name] - flat[name] for name in raised}


def _along_normal(normal: Array, by_block: Array) -> Array:
    """Return the derivative of `n_z n`, (3, size, n), from that of n."""
    turned: Array = normal[2] * by_block + normal[:, None] * by_block[2][None]
    return turned
