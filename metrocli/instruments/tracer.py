"""Tracking interferometers: the length from a tracer's reference point to a reflector (Härtig et al. eq. 1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import IDENTITY, Chain, LinkContext, Step
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.adjust.movements import of_members, of_points
from metrocli.adjust.rounds import Aspect
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.instruments.frames import PointOf

POINT, TRACER, STOP, AIR = "point", "tracer", "stop", "air"
"""Blocks: reflector positions; x0, y0, z0, dead path and scale of each tracer; deviations of the carrier's stops; the
relative error of the refractive index, which all lengths share. The condition `air` is the index at a reading over that
where its tracer was set to zero."""
NO_STOP = "no other length"
"""Name of the stop that stands for all stops with one length"""
ALONE = "alone"
"""Condition: 1 for a length that is the only one of its stop, 0 for others"""
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
    """Link to the length change read by a tracer: `l = s |x - x0| - l0`, after Härtig et al. eq. 1.

    In air of a given index s is times `a (1 + e)`, a the condition `air` and e the column of the block of this name.
    """

    block: str = TRACER
    in_air: bool = False
    takes = Quantity.POINT_IN_MACHINE
    gives = Quantity.LENGTH

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of the block of tracers and of that of the air."""
        return (self.block, AIR) if self.in_air else (self.block,)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the length, (1, n), with its derivatives by the point, (1, 3, n), and by the tracer, (1, 5, n)."""
        tracer = local.rows(self.block)
        from_tracer = value - tracer[:3]
        distance = np.sqrt(np.einsum("an,an->n", from_tracer, from_tracer))
        air = (
            local.observations.conditions.get(AIR, np.ones(1)) * (1 + local.rows(AIR)[0]) if self.in_air else np.ones(1)
        )
        scale = tracer[4] * air
        length = (scale * distance - tracer[3])[None]
        if not local.wanted:
            return Step(length)
        towards = from_tracer * (scale / distance)
        by_tracer = np.empty((1, 5, len(distance)))
        np.negative(towards, out=by_tracer[0, :3])
        by_tracer[0, 3] = -1.0
        by_tracer[0, 4] = distance * air
        by_block = {self.block: by_tracer}
        if self.in_air:
            by_block[AIR] = (scale * distance / (1 + local.rows(AIR)[0]))[None, None]
        return Step(length, towards[None], by_block)


@dataclass(frozen=True)
class Returned:
    """Link to the place where the carrier stood at a stop: the point plus the deviation of its return."""

    takes = gives = Quantity.POINT_IN_MACHINE
    blocks = (STOP,)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point, (3, n), with its derivatives by the point and by the deviation."""
        return Step(value + local.rows(STOP), IDENTITY, {STOP: IDENTITY})


def reach() -> Chain:
    """Return the chain to a reflector whose place is an unknown."""
    return Chain((PointOf(POINT, Quantity.POINT_IN_MACHINE),))


def chain(to: Chain | None = None, stops: bool = False, in_air: bool = False) -> Chain:
    """Return the forward model of a length to the end of a chain, default `reach()`.

    `stops` is with the deviations of stops, `in_air` with the refractive index of the air.
    """
    return Chain((*(to or reach()).links, *([Returned()] if stops else []), LengthFrom(TRACER, in_air)))


def beams(to: Chain, blocks: Mapping[str, Block], observations: Observations) -> Array:
    """Return the vectors from tracers to the ends of a chain, (3, n)."""
    ends = to.predict(blocks, observations)
    return np.ascontiguousarray(ends - blocks[TRACER].values[observations.index[TRACER], :3].T)


def _double_azimuth(beam: Array) -> tuple[Array, Array]:
    x, y, _ = beam
    flat = np.maximum(x**2 + y**2, 1e-300)
    return (x**2 - y**2) / flat, 2 * x * y / flat


def aspects(to: Chain) -> dict[str, Aspect]:
    """Return the covariates of the beams to the end of a chain on which effects may depend, by name.

    The reflector has its axis along +z and sees the beam along -b.
    """
    return {
        COS_2A: lambda blocks, observations: _double_azimuth(beams(to, blocks, observations))[0],
        SIN_2A: lambda blocks, observations: _double_azimuth(beams(to, blocks, observations))[1],
        INCIDENCE: lambda blocks, observations: _incidence(beams(to, blocks, observations)),
        COS_A: lambda blocks, observations: _azimuth(beams(to, blocks, observations))[0],
        SIN_A: lambda blocks, observations: _azimuth(beams(to, blocks, observations))[1],
    }


def _azimuth(beam: Array) -> tuple[Array, Array]:
    x, y, _ = beam
    level = np.maximum(np.hypot(x, y), 1e-300)
    return x / level, y / level


def _incidence(beam: Array) -> Array:
    return np.asarray(1 + beam[2] / np.sqrt((beam**2).sum(axis=0)))


def point_block(points: Array, names: Sequence[str], free: Mask | bool, extent: float) -> Block:
    """Return the block of reflector positions, (points, 3); their plausible reach is a tenth of the measured volume."""
    return Block(
        POINT, points, ("x", "y", "z"), tuple(names), free=np.asarray(free), reach=np.array(extent / 10), noun="point"
    )


def tracer_block(values: Array, names: Sequence[str], free: Mask, extent: float) -> Block:
    """Return the block of tracers, (tracers, 5); their plausible reach is a tenth of the measured volume."""
    reach = np.array([extent / 10] * 4 + [1e-2])
    return Block(TRACER, values, COLUMNS, tuple(names), free=free, reach=reach, noun="tracer")


def stop_block(stops: Index) -> Block | None:
    """Return the block of deviations of stops, (1 + stops, 3), for the number of the stop of each length from 1.

    The first member has none: it is for lengths that are the only one of their stop. None if all are.
    """
    count = int(stops.max(initial=0))
    if not count:
        return None
    free = np.ones((count + 1, 3), dtype=bool)
    free[0] = False
    members = (NO_STOP, *map(str, range(1, count + 1)))
    return Block(STOP, np.zeros((count + 1, 3)), ("x", "y", "z"), members, free, reach=np.array(1.0), noun="stop")


def datum(points: Block, takes_part: Array) -> Datum:
    """Return the inner constraints of a free network on the points (Härtig et al. eq. 8)."""
    # without scale: lengths fix it
    places = of_points()
    tracers = of_members(len(COLUMNS), places)
    return Datum(POINT, points.values, takes_part, {POINT: places, TRACER: tracers}, FREEDOMS)
