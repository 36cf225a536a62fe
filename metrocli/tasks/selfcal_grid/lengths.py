"""Length errors of a machine from its error at sites, as calibrated lengths in all directions would show them."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.table import Table

_MOST = 1400
"""Largest number of sites of which all pairs are calculated"""
_BINS = 12


@dataclass(frozen=True)
class LargestLengthError:
    """The largest error of a length between two sites, `(G_b - G_a) . u` with u the direction from a to b."""

    first: int
    second: int
    error: float
    direction: Array
    table: Table
    """Largest and root mean square error by length"""
    sites: int
    """Number of sites of which all pairs were calculated"""


def largest(places: Array, errors: Array) -> LargestLengthError | None:
    """Return the largest length error of a field (n, 3) at places (n, 3), or None for fewer than two sites.

    Every pair of sites is a length from centre to centre. So it compares with the length errors of ISO 10360-2, but has
    no probing error. If n is large, a regular part of the sites is used.
    """
    chosen = _thinned(places)
    if len(chosen) < 2:
        return None
    first, second = np.triu_indices(len(chosen), 1)
    first, second = chosen[first], chosen[second]
    between = places[second] - places[first]
    length = np.sqrt(np.einsum("na,na->n", between, between))
    error = np.einsum("na,na->n", errors[second] - errors[first], between) / length
    worst = int(np.argmax(np.abs(error)))
    table = _by_length(length, error)
    return LargestLengthError(
        int(first[worst]), int(second[worst]), float(error[worst]), between[worst] / length[worst], table, len(chosen)
    )


def _thinned(places: Array) -> Index:
    """Return all sites, or those of every second, third, ... layer in each direction, with the outermost layers."""
    layers = [np.unique(places[:, a], return_inverse=True) for a in range(3)]
    for step in range(1, 200):
        keep = np.ones(len(places), dtype=bool)
        for values, at in layers:
            last = len(values) - 1
            kept = np.zeros(len(values), dtype=bool)
            kept[np.unique(np.rint(np.linspace(0, last, max(last // step, 1) + 1)).astype(int))] = True
            keep &= kept[at.reshape(-1)]
        if keep.sum() <= _MOST:
            break
    return np.flatnonzero(keep)


def _by_length(length: Array, error: Array) -> Table:
    edges = np.linspace(0.0, length.max() * (1 + 1e-12), _BINS + 1)
    at = np.clip(np.searchsorted(edges, length, side="right") - 1, 0, _BINS - 1)
    count = np.bincount(at, minlength=_BINS)
    largest = np.zeros(_BINS)
    np.maximum.at(largest, at, np.abs(error))
    square = np.bincount(at, error**2, minlength=_BINS)
    used = count > 0
    return Table.of(
        {
            "from_length [mm]": edges[:-1][used],
            "to_length [mm]": edges[1:][used],
            "lengths": count[used],
            "largest_error [mm]": largest[used],
            "rms_error [mm]": np.sqrt(square[used] / count[used]),
        }
    )
