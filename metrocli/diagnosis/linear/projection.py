"""The adjustment as one dense linear system, which separates a change of the readings into two parts.

J are the whitened derivatives by all unknowns. The projector `M = I - J (J'J)^- J'` removes from a signature g the part
that the unknowns absorb. `M g` is visible in the residuals. `J^- g` is the error of the unknowns (external
reliability). M does not depend on the datum.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from metrocli.adjust.datum import open_frame
from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.chain import Link, through
from metrocli.adjust.model.groups import Group, Linear
from metrocli.adjust.model.observations import Index, Mask
from metrocli.adjust.schur.layout import Layout, arrange, without_elimination
from metrocli.diagnosis.linear.basis import Basis, Solver, datum_of, orthonormal_members
from metrocli.effects.model import Model
from metrocli.errors import InputError

VISIBLE = 1e-6
"""Share of a signature below which its visible part is a rounding error"""
FLAT = 1e-8
"""Smallest eigenvalue of a Gram matrix, relative to the largest, of a visible direction of the parameters"""
MOST_NUMBERS = 60_000_000
"""Largest number of elements of the dense system"""


@dataclass(frozen=True)
class System:
    """A model linearised at its values, with one row for each component of each reading, reading by reading."""

    model: Model
    layout: Layout
    residual: Array
    """Whitened residuals (rows,)"""
    basis: Basis
    """Columns b with `b b' = J (J'J)^- J'`"""
    solver: Solver
    """From `b' values` to the unknowns, in the datum of the model"""
    first: Mapping[str, int]
    """The first row of each group"""
    scale: Array
    """Standard deviation of each row in the unit of its reading, (rows,)"""
    sizes: Array
    """Norm of J's column of each unknown, (unknowns,)"""
    runs: dict[str, Run] = field(default_factory=dict, compare=False, repr=False)
    """Cache of the values along the chains, by group"""

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.residual)

    @cached_property
    def dof(self) -> int:
        """Degrees of freedom, the trace of M."""
        return round(self.rows - float(self.basis.squares().sum()))

    @cached_property
    def measured(self) -> Mask:
        """The rows that are readings, not priors."""
        mask = np.zeros(self.rows, dtype=bool)
        for group in self.model.readings:
            mask[self.first[group.name] : self.first[group.name] + group.observations.readings.size] = True
        return mask

    @cached_property
    def alike(self) -> Mask:
        """The rows whose readings have the unit of the first group, in which errors are reported."""
        first, mask = self.model.readings[0].observations.unit, np.zeros(self.rows, dtype=bool)
        for group in self.model.readings:
            start = self.first[group.name]
            mask[start : start + group.observations.readings.size] = group.observations.unit == first
        return mask

    def seen(self, values: Array) -> Array:
        """Return `M values`, (rows, ...), the visible part; 0 where it is a rounding error."""
        return self.split(values)[0]

    def split(self, values: Array) -> tuple[Array, Array]:
        """Return the visible part of values (rows, ...), and the coordinates of the rest in the basis (unknowns, ...).

        The change of the unknowns by the values is `solver.change` of these coordinates.
        """
        inside = self.basis.coordinates(values)
        left = values - self.basis.combined(inside)
        shown = np.linalg.norm(left, axis=0) > VISIBLE * np.linalg.norm(values, axis=0)
        return np.asarray(np.where(shown, left, 0.0)), inside

    def absorbed(self, values: Array) -> Array:
        """Return the change of the unknowns (unknowns, k) that absorbs values (rows, k)."""
        return self.solver.change(self.basis.coordinates(values))

    def spread(self, group: Group, values: Array) -> Array:
        """Return values of readings (n, ...) at all rows of each reading, and 0 elsewhere."""
        d = len(group.observations.readings)
        full = np.zeros((self.rows, *values.shape[1:]))
        start = self.first[group.name]
        full[start : start + d * len(values)] = np.repeat(values, d, axis=0)
        return full

    def run(self, group: Group) -> Run:
        """Return the values and derivatives along the chain of a group."""
        if group.name not in self.runs:
            self.runs[group.name] = run_of(group, self.model.blocks)
        return self.runs[group.name]

    def entries(self, block: str) -> Index:
        """Return the index of each entry of a block among the unknowns, -1 if it is fixed, (members, size)."""
        columns = self.layout.columns.get(block)
        shape = self.model.blocks[block].values.shape
        return np.full(shape, -1, dtype=np.intp) if columns is None else columns

    def shift(self, values: Array, block: str, columns: tuple[int, ...]) -> Array:
        """Return the shift of columns of a block (members, columns, k) by a change of the readings (rows, k).

        The sign is that of the estimates if the readings contain the change and the model does not.
        """
        change = self.absorbed(values)
        places = self.entries(block)[:, list(columns)]
        return np.where((places >= 0)[:, :, None], change[np.maximum(places, 0)], 0.0)

    def shifts(self, values: Array, blocks: Sequence[str], columns: tuple[int, ...]) -> Array:
        """Return `shift` of several blocks, one after the other."""
        return np.concatenate([self.shift(values, block, columns) for block in blocks])


@dataclass(frozen=True)
class Run:
    """The values before each link of a chain, and the derivatives of the reading by them."""

    links: tuple[Link, ...]
    values: tuple[Array, ...]
    """Input (in, n) of each link, then the predicted reading"""
    outer: tuple[Array | None, ...]
    """Derivatives (d, in, n) by the input of each link except the first; None for that of the reading by itself"""


def run_of(group: Group, blocks: Mapping[str, Block]) -> Run:
    """Return the values and derivatives along a chain at the values of the blocks."""
    links, steps = group.chain.links, group.chain.steps(blocks, group.observations, frozenset(blocks))
    outer: list[Array | None] = [None]
    for step in steps[:0:-1]:
        after, by_input = outer[0], step.by_input
        outer.insert(0, by_input if after is None or by_input is None else through(after, by_input))
    return Run(links, (np.zeros((0, group.observations.count)), *(step.value for step in steps)), (None, *outer))


def by_rows(linear: Linear) -> Array:
    """Return the residuals of a group ordered by reading, with the components of a reading side by side."""
    return np.ascontiguousarray(linear.residual.T).ravel()


def linearised(model: Model, weights: Mapping[str, Array] | None = None) -> System:
    """Return the model as a linear system; `weights` (n,) multiply the whitened rows of the readings of a group.

    The unknowns of one block are local: each reading uses one of its members (point, image). Their columns are removed
    member by member; the others are dense. Raises InputError if the dense part would be too large.
    """
    whole, layout = without_elimination(model.blocks), arrange(model.blocks, model.groups)
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
        parts.append(_Rows.of(model, layout, linear).times(factor))
        scales.append(group.observations.deviations.T.ravel() / factor)
    rows = _Rows.joined(parts)
    basis, solver, sizes = _factored(model, layout, whole, rows)
    residual = np.concatenate(residuals)
    system = System(model, whole, residual, basis, solver, first, np.concatenate(scales), sizes)
    return replace(system, residual=system.seen(residual))


@dataclass(frozen=True)
class _Rows:
    """Derivatives of some rows by the unknowns of their local member, and by all shared unknowns."""

    local: Array
    """(rows, size)"""
    member: Index
    shared: Array
    """(rows, width)"""

    @classmethod
    def of(cls, model: Model, layout: Layout, linear: Linear) -> _Rows:
        """Return the rows of a group, ordered by reading."""
        d, n = linear.residual.shape
        block = model.blocks.get(layout.eliminated or "")
        local = np.zeros((n, d, block.size if block is not None else 0))
        member, shared = np.full(n, -1, dtype=np.intp), np.zeros((n, d, layout.width))
        for touch in linear.touches:
            if block is not None and touch.block == block.name:
                local[:] = np.moveaxis(touch.jacobian, -1, 0) * block.free[touch.index][:, None, :]
                member = np.asarray(touch.index)
            else:
                scatter(shared, touch.jacobian, layout.columns[touch.block][touch.index])
        return cls(local.reshape(n * d, local.shape[2]), np.repeat(member, d), shared.reshape(n * d, layout.width))

    def times(self, factor: Array) -> _Rows:
        """Return the rows multiplied by factors."""
        return _Rows(self.local * factor[:, None], self.member, self.shared * factor[:, None])

    @staticmethod
    def joined(parts: Sequence[_Rows]) -> _Rows:
        """Return the rows of all groups."""
        return _Rows(
            np.concatenate([one.local for one in parts]),
            np.concatenate([one.member for one in parts]),
            np.concatenate([one.shared for one in parts]),
        )


def _must_fit(model: Model, layout: Layout) -> None:
    rows = sum(group.observations.readings.size for group in model.groups)
    if rows * max(layout.width, 1) > MOST_NUMBERS:
        raise InputError(
            f"diagnose holds readings and shared unknowns in one table; {rows} readings with {layout.width} unknowns "
            "are too many: diagnose a part of the measurement"
        )


def scatter(full: Array, jacobian: Array, columns: Index) -> None:
    """Add derivatives (d, size, n) to (n, d, width) at each reading's columns (n, size); -1 is nowhere."""
    rows = np.arange(len(full))
    for a in range(columns.shape[1]):
        at = columns[:, a]
        kept = at >= 0
        full[rows[kept], :, at[kept]] += jacobian[:, a, :].T[kept]


def _factored(model: Model, layout: Layout, whole: Layout, rows: _Rows) -> tuple[Basis, Solver, Array]:
    """Return basis, solver and the norm of the column of each unknown."""
    local_block = model.blocks.get(layout.eliminated or "")
    members = len(local_block.members) if local_block is not None else 0
    own, inverses = orthonormal_members(rows.local, rows.member, members)
    before = Basis(own, rows.member, members, np.zeros((len(own), 0)))
    sizes = np.sqrt((rows.shared**2).sum(axis=0))
    scaled = rows.shared / np.where(sizes > 0, sizes, 1.0)
    coupling = before.coordinates(scaled)
    left = scaled - before.combined(coupling)
    # once more, so that rounding does not leave a part of the local columns
    left -= before.combined(before.coordinates(left))
    gram = left.T @ left
    frame = None if model.datum is None else open_frame(model.datum, model.blocks, layout, _unscaled(gram, sizes))
    # a free network leaves as many directions open as its frame has movements
    open_ones = 0 if frame is None else frame.reduced.shape[1]
    u, s, vt = np.linalg.svd(left, full_matrices=False)
    kept = len(s) - open_ones
    factor = np.where(sizes > 0, 1 / np.where(sizes > 0, sizes, 1.0), 0.0)
    shared = factor[:, None] * vt[:kept].T / s[:kept]
    by_member = coupling[: own.shape[1] * members].reshape(members, own.shape[1], layout.width) * np.where(
        sizes > 0, sizes, 1.0
    )
    numbers = np.zeros(layout.width, dtype=np.intp)
    for name, columns in layout.columns.items():
        numbers[columns[columns >= 0]] = whole.columns[name][columns >= 0]
    places = whole.columns[local_block.name] if local_block is not None else np.zeros((0, 0), dtype=np.intp)
    solver = Solver(
        inverses, by_member, shared, (places, numbers), whole.width, *datum_of(frame, layout, whole, model.blocks)
    )
    norms = np.zeros(whole.width)
    norms[numbers] = sizes
    if local_block is not None:
        squares = np.zeros((members + 1, local_block.size))
        np.add.at(squares, rows.member, rows.local**2)
        norms[places[places >= 0]] = np.sqrt(squares[:members][places >= 0])
    return Basis(own, rows.member, members, u[:, :kept]), solver, norms


def _unscaled(gram: Array, sizes: Array) -> Array:
    return gram * sizes * sizes[:, None]
