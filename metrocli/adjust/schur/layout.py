"""Layout of the normal equations: which block is eliminated member by member, and the columns of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.arrays import Index
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Layout:
    """Places of the unknowns: the eliminated block, then the free entries of the other blocks (the reduced system)."""

    eliminated: str | None
    columns: Mapping[str, Index]
    """For each block of the reduced system the column of every entry, (members, size); -1 if it is fixed"""
    width: int
    """Number of columns of the reduced system"""

    @property
    def wanted(self) -> frozenset[str]:
        """Blocks whose derivatives are needed."""
        return frozenset(self.columns) | ({self.eliminated} if self.eliminated else frozenset())


def arrange(blocks: Mapping[str, Block], groups: Sequence[Group]) -> Layout:
    """Choose the block to eliminate and number the unknowns of the others.

    It is the block with the most unknowns, among those of which no reading uses two members.
    """
    # if a reading used two members of it, D would not be block-diagonal
    candidates = [b for b in blocks.values() if b.free.any() and len(b.members) > 1 and single_touch(b, groups)]
    eliminated = max(candidates, key=lambda block: int(block.free.sum()), default=None)
    rest = {name: block for name, block in blocks.items() if block is not eliminated}
    return replace(without_elimination(rest), eliminated=eliminated.name if eliminated else None)


def without_elimination(blocks: Mapping[str, Block]) -> Layout:
    """Number the free entries of all blocks one after the other."""
    columns: dict[str, Index] = {}
    place = 0
    for block in blocks.values():
        if block.free.any():
            numbers = np.full(block.values.shape, -1, dtype=np.intp)
            numbers[block.free] = place + np.arange(block.free.sum())
            columns[block.name] = numbers
            place += int(block.free.sum())
    return Layout(None, columns, place)


def single_touch(block: Block, groups: Sequence[Group]) -> bool:
    """Return whether each reading of some groups uses at most one member of a block."""
    indices = (group.observations.index.get(block.name) for group in groups if block.name in group.chain.blocks)
    return all(index is not None and (index.ndim == 1 or len(index) == 1) for index in indices)
