"""Correlated errors: piecewise linear functions of a covariate between knots, for each unit and component.

Method: docs/algorithms/evidence.md (correlated errors).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear.projection import Linearised
from metrocli.effects.covariates import Covariate, smooth_functions
from metrocli.frozen import dataclass

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix


@dataclass(frozen=True)
class Functions:
    """Piecewise linear functions of a covariate between knots, for each unit and each component of the readings."""

    name: str
    by: str
    """Key of the units, or empty"""
    distances: Array
    """Between knots, as shares of the range, (knots, knots)"""
    count: int
    """Number of units, 1 without a key"""
    components: int
    """Of the readings of all groups"""
    sigmas: Mapping[str, float]
    """Median of the declared standard deviations of the readings of each internal unit"""
    values: Array
    """Whitened values of the functions that are not 0 at each row, (rows, m)"""
    numbers: Index
    """Their knots, (rows, m)"""
    component: Index
    """Component (of all groups) of each row, -1 where it has no functions"""
    unit: Index
    """Unit of each row"""

    @cached_property
    def columns(self) -> csr_matrix:
        """All functions by component, in it by unit, in it by knot: (rows, components*units*knots)."""
        from scipy.sparse import csr_matrix

        (rows, m), knots = self.values.shape, len(self.distances)
        first = (np.maximum(self.component, 0) * self.count + self.unit) * knots
        # built from its arrays: each row has the same number of entries, so that nothing has to be sorted or counted
        entries = (self.values.ravel(), (first[:, None] + self.numbers).astype(np.int32).ravel())
        ends = np.arange(0, self.values.size + 1, m, dtype=np.int32)
        return csr_matrix((*entries, ends), shape=(rows, self.components * self.count * knots))

    def compact(self, turn: Array, unit: int = -1) -> Array:
        """Return the columns of each row's own unit, (rows, components*k), of a turn of the knots (knots, k)."""
        k = turn.shape[1]
        columns = np.zeros((len(self.values), self.components, k))
        combined = np.einsum("rm,rmk->rk", self.values, turn[self.numbers])
        has_functions = self.component >= 0
        if unit >= 0:
            has_functions &= self.unit == unit
        rows = np.flatnonzero(has_functions)
        columns[rows, self.component[rows]] = combined[rows]
        return columns.reshape(len(columns), -1)

    def spread(self, turn: Array) -> Array:
        """Return the columns of all units side by side, (rows, components*units*k)."""
        compact = self.compact(turn)
        if self.count == 1:
            return compact
        columns = np.zeros((len(compact), self.count, compact.shape[1]))
        columns[np.arange(len(compact)), self.unit] = compact
        return columns.reshape(len(compact), -1)


def process_bases(job: AdjustedJob, system: Linearised) -> Iterator[Functions]:
    """Yield the functions of each covariate, independent in the units of each kind, and one for all readings."""
    first = job.model.readings[0].name
    # those of several coordinates need the most memory while they are made: nothing else is held yet
    for covariate in sorted(job.smooth_covariates, key=lambda covariate: -len(np.atleast_2d(covariate.values[first]))):
        for by in (*job.units, *([] if covariate.of_units else [""])):
            basis = _basis(job, system, covariate, by)
            if basis is not None:
                yield basis


def _basis(job: AdjustedJob, system: Linearised, covariate: Covariate, by: str) -> Functions | None:
    groups = job.model.readings
    labels = [job.model.units_in(group, by) for group in groups]
    units = len(job.model.places[by].names) if by else 1
    smooth = smooth_functions(covariate, groups, labels, units)
    if smooth is None:
        return None
    shape = system.rows, smooth.values[0][0].shape[1]
    terms, numbers = np.zeros(shape), np.zeros(shape, dtype=np.intp)
    component, unit = np.full(system.rows, -1), np.zeros(system.rows, dtype=np.intp)
    of_components = list[str]()
    for group, (values, knots), label in zip(groups, smooth.values, labels, strict=True):
        rows, d = system.stretch(group), len(group.observations.readings)
        for at, deviations in enumerate(group.observations.deviations):
            own = slice(rows.start + at, rows.stop, d)
            # in units of the declared noise, so that lengths and angles can share a variance
            np.multiply(values, (deviations / system.scale[own])[:, None], out=terms[own])
            numbers[own], unit[own] = knots, label
            component[own] = np.where(terms[own].any(axis=1), len(of_components), -1)
            of_components.append(group.observations.unit_of_each[at])
    sigmas = {name: _typical(job, name) for name in dict.fromkeys(of_components)}
    sizes = smooth.distances, units, len(of_components), sigmas
    return Functions(covariate.name, by, *sizes, terms, numbers, component, unit)


def _typical(job: AdjustedJob, unit: str) -> float:
    """Return the median of the declared standard deviations of the readings in a unit."""
    return float(np.median(np.concatenate([group.observations.deviations_in(unit) for group in job.model.readings])))
