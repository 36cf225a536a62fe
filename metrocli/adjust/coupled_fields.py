"""Adjustment of two fields that stay coupled, e.g. the errors of a machine and of an artefact in many views.

There are three sorts of unknowns: `local` ones l, of which no reading uses two (eliminated one by one), those of the
`net` g (sparse Cholesky), and the few others of the border b (dense). With D the diagonal block of l, the net is left
with `S = N_gg - N_gl D^-1 N_lg`; eliminating l and g leaves a small dense matrix T for the border. The factor of S
takes nearly all the time.

The normal matrix is computed once, at a stated design; the gradient is exact, so the iteration ends at the minimum
under the conditions of the datum. What the design leaves undetermined is computed first; the conditions alone fix it.
Method: docs/algorithms/nested-dissection.md and docs/algorithms/free-networks.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, LinearGroup
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.solution import Residuals, Solution
from metrocli.adjust.sparse.bordered_factor import BorderedFactor, bordered_factor
from metrocli.adjust.sparse.nested_dissection import Sparse
from metrocli.adjust.sparse.partition import Partition, gradient, jacobian, partition
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass

_MOST_STEPS = 60
_MOST_HALVINGS = 12
_ROUNDING = 1e-13
"""Predicted fall of the sum of squares that is rounding, relative to it"""


@dataclass(frozen=True)
class Fields:
    """Two coupled fields with their readings."""

    blocks: Mapping[str, Block]
    groups: tuple[Group, ...]
    net: str
    local: str
    places: Array
    """Integer coordinates of the members, (members, size, k): readings couple unknowns with close coordinates"""
    design: Callable[[Mapping[str, Block]], Mapping[str, Block]]
    """Function from the blocks to the values at which rank, datum and covariance are computed"""
    conditions: Mapping[str, Array]
    """The datum: for some blocks the coefficients (conditions, members, size) of sums that are to be zero"""


@dataclass(frozen=True)
class FieldDesign:
    """Rank, null space and covariance of a design; they do not depend on the readings."""

    partition: Partition
    jacobian: Sparse
    """Derivatives of all whitened readings by all unknowns, group after group, (d*n, unknowns)"""
    reduction: BorderedFactor
    constraint: Array
    """H, (k, unknowns), with `H Z = I`: the step `-Z H x` restores the conditions"""

    @property
    def null(self) -> Array:
        """Z, the directions that no reading determines, (unknowns, k)."""
        return self.reduction.null

    @cached_property
    def _gauge(self) -> tuple[Array, Array]:
        """`P = Q H'` and `H P`, with Q the inverse before the datum is applied."""
        p = self.reduction.solve(self.constraint.T)
        return p, self.constraint @ p

    def solve(self, right: Array) -> Array:
        """Return the covariance times `right`, `(I - Z H) Q (I - Z H)' right`, (unknowns,) or (unknowns, k)."""
        solved = self.reduction.solve(right - self.constraint.T @ (self.null.T @ right))
        return solved - self.null @ (self.constraint @ solved)

    def variances(self, rows: Sparse) -> Array:
        """Return the variances of sparse linear combinations R of unknowns, (n,).

        `diag(R (I - Z H) Q (I - Z H)' R') = diag(R Q R' - 2 R Z (R P)' + R Z H P (R Z)')`. Each row of R may only
        combine unknowns that a reading couples, because only these entries of Q are known.
        """
        by_null, by_gauge, gauge = self._in_datum(rows)
        variances = self.reduction.variances(rows)
        variances -= 2 * np.einsum("nk,nk->n", by_null, by_gauge)
        variances += np.einsum("nk,kl,nl->n", by_null, gauge, by_null)
        # rounding of the difference must not make a variance negative
        return np.maximum(variances, 0.0)

    def covariance(self, rows: Sparse) -> Array:
        """Return the covariance of any linear combinations of unknowns, (n, n), with forward solutions only."""
        by_null, by_gauge, gauge = self._in_datum(rows)
        cross = by_null @ by_gauge.T
        return self.reduction.covariance(rows) - cross - cross.T + by_null @ gauge @ by_null.T

    def _in_datum(self, rows: Sparse) -> tuple[Array, Array, Array]:
        """Return R Z, R P and H P: what the datum's part of the covariance of rows R consists of."""
        p, gauge = self._gauge
        return np.asarray(rows @ self.null), np.asarray(rows @ p), gauge

    def std(self, block: str) -> Array:
        """Return the standard uncertainties of a block, (members, size), nan for fixed entries."""
        from scipy.sparse import eye_array

        columns = self.partition.columns[block]
        free = columns >= 0
        rows = eye_array(self.partition.width, format="csr")[columns[free]]
        std = np.full(columns.shape, np.nan)
        std[free] = np.sqrt(self.variances(rows))
        return std

    def redundancy(self) -> Array:
        """Return the redundancy numbers `1 - diag(J Q J')`, in the order of the rows of the Jacobian."""
        return np.clip(1.0 - self.reduction.variances(self.jacobian), 0.0, 1.0)


@dataclass(frozen=True)
class CorrelatedDesign(FieldDesign):
    """A design whose readings have correlated errors, with the covariance of all unknowns as one table."""

    matrix: Array
    """(unknowns, unknowns)"""

    def variances(self, rows: Sparse) -> Array:
        """Return the variances of any sparse linear combinations of unknowns, (n,)."""
        return np.asarray((rows.multiply(rows @ self.matrix)).sum(axis=1)).ravel()

    def covariance(self, rows: Sparse) -> Array:
        """Return the covariance of any linear combinations of unknowns, (n, n)."""
        return np.asarray(rows @ (rows @ self.matrix).T)


@dataclass(frozen=True)
class FieldSolution:
    """The result of an adjustment of fields, with the same methods for covariances as `Solution`."""

    solution: Solution
    design: FieldDesign

    @property
    def blocks(self) -> Mapping[str, Block]:
        """All blocks at the solution."""
        return self.solution.blocks

    def std(self, block: str) -> Array:
        """Return the standard uncertainties of a block, (members, size), 0 for fixed entries."""
        return np.nan_to_num(self.design.std(block))

    def covariance_or_raise(self) -> FieldSolution:
        """Return the covariance, which is computed on demand."""
        return self

    def of(self, name: str) -> Array:
        """Return the covariance of a block, (members*size, members*size), zero for fixed entries."""
        columns = self.design.partition.columns[name].ravel()
        free = columns >= 0
        full = np.zeros((len(columns), len(columns)))
        full[np.ix_(free, free)] = self.between(columns[free])
        return full

    def between(self, places: Index) -> Array:
        """Return the covariance of the unknowns with the given numbers, (n, n)."""
        from scipy.sparse import eye_array

        return self.design.covariance(eye_array(self.design.partition.width, format="csr")[places])

    def residuals(self) -> tuple[Residuals, ...]:
        """Return the residuals of each group, with redundancy and Baarda's w."""
        redundancy, at, parts = self.design.redundancy(), 0, []
        for group in self.solution.groups:
            values = group.residuals(self.solution.blocks)
            share = redundancy[at : at + values.size].reshape(values.shape)
            at += values.size
            parts.append(Residuals.of(group.observations, values, share))
        return tuple(parts)


def design_of(fields: Fields) -> FieldDesign:
    """Return the design of fields.

    Raises OpenDesignError if more directions are undetermined than can be listed.
    """
    parts = partition(fields.blocks, fields.groups, fields.net, fields.local)
    at = fields.design(fields.blocks)
    rows = jacobian([group.linear(at, frozenset(fields.blocks)) for group in fields.groups], parts)
    reduction = bordered_factor(rows, parts, _places(fields, parts))
    return FieldDesign(parts, rows, reduction, _constraint(_conditions(fields, parts), reduction.null))


def in_datum(fields: Fields, design: FieldDesign) -> FieldDesign:
    """Return the design with the datum of these fields, which may differ from its own in their conditions only."""
    return replace(design, constraint=_constraint(_conditions(fields, design.partition), design.null))


def adjust_fields(fields: Fields, design: FieldDesign | None = None) -> FieldSolution:
    """Minimise the sum of squares of the whitened residuals under the conditions of the datum.

    The steps use the normal matrix of the design throughout (a fixed-matrix Newton iteration).
    """
    design = design or design_of(fields)
    state = dict(fields.blocks)
    linears = _linears(fields, state)
    cost = sum(linear.cost for linear in linears)
    outcome, iterations = Outcome.ITERATION_LIMIT, 0
    # square of 1e-6 standard deviations for each unknown, as the tolerance of `StoppingRule`
    small = 1e-12 * design.partition.width
    while iterations < _MOST_STEPS:
        iterations += 1
        downhill = gradient(linears, design.partition)
        step = design.solve(downhill)
        # a step along Z changes no reading, so that the conditions are restored at no cost, to first order
        restoring = design.null @ (design.constraint @ design.partition.values_of(state))
        fall = float(downhill @ step)
        trial = _tried(fields, state, (step - restoring, design), cost)
        if trial is None:
            # at the minimum no step lowers the sum, and the predicted fall is rounding; a larger one was not reached
            outcome = Outcome.CONVERGED if fall <= 1e-6 * design.partition.width else Outcome.DIVERGED
            break
        state, linears, cost = trial
        if fall <= small + _ROUNDING * cost:
            outcome = Outcome.CONVERGED
            break
    unknowns = design.partition.width
    solution = Solution(
        outcome, state, fields.groups, cost, iterations, unknowns, conditions=design.reduction.null.shape[1]
    )
    return FieldSolution(solution, design)


def _tried(
    fields: Fields, state: Mapping[str, Block], move: tuple[Array, FieldDesign], cost: float
) -> tuple[dict[str, Block], list[LinearGroup], float] | None:
    """Return the state after the step, or after a part of it that does not raise the cost; None if each part does."""
    step, design = move
    for _ in range(_MOST_HALVINGS):
        moved = design.partition.moved(state, step)
        linears = _linears(fields, moved)
        total = sum(linear.cost for linear in linears)
        # the step that restores the datum is exact to first order only, so it may raise the cost by rounding
        if total <= cost * (1 + 1e-9) + 1e-9 * design.partition.width:
            return moved, linears, total
        step = step / 2
    return None


def _linears(fields: Fields, state: Mapping[str, Block]) -> list[LinearGroup]:
    return [group.linear(state, frozenset(fields.blocks)) for group in fields.groups]


def _places(fields: Fields, parts: Partition) -> Array:
    """Return the coordinates of the unknowns of the net, (net, k)."""
    columns = parts.columns[fields.net]
    places = np.zeros((parts.net, fields.places.shape[-1]))
    places[columns[columns >= 0]] = fields.places[columns >= 0]
    return places


def _conditions(fields: Fields, parts: Partition) -> Array:
    """Return the conditions of the datum as rows of unit length, (conditions, unknowns)."""
    count = len(next(iter(fields.conditions.values())))
    rows = np.zeros((count, parts.width))
    for name, factors in fields.conditions.items():
        columns = parts.columns[name]
        rows[:, columns[columns >= 0]] = factors[:, columns >= 0]
    # rows of unit length: conditions in mm and in rad have one bound on their singular values in `_constraint`
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300))


def _constraint(conditions: Array, null: Array) -> Array:
    """Return H with `H Z = I`.

    The conditions fix as many directions as they can. The others are fixed by the least sum of squares of all unknowns.
    """
    if not null.shape[1]:
        return np.zeros((0, len(null)))
    by_conditions = conditions @ null
    _, sizes, mix = np.linalg.svd(by_conditions)
    # combinations of the open directions that meet all conditions, which the least sum of squares has to fix
    free = mix[int((sizes > 1e-7 * max(sizes.max(initial=0.0), 1e-300)).sum()) :]
    inverse = np.linalg.pinv(np.concatenate([by_conditions, free @ (null.T @ null)]))
    count = len(conditions)
    return np.asarray(inverse[:, :count] @ conditions + inverse[:, count:] @ free @ null.T)
