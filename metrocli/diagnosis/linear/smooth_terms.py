"""Smooth functions of the covariates, for residual structure whose cause is not known.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.adjusted_job import AdjustedJob, Covariate
from metrocli.diagnosis.linear.candidates import Alternative, Family
from metrocli.diagnosis.linear.column_parts import Own
from metrocli.diagnosis.linear.columns import gathered, side_by_side
from metrocli.diagnosis.linear.fitted_columns import orthonormal
from metrocli.diagnosis.linear.projection import System
from metrocli.diagnosis.linear.smooth.recomputed_terms import SmoothFunctions, Terms, number_of_polynomials
from metrocli.effects.effect import Effect, Parameter
from metrocli.frozen import dataclass

_FEWEST_STEPS = 6
"""Least number of different values of a covariate for sines of it"""
_MOST_PERIODS = 60.0
_RANK = 1e-7
"""Smallest singular value of independent terms of a smooth function, relative to the largest norm of a term"""
_SHOWS = 0.02
"""Smallest share of a smooth function that must be visible beside the unknowns"""
_MOST_OF_UNITS, _LEAST_DEGREE = 2000, 2
"""Most terms of one covariate for all units together, and the degree that is kept in any case"""
_FEWEST_FOR = 4
"""Least number of readings per term for which a unit gets its own terms"""
_MANY = 20_000
"""Rows of a function from which its columns are not held"""
_Shown = tuple[Alternative, Own | Terms, Array]
"""An alternative, its visible directions (r, k) at the rows that it changes, and their visible squares (k,)"""


def smooth_families(job: AdjustedJob, system: System) -> list[Family]:
    """Return the families of smooth functions: polynomials of each covariate, for all readings and for each unit.

    A unit is for example a tracer or an image. Covariates that vary periodically also give sines, with a scan over
    their periods. Covariates that are terms themselves give these terms.
    """
    readings = [_Readings.of(job, system, group) for group in job.model.readings]
    apart = [covariate for covariate in job.covariates if not covariate.together]
    smooth = [family for covariate in apart for family in _of(job, system, covariate, readings)]
    smooth += [_together(job, system, covariate) for covariate in job.covariates if covariate.together]
    waves = [family for one in job.covariates if one.periodic for family in _waves(job, system, one)]
    return smooth + waves


def columns_of_smooth(job: AdjustedJob) -> int:
    """Return how many columns of smooth functions are held for each row: of all readings and of its unit, and sines.

    Functions of many readings are not held.
    """
    rows = sum(group.observations.readings.size for group in job.model.readings)
    held = sum(rows < _MANY * count for count in (1, *(len(job.model.places[key].names) for key in job.units)))
    found = 0
    for covariate in job.covariates:
        values = [one for name, one in covariate.values.items() if name in job.model.measured]
        if not values or covariate.together:
            continue
        terms = _terms(len(np.atleast_2d(values[0])), covariate.degree, covariate.angle)
        found += terms * held + (4 * int(_MOST_PERIODS) if covariate.periodic else 0)
    return found * max(len(group.observations.components) for group in job.model.readings)


@dataclass(frozen=True)
class _Readings:
    """The readings of a group."""

    group: Group
    weights: Array
    """By how much a function in each component changes each row of a reading, (n, d, components)"""
    parts: tuple[tuple[tuple[str, ...], Index], ...]
    """All readings, then those of each unit with the name of its place"""

    @classmethod
    def of(cls, job: AdjustedJob, system: System, group: Group) -> _Readings:
        return cls(group, _weights(system, group), tuple(_parts(job, group)))


def _of(job: AdjustedJob, system: System, covariate: Covariate, readings: Sequence[_Readings]) -> Iterator[Family]:
    by_size: dict[int, list[_Shown]] = {}
    for one in readings:
        if one.group.name not in covariate.values:
            continue
        values = np.atleast_2d(covariate.values[one.group.name])
        functions = SmoothFunctions.of(values, covariate.degree, covariate.angle)
        for where, chosen in one.parts:
            degree = _degree(job, one.group, covariate) if where else covariate.degree
            terms = Terms.of(system.first[one.group.name], chosen, one.weights, functions.between(chosen, degree))
            if len(chosen) >= _FEWEST_FOR * terms.functions.count:
                shown = (_alternative(covariate, where), *_visible(system, terms))
                by_size.setdefault(terms.parameters, []).append(shown)
    for items in by_size.values():
        yield _family(f"smooth in {covariate.name}", items, covariate)


def _visible(system: System, terms: Terms) -> tuple[Own | Terms, Array]:
    """Return the visible directions of terms, those of many readings to be computed anew, with their squares (k,)."""
    rows = terms.rows
    if len(rows) < _MANY:
        directions, squares = visible_directions(system, rows, [terms.dense()[:, 0]])[0]
        return Own(rows, directions), squares
    basis = terms.orthonormal(_RANK)
    turn, squares = _shown(basis.grams(system.basis, None))
    return basis.turned(turn), squares[0]


def _family(name: str, items: Sequence[_Shown], covariate: Covariate) -> Family:
    """Return the family of some smooth functions."""
    alternatives, directions, squares = zip(*items, strict=True)
    columns = gathered((one.rows.tobytes(), one) for one in directions)
    raw = np.ones((columns.count, columns.parameters))
    gram = np.eye(columns.parameters) * np.stack(squares)[:, None, :]
    return Family(name, alternatives, columns, raw, gram, covariate.name)


def _degree(job: AdjustedJob, group: Group, covariate: Covariate) -> int:
    """Return the degree of the functions of single units: lower where there are many units, so that all can be held."""
    units = sum(len(job.model.places[key].names) for key in job.units) * len(group.observations.components)
    coordinates = len(np.atleast_2d(covariate.values[group.name]))
    degree = covariate.degree
    while degree > _LEAST_DEGREE and units * _terms(coordinates, degree, covariate.angle) > _MOST_OF_UNITS:
        degree -= 1
    return degree


def _terms(coordinates: int, degree: int, angle: bool) -> int:
    return 2 * degree if angle else number_of_polynomials(coordinates, degree)


def visible_directions(system: System, rows: Index, several: Sequence[Array]) -> list[tuple[Array, Array]]:
    """Return the spaces of some terms (r, k) at the same rows by unit directions, with their visible squares (k,).

    A visible part of a thousandth of a function would fit any pattern, and mean an error a thousand times its size.
    So directions that hardly show are 0. The visible squares of unit columns b are the eigenvalues of `b' M b`.
    """
    bases = []
    for columns in several:
        largest = float(np.sqrt(np.einsum("rk,rk->k", columns, columns).max()))
        basis = orthonormal(columns, _RANK * max(largest, 1e-300))
        lost = columns.shape[1] - basis.shape[1]
        bases.append(np.pad(basis, ((0, 0), (0, lost))) if lost else basis)
    visible = np.stack([basis.T @ basis for basis in bases]) - system.basis.at(rows).grams(side_by_side(bases))
    return [(basis @ turn, squares) for basis, turn, squares in zip(bases, *_shown(visible), strict=True)]


def _shown(visible: Array) -> tuple[Array, Array]:
    """Return the turns (n, k, k) to directions that show, by the Gram matrices (n, k, k), and their squares (n, k)."""
    values, vectors = np.linalg.eigh(visible)
    shows = values[:, ::-1] > _SHOWS**2
    return vectors[:, :, ::-1] * shows[:, None, :], values[:, ::-1] * shows


def beside_columns(family: Family, columns: Array) -> Family:
    """Return a family of smooth functions beside further unknowns, of orthonormal visible columns (rows, k).

    Directions of the functions that hardly show beside these become 0.
    """
    along = family.columns.products(columns)
    left = family.gram - along @ np.swapaxes(along, 1, 2)
    values, vectors = np.linalg.eigh(left)
    shows = values > _SHOWS**2
    if (shows.sum(axis=1) == (np.linalg.eigvalsh(family.gram) > _SHOWS**2).sum(axis=1)).all():
        return replace(family, gram=left)
    turned = family.columns.turned(vectors * shows[:, None, :])
    return replace(family, columns=turned, gram=np.eye(left.shape[1]) * (values * shows)[:, None, :])


def _together(job: AdjustedJob, system: System, covariate: Covariate) -> Family:
    """Return the family whose terms are the coordinates of a covariate, for readings of one component each."""
    full = np.zeros((system.rows, len(np.atleast_2d(next(iter(covariate.values.values()))))))
    for group in job.model.readings:
        rows = system.first[group.name] + np.arange(group.observations.count)
        full[rows] = np.atleast_2d(covariate.values[group.name]).T / system.scale[rows, None]
    rows = np.arange(system.rows)
    directions, squares = visible_directions(system, rows, [full])[0]
    item = (_alternative(covariate, ()), Own(rows, directions), squares)
    return _family(f"moving with {covariate.name}", [item], covariate)


def _waves(job: AdjustedJob, system: System, covariate: Covariate) -> Iterator[Family]:
    """Yield cosine and sine of a covariate for each component, from one period over the measurement upwards.

    The highest frequency has one period in two steps of the covariate (Nyquist). Frequencies are half a period over
    the measurement apart, so that the scan misses none between them.
    """
    for group in job.model.readings:
        values = covariate.values.get(group.name)
        steps = np.unique(np.zeros(0) if values is None else values)
        if values is None or len(steps) < _FEWEST_STEPS:
            continue
        turns = 2 * np.pi * (values - steps[0]) / np.ptp(steps)
        every, weights = np.arange(len(values)), _weights(system, group)
        names: list[Alternative] = []
        waves: list[Array] = []
        for periods in np.arange(1.0, min((len(steps) - 1) / 2, _MOST_PERIODS) + 0.1, 0.5):
            terms = np.stack([np.cos(periods * turns), np.sin(periods * turns)], axis=1)
            rows, full = _components(system, group, weights, every, terms)
            for i, component in enumerate(group.observations.components):
                names.append(_alternative(covariate, (component, f"{periods:g} periods")))
                waves.append(full[:, 2 * i : 2 * i + 2])
        shown = visible_directions(system, rows, waves)
        items = [(name, Own(rows, one), squares) for name, (one, squares) in zip(names, shown, strict=True)]
        yield _family(f"waves in {covariate.name}", items, covariate)


def _parts(job: AdjustedJob, group: Group) -> Iterator[tuple[tuple[str, ...], Index]]:
    """Yield all readings, then those of each unit that has any, with the name of the place."""
    yield (), np.arange(group.observations.count)
    for key in job.units:
        place = job.model.places[key]
        index = group.observations.index.get(place.index)
        if index is not None:
            for number, name in enumerate(place.names):
                chosen = np.flatnonzero(index == number)
                if len(chosen):
                    yield (name,), chosen


def _weights(system: System, group: Group) -> Array:
    """Return by how much a function in each component changes each row of a reading, (n, rows, components)."""
    observations = group.observations
    d, n = observations.readings.shape
    unit = observations.whitened(np.broadcast_to(np.eye(d)[:, :, None], (d, d, n)))
    start = system.first[group.name]
    factor = observations.deviations.T / system.scale[start : start + n * d].reshape(n, d)
    return np.asarray(np.moveaxis(unit, -1, 0) * factor[:, :, None])


def _components(system: System, group: Group, weights: Array, chosen: Index, terms: Array) -> tuple[Index, Array]:
    """Return whitened terms (n, k) of some readings for each component of these separately, (r, k components).

    The rows (r,) come first.
    """
    d = weights.shape[1]
    rows = (system.first[group.name] + d * chosen[:, None] + np.arange(d)).ravel()
    full = weights[chosen][:, :, :, None] * terms[:, None, None, :]
    return rows, full.reshape(len(rows), -1)


def _alternative(covariate: Covariate, where: tuple[str, ...]) -> Alternative:
    effect = Effect(f"unknown, varies with {covariate.name}", "", (Parameter("size"),), where=("unit",) * len(where))
    return Alternative(effect, where)
