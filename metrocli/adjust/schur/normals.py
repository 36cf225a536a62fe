"""Normal equations with one block eliminated member by member (Schur complement).

With e the unknowns of the eliminated block (D, block-diagonal) and r the others, the normal matrix is
[[D, B], [B', N]]. The reduced system is `S = N - B' D^-1 B`. The cost grows linearly with the number of readings and
of members of the eliminated block. Method: docs/algorithms/tiled-elimination.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.schur.irregular_normals import IrregularNormals, NormalSums, OutsideTiles
from metrocli.adjust.schur.layout import Layout
from metrocli.adjust.schur.tile_rows import TileRows
from metrocli.adjust.schur.tiled_elimination import EliminatedTile
from metrocli.adjust.schur.tiles import Tiling
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Normals:
    """The parts of the normal matrix and of the right side `J' r`, all in whitened readings."""

    parts: tuple[EliminatedMembers, ...]
    """The tiles, then the other readings, then tied members"""
    shape: tuple[int, int]
    """Shape of the eliminated block, (members, s)"""
    cost: float
    damping: float = 0.0

    @property
    def diagonal(self) -> Array:
        """The diagonal of N, (width,)."""
        return np.asarray(np.sum([part.diagonal for part in self.parts], axis=0))

    def reduced(self) -> tuple[Array, Array, float]:
        """Return `S = N - B' D^-1 B`, its right side, and the decrease of the sum of squares by the members alone.

        Raises LinAlgError if a member is singular.
        """
        matrices, rights, alone = zip(*(part.reduced for part in self.parts), strict=True)
        matrix, right = np.sum(matrices, axis=0), np.sum(rights, axis=0)
        if self.damping:
            # diag(N), not diag(S): so S stays the Schur complement of the damped normal matrix as a whole
            diagonal = self.diagonal
            matrix[np.diag_indices_from(matrix)] += self.damping * np.where(diagonal > 0, diagonal, 1.0)
        return matrix, right, sum(alone)

    def damped(self, factor: float) -> Normals:
        """Return the normal equations with their diagonal multiplied by `1 + factor` (Marquardt)."""
        return replace(self, parts=tuple(part.damped(factor) for part in self.parts), damping=factor)

    def back(self, step: Array) -> Array:
        """Return the step of the eliminated unknowns, `D^-1 (right - B step)`, (members, s)."""
        steps = np.zeros(self.shape)
        for part in self.parts:
            steps[part.members] = part.back(step)
        return steps

    def following(self, step: Array) -> Array:
        """Return `W step`: the eliminated unknowns move by minus this for a step of the others, (members, s)."""
        steps = np.zeros(self.shape)
        for part in self.parts:
            steps[part.members] = part.weights() @ step
        return steps


def assemble(tiling: Tiling, blocks: Mapping[str, Block], layout: Layout) -> Normals:
    """Linearise all readings and return the sum of their normal equations.

    If the cost is not finite, it stops before the sums of the tiles.
    """
    name = layout.eliminated
    shape = blocks[name].values.shape if name else (0, 0)
    sums = NormalSums.empty(0 if tiling.tiles else shape[0], shape[1], layout.width)
    cost = 0.0
    for chunk in tiling.chunks:
        linear = chunk.group.linear(blocks, layout.wanted)
        cost += linear.cost
        sums.add(linear, blocks, layout)
    parts: list[EliminatedMembers] = []
    for tile in tiling.tiles:
        linears = [piece.group.linear(blocks, layout.wanted) for piece in tile.pieces]
        cost += sum(linear.cost for linear in linears)
        if not np.isfinite(cost):
            # the step is rejected by its cost, so that nobody needs these sums
            break
        rows = [TileRows.of(linear, tile.members, blocks, layout) for linear in linears]
        part = EliminatedTile(tile.members, blocks[name or ""].free[tile.members], rows, layout.width)
        with suppress(np.linalg.LinAlgError):  # raised again on use; computed now while the rows are cached
            _ = part.reduced
        parts.append(part)
    free = layout.alone(blocks[name]) if name else np.zeros((0, 0), dtype=bool)
    # where tiles hold the members, the other readings have none of them and give to the reduced system only
    parts.append(sums.normals(free[:0] if tiling.tiles else free))
    if name and len(layout.tied):
        parts.append(TiedMembers(layout.tied, layout.columns[name][layout.tied], layout.width))
    return Normals(tuple(parts), shape, float(cost))


def cost_of(tiling: Tiling, blocks: Mapping[str, Block]) -> float:
    """Return the sum of squares of the whitened residuals of all readings."""
    pieces = [*tiling.chunks, *(piece for tile in tiling.tiles for piece in tile.pieces)]
    return float(sum(piece.group.linear(blocks, frozenset()).cost for piece in pieces))


@dataclass(frozen=True)
class TiedMembers(OutsideTiles):
    """Tied members, with their columns in the reduced system."""

    members: Index
    columns: Index
    """(k, s), -1 for fixed entries"""
    width: int

    @property
    def reduced(self) -> tuple[Array, Array, float]:
        """Nothing: their readings are in the reduced system as they are."""
        return np.zeros((self.width, self.width)), np.zeros(self.width), 0.0

    @property
    def diagonal(self) -> Array:
        """Nothing, (width,)."""
        return np.zeros(self.width)

    def damped(self, factor: float) -> TiedMembers:
        """Return the same: their diagonal is damped with that of the reduced system."""
        return self

    def back(self, step: Array) -> Array:
        """Return their part of the step of the reduced unknowns, (k, s)."""
        return np.where(self.columns >= 0, step[np.maximum(self.columns, 0)], 0.0)

    def normals(self) -> Array:
        """Return unit matrices, (k, s, s): the reduced system shows whether they are determined."""
        k, s = self.columns.shape
        return np.tile(np.eye(s), (k, 1, 1))

    def inverse(self) -> Array:
        """Return zeros, (k, s, s): they have no noise beside the reduced unknowns."""
        k, s = self.columns.shape
        return np.zeros((k, s, s))

    def weights(self) -> Array:
        """Return `W = -S`, (k, s, width)."""
        k, s = self.columns.shape
        weights = np.zeros((k, s, self.width))
        at = np.nonzero(self.columns >= 0)
        weights[(*at, self.columns[at])] = -1.0
        return weights

    def covariance(self, reduced: Array) -> Array:
        """Return their covariance, (k, s, s)."""
        free, at = self.columns >= 0, np.maximum(self.columns, 0)
        return np.where(free[:, :, None] & free[:, None, :], reduced[at[:, :, None], at[:, None, :]], 0.0)

    def solved(self, fields: Array) -> Array:
        """Return zeros, as `D^-1 H` of fields H (k, s, f)."""
        return np.zeros(fields.shape)

    def moments(self, fields: Array) -> tuple[Array, Array]:
        """Return `H' W` (f, width), and zeros for `H' D^-1 H` (f, f), of fields H (k, s, f)."""
        f = fields.shape[2]
        flat = fields.reshape(-1, f)
        return flat.T @ self.weights().reshape(len(flat), self.width), np.zeros((f, f))


EliminatedMembers = EliminatedTile | IrregularNormals | TiedMembers
"""Some members of the eliminated block with the elimination of their unknowns"""
