"""A model as a linear system: local unknowns are removed member by member, the shared ones are dense.

Method: docs/algorithms/what-can-be-seen.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.datum import Frame, open_frame, placed_movements
from metrocli.adjust.decompositions import orthonormalised, thin_svd
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.groups import LinearGroup
from metrocli.adjust.model.observations import Index, Mask
from metrocli.adjust.schur.layout import Layout, tied_members, without_elimination
from metrocli.diagnosis.linear.basis import Basis, members_of_equal_size
from metrocli.diagnosis.linear.projection import MOST_NUMBERS, Linearised, by_rows, scatter
from metrocli.diagnosis.linear.quadratics import triangular
from metrocli.diagnosis.linear.solver import Solver
from metrocli.effects.model import Model
from metrocli.errors import InputError
from metrocli.frozen import dataclass

_DEPENDENT = 1e-10
"""Singular value of a member's scaled columns, relative to the largest, below which a direction is not seen"""
_WELL = 1e-5
"""Singular value of unit columns that the Gram matrix still resolves; those that a datum leaves open are 0"""


def linearised(model: Model, weights: Mapping[str, Array] | None = None) -> Linearised:
    """Return the model as a linear system; `weights` (n,) multiply the whitened rows of the readings of a group.

    The unknowns of one block are local: each reading uses one of its members (point, image). Their columns are removed
    member by member; the others are dense. Raises InputError if the dense part would be too large.
    """
    whole, local = without_elimination(model.blocks), local_members(model)
    layout = _shared(model, local)
    _must_fit(model, layout)
    residuals, parts, scales, first, place = [], [], [], {}, 0
    for group in model.groups:
        linear = group.linear(model.blocks, whole.wanted)
        d, n = linear.residual.shape
        own = None if weights is None else weights.get(group.name)
        factor = np.repeat(np.ones(n) if own is None else own, d)
        first[group.name] = place
        place += n * d
        residuals.append(by_rows(linear) * factor)
        parts.append(_Rows.of(local, layout, linear).times(None if own is None else factor))
        scales.append(group.observations.deviations.T.ravel() / factor)
    rows = _Rows.joined(parts)
    basis, solver, sizes = _factored(model, local, layout, whole, rows)
    residual = np.concatenate(residuals)
    system = Linearised(model, whole, residual, basis, solver, first, np.concatenate(scales), sizes)
    return replace(system, residual=system.seen(residual))


def shared_unknowns(model: Model) -> int:
    """Return the number of unknowns that are not local."""
    return _shared(model, local_members(model)).width


@dataclass(frozen=True)
class LocalMembers:
    """The members of a block whose unknowns are local: no reading uses two of them."""

    block: Block | None
    members: Mask
    """Which members are local, (members,)"""


_NOBODY = np.zeros(0, dtype=bool)


def local_members(model: Model) -> LocalMembers:
    """Return the block with the most unknowns in members of which no reading and no condition uses two."""
    blocks = [block for block in model.blocks.values() if len(block.members) > 1]
    tied = [(block, tied_members(block, model.groups)) for block in blocks]
    apart = [(block, _without(block, members)) for block, members in tied if members is not None]
    block, local = max(apart, key=lambda pair: int(pair[0].free[pair[1]].sum()), default=(None, _NOBODY))
    if block is None or not block.free[local].any():
        return LocalMembers(None, _NOBODY)
    return LocalMembers(block, local)


def _without(block: Block, tied: Index) -> Mask:
    """Return the members of a block that are not tied, (members,)."""
    local = np.ones(len(block.members), dtype=bool)
    local[tied] = False
    return local


def _shared(model: Model, local: LocalMembers) -> Layout:
    """Return the numbers of the unknowns that are not local."""
    if local.block is None:
        return without_elimination(model.blocks)
    rest = local.block.free & ~local.members[:, None]
    return without_elimination({**model.blocks, local.block.name: replace(local.block, free=rest)})


@dataclass(frozen=True)
class _Rows:
    """Derivatives of some rows by the unknowns of their local member, and by all shared unknowns."""

    local: Array
    """(rows, size)"""
    member: Index
    shared: Array
    """(rows, width)"""

    @classmethod
    def of(cls, local: LocalMembers, layout: Layout, linear: LinearGroup) -> _Rows:
        """Return the rows of a group, ordered by reading."""
        d, n = linear.residual.shape
        block = local.block
        own = np.zeros((n, d, block.size if block is not None else 0))
        member, shared = np.full(n, -1, dtype=np.intp), np.zeros((n, d, layout.width))
        for touch in linear.touches:
            if block is not None and touch.block == block.name:
                here = local.members[touch.index]
                # fixed entries have no column, so that the shared columns must not be freed of them
                own[here] = (np.moveaxis(touch.jacobian, -1, 0) * block.free[touch.index][:, None, :])[here]
                member[here] = touch.index[here]
            if touch.block in layout.columns:
                scatter(shared, touch.jacobian, layout.columns[touch.block][touch.index])
        return cls(own.reshape(n * d, own.shape[2]), np.repeat(member, d), shared.reshape(n * d, layout.width))

    def times(self, factor: Array | None) -> _Rows:
        """Return the rows multiplied by factors, None for 1."""
        if factor is None:
            return self
        return _Rows(self.local * factor[:, None], self.member, self.shared * factor[:, None])

    @staticmethod
    def joined(parts: Sequence[_Rows]) -> _Rows:
        """Return the rows of all groups."""
        if len(parts) == 1:
            return parts[0]
        return _Rows(
            np.concatenate([rows.local for rows in parts]),
            np.concatenate([rows.member for rows in parts]),
            np.concatenate([rows.shared for rows in parts]),
        )


def _must_fit(model: Model, layout: Layout) -> None:
    rows = sum(group.observations.readings.size for group in model.groups)
    if rows * max(layout.width, 1) > MOST_NUMBERS:
        raise InputError(
            f"diagnose holds readings and shared unknowns in one table; {rows} readings with {layout.width} unknowns "
            "are too many: diagnose a part of the measurement"
        )


def _factored(
    model: Model, local: LocalMembers, layout: Layout, whole: Layout, rows: _Rows
) -> tuple[Basis, Solver, Array]:
    """Return basis, solver and the norm of the column of each unknown."""
    members = len(local.members)
    own, inverses = _orthonormal_members(rows.local, rows.member, members)
    before = Basis(own, rows.member, members, np.zeros((len(own), 0)))
    sizes = np.sqrt(np.einsum("rk,rk->k", rows.shared, rows.shared))
    # many readings: the columns are turned where they are, without a second table of their size
    left = rows.shared
    left /= np.where(sizes > 0, sizes, 1.0)
    coupling = before.coordinates(left)
    before.take_from(left, coupling)
    # once more, so that rounding does not leave a part of the local columns
    before.take_from(left, before.coordinates(left))
    gram = left.T @ left
    reduced = gram * sizes * sizes[:, None]
    frame = None if model.datum is None else open_frame(model.datum, model.blocks, layout, reduced, sizes**2)
    # a free network leaves as many directions open as its frame has movements
    open_ones = 0 if frame is None else frame.reduced.shape[1]
    unit, turn = _orthonormal(left, gram, left.shape[1] - open_ones)
    # an unknown that no reading shows has a column of 0; its change is 0, and not 0/0
    factor = np.where(sizes > 0, 1 / np.where(sizes > 0, sizes, 1.0), 0.0)
    shared = factor[:, None] * turn
    by_member = coupling[: own.shape[1] * members].reshape(members, own.shape[1], layout.width) * np.where(
        sizes > 0, sizes, 1.0
    )
    numbers = np.zeros(layout.width, dtype=np.intp)
    for name, columns in layout.columns.items():
        numbers[columns[columns >= 0]] = whole.columns[name][columns >= 0]
    places = np.zeros((0, 0), dtype=np.intp)
    if local.block is not None:
        places = np.where(local.members[:, None], whole.columns[local.block.name], -1)
    datum = _datum_of(frame, whole, model.blocks)
    solver = Solver(inverses, by_member, shared, (places, numbers), whole.width, *datum)
    norms = np.zeros(whole.width)
    norms[numbers] = sizes
    squares = np.zeros((members + 1, rows.local.shape[1]))
    np.add.at(squares, rows.member, rows.local**2)
    norms[places[places >= 0]] = np.sqrt(squares[:members][places >= 0])
    return Basis(own, rows.member, members, unit), solver, norms


def _orthonormal_members(columns: Array, member: Index, members: int) -> tuple[Array, Array]:
    """Return orthonormal local columns (rows, q) and the inverses (members, q, q): `unknowns = inverse coordinates`.

    `columns` (rows, q) are the derivatives of each row by the unknowns of its member. Directions that no row of a
    member shows have zero columns.
    """
    rows, q = columns.shape
    basis, inverses = np.zeros((rows, q)), np.zeros((members, q, q))
    for chosen, at in members_of_equal_size(member, members):
        size = np.linalg.norm(columns[at], axis=1)
        size = np.where(size > 0, size, 1.0)
        unit = columns[at] / size[:, None, :]
        # Cholesky factors take a fifth of the time of an SVD; twice, so that rounding leaves nothing of the first
        first, weak = triangular(np.swapaxes(unit, 1, 2) @ unit)
        first[weak] = 0.0
        left = unit @ first
        again, _ = triangular(np.swapaxes(left, 1, 2) @ left)
        basis[at], inverses[chosen] = left @ again, first @ again / size[:, :, None]
        if weak.any():
            u, s, vt = np.linalg.svd(unit[weak], full_matrices=False)
            seen = s > _DEPENDENT * np.maximum(s[:, :1], 1e-300)
            most = u.shape[2]
            basis[at[weak].ravel()[:, None], np.arange(most)] = (u * seen[:, None, :]).reshape(-1, most)
            inverse = np.swapaxes(vt, 1, 2) * np.where(seen, 1 / np.where(seen, s, 1.0), 0.0)[:, None, :]
            inverses[chosen[weak], :, :most] = inverse / size[weak, :, None]
    return basis, inverses


def _orthonormal(columns: Array, gram: Array, rank: int) -> tuple[Array, Array]:
    """Return an orthonormal basis (rows, rank) of columns (rows, q), and the turn (q, rank) that gives it."""
    unit, turn = orthonormalised(columns, _WELL, gram)
    # the Gram matrix has lost the digits that tell the last directions from the open ones; the SVD keeps them
    if turn.shape[1] != rank:
        u, s, vt = thin_svd(columns)
        unit, turn = u[:, :rank], vt[:rank].T / s[:rank]
    return unit, turn


def _datum_of(frame: Frame | None, layout: Layout, blocks: Mapping[str, Block]) -> tuple[Array, Array]:
    """Return movements (unknowns, m) and conditions (m, unknowns) of a frame, in the numbers of a whole layout."""
    if frame is None:
        return np.zeros((layout.width, 0)), np.zeros((0, layout.width))
    return placed_movements(frame.moves, blocks, layout, frame.reduced.shape[1]), frame.conditions(layout)
