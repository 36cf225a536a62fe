"""Normal equations with one block eliminated member by member (Schur complement).

With e the unknowns of the eliminated block (block-diagonal D) and r the rest, the normal matrix is [[D, B], [B', N]];
the reduced system is `S = N - B' D^-1 B`. Cost grows linearly with readings and with members of the eliminated block.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from metrocli.adjust.blocks import Array, Block
from metrocli.adjust.eliminated import Eliminated, Rows
from metrocli.adjust.gathered import Sums
from metrocli.adjust.groups import Group
from metrocli.adjust.layout import Layout
from metrocli.adjust.observations import Index
from metrocli.adjust.portions import Split


class Part(Protocol):
    """Members of the eliminated block, with what their elimination takes from the reduced system and gives back."""

    @property
    def members(self) -> Index | slice:
        """Which members, (k,)"""

    def damped(self, factor: float) -> Part:
        """Return the same with the diagonal of D enlarged by `1 + factor`."""

    @property
    def loss(self) -> tuple[Array, Array]:
        """`B' D^-1 B` and `B' D^-1 right`; LinAlgError where D is singular."""

    def back(self, step: Array) -> Array:
        """Return the members' own step, `D^-1 (right - B step)`, (k, s)."""

    def fall(self, step: Array) -> float:
        """Return the right side times a step (k, s)."""

    def normals(self) -> Array:
        """Return D, (k, s, s)."""

    def inverse(self) -> Array:
        """Return D^-1 with zeros at fixed entries, (k, s, s)."""

    def weights(self) -> Array:
        """Return `W = D^-1 B`: what the members lose for each unit of the others, (k, s, width)."""

    def covariance(self, reduced: Array) -> Array:
        """Return `D^-1 + W Q W'` of each member, (k, s, s)."""

    def moments(self, fields: Array) -> tuple[Array, Array, Array]:
        """Return `H' W`, `H' D^-1 H` and `D^-1 H` of fields H (k, s, f): (f, width), (f, f), (k, s, f)."""


@dataclass(frozen=True)
class Normals:
    """The parts of the normal matrix and of the right side `J' r`, all in whitened readings."""

    parts: tuple[Part, ...]
    shape: tuple[int, int]
    """Of the eliminated block, (members, s)"""
    n: Array
    """(width, width)"""
    right: Array
    """Right side of the reduced unknowns before elimination, (width,)"""
    cost: float

    def reduced(self) -> tuple[Array, Array]:
        """Return `S = N - B' D^-1 B` and its right side; LinAlgError where a member is singular."""
        matrix, right = self.n.copy(), self.right.copy()
        for part in self.parts:
            matrix -= part.loss[0]
            right -= part.loss[1]
        return matrix, right

    def damped(self, factor: float) -> Normals:
        """Return the normals with their diagonal enlarged by `1 + factor` (Marquardt)."""
        n, diagonal = self.n.copy(), np.diag(self.n)
        n[np.diag_indices_from(n)] += factor * np.where(diagonal > 0, diagonal, 1.0)
        return replace(self, parts=tuple(part.damped(factor) for part in self.parts), n=n)

    def back(self, step: Array) -> Array:
        """Return the step of the eliminated unknowns, `D^-1 (right - B step)`, (members, s)."""
        steps = np.zeros(self.shape)
        for part in self.parts:
            steps[part.members] = part.back(step)
        return steps

    def following(self, step: Array) -> Array:
        """Return `W step`: how far the eliminated unknowns go against a step of the others, (members, s)."""
        steps = np.zeros(self.shape)
        for part in self.parts:
            steps[part.members] = part.weights() @ step
        return steps

    def fall(self, step: Array, steps: Array) -> float:
        """Return the right side times a step (width,) and (members, s): the fall that the step promises, twofold."""
        return float(self.right @ step) + sum(part.fall(steps[part.members]) for part in self.parts)


def assemble(groups: Sequence[Group], split: Split, blocks: Mapping[str, Block], layout: Layout) -> Normals:
    """Linearise all groups and sum their normal equations; a cost that is no number ends it before the sums."""
    name = layout.eliminated
    shape = blocks[name].values.shape if name else (0, 0)
    sums = Sums.empty(0 if split.portions else shape[0], shape[1], layout.width)
    cost = 0.0
    for place in split.whole:
        linear = groups[place].linear(blocks, layout.wanted)
        cost += linear.cost
        sums.add(linear, blocks, layout)
    matrix, right = np.pad(sums.n, (0, 1)), np.append(sums.right_r, 0.0)
    parts: list[Part] = []
    for portion in split.portions:
        linears = [piece.group.linear(blocks, layout.wanted) for piece in portion.pieces]
        cost += sum(linear.cost for linear in linears)
        if not np.isfinite(cost):
            break
        rows = [Rows.of(linear, portion.members, blocks, layout) for linear in linears]
        part = Eliminated(portion.members, blocks[name or ""].free[portion.members], rows, layout.width)
        part.add(matrix, right)
        with suppress(np.linalg.LinAlgError):  # told when it is asked for; found here, while the rows are in the cache
            _ = part.loss
        parts.append(part)
    if not split.portions:
        parts.append(sums.gathered(blocks[name].free if name else np.zeros((0, 0), dtype=bool)))
    return Normals(tuple(parts), shape, matrix[:-1, :-1], right[:-1], float(cost))


def cost_of(groups: Sequence[Group], split: Split, blocks: Mapping[str, Block]) -> float:
    """Return the sum of squares of the whitened residuals of all groups."""
    chosen = [groups[place] for place in split.whole]
    chosen += [piece.group for portion in split.portions for piece in portion.pieces]
    return float(sum(group.linear(blocks, frozenset()).cost for group in chosen))
