"""Effects of a reversal on the error motion of a machine: along the axis that turned, across it, and on its angles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.chain import Chain, Local, Step
from metrocli.effects.links.motions import AXES, ErrorMotionEffect
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import cross_matrix
from metrocli.instruments.machine import POSITION, TOOL, ErrorMotion, Machine, by_errors
from metrocli.instruments.machine_path import SINCE


@dataclass(frozen=True)
class StraightnessReversal(ErrorMotionEffect):
    """Shift along axis b by the direction of axis a: `+width/2` after a positive move of a, else `-`; width [mm]."""

    turned: str
    """Axis a"""
    shifted: str
    """Axis b"""

    def step(self, value: Array, local: Local) -> Step:
        """Return the motion (6, n)."""
        side = np.sign(local.observations.conditions[f"from_{self.turned}"])
        return self.along(self.shifted, side / 2, value, local)


@dataclass(frozen=True)
class Hysteresis(ErrorMotionEffect):
    """What backlash lacks behind a turn, while it builds up: `-s width exp(-w/length)`; columns width, length [mm].

    s = +1 after a positive move of the axis, -1 after a negative one; w is its way since it turned.
    """

    axis: str

    def step(self, value: Array, local: Local) -> Step:
        """Return the motion (6, n)."""
        width, length = local.rows(self.block)
        given = local.observations.conditions
        lacking = np.exp(-given[SINCE.format(axis=self.axis)] / length)
        by_block = np.zeros((3, 2, len(lacking)))
        by_block[AXES.index(self.axis), 0] = -np.sign(given[f"from_{self.axis}"]) * lacking
        return self.moved(value, by_block[:, 0] * width, by_block)


@dataclass(frozen=True)
class AngularReversal(ErrorMotionEffect):
    """Tilt of a carriage by its direction: `theta += s r/2, d += s r/2 x L`; columns rx, ry, rz of r [rad].

    s = +1 after a positive move of the axis, -1 after a negative one; L is the lever of the axis.
    """

    axis: str
    machine: Machine | None = None

    @property
    def blocks(self) -> tuple[str, ...]:
        """The tool vectors, which are part of the lever, and its own block."""
        return (TOOL, self.block)

    def within(self, before: Chain) -> AngularReversal:
        """Return the effect for the machine whose error motion comes before it."""
        return replace(self, machine=next(link.machine for link in before.links if isinstance(link, ErrorMotion)))

    def step(self, value: Array, local: Local) -> Step:
        """Return the motion (6, n)."""
        if self.machine is None:
            raise ValueError("AngularReversal acts within a chain that begins with an error motion")
        given, angles = local.observations.conditions, local.rows(self.block)
        half = np.sign(given[f"from_{self.axis}"]) / 2
        lever = self.machine.lever(
            AXES.index(self.axis), np.stack([given[name] for name in POSITION]), local.rows(TOOL)
        )
        by_block = by_errors(lever)[:, 3:] * half
        by_tool = np.zeros((6, 3, len(half)))
        by_tool[:3] = np.moveaxis(cross_matrix((half * angles).T), 0, -1)
        moved = value + (by_block * angles).sum(axis=1)
        return Step(moved, np.eye(6)[:, :, None], {TOOL: by_tool, self.block: by_block})
