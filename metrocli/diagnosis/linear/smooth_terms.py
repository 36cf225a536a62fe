"""Smooth functions of the covariates, for residual structure whose cause is not known.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import comb

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.groups import Group
from metrocli.diagnosis.adjusted_job import AdjustedJob, Covariate
from metrocli.diagnosis.linear.candidates import Alternative, Family
from metrocli.diagnosis.linear.projection import System
from metrocli.effects.effect import Effect, Parameter

_FEWEST_STEPS = 6
"""Least number of different values of a covariate for sines of it"""
_MOST_PERIODS = 60.0
_RANK = 1e-9
"""Smallest singular value of independent terms of a smooth function, relative to the largest"""
_SHOWS = 0.02
"""Smallest share of a smooth function that must be visible beside the unknowns"""
_NONE = np.zeros((0, 0, 0))
"""What the unknowns absorb of smooth functions is not needed"""
_MOST_OF_UNITS, _LEAST_DEGREE = 2000, 2
"""Most terms of one covariate for all units together, and the degree that is kept in any case"""
_FEWEST_FOR = 4
"""Least number of readings per term for which a unit gets its own terms"""


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


def _of(job: AdjustedJob, system: System, covariate: Covariate) -> Iterator[Family]:
    found: list[tuple[Alternative, Array]] = []
    for group in job.model.readings:
        values = covariate.values.get(group.name)
        if values is None:
            continue
        for where, mask in _parts(job, group):
            if not mask.any():
                continue
            degree = _degree(job, group, covariate) if where else covariate.degree
            terms = (harmonics if covariate.angle else polynomials)(np.atleast_2d(values)[:, mask], degree)
            if mask.sum() < _FEWEST_FOR * terms.shape[1]:
                continue
            full = np.zeros((group.observations.count, terms.shape[1]))
            full[mask] = terms
            found.append((_alternative(covariate, where), _components(system, group, full)))
    by_size: dict[int, list[tuple[Alternative, Array]]] = {}
    for item in found:
        by_size.setdefault(item[1].shape[1], []).append(item)
    for items in by_size.values():
        seen = np.stack([visible_directions(system, columns) for _, columns in items], axis=1)
        raw = np.ones(seen.shape[1:])
        yield Family(f"smooth in {covariate.name}", tuple(a for a, _ in items), seen, raw, _NONE, covariate.name)


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


def visible_directions(system: System, columns: Array) -> Array:
    """Return the visible part of the space of some terms (rows, k), by directions; 0 if it is too small.

    A visible part of a thousandth of a function would fit any pattern, and mean an error a thousand times its size.
    """
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis * (sizes > _RANK * max(float(sizes[0]), 1e-300))
    u, s, _ = np.linalg.svd(system.seen(basis), full_matrices=False)
    return np.asarray(u * np.where(s > _SHOWS, s, 0.0))


def _together(job: AdjustedJob, system: System, covariate: Covariate) -> Family:
    """Return the family whose terms are the coordinates of a covariate, for readings of one component each."""
    full = np.zeros((system.rows, len(np.atleast_2d(next(iter(covariate.values.values()))))))
    for group in job.model.readings:
        rows = system.first[group.name] + np.arange(group.observations.count)
        full[rows] = np.atleast_2d(covariate.values[group.name]).T / system.scale[rows, None]
    seen = visible_directions(system, full)[:, None]
    alternatives, raw = (_alternative(covariate, ()),), np.ones(seen.shape[1:])
    return Family(f"moving with {covariate.name}", alternatives, seen, raw, _NONE, covariate.name)


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
        columns: list[Array] = []
        names: list[Alternative] = []
        for periods in np.arange(1.0, min((len(steps) - 1) / 2, _MOST_PERIODS) + 0.1, 0.5):
            terms = np.stack([np.cos(periods * turns), np.sin(periods * turns)], axis=1)
            full = _components(system, group, terms)
            for i, component in enumerate(group.observations.components):
                columns.append(full[:, 2 * i : 2 * i + 2])
                names.append(_alternative(covariate, (component, f"{periods:g} periods")))
        seen = np.stack([visible_directions(system, one) for one in columns], axis=1)
        raw = np.ones(seen.shape[1:])
        yield Family(f"waves in {covariate.name}", tuple(names), seen, raw, _NONE, covariate.name)


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


def _components(system: System, group: Group, terms: Array) -> Array:
    """Return whitened terms (n, k) for each component of the readings separately, (rows, k components)."""
    observations = group.observations
    d, n = observations.readings.shape
    k = terms.shape[1]
    full = np.zeros((system.rows, k * d))
    start = system.first[group.name]
    rows = slice(start, start + d * n)
    factor = observations.deviations.T.ravel() / system.scale[rows]
    for i in range(d):
        change = np.zeros((d, k, n))
        change[i] = terms.T
        whitened = np.moveaxis(observations.whitened(change), -1, 0).reshape(n * d, k)
        full[rows, i * k : (i + 1) * k] = whitened * factor[:, None]
    return full


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
