"""Tracking interferometers: the length from a tracer's reference point to a reflector (Härtig et al. eq. 1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from metrocli.adjust.datum import Datum
from metrocli.adjust.iterated_weights import Aspect
from metrocli.adjust.model.blocks import Array, Block, Mask
from metrocli.adjust.model.chain import Chain, Local, Step
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.adjust.movements import of_members, of_points
from metrocli.instruments.frames import PointOf

POINT, TRACER = "point", "tracer"
"""Blocks: reflector positions; x0, y0, z0, dead path and scale of each tracer"""
COLUMNS = ("x", "y", "z", "dead_path", "scale")
FREEDOMS = (
    "shift along x",
    "shift along y",
    "shift along z",
    "rotation about x",
    "rotation about y",
    "rotation about z",
)


COS_2A, SIN_2A, INCIDENCE, COS_A, SIN_A = "cos 2a", "sin 2a", "1 - cos i", "cos a", "sin a"
"""Covariates of a beam: a is its azimuth atan2(dy, dx), i its angle of incidence to the axis of the reflector"""


@dataclass(frozen=True)
class LengthFrom:
    """Link to the length change read by a tracer: `l = s |x - x0| - l0`, after Härtig et al. eq. 1."""

    block: str = TRACER
    takes = Quantity.POINT_IN_MACHINE
    gives = Quantity.LENGTH

    @property
    def blocks(self) -> tuple[str, ...]:
        """Name of the block of tracers."""
        return (self.block,)

    def step(self, value: Array, local: Local) -> Step:
        """Return the length, (1, n), with its derivatives by the point, (1, 3, n), and by the tracer, (1, 5, n)."""
        tracer = local.rows(self.block)
        from_tracer = value - tracer[:3]
        distance = np.sqrt(np.einsum("an,an->n", from_tracer, from_tracer))
        scale = tracer[4]
        length = (scale * distance - tracer[3])[None]
        if not local.wanted:
            return Step(length)
        towards = from_tracer * (scale / distance)
        by_tracer = np.empty((1, 5, len(distance)))
        np.negative(towards, out=by_tracer[0, :3])
        by_tracer[0, 3] = -1.0
        by_tracer[0, 4] = distance
        return Step(length, towards[None], {self.block: by_tracer})


def chain() -> Chain:
    """Return the forward model of a length."""
    return Chain((PointOf(POINT, Quantity.POINT_IN_MACHINE), LengthFrom(TRACER)))


def beams(blocks: Mapping[str, Block], observations: Observations) -> Array:
    """Return the vectors from tracers to reflectors, (3, n)."""
    ends = blocks[POINT].values[observations.index[POINT]] - blocks[TRACER].values[observations.index[TRACER], :3]
    return np.ascontiguousarray(ends.T)


def _double_azimuth(blocks: Mapping[str, Block], observations: Observations) -> tuple[Array, Array]:
    x, y, _ = beams(blocks, observations)
    flat = np.maximum(x**2 + y**2, 1e-300)
    return (x**2 - y**2) / flat, 2 * x * y / flat


def _azimuth(blocks: Mapping[str, Block], observations: Observations) -> tuple[Array, Array]:
    x, y, _ = beams(blocks, observations)
    level = np.maximum(np.hypot(x, y), 1e-300)
    return x / level, y / level


def _incidence(blocks: Mapping[str, Block], observations: Observations) -> Array:
    """Return 1 - cos i for a reflector with its axis along +z; the reflector sees the beam along -b."""
    beam = beams(blocks, observations)
    return np.asarray(1 + beam[2] / np.sqrt((beam**2).sum(axis=0)))


ASPECTS: dict[str, Aspect] = {
    COS_2A: lambda blocks, observations: _double_azimuth(blocks, observations)[0],
    SIN_2A: lambda blocks, observations: _double_azimuth(blocks, observations)[1],
    INCIDENCE: _incidence,
    COS_A: lambda blocks, observations: _azimuth(blocks, observations)[0],
    SIN_A: lambda blocks, observations: _azimuth(blocks, observations)[1],
}
"""Covariates on which effects on a beam may depend, by name"""


def point_block(points: Array, names: Sequence[str], free: Mask | bool, extent: float) -> Block:
    """Return the block of reflector positions, (points, 3); their plausible reach is a tenth of the measured volume."""
    return Block(
        POINT, points, ("x", "y", "z"), tuple(names), free=np.asarray(free), reach=np.array(extent / 10), noun="point"
    )


def tracer_block(values: Array, names: Sequence[str], free: Mask, extent: float) -> Block:
    """Return the block of tracers, (tracers, 5); their plausible reach is a tenth of the measured volume."""
    reach = np.array([extent / 10] * 4 + [1e-2])
    return Block(TRACER, values, COLUMNS, tuple(names), free=free, reach=reach, noun="tracer")


def datum(points: Block, takes_part: Array) -> Datum:
    """Return the inner constraints of a free network on the points (Härtig et al. eq. 8)."""
    places = of_points()
    tracers = of_members(len(COLUMNS), places)
    return Datum(POINT, points.values, takes_part, {POINT: places, TRACER: tracers}, FREEDOMS)
