"""Layout of the normal equations: which block is eliminated member by member, and the columns of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.arrays import Index, Mask
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Layout:
    """Places of the unknowns: the eliminated block, then the free entries of the other blocks (the reduced system).

    Members of the eliminated block of which a reading uses two are tied: they stay in the reduced system.
    """

    eliminated: str | None
    columns: Mapping[str, Index]
    """For each block of the reduced system the column of every entry, (members, size); -1 if it is fixed.

    The eliminated block has those of its tied members, -1 for the others.
    """
    width: int
    """Number of columns of the reduced system"""
    tied: Index = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """Numbers of the tied members"""

    @property
    def wanted(self) -> frozenset[str]:
        """Blocks whose derivatives are needed."""
        return frozenset(self.columns) | ({self.eliminated} if self.eliminated else frozenset())

    def alone(self, block: Block) -> Mask:
        """Return the free entries of the members of the eliminated block that are not tied, (members, size)."""
        return _alone(block, self.tied) if len(self.tied) else block.free


def arrange(blocks: Mapping[str, Block], groups: Sequence[Group]) -> Layout:
    """Choose the block to eliminate and number the unknowns of the others.

    It is the block with the most unknowns in members of which no reading uses two.
    """
    candidates = [(block, tied_members(block, groups)) for block in blocks.values() if len(block.members) > 1]
    # tied members in the elimination would make D no longer block-diagonal
    apart = [(_alone(block, tied), block, tied) for block, tied in candidates if tied is not None]
    nothing = np.zeros((0, 0), dtype=bool), None, np.zeros(0, dtype=np.intp)
    alone, eliminated, tied = max(apart, key=lambda candidate: int(candidate[0].sum()), default=nothing)
    if eliminated is None or not alone.any():
        return without_elimination(blocks)
    kept = {name: block for name, block in blocks.items() if block is not eliminated}
    if len(tied):
        # the tied members stay with their columns in the reduced system, under the name of the same block
        kept[eliminated.name] = replace(eliminated, free=eliminated.free & ~alone)
    return replace(without_elimination(kept), eliminated=eliminated.name, tied=tied)


def _alone(block: Block, tied: Index) -> Mask:
    """Return the free entries of the members that are not tied, (members, size)."""
    alone = block.free.copy()
    alone[tied] = False
    return alone


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


def tied_members(block: Block, groups: Sequence[Group]) -> Index | None:
    """Return the members of a block of which some reading uses two; None if one uses the block without an index."""
    tied = [np.zeros(0, dtype=np.intp)]
    for group in groups:
        if block.name in group.chain.blocks:
            index = group.observations.index.get(block.name)
            if index is None:
                return None
            tied += [index.ravel()] if index.ndim > 1 and len(index) > 1 else []
    # np.unique loads numpy.ma, which takes longer than a small job
    return np.flatnonzero(np.bincount(np.concatenate(tied), minlength=len(block.members)))
