"""Covariance of any block from the factors of the normal equations, without the inverse of the whole matrix.

With W = D^-1 B and Q_r the covariance of the reduced unknowns, `Q_er = -W Q_r` and `Q_ee = D^-1 + W Q_r W'`. With Q_r
in the chosen datum these hold in that datum, unless the datum depends on the eliminated members. For inner
constraints on these members the terms of `Gauge` are added. Method: docs/algorithms/free-networks.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.schur.layout import Layout
from metrocli.adjust.schur.member_covariance import MemberCovariance
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Covariance:
    """Covariance of all unknowns, returned block by block."""

    layout: Layout
    shapes: Mapping[str, tuple[int, int]]
    reduced: Array
    """(width, width)"""
    eliminated: MemberCovariance
    """Covariance of the eliminated block"""
    factor: float = 1.0
    """sigma0^2 if the noise is estimated, else 1"""
    _members: dict[str, Array] = field(default_factory=dict, init=False, repr=False, compare=False)
    """Covariances of the members of a block, once they are asked for"""

    def scaled(self, factor: float) -> Covariance:
        """Return the covariance multiplied by `factor`."""
        return replace(self, factor=self.factor * factor)

    def of(self, name: str) -> Array:
        """Return the full covariance of a block, (members*size, members*size), zero for fixed entries."""
        return self.between(name, name)

    def between(self, name: str, other: str) -> Array:
        """Return the covariance between all entries of two blocks, (members*size, members*size)."""
        if self.layout.eliminated == name == other:
            m, s = self.shapes[name]
            members = self.eliminated
            flat = members.weights.reshape(m * s, self.layout.width)
            full = flat @ self.reduced @ flat.T
            view = full.reshape(m, s, m, s)
            # index arrays with a slice between them come first in the result, (m, s, s): the diagonal blocks
            view[np.arange(m), :, np.arange(m), :] += members.inverse
            if members.gauge is not None:
                shared = members.gauge.moves.reshape(m * s, -1) @ members.share.reshape(m * s, -1).T
                full -= shared + shared.T
            return self.factor * full
        if other == self.layout.eliminated:
            return self.between(other, name).T
        rows = -self._cross if name == self.layout.eliminated else self._rows(name, self.reduced)
        m, s = self.shapes[name]
        return self.factor * self._columns(other, rows.reshape(m * s, self.layout.width))

    def members(self, name: str) -> Array:
        """Return the covariance of each member of a block, (members, size, size), the same array each time."""
        if name not in self._members:
            covariance = self._of_members(name)
            covariance.setflags(write=False)
            self._members[name] = covariance
        return self._members[name]

    def _of_members(self, name: str) -> Array:
        m, s = self.shapes[name]
        if name == self.layout.eliminated:
            return self.factor * self.eliminated.covariance
        columns = self.layout.columns.get(name)
        if columns is None:
            return np.zeros((m, s, s))
        inside = (columns >= 0)[:, :, None] & (columns >= 0)[:, None, :]
        return self.factor * np.where(inside, self.reduced[columns[:, :, None], columns[:, None, :]], 0.0)

    def pairs(self, name: str, index: Index, other: str, other_index: Index) -> Array:
        """Return the covariance of chosen pairs of members of two blocks, (size, size', n).

        n is 1 if both blocks have one member.
        """
        solved = {self.layout.eliminated, *self.layout.columns}
        if not {name, other} <= solved:
            return np.zeros((self.shapes[name][1], self.shapes[other][1], len(index)))
        if other == self.layout.eliminated and name != other:
            return np.swapaxes(self.pairs(other, other_index, name, index), 0, 1)
        if name == other == self.layout.eliminated:
            same = index == other_index
            if same.all():
                # the usual case, a reading with the member that it uses: no second table is made
                return self.factor * _at(self.eliminated.covariance, index)
            apart = np.moveaxis(self.apart(name, index, other_index), 0, -1)
            return np.where(same, self.factor * _at(self.eliminated.covariance, index), apart)
        others, within = self._places(other, other_index)
        if name == self.layout.eliminated:
            rows = -self._cross
            if len(others) == 1:
                chosen: Array = self.factor * within[0][:, None] * _at(rows, index)[:, others[0]]
                return chosen
            picked = rows[index[:, None, None], np.arange(rows.shape[1])[None, :, None], others[:, None, :]]
            return self.factor * np.moveaxis(picked * within[:, None, :], 0, -1)
        columns, inside = self._places(name, index)
        # fixed entries have column -1: they are read at 0 and multiplied by False
        picked = self.reduced[columns[:, :, None], others[:, None, :]] * (inside[:, :, None] & within[:, None, :])
        covariance: Array = self.factor * np.moveaxis(picked, 0, -1)
        return covariance

    def apart(self, name: str, index: Index, other: Index) -> Array:
        """Return the covariance of members `index` (n,) with members `other` (n,) of one block, (n, size, size).

        The members of a pair differ.
        """
        if name != self.layout.eliminated:
            return np.moveaxis(self.pairs(name, index, name, other), -1, 0)
        members = self.eliminated
        covariance = members.weights[index] @ self.reduced @ np.swapaxes(members.weights[other], 1, 2)
        if members.gauge is not None:
            moves, share = members.gauge.moves, members.share
            covariance = (
                covariance
                - moves[index] @ np.swapaxes(share[other], 1, 2)
                - share[index] @ np.swapaxes(moves[other], 1, 2)
            )
        return self.factor * covariance

    @cached_property
    def _cross(self) -> Array:
        """Minus the covariance of the eliminated members with the reduced unknowns, (members, s, width)."""
        members = self.eliminated
        product: Array = members.weights @ self.reduced
        return product if members.gauge is None else product + members.share @ members.gauge.reduced.T

    def _places(self, name: str, index: Index) -> tuple[Index, Mask]:
        columns = self.layout.columns[name]
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


def _at(per_member: Array, index: Index) -> Array:
    """Return the matrices of the members that readings use, (members, a, b) -> (a, b, n)."""
    first, last = index.min(initial=len(per_member)), index.max(initial=-1)
    few = np.ascontiguousarray(np.moveaxis(per_member[first : last + 1], 0, -1))
    chosen: Array = few.take(index - first, axis=-1, mode="clip")
    return chosen


def shapes_of(blocks: Mapping[str, Block]) -> dict[str, tuple[int, int]]:
    """Return (members, size) of each block."""
    return {name: (len(block.members), block.size) for name, block in blocks.items()}
