"""Effects on the rotary axes of a machine: their worms, encoders and bearings, and what a crash leaves."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.effects.effect import ELAPSED
from metrocli.effects.links.motions import PLACE, THETA, TURNING, OnAxis, waves
from metrocli.frozen import dataclass
from metrocli.instruments.axes.kinematics import ON_WORKPIECE
from metrocli.instruments.axes.rotary import ANGLE


def _angle(axis: str, local: LinkContext) -> Array:
    """Return the commanded angle of an axis at each reading [rad]."""
    return local.observations.conditions[ANGLE.format(axis=axis)]


def _step(local: LinkContext, at: Array) -> Array:
    """Return 1 for readings from the time `at` on, else 0."""
    return (local.observations.conditions["t"] >= at).astype(float)


@dataclass(frozen=True)
class WormError(OnAxis):
    """`amplitude sin(periods s + phase)` in the angle of an axis; columns amplitude, phase [rad], periods [1 a turn].

    Its derivatives are taken along the phasor and across it (`Space.WAVE`).
    """

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        amplitude, phase, periods = local.rows(self.block)
        return self.wave(periods * _angle(self.axis, local) + phase, amplitude, value)


@dataclass(frozen=True)
class EncoderEccentricity(OnAxis):
    """`c1 (cos s - cos s0) + s1 (sin s - sin s0)` in the angle of an axis, s0 the zero of its table; columns c1, s1."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        angle, zero = _angle(self.axis, local), self.zero
        by_block = np.stack([np.cos(angle) - np.cos(zero), np.sin(angle) - np.sin(zero)])
        return self.linear(value, local, [self.own], by_block[None])

    @property
    def zero(self) -> float:
        """The zero of the table of the axis."""
        machine = self.machine
        return 0.0 if machine is None else next(a.reference for a in machine.axes if a.letter == self.axis.upper())


@dataclass(frozen=True)
class Wobble(OnAxis):
    """`c cos ns + s sin ns` in each tilt of an axis; columns c1, s1 of the first tilt, c2, s2 of the other, n."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        rows = local.rows(self.block)
        angle = rows[4] * _angle(self.axis, local)
        by_block = np.zeros((2, 5, len(angle)))
        sine, cosine = waves(angle)
        by_block[0, 0] = by_block[1, 2] = cosine
        by_block[0, 1] = by_block[1, 3] = sine
        across = [THETA + k for k in range(3) if TURNING[k] != self.axis]
        return self.linear(value, local, [self.row(k) for k in across], by_block)


@dataclass(frozen=True)
class AxisJump(OnAxis):
    """The line of an axis is displaced from a time on: `o += d`; columns dx, dy, dz without that along it, at [s]."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        across = [k for k in range(3) if TURNING[k] != self.axis]
        later = _step(local, local.rows(self.block)[2])
        by_block = np.zeros((2, 3, len(later)))
        by_block[0, 0] = by_block[1, 1] = later
        return self.linear(value, local, [self.row(PLACE + k) for k in across], by_block)


@dataclass(frozen=True)
class PivotDrift(OnAxis):
    """The line of an axis drifts: `o += v t`; columns vx, vy, vz without that along it [mm/s]."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        across = [k for k in range(3) if TURNING[k] != self.axis]
        by_block = np.eye(2)[:, :, None] * local.observations.conditions[ELAPSED]
        return self.linear(value, local, [self.row(PLACE + k) for k in across], by_block)


@dataclass(frozen=True)
class LoadUnbalance(OnAxis):
    """`cos a (c1 cos c + s1 sin c)` in the angle a of a tilting axis, c that of the axis it carries; columns c1, s1."""

    carried: str = "c"

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the errors."""
        tilt, angle = _angle(self.axis, local), _angle(self.carried, local)
        by_block = np.cos(tilt) * np.stack([np.cos(angle), np.sin(angle)])
        return self.linear(value, local, [self.own], by_block[None])


@dataclass(frozen=True)
class BallMoves(OfBlock):
    """A point on the workpiece stands elsewhere from a time on: `b += d`; columns dx, dy, dz [mm], at [s]."""

    varies = ON_WORKPIECE
    takes = gives = Quantity.PARAMETERS

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        rows = np.broadcast_to(local.rows(self.block), (4, value.shape[1]))
        later = _step(local, rows[3])
        by_block = np.zeros((3, 4, len(later)))
        by_block[:, :3] = np.eye(3)[:, :, None] * later
        return Step(value + rows[:3] * later, np.eye(3)[:, :, None] * np.ones(len(later)), {self.block: by_block})
