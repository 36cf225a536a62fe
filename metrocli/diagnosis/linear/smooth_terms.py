"""Smooth functions of the covariates, for residual structure whose cause is not known.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from math import comb

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
from metrocli.effects.effect import Effect, Parameter

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
_Shown = tuple[Alternative, Index, Array, Array]
"""An alternative, the rows that it changes (r,), its visible directions there (r, k) and their visible squares (k,)"""


def smooth_families(job: AdjustedJob, system: System) -> list[Family]:
    """Return the families of smooth functions: polynomials of each covariate, for all readings and for each unit.

    A unit is for example a tracer or an image. Covariates that vary periodically also give sines, with a scan over
    their periods. Covariates that are terms themselves give these terms.
    """
    apart = [covariate for covariate in job.covariates if not covariate.together]
    smooth = [family for covariate in apart for family in _of(job, system, covariate)]
    smooth += [_together(job, system, covariate) for covariate in job.covariates if covariate.together]
    waves = [family for one in job.covariates if one.periodic for family in _waves(job, system, one)]
    return smooth + waves


def columns_of_smooth(job: AdjustedJob) -> int:
    """Return how many columns of smooth functions each row has: those of all readings and of its unit, and sines."""
    found = 0
    for covariate in job.covariates:
        values = [one for name, one in covariate.values.items() if name in job.model.measured]
        if not values or covariate.together:
            continue
        terms = _terms(len(np.atleast_2d(values[0])), covariate.degree, covariate.angle)
        found += terms * (1 + len(job.units)) + (4 * int(_MOST_PERIODS) if covariate.periodic else 0)
    return found * max(len(group.observations.components) for group in job.model.readings)


def _of(job: AdjustedJob, system: System, covariate: Covariate) -> Iterator[Family]:
    found: list[_Shown] = []
    for group in job.model.readings:
        values = covariate.values.get(group.name)
        if values is None:
            continue
        weights = _weights(system, group)
        for where, mask in _parts(job, group):
            if not mask.any():
                continue
            degree = _degree(job, group, covariate) if where else covariate.degree
            terms = (harmonics if covariate.angle else polynomials)(np.atleast_2d(values)[:, mask], degree)
            if mask.sum() < _FEWEST_FOR * terms.shape[1]:
                continue
            rows, full = _components(system, group, weights, np.flatnonzero(mask), terms)
            found.append((_alternative(covariate, where), rows, *visible_directions(system, rows, [full])[0]))
    by_size: dict[int, list[_Shown]] = {}
    for item in found:
        by_size.setdefault(item[2].shape[1], []).append(item)
    for items in by_size.values():
        yield _family(f"smooth in {covariate.name}", items, covariate)


def _family(name: str, items: Sequence[_Shown], covariate: Covariate) -> Family:
    """Return the family of some smooth functions."""
    alternatives, rows, directions, squares = zip(*items, strict=True)
    columns = gathered((one.tobytes(), Own(one, own)) for one, own in zip(rows, directions, strict=True))
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
    return 2 * degree if angle else comb(coordinates + degree, degree) - 1


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
    values, vectors = np.linalg.eigh(visible)
    shows = values[:, ::-1] > _SHOWS**2
    return [
        (basis @ (turn[:, ::-1] * one), squares[::-1] * one)
        for basis, turn, squares, one in zip(bases, vectors, values, shows, strict=True)
    ]


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
    item = (_alternative(covariate, ()), rows, *visible_directions(system, rows, [full])[0])
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
        items = [(name, rows, *one) for name, one in zip(names, shown, strict=True)]
        yield _family(f"waves in {covariate.name}", items, covariate)


def _parts(job: AdjustedJob, group: Group) -> Iterator[tuple[tuple[str, ...], Array]]:
    """Yield the mask of all readings, then that of each unit, with the name of the place."""
    count = group.observations.count
    yield (), np.ones(count, dtype=bool)
    for key in job.units:
        place = job.model.places[key]
        index = group.observations.index.get(place.index)
        if index is not None:
            for number, name in enumerate(place.names):
                yield (name,), index == number


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


def polynomials(values: Array, degree: int) -> Array:
    """Return products of Legendre polynomials of coordinates (k, n), of total degree 1 to `degree`, (n, terms)."""
    low, high = values.min(axis=1, keepdims=True), values.max(axis=1, keepdims=True)
    unit = 2 * (values - low) / np.where(high > low, high - low, 1.0) - 1
    single = [np.polynomial.legendre.legvander(x, degree) for x in unit]
    powers = [p for p in product(range(degree + 1), repeat=len(single)) if 0 < sum(p) <= degree]
    powers.sort(key=lambda p: (sum(p), p[::-1]))
    return np.stack([np.prod([v[:, i] for v, i in zip(single, p, strict=True)], axis=0) for p in powers], axis=1)


def harmonics(values: Array, degree: int) -> Array:
    """Return cos k a and sin k a of an angle (1, n) for k = 1 to `degree`, (n, terms)."""
    orders = np.arange(1, degree + 1)[:, None] * values
    return np.concatenate([np.cos(orders), np.sin(orders)]).T


def _alternative(covariate: Covariate, where: tuple[str, ...]) -> Alternative:
    effect = Effect(f"unknown, varies with {covariate.name}", "", (Parameter("size"),), where=("unit",) * len(where))
    return Alternative(effect, where)
