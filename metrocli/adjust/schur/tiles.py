"""Tiles: lots of members of the eliminated block whose readings fit the processor's cache, in regular order.

Members that are read alike (e.g. points seen by the same tracers) are put together. Their readings, sorted alike,
form a lattice: a value for each reading is then a repetition, and a sum over a member's readings a sum along an axis.
Method: docs/algorithms/tiled-elimination.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from random import Random  # numpy.random takes longer to load than a small job to adjust

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Lattice
from metrocli.adjust.schur.layout import Layout
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass

READINGS_OF_TILE = 32768
"""Approximate number of readings in a tile: fewer cost function calls, more leave the cache"""
MOST_COLUMNS = 64
"""Most scalar readings of a member in a lattice; beyond it matrix products member by member are faster"""
WORTH_TILES = 200
"""Average number of readings from which a tile is worth its overhead"""
READINGS_OF_CHUNK = 4096
"""Readings without regular order that are taken together: as many as the cache holds with their derivatives"""
NUMBERS_OF_READING = 32
"""Derivatives and residuals of one such reading, about: a chunk has at least as many as the reduced matrix"""


@dataclass(frozen=True)
class Piece:
    """Some readings of one group: those of a tile, or a chunk of readings without regular order."""

    group: Group
    """The group with only these readings, without their keys; in a tile in regular order"""
    place: int
    """Number of the group that it is a piece of"""
    rows: Index | slice
    """Numbers of these readings in that group"""


@dataclass(frozen=True)
class Tile:
    """Some members of the eliminated block and all their readings."""

    members: Index | slice
    """Numbers of the members; a slice if they are consecutive"""
    pieces: tuple[Piece, ...]


@dataclass(frozen=True)
class Tiling:
    """The readings of an adjustment: those in tiles, and the others in chunks."""

    tiles: tuple[Tile, ...]
    chunks: tuple[Piece, ...]
    """The readings that are in no tile"""


def tiling_of(groups: Sequence[Group], blocks: Mapping[str, Block], layout: Layout) -> Tiling:
    """Return the tiles of the eliminated block; there are none if the readings have no regular order."""
    eliminated = layout.eliminated
    everything = range(len(groups))
    touching = [i for i in everything if eliminated in groups[i].chain.blocks]
    tiles = _tiled(groups, blocks, eliminated, touching) if eliminated and not len(layout.tied) else []
    left = [i for i in everything if i not in touching] if tiles else everything
    return Tiling(tuple(tiles), tuple(chunk for i in left for chunk in chunks_of(groups[i], i, layout)))


def _tiled(
    groups: Sequence[Group], blocks: Mapping[str, Block], eliminated: str, touching: Sequence[int]
) -> list[Tile]:
    orders = [_Order.of(groups[i], i, blocks, eliminated) for i in touching]
    kept = [order for order in orders if order is not None]
    # a member is eliminated with all of its readings at once: one group without an order leaves no tiles
    if len(kept) < len(orders) or not kept:
        return []
    alike = _alike(kept)
    # small tiles cost more in calls than the cache gains (docs/algorithms/tiled-elimination.md)
    if len(alike) > 2 and sum(len(order.rows) for order in kept) < WORTH_TILES * len(alike):
        return []
    return [tile for members in alike for tile in _tiles(kept, groups, members, eliminated)]


def chunks_of(group: Group, place: int, layout: Layout) -> list[Piece]:
    """Return the readings of a group in chunks that fit the cache, cut between members of the eliminated block.

    A few readings are one chunk, in their order. `place` is the number of the group.
    """
    count = group.observations.count
    size = max(READINGS_OF_CHUNK, layout.width**2 // NUMBERS_OF_READING)
    number = round(count / size)
    if number < 2:
        return [Piece(group, place, slice(0, count))]
    own = np.atleast_2d(group.observations.index.get(layout.eliminated or "", np.arange(count)))[0]
    in_order = bool((np.diff(own) >= 0).all())
    order = np.arange(count) if in_order else np.argsort(own, kind="stable")
    # the reading at which a cut would fall moves back to the first one of its member
    cuts = np.unique(np.searchsorted(own[order], own[order][np.arange(number) * count // number]))
    ends = zip(cuts.tolist(), [*cuts[1:].tolist(), count], strict=True)
    return [_chunk(group, place, slice(a, b) if in_order else order[a:b]) for a, b in ends]


def _chunk(group: Group, place: int, rows: Index | slice) -> Piece:
    weights = None if group.weights is None else group.weights[rows]
    return Piece(replace(group, observations=group.observations.without_keys(rows), weights=weights), place, rows)


@dataclass(frozen=True)
class _Order:
    """The readings of a group, sorted by the member of the eliminated block, then by the others that they use."""

    place: int
    rows: Index
    counts: Index
    """Number of readings of each member"""
    starts: Index
    code: Index
    """The other members that each sorted reading uses, coded as one number"""
    others: Mapping[str, Index]
    """Which members of the other blocks each reading uses, unsorted"""

    @staticmethod
    def of(group: Group, place: int, blocks: Mapping[str, Block], eliminated: str) -> _Order | None:
        """Return the order; None if a reading uses two members of a block, or if a member has many readings."""
        observations, members = group.observations, len(blocks[eliminated].members)
        own = observations.index[eliminated].reshape(-1)
        nothing = np.zeros(len(own), dtype=np.intp)
        others = {
            name: observations.index.get(name, nothing)
            for name in group.chain.blocks
            if name != eliminated and len(blocks[name].members) > 1
        }
        counts = np.bincount(own, minlength=members)
        most = int(counts.max(initial=0)) * len(observations.readings)
        if most > MOST_COLUMNS or any(index.ndim > 1 for index in others.values()):
            return None
        code = nothing
        for name, index in others.items():
            code = code * len(blocks[name].members) + index
        key = own * (int(code.max(initial=0)) + 1) + code
        rows = np.arange(len(own)) if (np.diff(key) >= 0).all() else np.argsort(key, kind="stable")
        return _Order(place, rows, counts, np.cumsum(counts) - counts, code[rows], others)

    def signature(self) -> Index:
        """Return a number for each member; equal for members that are read alike.

        It is a hash with random factors: two members that are not read alike agree with a probability of about 2^-60.
        """
        draws = Random(self.place)
        slots = np.array([draws.getrandbits(62) | 1 for _ in range(int(self.counts.max(initial=0)) + 1)])
        position = np.arange(len(self.rows)) - np.repeat(self.starts, self.counts)
        mixed = (self.code + 1) * slots[position]
        sums = np.concatenate([[0], np.cumsum(mixed)])
        total: Index = sums[self.starts + self.counts] - sums[self.starts] + slots[-1] * self.counts
        return total

    def at(self, members: Index) -> Index:
        """Return the sorted readings of members that have equally many, (m, k)."""
        return np.asarray(np.arange(self.counts[members[0]])[:, None] + self.starts[members])


def _alike(orders: Sequence[_Order]) -> list[Index]:
    """Return lots of members that are read alike."""
    if all(_one_pattern(order) for order in orders):
        return [np.arange(len(orders[0].counts))]
    with np.errstate(over="ignore"):
        signature = sum((order.signature() for order in orders), np.zeros(len(orders[0].counts), dtype=np.intp))
    _, kinds, counts = np.unique(signature, return_inverse=True, return_counts=True)
    return np.split(np.argsort(kinds, kind="stable"), np.cumsum(counts)[:-1])


def _one_pattern(order: _Order) -> bool:
    """Return whether all members of a group are read alike."""
    m = int(order.counts[0])
    if not (order.counts == m).all():
        return False
    return m == 0 or bool((order.code.reshape(-1, m) == order.code[:m]).all())


def _tiles(orders: Sequence[_Order], groups: Sequence[Group], members: Index, eliminated: str) -> list[Tile]:
    readings = sum(int(order.counts[members[0]]) * len(groups[order.place].observations.readings) for order in orders)
    number = max(1, round(len(members) * readings / READINGS_OF_TILE))
    return [
        Tile(
            _as_slice(some),
            tuple(_piece(order, groups[order.place], some, eliminated) for order in orders if order.counts[some[0]]),
        )
        for some in np.array_split(members, number)
    ]


def _as_slice(members: Index) -> Index | slice:
    first, last = int(members[0]), int(members[-1])
    return slice(first, last + 1) if last - first + 1 == len(members) else members


def _piece(order: _Order, group: Group, members: Index, eliminated: str) -> Piece:
    rows = order.rows[order.at(members)]
    slots = {name: index[rows[:, 0]] for name, index in order.others.items()}
    flat = rows.ravel()
    lattice = Lattice(eliminated, _as_slice(members), slots, rows.shape)
    weights: Array | None = None if group.weights is None else group.weights[flat]
    observations = group.observations.in_lattice(flat, lattice)
    return Piece(replace(group, observations=observations, weights=weights), order.place, flat)
