"""Effects on the error motion of a machine: its drives, their reversals, and the laser that reads it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.adjust.model.chain import Chain, Local, Step
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.effects.effect import ELAPSED
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import cross_matrix
from metrocli.instruments.machine import POSITION, TOOL, ErrorMotion, Machine, by_errors
from metrocli.instruments.machine_path import SINCE, SPEED
from metrocli.instruments.six_dof import ALONG, LINE

_AS_IT_IS = np.eye(6)[:, :, None]
AXES = "xyz"


@dataclass(frozen=True)
class ErrorMotionEffect(OfBlock):
    """A link that adds a displacement to the error motion, (6, n)."""

    takes = gives = Quantity.ERROR_MOTION

    def moved(self, value: Array, displacement: Array, by_block: Array) -> Step:
        """Return the motion plus a displacement (3, n), which has derivatives (3, size, n) by its own block."""
        total = np.array(np.broadcast_to(value, (6, displacement.shape[1])))
        total[:3] += displacement
        derivative = np.zeros((6, *by_block.shape[1:]))
        derivative[:3] = by_block
        return Step(total, _AS_IT_IS, {self.block: derivative})

    def along(self, axis: str, factor: Array, value: Array, local: Local) -> Step:
        """Return the motion plus `p factor` along an axis; p is the only column of its own block, factor (n,)."""
        by_block = np.zeros((3, 1, len(factor)))
        by_block[AXES.index(axis), 0] = factor
        return self.moved(value, by_block[:, 0] * local.rows(self.block), by_block)


@dataclass(frozen=True)
class Backlash(ErrorMotionEffect):
    """Backlash: `+width/2` along an axis after a positive move, `-width/2` after a negative one; column width [mm]."""

    axis: str

    def step(self, value: Array, local: Local) -> Step:
        """Return the motion (6, n)."""
        return self.along(self.axis, np.sign(local.observations.conditions[f"from_{self.axis}"]) / 2, value, local)


@dataclass(frozen=True)
class BacklashGrowth(ErrorMotionEffect):
    """Backlash that grows along the axis: `+-growth pos/2`, pos the commanded position; column growth [1]."""

    axis: str

    def step(self, value: Array, local: Local) -> Step:
        """Return the motion (6, n)."""
        given = local.observations.conditions
        return self.along(self.axis, np.sign(given[f"from_{self.axis}"]) * given[self.axis] / 2, value, local)


@dataclass(frozen=True)
class ServoLag(ErrorMotionEffect):
    """Lag behind the command: `-tau v` along an axis, v its speed [mm/s]; column tau [s]."""

    axis: str

    def step(self, value: Array, local: Local) -> Step:
        """Return the motion (6, n)."""
        return self.along(self.axis, -local.observations.conditions[SPEED.format(axis=self.axis)], value, local)


@dataclass(frozen=True)
class ThermalGrowth(ErrorMotionEffect):
    """Growth of a scale: `rate t pos` along an axis, pos its commanded position; column rate [1/s]."""

    axis: str

    def step(self, value: Array, local: Local) -> Step:
        """Return the motion (6, n)."""
        given = local.observations.conditions
        return self.along(self.axis, given[ELAPSED] * given[self.axis], value, local)


@dataclass(frozen=True)
class LoadSag(ErrorMotionEffect):
    """Sag: `dz += c a b`, a and b the commanded positions of two axes; column c [1/mm]."""

    pair: str

    def step(self, value: Array, local: Local) -> Step:
        """Return the motion (6, n)."""
        first, second = (local.observations.conditions[axis] for axis in self.pair)
        return self.along("z", first * second, value, local)


@dataclass(frozen=True)
class MachineDrift(ErrorMotionEffect):
    """The machine drifts: `d += v t`; columns vx, vy, vz [mm/s]."""

    def step(self, value: Array, local: Local) -> Step:
        """Return the motion (6, n)."""
        elapsed = local.observations.conditions[ELAPSED]
        by_block = np.eye(3)[:, :, None] * elapsed
        return self.moved(value, local.rows(self.block) * elapsed, by_block)


@dataclass(frozen=True)
class ScrewPitchError(ErrorMotionEffect):
    """`amplitude sin(2 pi pos / period + phase)` along an axis; columns amplitude [mm], phase [rad], period [mm].

    Its derivatives are taken along the phasor and across it (`Space.WAVE`), so that an adjustment can start from
    amplitude 0.
    """

    axis: str

    def step(self, value: Array, local: Local) -> Step:
        """Return the motion (6, n)."""
        amplitude, phase, period = local.rows(self.block)
        angle = 2 * np.pi * local.observations.conditions[self.axis] / period + phase
        row = AXES.index(self.axis)
        by_block = np.zeros((3, 3, len(angle)))
        by_block[row, 0], by_block[row, 1] = np.sin(angle), np.cos(angle)
        displacement = np.zeros((3, len(angle)))
        displacement[row] = amplitude * by_block[row, 0]
        return self.moved(value, displacement, by_block)


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


@dataclass(frozen=True)
class LineTerm(ErrorMotionEffect):
    """Error along the line: `d += u p c`, u the direction of the line, c a product of conditions; one column p."""

    conditions: tuple[str, ...]

    @property
    def blocks(self) -> tuple[str, ...]:
        """The block of lines, which only readings of a laser have, and its own block."""
        return (LINE, self.block)

    def step(self, value: Array, local: Local) -> Step:
        """Return the motion (6, n)."""
        given = local.observations.conditions
        factor = np.prod([given[name] for name in self.conditions], axis=0)
        by_block = (np.stack([given[name] for name in ALONG]) * factor)[:, None]
        return self.moved(value, by_block[:, 0] * local.rows(self.block), by_block)
