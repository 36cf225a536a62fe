"""The members of the eliminated block as adjusted: their covariance, and the variance of their readings.

With W = D^-1 B and Q_r the covariance of the reduced unknowns, member i has the covariance `D_i^-1 + W_i Q_r W_i'`;
inner constraints on the members themselves add what Gauge says. What is read has in every frame the same variance
`diag(J D^-1 J' + A Q_r A')`, `A = K - J W`, since A takes no notice of the movements that no reading sees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from metrocli.adjust.datum import Frame
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.observations import Index
from metrocli.adjust.schur.normals import Part
from metrocli.adjust.schur.tiles import Tile


@dataclass(frozen=True)
class Gauge:
    """What inner constraints on the eliminated block add: its noise E then enters the common movement h = sum H e."""

    frame: Frame
    block: Block
    """The eliminated block at the solution"""

    def moves_of(self, members: Index | slice) -> Array:
        """Return E of some members, (k, s, f)."""
        moves = self.frame.moves[self.block.name].at(self.block.values, members)
        return moves if self.block.all_free else np.asarray(moves * self.block.free[members, :, None])

    def share_of(self, part: Part) -> Array:
        """Return `D^-1 H'` of the members of a part: the covariance of their own noise with the movement, (k, s, f)."""
        return part.solved(self.frame.constraint(part.members))

    def shared(self, part: Part) -> Array:
        """Return `-D^-1 H' E' - E H D^-1` of the members of a part, (k, s, s)."""
        moved = np.einsum("nsf,ntf->stn", self.frame.constraint(part.members), self.moves_of(part.members))
        half = part.solved(moved.transpose(2, 0, 1))
        return np.asarray(-half - half.swapaxes(1, 2))

    @cached_property
    def moves(self) -> Array:
        """E of the eliminated members, (members, s, f)."""
        return self.moves_of(np.arange(len(self.block.members)))

    @property
    def reduced(self) -> Array:
        """E in the reduced system, (width, f)."""
        return self.frame.reduced


@dataclass(frozen=True)
class MemberCovariance:
    """The eliminated members at the solution, without an estimated factor of the noise."""

    shape: tuple[int, int]
    """(members, s)"""
    parts: tuple[Part, ...]
    tiles: tuple[Tile, ...]
    """The readings of each part, where they are in tiles"""
    reduced: Array
    """The covariance of the reduced unknowns, (width, width)"""
    gauge: Gauge | None = None

    @cached_property
    def weights(self) -> Array:
        """W, (members, s, width)."""
        return self._collected([part.weights() for part in self.parts])

    @cached_property
    def inverse(self) -> Array:
        """D^-1 with zeros at fixed entries, (members, s, s)."""
        return self._collected([part.inverse() for part in self.parts])

    @cached_property
    def share(self) -> Array:
        """`D^-1 H'` of the gauge, (members, s, f)."""
        return self._collected([self.gauge.share_of(part) for part in self.parts] if self.gauge else [])

    @property
    def covariance(self) -> Array:
        """The covariance of each member, (members, s, s)."""
        return self._adjusted[0]

    def residuals(self, place: int, blocks: Mapping[str, Block], shape: tuple[int, int]) -> Array:
        """Return `reading - predicted` of the group at `place`, whose readings are in tiles, (d, n)."""
        return self._read(place, shape, lambda i, j: self.tiles[i].pieces[j].group.residuals(blocks))

    def explained(self, place: int, shape: tuple[int, int]) -> Array:
        """Return the variance of the adjusted, whitened readings (d, n) of the group at `place`, `diag(J Q J')`.

        Its readings are in tiles.
        """
        return self._read(place, shape, lambda i, j: self._adjusted[1][i][j])

    def reads(self, place: int) -> bool:
        """Whether the readings of the group at `place` are in tiles."""
        return any(piece.place == place for tile in self.tiles for piece in tile.pieces)

    def _read(self, place: int, shape: tuple[int, int], values: Callable[[int, int], Array]) -> Array:
        """Return what is found for each piece in the order of the group's readings, (d, n)."""
        full = np.empty(shape)
        for i, tile in enumerate(self.tiles):
            for j, piece in enumerate(tile.pieces):
                if piece.place == place:
                    full[:, piece.rows] = values(i, j)
        return full

    @cached_property
    def _adjusted(self) -> tuple[Array, list[tuple[Array, ...]]]:
        """Both in one go, as most of the work is the same: covariances, and variances of each part's readings."""
        covariances, readings = np.empty((*self.shape, self.shape[1])), []
        for part in self.parts:
            covariance, explained = part.adjusted(self.reduced)
            covariances[part.members] = covariance if self.gauge is None else covariance + self.gauge.shared(part)
            readings.append(explained)
        return covariances, readings

    def _collected(self, found: Sequence[Array]) -> Array:
        """Return what was found for each part in the order of the members."""
        if not self.shape[1]:
            return np.zeros((0, 0, 0))
        full = np.empty((self.shape[0], *found[0].shape[1:]))
        for part, values in zip(self.parts, found, strict=True):
            full[part.members] = values
        return full
