"""The partition of unknowns into coupled fields and a border, and the sparse Jacobian in its order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, LinearGroup
from metrocli.adjust.sparse.nested_dissection import Sparse
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Partition:
    """Numbers of the free unknowns: those of the net first, then the local ones, then the border."""

    net: int
    local: int
    width: int
    columns: Mapping[str, Index]
    """For each block the number of every entry, (members, size); -1 if it is fixed"""

    def values_of(self, blocks: Mapping[str, Block]) -> Array:
        """Return the values of all unknowns, (width,); poses as they are stored."""
        values = np.zeros(self.width)
        for name, columns in self.columns.items():
            values[columns[columns >= 0]] = blocks[name].values[columns >= 0]
        return values

    def moved(self, blocks: Mapping[str, Block], step: Array) -> dict[str, Block]:
        """Return the blocks after a step of all unknowns, (width,)."""
        moved = dict(blocks)
        for name, columns in self.columns.items():
            moved[name] = blocks[name].moved(np.where(columns >= 0, step[np.maximum(columns, 0)], 0.0))
        return moved


def partition(blocks: Mapping[str, Block], groups: Sequence[Group], net: str, local: str) -> Partition:
    """Number the free unknowns; members of the local block that one reading uses together go to the border."""
    # D would not be diagonal otherwise: a reading couples the two members
    joined = _joined(blocks[local], groups)
    alone = blocks[local].free & ~joined[:, None]
    columns = {name: np.full(block.values.shape, -1, dtype=np.intp) for name, block in blocks.items()}
    place = 0
    sizes = []
    rest = [(name, block.free) for name, block in blocks.items() if name not in (net, local)]
    for name, free in [(net, blocks[net].free), (local, alone), (local, blocks[local].free & ~alone), *rest]:
        columns[name][free] = place + np.arange(int(free.sum()))
        place += int(free.sum())
        sizes.append(int(free.sum()))
    return Partition(sizes[0], sizes[1], place, columns)


def _joined(block: Block, groups: Sequence[Group]) -> Mask:
    """Return which members of a block are used together with another one in some reading, (members,)."""
    joined = np.zeros(len(block.members), dtype=bool)
    for group in groups:
        index = group.observations.index.get(block.name)
        if index is not None and index.ndim == 2 and len(index) > 1:
            joined[index.ravel()] = True
    return joined


def gradient(linears: Sequence[LinearGroup], parts: Partition) -> Array:
    """Return the gradient `J' residual` at the present values."""
    total = np.zeros(parts.width)
    for linear in linears:
        for touch in linear.touches:
            towards = np.einsum("dsn,dn->ns", touch.jacobian, linear.residual)
            columns = parts.columns[touch.block][touch.index]
            inside = columns >= 0
            # bincount adds up repeated places, which `total[columns] += ...` would write once only
            total += np.bincount(columns[inside], towards[inside], minlength=parts.width)
    return total


def jacobian(linears: Sequence[LinearGroup], parts: Partition) -> Sparse:
    """Return the sparse Jacobian of all groups, one below the other."""
    from scipy.sparse import csr_array, vstack

    stacked = []
    for linear in linears:
        d, n = linear.residual.shape
        values: list[Array] = []
        rows: list[Index] = []
        columns: list[Index] = []
        for touch in linear.touches:
            at = parts.columns[touch.block][touch.index]
            # zeros in the derivatives would enter the pattern of the matrix, and each entry there costs in the factor
            a, s, i = np.nonzero(touch.jacobian)
            keep = at[i, s] >= 0
            a, s, i = a[keep], s[keep], i[keep]
            values.append(touch.jacobian[a, s, i])
            # all first components, then all second ones, as `ravel` of (d, n) and the redundancies have them
            rows.append(a * n + i)
            columns.append(at[i, s])
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        stacked.append(csr_array(entries, shape=(d * n, parts.width)))
    return vstack(stacked, format="csr")
