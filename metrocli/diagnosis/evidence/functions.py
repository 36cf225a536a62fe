"""Correlated errors: piecewise linear functions of a covariate between knots, for each unit and component.

Method: docs/algorithms/evidence.md (correlated errors).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
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
    units: tuple[str, ...]
    """Internal unit of the readings of each component and unit, (copies,)"""
    count: int
    """Number of units, 1 without a key"""
    sigmas: Mapping[str, float]
    """Median of the declared standard deviations of the readings of each internal unit"""
    columns: csr_matrix
    """Whitened columns, (rows, components*units*knots)"""


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
    from scipy.sparse import csr_matrix

    groups = job.model.readings
    labels = [job.model.units_in(group, by) for group in groups]
    units = len(job.model.places[by].names) if by else 1
    smooth = smooth_functions(covariate, groups, labels, units)
    if smooth is None:
        return None
    functions, distances = smooth.values, smooth.distances
    copies, count = units * sum(len(group.observations.readings) for group in groups), len(distances)
    each = functions[0][0].shape[1]
    terms, numbers = np.zeros((system.rows, each)), np.zeros((system.rows, each), dtype=np.int32)
    place, of_copies = 0, list[str]()
    for group, (values, knots), label in zip(groups, functions, labels, strict=True):
        components = len(group.observations.readings)
        for component, deviations in enumerate(group.observations.deviations):
            first = system.first[group.name]
            rows = slice(first + component, first + components * len(values), components)
            # in units of the declared noise, so that lengths and angles can share a variance
            np.multiply(values, (deviations / system.scale[rows])[:, None], out=terms[rows])
            np.add((place + label * count).astype(np.int32)[:, None], knots, out=numbers[rows])
            place += units * count
            of_copies += [group.observations.unit_of_each[component]] * units
    # of many readings these are large
    del smooth, functions, values, knots
    ends = np.arange(0, terms.size + 1, each, dtype=np.int32)
    # built from its arrays: each row has the same number of entries, so that nothing has to be sorted or counted
    columns = csr_matrix((terms.ravel(), numbers.ravel(), ends), shape=(system.rows, copies * count))
    sigmas = {unit: _typical(job, unit) for unit in dict.fromkeys(of_copies)}
    return Functions(covariate.name, by, distances, tuple(of_copies), units, sigmas, columns)


def _typical(job: AdjustedJob, unit: str) -> float:
    """Return the median of the declared standard deviations of the readings in a unit."""
    return float(np.median(np.concatenate([group.observations.deviations_in(unit) for group in job.model.readings])))
