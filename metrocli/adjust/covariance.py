"""Covariance of any block from the factors of the normal equations, without the inverse of the whole matrix.

With W = D^-1 B and Q_r the covariance of the reduced unknowns (considered ones included): `Q_er = -W Q_r`,
`Q_ee = D^-1 + W Q_r W'`. These hold in any datum once Q_r is in it, as long as the datum does not depend on the
eliminated members; where it does (inner constraints on them) the terms of `Gauge` are added.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from metrocli.adjust.blocks import Array, Block
from metrocli.adjust.datum import Frame
from metrocli.adjust.eliminated import Eliminated
from metrocli.adjust.layout import Layout
from metrocli.adjust.normals import Part
from metrocli.adjust.observations import Index, Mask
from metrocli.adjust.portions import Portion


@dataclass(frozen=True)
class Gauge:
    """What inner constraints on the eliminated block add: its noise E then enters the common movement h = sum H e."""

    frame: Frame
    block: Block
    """The eliminated block at the solution"""
    shares: tuple[Array, ...]
    """`D^-1 H'` of each part: the covariance of its own noise with the movement, (k, s, f)"""

    def moves_of(self, members: Index | slice) -> Array:
        """Return E of some members, (k, s, f)."""
        moves = self.frame.moves[self.block.name].at(self.block.values, members)
        return moves if self.block.all_free else np.asarray(moves * self.block.free[members, :, None])

    @cached_property
    def moves(self) -> Array:
        """E of the eliminated members, (members, s, f)."""
        return self.moves_of(np.arange(len(self.block.members)))

    @property
    def reduced(self) -> Array:
        """E in the reduced system, (width, f)."""
        return self.frame.reduced


@dataclass(frozen=True)
class Covariance:
    """Covariance of all unknowns, given out block by block."""

    layout: Layout
    shapes: Mapping[str, tuple[int, int]]
    reduced: Array
    """(width, width)"""
    parts: tuple[Part, ...]
    """The eliminated members at the solution"""
    portions: tuple[Portion, ...]
    """The readings of each part, where they are in portions"""
    invariant: Array
    """The covariance of the reduced unknowns in a frame that they define alone, (width, width)"""
    factor: float = 1.0
    """sigma0^2 where the noise is estimated, else 1"""
    gauge: Gauge | None = None

    @cached_property
    def weights(self) -> Array:
        """W, (members, s, width)."""
        return self._collected([part.weights() for part in self.parts])

    @cached_property
    def inverse(self) -> Array:
        """D^-1 of the eliminated members with zeros at fixed entries, (members, s, s)."""
        return self._collected([part.inverse() for part in self.parts])

    @cached_property
    def share(self) -> Array:
        """`D^-1 H'` of the gauge, (members, s, f)."""
        return self._collected(self.gauge.shares if self.gauge else [])

    def _collected(self, found: Sequence[Array]) -> Array:
        """Return what was found for each part in the order of the members."""
        if not self.layout.eliminated:
            return np.zeros((0, 0, 0))
        full = np.empty((self.shapes[self.layout.eliminated][0], *found[0].shape[1:]))
        for part, values in zip(self.parts, found, strict=True):
            full[part.members] = values
        return full

    def explained(self, place: int, group_readings: tuple[int, int]) -> Array | None:
        """Return the variance of the adjusted, whitened readings of the group at `place`, `diag(J Q J')`, (d, n).

        It is the same in every frame. None where its readings are not in portions.
        """
        if not any(piece.place == place for portion in self.portions for piece in portion.pieces):
            return None
        full = np.empty(group_readings)
        for part, portion in zip(self.parts, self.portions, strict=False):
            if not isinstance(part, Eliminated):
                return None
            for piece, values in zip(portion.pieces, part.explained(self.invariant), strict=True):
                if piece.place == place:
                    full[:, piece.rows] = values
        return self.factor * full

    def scaled(self, factor: float) -> Covariance:
        """Return the covariance multiplied by `factor`."""
        return replace(self, factor=self.factor * factor)

    def of(self, name: str) -> Array:
        """Return the full covariance of a block, (members*size, members*size), zero where it is fixed."""
        return self.between(name, name)

    def between(self, name: str, other: str) -> Array:
        """Return the covariance between all entries of two blocks, (members*size, members*size)."""
        if self.layout.eliminated == name == other:
            m, s = self.shapes[name]
            flat = self.weights.reshape(m * s, self.layout.width)
            full = flat @ self.reduced @ flat.T
            view = full.reshape(m, s, m, s)
            view[np.arange(m), :, np.arange(m), :] += self.inverse
            if self.gauge is not None:
                shared = self.gauge.moves.reshape(m * s, -1) @ self.share.reshape(m * s, -1).T
                full -= shared + shared.T
            return self.factor * full
        if other == self.layout.eliminated:
            return self.between(other, name).T
        rows = -self._cross if name == self.layout.eliminated else self._rows(name, self.reduced)
        m, s = self.shapes[name]
        return self.factor * self._columns(other, rows.reshape(m * s, self.layout.width))

    def members(self, name: str) -> Array:
        """Return the covariance of each member of a block, (members, size, size)."""
        m, s = self.shapes[name]
        if name == self.layout.eliminated:
            own = np.empty((m, s, s))
            for i, part in enumerate(self.parts):
                own[part.members] = self.factor * self._own(i, part)
            return own
        columns = self.layout.columns.get(name)
        if columns is None:
            return np.zeros((m, s, s))
        inside = (columns >= 0)[:, :, None] & (columns >= 0)[:, None, :]
        return self.factor * np.where(inside, self.reduced[columns[:, :, None], columns[:, None, :]], 0.0)

    def _own(self, i: int, part: Part) -> Array:
        """Return the covariance of the members of one part, (k, s, s)."""
        own = part.covariance(self.reduced)
        if self.gauge is not None:
            shared = np.einsum("nsf,ntf->stn", self.gauge.moves_of(part.members), self.gauge.shares[i])
            own = own - (shared + shared.swapaxes(0, 1)).transpose(2, 0, 1)
        return own

    def pairs(self, name: str, index: Index, other: str, other_index: Index) -> Array:
        """Return the covariance of chosen pairs of members of two blocks, (size, size', n).

        n is 1 where both blocks have one member. Of the eliminated block a member is paired with itself only.
        """
        if other == self.layout.eliminated and name != other:
            return np.swapaxes(self.pairs(other, other_index, name, index), 0, 1)
        if name == other == self.layout.eliminated:
            return np.ascontiguousarray(np.moveaxis(self.members(name), 0, -1))[:, :, index]
        others, within = self._places(other, other_index)
        if name == self.layout.eliminated:
            rows = -self._cross
            if len(others) == 1:
                chosen = np.where(within[0], rows[:, :, others[0]], 0.0)
                return self.factor * np.ascontiguousarray(np.moveaxis(chosen, 0, -1))[:, :, index]
            picked = rows[index[:, None, None], np.arange(rows.shape[1])[None, :, None], others[:, None, :]]
            return self.factor * np.moveaxis(picked * within[:, None, :], 0, -1)
        columns, inside = self._places(name, index)
        picked = self.reduced[columns[:, :, None], others[:, None, :]] * (inside[:, :, None] & within[:, None, :])
        covariance: Array = self.factor * np.moveaxis(picked, 0, -1)
        return covariance

    @cached_property
    def _cross(self) -> Array:
        """Minus the covariance of the eliminated members with the reduced unknowns, (members, s, width)."""
        product: Array = self.weights @ self.reduced
        return product if self.gauge is None else product + self.share @ self.gauge.reduced.T

    def _places(self, name: str, index: Index) -> tuple[Index, Mask]:
        columns = self.layout.columns.get(name)
        if columns is None:
            shape = (len(index), self.shapes[name][1])
            return np.zeros(shape, dtype=np.intp), np.zeros(shape, dtype=bool)
        rows = columns if len(columns) == 1 else columns[index]
        return np.maximum(rows, 0), rows >= 0

    def _rows(self, name: str, matrix: Array) -> Array:
        columns = self.layout.columns.get(name)
        if columns is None:
            m, s = self.shapes[name]
            return np.zeros((m * s, matrix.shape[1]))
        flat = columns.ravel()
        return np.where((flat >= 0)[:, None], matrix[np.maximum(flat, 0)], 0.0)

    def _columns(self, name: str, matrix: Array) -> Array:
        return self._rows(name, np.ascontiguousarray(matrix.T)).T


def shapes_of(blocks: Mapping[str, Block]) -> dict[str, tuple[int, int]]:
    """Return (members, size) of each block."""
    return {name: (len(block.members), block.size) for name, block in blocks.items()}
