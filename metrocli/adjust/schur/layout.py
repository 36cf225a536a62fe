"""Layout of the normal equations: the block eliminated member by member, and the places of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Index


@dataclass(frozen=True)
class Layout:
    """Places of unknowns: one block eliminated, the free entries of the others, then the considered ones."""

    eliminated: str | None
    columns: Mapping[str, Index]
    """For each block of the reduced system the column of every entry, (members, size); -1 where it is fixed."""
    free: int
    """Number of free columns of the reduced system; considered ones follow."""
    width: int

    @property
    def wanted(self) -> frozenset[str]:
        """Blocks whose derivatives are needed."""
        return frozenset(self.columns) | ({self.eliminated} if self.eliminated else frozenset())


def arrange(blocks: Mapping[str, Block], groups: Sequence[Group], keep: Sequence[str] = ()) -> Layout:
    """Choose the block to eliminate and place the rest.

    It is the one of most unknowns of which no reading touches two members, and that is not in `keep`.
    """
    candidates = [
        b
        for b in blocks.values()
        if b.free.any() and len(b.members) > 1 and b.name not in keep and _single_touch(b, groups)
    ]
    eliminated = max(candidates, key=lambda block: int(block.free.sum()), default=None)
    rest = [block for block in blocks.values() if block is not eliminated]
    columns: dict[str, Index] = {}
    place = 0
    for considered in (False, True):
        for block in rest:
            mask = np.ones_like(block.free) if considered else block.free
            if (block.considered is not None) is not considered or not mask.any():
                continue
            numbers = np.full(block.values.shape, -1, dtype=np.intp)
            numbers[mask] = place + np.arange(mask.sum())
            columns[block.name] = numbers
            place += int(mask.sum())
    free = sum(int(block.free.sum()) for block in rest)
    return Layout(eliminated.name if eliminated else None, columns, free, place)


def _single_touch(block: Block, groups: Sequence[Group]) -> bool:
    indices = (group.observations.index.get(block.name) for group in groups if block.name in group.chain.blocks)
    return all(index is not None and (index.ndim == 1 or len(index) == 1) for index in indices)


def considered_covariance(blocks: Mapping[str, Block], layout: Layout) -> Array:
    """Return the covariance of the considered columns, block-diagonal, (width - free, width - free)."""
    covariance = np.zeros((layout.width - layout.free,) * 2)
    for name, columns in layout.columns.items():
        given = blocks[name].considered
        if given is not None:
            places = columns.ravel() - layout.free
            covariance[np.ix_(places, places)] = given
    return covariance
