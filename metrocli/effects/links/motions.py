"""Effects on the axes of a machine: their drives and reversals, and what they carry; and the laser that reads it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Self

import numpy as np

from metrocli.adjust.model.chain import Chain, LinkContext, Step
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.effects.effect import ELAPSED
from metrocli.frozen import dataclass
from metrocli.instruments.axes.error_motion import Undisturbed
from metrocli.instruments.machine import Machine
from metrocli.instruments.machine_path import SINCE, SPEED
from metrocli.instruments.six_dof import ALONG, LINE

AXES, TURNING = "xyz", "abc"
THETA, PLACE = 3, 6
"""First of the angles of an axis among its errors, and of the shifts of its line"""
_ROUNDING = 1e-9
"""Values of a wave below this are rounding of its angle, which may be hundreds of turns"""


@dataclass(frozen=True)
class AxisErrorEffect(OfBlock):
    """A link that adds to the errors of the axes, (9 axes, n); `Machine.row` gives the row of an error."""

    machine: Machine | None = None
    takes = gives = Quantity.AXIS_ERRORS

    def within(self, before: Chain) -> Self:
        """Return the effect for the machine whose axes come before it."""
        machine = next(link.machine for link in before.links if isinstance(link, Undisturbed))
        return replace(self, machine=machine)

    def added(self, value: Array, rows: Sequence[int], size: Array, by_block: Array) -> Step:
        """Return the errors plus sizes (rows, n) in some rows, with derivatives (rows, columns, n) by its own block.

        They have no derivative by the errors: None stands for 1, and saves products of large matrices.
        """
        n = by_block.shape[2]
        total, derivative = (
            np.array(np.broadcast_to(value, (len(value), n))),
            np.zeros((len(value), *by_block.shape[1:])),
        )
        total[list(rows)] += size
        derivative[list(rows)] = by_block
        return Step(total, None, {self.block: derivative})

    def linear(self, value: Array, local: LinkContext, rows: Sequence[int], by_block: Array) -> Step:
        """Return the errors plus `by_block p` in some rows, p the columns of its own block."""
        return self.added(value, rows, np.einsum("rcn,cn->rn", by_block, self.columns(local, by_block)), by_block)

    def columns(self, local: LinkContext, by_block: Array) -> Array:
        """Return the values of its own block at each reading, (columns, n)."""
        return np.broadcast_to(local.rows(self.block), by_block.shape[1:])


@dataclass(frozen=True)
class OnAxis(AxisErrorEffect):
    """An effect on one axis."""

    axis: str = "x"

    def row(self, error: int) -> int:
        """Return the row of an error of the axis, 0 to 8; ValueError outside a chain with axes."""
        return _machine(self.machine).row(self.axis, error)

    @property
    def own(self) -> int:
        """The row of the error of the axis in its own motion: positioning, or the angle of a rotary axis."""
        return self.row(AXES.index(self.axis) if self.axis in AXES else THETA + TURNING.index(self.axis))

    def proportional(self, factor: Array, value: Array, local: LinkContext) -> Step:
        """Return the errors with `p factor` more in the axis' own motion, p the only column of the effect's block."""
        return self.linear(value, local, [self.own], factor[None, None])

    def wave(self, angle: Array, amplitude: Array, value: Array) -> Step:
        """Return the errors with `amplitude sin(angle)` more in the axis' own motion."""
        by_block = np.zeros((1, 3, len(angle)))
        by_block[0, :2] = waves(angle)
        return self.added(value, [self.own], amplitude * by_block[:, 0], by_block)


def waves(angle: Array) -> Array:
    """Return sine and cosine, (2, n), without the rounding of their zeros.

    At equal steps all readings may stand at zeros of a wave, whose rounding would be fitted with any amplitude.
    """
    both = np.stack([np.sin(angle), np.cos(angle)])
    return np.where(np.abs(both) < _ROUNDING, 0.0, both)


def _machine(machine: Machine | None) -> Machine:
    if machine is None:
        raise ValueError("an effect on axes acts within a chain that begins with the axes of a machine")
    return machine


@dataclass(frozen=True)
class Backlash(OnAxis):
    """Backlash: `+width/2` of an axis after a positive move, `-width/2` after a negative; column width [mm, rad]."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        return self.proportional(np.sign(local.observations.conditions[f"from_{self.axis}"]) / 2, value, local)


@dataclass(frozen=True)
class BacklashGrowth(OnAxis):
    """Backlash that grows along the axis: `+-growth pos/2`, pos the commanded position; column growth [1]."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        given = local.observations.conditions
        return self.proportional(np.sign(given[f"from_{self.axis}"]) * given[self.axis] / 2, value, local)


@dataclass(frozen=True)
class ServoLag(OnAxis):
    """Lag behind the command: `-tau v` along an axis, v its speed [mm/s]; column tau [s]."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        return self.proportional(-local.observations.conditions[SPEED.format(axis=self.axis)], value, local)


@dataclass(frozen=True)
class ThermalGrowth(OnAxis):
    """Growth of a scale: `rate t pos` along an axis, pos its commanded position; column rate [1/s]."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        given = local.observations.conditions
        return self.proportional(given[ELAPSED] * given[self.axis], value, local)


@dataclass(frozen=True)
class ScrewPitchError(OnAxis):
    """`amplitude sin(2 pi pos / period + phase)` along an axis; columns amplitude [mm], phase [rad], period [mm].

    Its derivatives are taken along the phasor and across it (`Space.WAVE`), so that an adjustment can start from
    amplitude 0.
    """

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        amplitude, phase, period = local.rows(self.block)
        return self.wave(2 * np.pi * local.observations.conditions[self.axis] / period + phase, amplitude, value)


@dataclass(frozen=True)
class StraightnessReversal(OnAxis):
    """Shift along axis b by the direction of axis a: `+width/2` after a positive move of a, else `-`; width [mm]."""

    shifted: str = "x"
    """Axis b"""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        side = np.sign(local.observations.conditions[f"from_{self.axis}"]) / 2
        return self.linear(value, local, [self.row(AXES.index(self.shifted))], side[None, None])


@dataclass(frozen=True)
class Hysteresis(OnAxis):
    """What backlash lacks behind a turn, while it builds up: `-s width exp(-w/length)`; columns width, length [mm].

    s = +1 after a positive move of the axis, -1 after a negative one; w is its way since it turned.
    """

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        width, length = local.rows(self.block)
        given = local.observations.conditions
        lacking = -np.sign(given[f"from_{self.axis}"]) * np.exp(-given[SINCE.format(axis=self.axis)] / length)
        return self.added(value, [self.own], (width * lacking)[None], np.stack([lacking, np.zeros_like(lacking)])[None])


@dataclass(frozen=True)
class AngularReversal(OnAxis):
    """Tilt of a carriage by its direction: `theta += s r/2`; columns rx, ry, rz of r [rad].

    s = +1 after a positive move of the axis, -1 after a negative one.
    """

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        half = np.sign(local.observations.conditions[f"from_{self.axis}"]) / 2
        return self.linear(value, local, [self.row(THETA + k) for k in range(3)], np.eye(3)[:, :, None] * half)


@dataclass(frozen=True)
class AtBed(AxisErrorEffect):
    """An effect on all that the bed carries towards the tool: on the axis next to the bed."""

    def rows(self, errors: Sequence[int]) -> list[int]:
        """Return rows of errors of the axis next to the bed; ValueError outside a chain with axes."""
        machine = _machine(self.machine)
        return [machine.row(machine.axes[machine.at_bed].letter, error) for error in errors]


@dataclass(frozen=True)
class LoadSag(AtBed):
    """Sag: `dz += c a b`, a and b the commanded positions of two axes; column c [1/mm]."""

    pair: str = "yz"

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        first, second = (local.observations.conditions[axis] for axis in self.pair)
        return self.linear(value, local, self.rows([2]), (first * second)[None, None])


@dataclass(frozen=True)
class MachineDrift(AtBed):
    """The machine drifts against its bed: `d += v t`; columns vx, vy, vz [mm/s]."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        elapsed = local.observations.conditions[ELAPSED]
        return self.linear(value, local, self.rows([0, 1, 2]), np.eye(3)[:, :, None] * elapsed)


@dataclass(frozen=True)
class LineTerm(OfBlock):
    """Error along the line: `d += u p c`, u the direction of the line, c a product of conditions; one column p."""

    conditions: tuple[str, ...]
    others = (LINE,)  # only readings of a laser have this block
    takes = gives = Quantity.ERROR_MOTION

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the motion (6, n)."""
        given = local.observations.conditions
        factor = np.prod([given[name] for name in self.conditions], axis=0)
        by_block = (np.stack([given[name] for name in ALONG]) * factor)[:, None]
        moved, derivative = np.array(np.broadcast_to(value, (6, len(factor)))), np.zeros((6, 1, len(factor)))
        moved[:3] += by_block[:, 0] * local.rows(self.block)
        derivative[:3] = by_block
        return Step(moved, np.eye(6)[:, :, None], {self.block: derivative})


@dataclass(frozen=True)
class ZeroDrift(OfBlock):
    """Drift of the zero of an angle that is read about a rotary axis: `e += rate t`; column rate [rad/s]."""

    others = (LINE,)  # only readings on lines have this block
    takes = gives = Quantity.ANGLE

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the angle (1, n)."""
        elapsed = local.observations.conditions[ELAPSED][None]
        return Step(value + local.rows(self.block) * elapsed, np.ones((1, 1, 1)), {self.block: elapsed[None]})
