"""Datum of a free network: the movements that no reading determines, and the inner constraints that fix them.

With E the movements and G those of the datum block at its reference values, the condition is
`G' (x - reference) = 0` (Härtig et al. eq. 8). Covariances follow by the S-transformation (Baarda 1973).
Method: docs/algorithms/free-networks.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.movements import Affine, Listed, Movement
from metrocli.adjust.schur.layout import Layout
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass

_OPEN = 1e-11
"""Relative contribution to the normal matrix below which a movement is open, because the rest is rounding"""
_LOOSE = 1e-12
"""Singular value, relative to the members' size, below which the datum's members do not fix a movement"""

Movements = Mapping[str, Affine] | Callable[[Mapping[str, Block]], Mapping[str, Array]]


@dataclass(frozen=True)
class Datum:
    """Inner constraints on the members of one block; they define the frame."""

    block: str
    reference: Array
    """Values to which the frame is fitted, (members, size)"""
    members: Array
    """(members,) 1 for a member that defines the datum, else 0"""
    movements: Movements
    """How each freedom changes each block: affine in its values, or a function of the blocks with (members, size, f)"""
    names: tuple[str, ...]
    """The freedoms in words, e.g. 'shift along x', 'rotation about z', 'scale'"""

    def of(self, blocks: Mapping[str, Block]) -> Mapping[str, Movement]:
        """Return the movements of each block."""
        if not callable(self.movements):
            return self.movements
        return {name: Listed(moves) for name, moves in self.movements(blocks).items()}

    def at_reference(self, blocks: Mapping[str, Block]) -> Movement:
        """Return the movements of the datum block at its reference."""
        return self.of({**blocks, self.block: blocks[self.block].with_values(self.reference)})[self.block]


def turning(datum: Datum, block: Block) -> Datum:
    """Return the datum with one more block, whose first three values are a vector that turns with the frame."""
    if callable(datum.movements):
        return datum
    own = datum.movements[datum.block]
    matrix = np.zeros((len(own.matrix), block.size, block.size))
    # a vector turns and scales as points do, but shifts leave it as it is
    matrix[:, :3, :3] = own.matrix[:, :3, :3]
    return replace(datum, movements={**datum.movements, block.name: Affine(matrix, np.zeros(matrix.shape[:2]))})


@dataclass(frozen=True)
class Frame:
    """The freedoms of a datum that the data leave open, at the present values."""

    datum: Datum
    reduced: Array
    """E in the reduced system, (width, k)"""
    moves: Mapping[str, Movement]
    """E for each block"""
    reference: Movement
    """G of the datum block"""
    amounts: Array
    """`(G' E)^-1`, (k, k)"""

    def steps(self, blocks: Mapping[str, Block], values: Array) -> dict[str, Array]:
        """Return for each block the step (members, size) that restores the condition at `values` of the datum block."""
        datum = self.datum
        off = values - datum.reference
        if not (datum.members == 1).all():
            off *= datum.members[:, None]
        # minus: the movement h is what the values are off the reference, and it is taken back
        by = -self.amounts @ self.reference.dot(datum.reference, off)
        steps = {name: move.step(blocks[name].values, by) for name, move in self.moves.items()}
        return {name: step if blocks[name].all_free else step * blocks[name].free for name, step in steps.items()}

    def constraint(self, members: Index | slice) -> Array:
        """Return `((G' E)^-1 G')'` for some members of the datum block, (members, size, k)."""
        g = self.reference.mixed(self.amounts.T).at(self.datum.reference, members)
        weights = self.datum.members[members]
        return g if (weights == 1).all() else np.asarray(g * weights[:, None, None])

    def conditions(self, layout: Layout) -> Array:
        """Return the conditions `H = (G' E)^-1 G'` on a reduced system that contains the datum block, (k, width)."""
        columns = layout.columns[self.datum.block]
        conditions = np.zeros((layout.width, self.reduced.shape[1]))
        conditions[columns[columns >= 0]] = self.constraint(np.arange(len(columns)))[columns >= 0]
        return conditions.T

    def transform(self, layout: Layout) -> Array:
        """Return the S-transformation `I - E H` of a reduced system that contains the datum block, (width, width)."""
        transform: Array = np.eye(layout.width) - self.reduced @ self.conditions(layout)
        return transform


def open_frame(
    datum: Datum, blocks: Mapping[str, Block], layout: Layout, matrix: Array, diagonal: Array
) -> Frame | None:
    """Return the movements of the datum that the reduced normal matrix leaves open; None if it determines all.

    `diagonal` (width,) is that of the normal matrix before its reduction.
    """
    moves = datum.of(blocks)
    full = placed_movements(moves, blocks, layout, len(datum.names))
    mix = _open(full, matrix, diagonal)
    if not mix.size:
        return None
    reference = datum.at_reference(blocks).mixed(mix)
    mixed = {name: move.mixed(mix) for name, move in moves.items()}
    amounts = _amounts(datum, blocks[datum.block], reference, mixed[datum.block])
    return Frame(datum, full @ mix, mixed, reference, amounts)


def placed_movements(moves: Mapping[str, Movement], blocks: Mapping[str, Block], layout: Layout, count: int) -> Array:
    """Return the changes of the unknowns of a layout by so many movements, (width, count)."""
    full = np.zeros((layout.width, count))
    for name, move in moves.items():
        columns = layout.columns.get(name)
        if columns is not None:
            full[columns[columns >= 0]] = move.at(blocks[name].values, np.arange(len(columns)))[columns >= 0]
    return full


def _open(full: Array, matrix: Array, diagonal: Array) -> Array:
    """Return the combinations of the movements (width, f) that the matrix does not determine, (f, k).

    A movement without a part in the reduced system counts as determined: the readings of each eliminated member fix it.
    """
    moving = np.flatnonzero((full != 0).any(axis=0))
    size = np.abs(full[:, moving])
    # largest value that the quadratic form could have without cancellation: what is far below it is rounding. All of
    # the matrix may be rounding of what the reduction takes from the diagonal
    largest = np.einsum("ik,ij,jk->k", size, np.abs(matrix), size, optimize=True) + diagonal @ size**2
    lengths = np.sqrt(np.maximum(largest, 1e-300))
    unit = full[:, moving] / lengths
    seen, basis = np.linalg.eigh(unit.T @ matrix @ unit)
    mix = np.zeros((full.shape[1], int((seen < _OPEN).sum())))
    mix[moving] = basis[:, seen < _OPEN] / lengths[:, None]
    return mix


def _amounts(datum: Datum, block: Block, reference: Movement, moves: Movement) -> Array:
    """Return `(G' E)^-1`.

    Raises LinAlgError if the members of the datum do not fix every open movement.
    """
    # a fixed entry of a datum's member cannot take part in restoring the datum
    seen = datum.members if block.all_free else datum.members[:, None] * block.free
    product = reference.gram(datum.reference, moves, block.values, seen)
    own = np.diag(reference.gram(datum.reference, reference, datum.reference, datum.members**2))
    # relative to the size of each movement: shifts in mm and rotations in rad are compared
    share = product / np.sqrt(np.maximum(own[:, None] * own, 1e-300))
    if not np.isfinite(share).all() or np.linalg.svd(share, compute_uv=False).min() < _LOOSE:
        raise np.linalg.LinAlgError("the members of the datum leave a movement open")
    return np.asarray(np.linalg.inv(product), dtype=float)
