"""Datum of a free network: the movements no reading sees, and the inner constraints that fix them.

With E the movements and G those of the datum block at its reference values, the condition is
`G' (x - reference) = 0` (Härtig et al. eq. 8); covariances follow by the S-transformation (Baarda 1973).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from metrocli.adjust.blocks import Array, Block
from metrocli.adjust.layout import Layout

_OPEN = 1e-11
"""A movement is open where its share of the normal matrix is rounding"""
_LOOSE = 1e-12
"""The members of a datum do not hold a movement that moves them by less than this against the others"""

Movements = Callable[[Mapping[str, Block]], Mapping[str, Array]]


@dataclass(frozen=True)
class Datum:
    """Inner constraints on the members of one block that define the frame."""

    block: str
    reference: Array
    """Values that the frame is fitted to, (members, size)"""
    members: Array
    """(members,) 1 for a member that takes part, else 0"""
    movements: Movements
    """From the blocks the change of each by each freedom, name -> (members, size, freedoms)"""
    names: tuple[str, ...]
    """The freedoms in words: 'shift along x', 'rotation about z', 'scale'"""


@dataclass(frozen=True)
class Frame:
    """The part of a datum that the data leave open, at the present values."""

    reduced: Array
    """E in the reduced system, (width, k)"""
    moves: Mapping[str, Array]
    """E for each block, (members, size, k)"""
    constraint: Array
    """`(G' E)^-1 G'` on the datum block, (k, members*size)"""

    def step(self, datum: Datum, values: Array) -> Array:
        """Return the amounts of each movement that restore the condition at `values` of the datum block, (k,)."""
        amounts: Array = -self.constraint @ (values - datum.reference).ravel()
        return amounts

    def transform(self, layout: Layout, datum: Datum) -> Array:
        """Return the S-transformation `I - E H` of the reduced system that holds the datum block, (width, width)."""
        reach = np.zeros((self.reduced.shape[1], layout.width))
        columns = layout.columns[datum.block].ravel()
        reach[:, columns[columns >= 0]] = self.constraint[:, columns >= 0]
        transform: Array = np.eye(layout.width) - self.reduced @ reach
        return transform

    def of_members(self, size: int) -> Array:
        """Return the constraint member by member, H (members, k, size)."""
        return np.moveaxis(self.constraint.reshape(len(self.constraint), -1, size), 0, 1)


def open_frame(datum: Datum, blocks: Mapping[str, Block], layout: Layout, matrix: Array) -> Frame | None:
    """Return the movements of the datum that the reduced normal matrix does not see; None if it sees them all."""
    moves = datum.movements(blocks)
    full = np.zeros((layout.width, len(datum.names)))
    for name, move in moves.items():
        columns = layout.columns.get(name)
        if columns is not None:
            full[columns[columns >= 0]] = move[columns >= 0]
    size = np.abs(full)
    lengths = np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", size, np.abs(matrix), size, optimize=True), 1e-300))
    unit = full / lengths
    seen, basis = np.linalg.eigh(unit.T @ matrix @ unit)
    open_ones = seen < _OPEN
    if not open_ones.any():
        return None
    mix = basis[:, open_ones] / lengths[:, None]
    chosen = {name: (move @ mix) * blocks[name].free[:, :, None] for name, move in moves.items()}
    movements = chosen[datum.block]
    at_reference = (
        datum.movements({**blocks, datum.block: blocks[datum.block].with_values(datum.reference)})[datum.block] @ mix
    )
    g = (at_reference * datum.members[:, None, None]).reshape(-1, mix.shape[1])
    return Frame(full @ mix, chosen, _constraint(g, movements.reshape(g.shape)))


def _constraint(g: Array, e: Array) -> Array:
    """Return `(G' E)^-1 G'`; LinAlgError where the members of the datum do not hold every open movement."""
    held = e * (g != 0).any(axis=1)[:, None]
    g_unit, e_unit = (part / np.maximum(np.linalg.norm(part, axis=0), 1e-300) for part in (g, held))
    if np.linalg.svd(g_unit.T @ e_unit, compute_uv=False).min() < _LOOSE:
        raise np.linalg.LinAlgError("the members of the datum leave a movement open")
    return np.asarray(np.linalg.solve(g.T @ e, g.T), dtype=float)
