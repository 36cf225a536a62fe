"""Covariance of the members of the eliminated block, and variance of their adjusted readings.

With W = D^-1 B and Q_r the covariance of the reduced unknowns, member i has the covariance `D_i^-1 + W_i Q_r W_i'`.
Inner constraints on the members themselves add the terms of `Gauge`. The variance of adjusted readings,
`diag(J D^-1 J' + A Q_r A')` with `A = K - J W`, is the same in every datum, since A annihilates the movements that no
reading determines. Method: docs/algorithms/tiled-elimination.md and docs/algorithms/free-networks.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from metrocli.adjust.datum import Frame
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.schur.normals import EliminatedMembers
from metrocli.adjust.schur.tiles import Tile
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Gauge:
    """The terms that inner constraints on the eliminated block add to its covariance.

    The noise of each member then enters the common movement `h = sum H_i e_i` that restores the datum.
    """

    frame: Frame
    block: Block
    """The eliminated block at the solution"""

    def moves_of(self, members: Index | slice) -> Array:
        """Return E for some members, (k, s, f)."""
        moves = self.frame.moves[self.block.name].at(self.block.values, members)
        return moves if self.block.all_free else np.asarray(moves * self.block.free[members, :, None])

    def share_of(self, part: EliminatedMembers) -> Array:
        """Return `D^-1 H'` for the members of a part: the covariance of their own noise with h, (k, s, f)."""
        return part.solved(self.frame.constraint(part.members))

    def shared(self, part: EliminatedMembers) -> Array:
        """Return `-D^-1 H' E' - E H D^-1` for the members of a part, (k, s, s)."""
        moved = np.einsum("nsf,ntf->stn", self.frame.constraint(part.members), self.moves_of(part.members))
        # the sign follows from `e' = n - W r'` and `cov(n, r') = -D^-1 H' E_r'`, with `W E_r = -E`
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
    """Covariance of the eliminated members at the solution, before any estimated factor of the noise."""

    shape: tuple[int, int]
    """(members, s)"""
    parts: tuple[EliminatedMembers, ...]
    tiles: tuple[Tile, ...]
    """The readings of each part that is a tile"""
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
        """Return `diag(J Q J')`, the variance of the adjusted, whitened readings (d, n), of the group at `place`.

        Its readings must be in tiles.
        """
        return self._read(place, shape, lambda i, j: self._adjusted[1][i][j])

    def cross_covariance(self, place: int, shape: tuple[int, int]) -> Array:
        """Return `Q_e. J'`, the covariance of a reading's member with the reading itself as adjusted, (s, d, n).

        J are the derivatives of the whitened reading by all unknowns. The group at `place` must be in tiles.
        """
        full = np.empty((self.shape[1], *shape))
        # not strict: behind the tiles the parts hold the readings in no order, and tied members, which have no tile
        for part, tile in zip(self.parts, self.tiles, strict=False):
            chosen = [j for j, piece in enumerate(tile.pieces) if piece.place == place]
            variances = part.cross_covariance(self.reduced, chosen)
            if self.gauge is not None:
                # the other terms of the gauge are movements times J, which no reading sees
                moves, seen = self.gauge.moves_of(part.members), part.reading_changes(self.gauge.share_of(part), chosen)
                variances = [q - np.einsum("ksf,fdmk->sdmk", moves, h) for q, h in zip(variances, seen, strict=True)]
            for j, values in zip(chosen, variances, strict=True):
                full[:, :, tile.pieces[j].rows] = values.reshape(*values.shape[:2], -1)
        return full

    def reads(self, place: int) -> bool:
        """Whether the readings of the group at `place` are in tiles."""
        return any(piece.place == place for tile in self.tiles for piece in tile.pieces)

    def _read(self, place: int, shape: tuple[int, int], values: Callable[[int, int], Array]) -> Array:
        """Return the values of all pieces in the order of the group's readings, (d, n)."""
        full = np.empty(shape)
        for i, tile in enumerate(self.tiles):
            for j, piece in enumerate(tile.pieces):
                if piece.place == place:
                    full[:, piece.rows] = values(i, j)
        return full

    @cached_property
    def _adjusted(self) -> tuple[Array, list[tuple[Array, ...]]]:
        """Covariances of the members and variances of each part's readings; they share most of the work."""
        covariances, readings = np.empty((*self.shape, self.shape[1])), []
        for part in self.parts:
            covariance, explained = part.adjusted(self.reduced)
            covariances[part.members] = covariance if self.gauge is None else covariance + self.gauge.shared(part)
            readings.append(explained)
        return covariances, readings

    def _collected(self, collected: Sequence[Array]) -> Array:
        """Return values found for each part in the order of the members."""
        if not self.shape[1]:
            return np.zeros((0, 0, 0))
        full = np.empty((self.shape[0], *collected[0].shape[1:]))
        for part, values in zip(self.parts, collected, strict=True):
            full[part.members] = values
        return full
