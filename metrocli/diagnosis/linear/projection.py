"""The adjustment as one dense linear system, which separates a change of the readings into two parts.

J are the whitened derivatives by all unknowns. The projector `M = I - J (J'J)^- J'` removes from a signature g the part
that the unknowns absorb. `M g` is visible in the residuals. `J^- g` is the error of the unknowns (external
reliability). M does not depend on the datum.

Method: docs/algorithms/what-can-be-seen.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.derivatives import through
from metrocli.adjust.model.groups import Group, LinearGroup
from metrocli.adjust.model.observations import Index, Mask
from metrocli.adjust.schur.layout import Layout
from metrocli.diagnosis.linear.basis import Basis
from metrocli.diagnosis.linear.solver import Solver
from metrocli.effects.model import Model
from metrocli.effects.variance_groups import READING as READING
from metrocli.frozen import dataclass

VISIBLE = 1e-6
"""Share of a signature below which its visible part is a rounding error"""
FEWEST = 10
"""Fewest readings, or prior values, of a group whose noise is tested: fewer show too little of their spread"""
FLAT = 1e-8
"""Smallest eigenvalue of a Gram matrix, relative to the largest, of a visible direction of the parameters"""
MOST_NUMBERS = 60_000_000
"""Largest number of elements of the shared derivatives, and of the columns that are fitted beside them"""
MOST_OF_STATE = MOST_NUMBERS // 2
"""That of the columns of a state, a further correlated error included: more copies of these are held"""


@dataclass(frozen=True)
class Linearised:
    """A model linearised at its values, with one row for each component of each reading, reading by reading."""

    model: Model
    layout: Layout
    residual: Array
    """Whitened residuals (rows,)"""
    basis: Basis
    """Columns b with `b b' = J (J'J)^- J'`"""
    solver_of_model: Solver
    """From `b' values` to the unknowns, in the datum of the model, by the basis before its rows were weighted"""
    first: Mapping[str, int]
    """The first row of each group"""
    scale: Array
    """Standard deviation of each row in the unit of its reading, (rows,)"""
    sizes: Array
    """Norm of J's column of each unknown, (unknowns,)"""
    unweighted: Linearised | None = None
    """The system before its rows were multiplied by weights; None if it is this one"""
    runs: dict[str, ChainValues] = field(default_factory=dict, compare=False, repr=False)
    """Cache of the values along the chains, by group"""
    sets_of_rows: list[Index] = field(default_factory=list, compare=False, repr=False)
    """The sets of rows that candidates change: those of a tracer are the same for many"""

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.residual)

    @cached_property
    def solver(self) -> Solver:
        """From `b' values` to the unknowns, in the datum of the model; most weights that are tried never need it."""
        bare = self.unweighted
        if bare is None:
            return self.solver_of_model
        sizes = bare.sizes[self.solver_of_model.places[1]]
        return self.solver_of_model.weighted(bare.basis, self.basis, bare.scale / self.scale, sizes)

    @cached_property
    def dof(self) -> int:
        """Degrees of freedom, the trace of M."""
        # the trace is a whole number but for rounding: each direction counts as one
        return round(self.rows - self.basis.trace)

    @cached_property
    def typical_scale(self) -> float:
        """The median standard deviation of the rows that are readings."""
        return float(np.median(np.concatenate([self.scale[self.stretch(group)] for group in self.model.readings])))

    def stretch(self, group: Group) -> slice:
        """Return the rows of a group, which follow each other."""
        first = self.first[group.name]
        return slice(first, first + group.observations.readings.size)

    def rows_of(self, group: Group) -> Mask:
        """Return the rows of a group as a mask of all, (rows,)."""
        mask = np.zeros(self.rows, dtype=bool)
        mask[self.stretch(group)] = True
        return mask

    def weights_of(self, group: Group) -> Array:
        """Return the factors of the rows of a group beside the noise that the group states, (rows of the group,)."""
        return np.asarray(group.observations.deviations.T.ravel() / self.scale[self.stretch(group)])

    @cached_property
    def in_reported_unit(self) -> Mask:
        """The rows whose readings have the unit of the first group, in which errors are reported."""
        return self.rows_in_units[self.model.readings[0].observations.unit_of_each[0]]

    @cached_property
    def rows_in_units(self) -> Mapping[str, Mask]:
        """The rows of the readings, or of their components, in each internal unit."""
        masks: dict[str, Mask] = {}
        for group in self.model.readings:
            names = np.array(group.observations.unit_of_each)
            for unit in dict.fromkeys(names.tolist()):
                mask = masks.setdefault(unit, np.zeros(self.rows, dtype=bool))
                mask[self.stretch(group)] = np.tile(names == unit, group.observations.count)
        return masks

    def showing(self, change: Array) -> tuple[str, Mask]:
        """Return the unit of the readings that show most of a change (rows,), whitened, and their rows.

        Angles may show nothing of a law of distances.
        """
        return max(self.rows_in_units.items(), key=lambda unit_rows: float((change[unit_rows[1]] ** 2).sum()))

    @cached_property
    def times(self) -> Array:
        """The time of each row's reading (rows,); nan for readings without a time."""
        times = np.full(self.rows, np.nan)
        for group in self.model.readings:
            own = group.observations.conditions.get("t")
            if own is not None:
                times[self.stretch(group)] = np.repeat(own, len(group.observations.readings))
        return times

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

    def is_local(self, block: str) -> bool:
        """Return whether the unknowns of a block are removed member by member."""
        places = self.solver_of_model.places[0]
        return places.size > 0 and bool(np.isin(places[places >= 0], self.entries(block)).all())

    def absorbed(self, values: Array) -> Array:
        """Return the change of the unknowns (unknowns, k) that absorbs values (rows, k).

        The sign is that of the estimates if the readings contain the values and the model does not.
        """
        return self.solver.change(self.basis.coordinates(values))

    def spread(self, group: Group, values: Array) -> Array:
        """Return values of readings (n, ...) at all rows of each reading, and 0 elsewhere."""
        full = np.zeros((self.rows, *values.shape[1:]))
        full[self.stretch(group)] = np.repeat(values, len(group.observations.readings), axis=0)
        return full

    def rows_at(self, where: Mapping[str, str]) -> Mask:
        """Return the rows of the readings at a place, such as those of one tracer; an axis or an encoder has none."""
        rows = np.zeros(self.rows, dtype=bool)
        for group in self.model.readings:
            inside = np.ones(group.observations.count)
            for key, name in where.items():
                place = self.model.places[key]
                index = group.observations.index.get(place.index)
                inside *= 0.0 if index is None else index == place.names.index(name)
            rows |= self.spread(group, inside) > 0
        return rows

    def same_rows(self, rows: Index) -> Index:
        """Return the set of rows that equals some rows, which is held once."""
        same = next((row for row in self.sets_of_rows if np.array_equal(row, rows)), None)
        if same is None:
            self.sets_of_rows.append(rows)
        return rows if same is None else same

    def run(self, group: Group) -> ChainValues:
        """Return the values and derivatives along the chain of a group."""
        if group.name not in self.runs:
            self.runs[group.name] = run_of(group, self.model.blocks)
        return self.runs[group.name]

    def entries(self, block: str) -> Index:
        """Return the index of each entry of a block among the unknowns, -1 if it is fixed, (members, size)."""
        columns = self.layout.columns.get(block)
        shape = self.model.blocks[block].values.shape
        return np.full(shape, -1, dtype=np.intp) if columns is None else columns

    def shift(self, change: Array, block: str, columns: tuple[int, ...]) -> Array:
        """Return the change of columns of a block (members, columns, ...) by that of the unknowns (unknowns, ...)."""
        places = self.entries(block)[:, list(columns)]
        shifts = change[np.maximum(places, 0)]
        # held entries have no place among the unknowns, and do not move
        shifts[places < 0] = 0.0
        return np.asarray(shifts)


@dataclass(frozen=True)
class ChainValues:
    """The values before each link of a chain, and the derivatives of the reading by them."""

    values: tuple[Array, ...]
    """Input (in, n) of each link, then the predicted reading"""
    outer: tuple[Array | None, ...]
    """Derivatives (d, in, n) by the input of each link except the first; None for that of the reading by itself"""


def run_of(group: Group, blocks: Mapping[str, Block]) -> ChainValues:
    """Return the values and derivatives along a chain at the values of the blocks."""
    steps = group.chain.steps(blocks, group.observations, frozenset(blocks))
    outer: list[Array | None] = [None]
    # without the first link, which has no input
    for step in steps[:0:-1]:
        after, by_input = outer[0], step.by_input
        outer.insert(0, after if by_input is None else by_input if after is None else through(after, by_input))
    return ChainValues((np.zeros((0, group.observations.count)), *(step.value for step in steps)), (None, *outer))


def by_rows(linear: LinearGroup) -> Array:
    """Return the residuals of a group ordered by reading, with the components of a reading side by side."""
    return np.ascontiguousarray(linear.residual.T).ravel()


def scatter(full: Array, jacobian: Array, columns: Index) -> None:
    """Add derivatives (d, size, n) to (n, d, width) at each reading's columns (n, size); -1 is nowhere."""
    rows = np.arange(len(full))
    for a in range(columns.shape[1]):
        at = columns[:, a]
        kept = at >= 0
        # all readings use the same member: a slice is added to, which is several times faster than gathered rows
        if len(at) and at[0] >= 0 and (at == at[0]).all():
            full[:, :, at[0]] += jacobian[:, a, :].T
        else:
            full[rows[kept], :, at[kept]] += jacobian[:, a, :].T[kept]
