"""Correlated errors: piecewise linear functions of a covariate between knots, for each unit and component.

Method: docs/algorithms/evidence.md (correlated errors).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations_with_replacement
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.adjusted_job import AdjustedJob, Covariate
from metrocli.diagnosis.linear.projection import Linearised
from metrocli.frozen import dataclass

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Numbers = np.ndarray[tuple[int, ...], np.dtype[np.int32]]
"""Numbers of knots; of many readings they are large"""
Values = tuple[Array, Numbers]
"""Functions that are not 0 at each reading: their values (n, m), 1 at their knots, and the numbers of these (n, m)"""


def around_circle(several: Sequence[Array], count: int) -> tuple[list[Values], Array]:
    """Return functions of angles (1, n) of each group, and the distances of their knots.

    The distance is the chord, as a share of the diameter: a distance for which the covariance stays one on the circle.
    """
    turns = np.arange(count) / count
    functions = []
    for values in several:
        own, knots = _between(np.mod(values[0] / (2 * np.pi), 1.0), np.append(turns, 1.0))
        functions.append((own, knots % count))
    return functions, np.abs(np.sin(np.pi * (turns[:, None] - turns)))


def between_knots(several: Sequence[Array], labels: Sequence[Index], count: int) -> tuple[list[Values], Array]:
    """Return functions of coordinates (k, n) of each group, and the distances of their knots.

    Knots begin at the lowest value of each unit (`labels`, (n,)) and span the largest range of a unit: views that are
    measured one after the other each have all of them.
    """
    low, spans = lowest_and_spans(several, labels)
    span = np.where(spans > 0, spans, 1.0)[:, None]
    ends = np.linspace(0.0, 1.0, count)
    functions = []
    for values, label in zip(several, labels, strict=True):
        product, numbers = np.ones((values.shape[1], 1)), np.zeros((values.shape[1], 1), dtype=np.int32)
        for row in (values - low[:, label]) / span:
            own, knots = _between(row, ends)
            product = (product[:, :, None] * own[:, None]).reshape(len(own), -1)
            numbers = (numbers[:, :, None] * count + knots[:, None]).reshape(len(own), -1)
        functions.append((product, np.asarray(numbers)))
    places = np.stack([one.ravel() for one in np.meshgrid(*[ends] * len(low), indexing="ij")], axis=1)
    return functions, np.asarray(np.linalg.norm(places[:, None] - places, axis=2))


def lowest_and_spans(several: Sequence[Array], labels: Sequence[Index]) -> tuple[Array, Array]:
    """Return the lowest value of each coordinate in each unit, (k, units), and its largest range in a unit, (k,)."""
    whole, units = np.concatenate(several, axis=1), np.concatenate(labels)
    low, high = np.full((2, len(whole), int(units.max()) + 1), np.inf)
    for axis, values in enumerate(whole):
        np.minimum.at(low[axis], units, values)
        np.minimum.at(high[axis], units, -values)
    return low, np.where(np.isfinite(low), -high - low, 0.0).max(axis=1)


def _between(values: Array, knots: Array) -> Values:
    """Return the two functions of values (n,) between whose knots each lies."""
    at = np.clip(np.searchsorted(knots, values, side="right") - 1, 0, len(knots) - 2).astype(np.int32)
    part = (values - knots[at]) / (knots[at + 1] - knots[at])
    return np.stack([1 - part, part], axis=1), np.stack([at, at + 1], axis=1)


_KNOTS = {1: (65, 33, 17, 13, 9), 2: (6, 5, 4, 3)}
"""Knots along each coordinate, by the number of coordinates: as many as the columns, and the readings, allow"""
_ENOUGH, _READINGS = 17, 16
"""More knots than so many along one coordinate are taken for so many readings of each unit to a knot"""
_FEW_KNOTS = (3,)
_AROUND = 16
"""Knots around a circle"""
_FEWEST = 6
"""Fewest readings of a unit with a process of its own"""
_MOST_COLUMNS, _MOST_NUMBERS = 600, 20_000_000
"""Most knots of all units, and most numbers of their columns; beyond it the process is one for all readings"""


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
    gram: Array
    """Their products without what the unknowns absorb, (columns, columns)"""


def process_bases(job: AdjustedJob, system: Linearised) -> Iterator[Functions]:
    """Yield the functions of each covariate, independent in the units of each kind, and one for all readings."""
    named = [group.name for group in job.model.readings]
    alone = [one for one in job.covariates if not one.together and all(name in one.values for name in named)]
    # those of several coordinates need the most memory while they are made: nothing else is held yet
    for covariate in sorted(alone, key=lambda one: -len(np.atleast_2d(one.values[named[0]]))):
        for by in (*job.units, *([] if covariate.of_units else [""])):
            basis = _basis(job, system, covariate, by)
            if basis is not None:
                yield basis


def _basis(job: AdjustedJob, system: Linearised, covariate: Covariate, by: str) -> Functions | None:
    from scipy.sparse import csr_matrix

    groups = job.model.readings
    several = [np.atleast_2d(covariate.values[group.name]) for group in groups]
    labels = [_labels(job, group, by) for group in groups]
    units = len(job.model.places[by].names) if by else 1
    copies = units * sum(len(group.observations.readings) for group in groups)
    along = (_AROUND,) if covariate.angle else _KNOTS.get(len(several[0]), _FEW_KNOTS)
    most, fewest = min(_MOST_COLUMNS, _MOST_NUMBERS // system.rows) // copies, min(map(_fewest, labels))
    dense = max(_ENOUGH, fewest // _READINGS)
    count = next((one for one in along if one <= dense and one ** len(several[0]) <= most), 0)
    # what is the same for all readings of each unit, such as the time of an image, has no length in it
    if count == 0 or fewest < _FEWEST or not lowest_and_spans(several, labels)[1].any():
        return None
    functions, distances = around_circle(several, count) if covariate.angle else between_knots(several, labels, count)
    count = len(distances)
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
            of_copies += [group.observations.unit] * units
    # of many readings these are large
    del functions, values, knots
    ends = np.arange(0, terms.size + 1, each, dtype=np.int32)
    columns = csr_matrix((terms.ravel(), numbers.ravel(), ends), shape=(system.rows, copies * count))
    gram = _gram(terms, numbers, copies * count) - system.basis.gram_of(columns)
    sigmas = {unit: _typical(job, unit) for unit in of_copies}
    return Functions(covariate.name, by, distances, tuple(of_copies), units, sigmas, columns, gram)


def _gram(terms: Array, numbers: Numbers, count: int) -> Array:
    """Return the products of columns that have the values `terms` (rows, m) at their numbers (rows, m)."""
    diagonal, upper = np.zeros((2, count * count))
    for i, j in combinations_with_replacement(range(terms.shape[1]), 2):
        found = np.bincount(numbers[:, i] * count + numbers[:, j], terms[:, i] * terms[:, j], count * count)
        (diagonal if i == j else upper)[:] += found
    above = upper.reshape(count, count)
    return diagonal.reshape(count, count) + above + above.T


def _typical(job: AdjustedJob, unit: str) -> float:
    """Return the median of the declared standard deviations of the readings in a unit."""
    alike = [group.observations for group in job.model.readings if group.observations.unit == unit]
    return float(np.median(np.concatenate([one.deviations.ravel() for one in alike])))


def _labels(job: AdjustedJob, group: Group, by: str) -> Index:
    """Return the number of the unit of each reading; 0 for all readings of a group without such units."""
    index = group.observations.index.get(job.model.places[by].index) if by else None
    return np.zeros(group.observations.count, dtype=np.intp) if index is None else index


def _fewest(labels: Index) -> int:
    counts = np.bincount(labels)
    return int(counts[counts > 0].min(initial=len(labels)))
