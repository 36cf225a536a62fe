"""Smooth functions of the covariates: what structure looks like whose cause is not known."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.groups import Group
from metrocli.diagnosis.candidates import Alternative, Family
from metrocli.diagnosis.projection import System
from metrocli.diagnosis.subject import Covariate, Subject
from metrocli.effects.effect import Effect, Parameter

_FEWEST_FOR = 4
"""Readings for each term that a unit must have to get terms of its own"""


def smooth_families(subject: Subject, system: System) -> list[Family]:
    """Return for each covariate polynomials of it: one for all readings, and one for each unit (tracer, image)."""
    return [family for covariate in subject.covariates for family in _of(subject, system, covariate)]


def _of(subject: Subject, system: System, covariate: Covariate) -> Iterator[Family]:
    found: list[tuple[Alternative, Array]] = []
    for group in subject.model.readings:
        values = covariate.values.get(group.name)
        if values is None:
            continue
        for where, mask in _parts(subject, group):
            terms = (harmonics if covariate.angle else polynomials)(np.atleast_2d(values)[:, mask], covariate.degree)
            if mask.sum() < _FEWEST_FOR * terms.shape[1]:
                continue
            full = np.zeros((group.observations.count, terms.shape[1]))
            full[mask] = terms
            found.append((_alternative(covariate, where), _components(system, group, full)))
    by_size: dict[int, list[tuple[Alternative, Array]]] = {}
    for item in found:
        by_size.setdefault(item[1].shape[1], []).append(item)
    for items in by_size.values():
        columns = np.stack([columns for _, columns in items], axis=1)
        raw = np.linalg.norm(columns, axis=0)
        shape = columns.shape
        seen = system.seen(columns.reshape(shape[0], -1)).reshape(shape)
        yield Family(f"smooth in {covariate.name}", tuple(a for a, _ in items), seen, raw, unknown=covariate.name)


def _parts(subject: Subject, group: Group) -> Iterator[tuple[tuple[str, ...], Array]]:
    """Yield all readings, then those of each unit."""
    count = group.observations.count
    yield (), np.ones(count, dtype=bool)
    for key in subject.units:
        place = subject.model.places[key]
        index = group.observations.index.get(place.index)
        if index is not None:
            for number, name in enumerate(place.names):
                yield (name,), index == number


def _components(system: System, group: Group, terms: Array) -> Array:
    """Return terms (n, k) for each component of the readings on its own, whitened, (rows, k components)."""
    observations = group.observations
    d, n = observations.readings.shape
    k = terms.shape[1]
    full = np.zeros((system.rows, k * d))
    start = system.first[group.name]
    rows = slice(start, start + d * n)
    factor = observations.sigma.T.ravel() / system.scale[rows]
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
