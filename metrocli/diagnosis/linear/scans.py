"""Values of scanned parameters that are tried: so many that no form of an effect between two of them is missed.

Method: docs/algorithms/what-can-be-seen.md (scans).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.linear.projection import Linearised
from metrocli.diagnosis.linear.signatures import of_places, scan_with_values
from metrocli.effects.effect import Effect
from metrocli.effects.model import Model

_MOST_ELEMENTS, _FEWEST, _MOST = 20_000_000, 8, 1000
"""Largest number of elements of a scan's columns, the number of values tried in any case, and the largest number"""
ALIKE, _APART = 0.5, 0.25
"""Mean squared cosine of two values' visible columns below which one between them is tried, or is missing

At 0.5 a form halfway keeps 85 % of its sum of squares along each of the two, at 0.25 it keeps 75 %.
"""
_DRAWS = 48
"""Random visible vectors that stand for the columns: their products give cosines to 0.15"""
_PLACES = 10
"""Largest number of places whose columns are compared"""


def scans(model: Model, effect: Effect, rows: int) -> list[dict[str, float]]:
    """Return all combinations of scanned values to begin with; one empty combination without scanned parameters."""
    grids: list[list[tuple[str, float]]] = []
    for parameter in effect.scanned:
        values: Array = np.zeros(0)
        if parameter.place:
            # from the second place on: what acts from the first one on acts on all
            values = np.arange(1.0, len(model.places[parameter.place].names))
        elif parameter.grid is not None:
            grid = parameter.grid(conditions_of(model))
            values = thinned(grid, parameter.tried if effect.is_step else min(parameter.tried, _of_each(effect, rows)))
        grids.append([(parameter.name, float(value)) for value in values])
    return [dict(combination) for combination in itertools.product(*grids)]


def conditions_of(model: Model) -> Mapping[str, Array]:
    """Return the conditions of all readings, (..., n) each: some may have no distance, but all have times."""
    every = [group.observations.conditions for group in model.readings]
    names = dict.fromkeys(name for conditions in every for name in conditions)
    return {
        name: np.concatenate([conditions[name] for conditions in every if name in conditions], axis=-1)
        for name in names
    }


def thinned(values: Array, most: int) -> Array:
    """Return at most `most` of the values, evenly spaced in their order."""
    if len(values) <= most:
        return values
    return np.asarray(values[np.linspace(0, len(values) - 1, most).astype(int)])


def most_tried(effect: Effect, rows: int) -> int:
    """Return how many values of a scanned parameter are tried at most, those in between included."""
    tried = max((parameter.tried for parameter in effect.scanned), default=1)
    if is_filled(effect):
        return max(tried, min(_MOST, _held(effect, rows)))
    return tried if effect.is_step else min(tried, _of_each(effect, rows))


def _of_each(effect: Effect, rows: int) -> int:
    """Return how many values of each scanned number are tried at most, so that the columns of all combinations fit."""
    numbers = sum(parameter.grid is not None for parameter in effect.scanned)
    # the root of a whole power may be rounded to just below it
    return int(_held(effect, rows) ** (1 / max(numbers, 1)) + 1e-9)


def _held(effect: Effect, rows: int) -> int:
    return max(_MOST_ELEMENTS // (rows * len(effect.parameters)), _FEWEST)


def is_filled(effect: Effect) -> bool:
    """Return whether values in between are tried: one scanned parameter, no time of a step, no place, no count."""
    if len(effect.scanned) != 1 or effect.is_step:
        return False
    return effect.scanned[0].grid is not None and not effect.scanned[0].whole


def scanned_columns(
    system: Linearised, effect: Effect, places: Sequence[tuple[str, ...]]
) -> Iterator[tuple[Mapping[str, float], tuple[Array, Block, Mask]]]:
    """Yield the scanned values with what `scan` yields, and values in between until neighbours' columns are alike.

    So a wave whose period lies between two values of a coarse scan is not missed.
    """
    model, start = system.model, scans(system.model, effect, system.rows)
    if not is_filled(effect) or len(start) < 2:
        yield from scan_with_values(system, effect, places, start)
        return
    parameter = effect.scanned[0]
    assert parameter.grid is not None
    grid = np.sort(parameter.grid(conditions_of(model)))
    seen, sketches = sketch_vectors(system), dict[float, list[Array]]()
    # the listed values are starting points of the scan: a wave between two of them would be missed
    # (docs/decisions/130-dense-scans.md)
    wanted, left = start, most_tried(effect, system.rows) - len(start)
    while wanted:
        for scanned, columns in scan_with_values(system, effect, places, wanted, needed=wanted is start):
            full, block, chosen = columns
            products = seen.T @ full
            some = itertools.islice(of_places(model, block, chosen, places), _PLACES)
            sketches[scanned[parameter.name]] = [_orthonormal(products[:, own]) for _, _, own in some]
            yield scanned, columns
        between = _between(sketches, grid)[: max(left, 0)]
        wanted, left = [{parameter.name: value} for value in between], left - len(between)


def sketch_vectors(system: Linearised) -> Array:
    """Return random visible vectors (rows, draws), whose products with columns keep the cosines between these."""
    return system.seen(np.random.default_rng(0).standard_normal((system.rows, _DRAWS)))


def _between(sketches: Mapping[float, Sequence[Array]], grid: Array) -> list[float]:
    """Return the grid values halfway between neighbours whose columns differ at any place, the widest gaps first.

    `sketches` are orthonormal bases of the columns at each place, by value.
    """
    tried = sorted(sketches)
    at = np.searchsorted(grid, tried)
    cosines = [
        # at the place where they differ most: a gap that one tracer shows is a gap
        min((_alike(a, b) for a, b in zip(sketches[low], sketches[high], strict=False)), default=1.0)
        for low, high in itertools.pairwise(tried)
    ]
    # neighbours in the grid have nothing between them
    gaps = [(cosine, (a + b) // 2) for cosine, (a, b) in zip(cosines, itertools.pairwise(at), strict=True) if b - a > 1]
    return [float(grid[middle]) for cosine, middle in sorted(gaps) if cosine < ALIKE]


def any_apart(products: Array) -> bool:
    """Return whether a form between any two neighbours can be missed, from their sketches (alternatives, q, draws)."""
    return any(_alike(*both) < _APART for both in itertools.pairwise(_orthonormal(product.T) for product in products))


def _alike(basis: Array, other: Array) -> float:
    """Return the mean squared cosine between the spans of two orthonormal bases (n, q); 1 where one has none."""
    fewest = min(basis.shape[1], other.shape[1])
    return float(((basis.T @ other) ** 2).sum() / fewest) if fewest else 1.0


def _orthonormal(columns: Array) -> Array:
    left, values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, values > 1e-6 * values.max(initial=1e-300)])
