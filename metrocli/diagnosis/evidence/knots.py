"""Piecewise linear functions between knots: of an angle around the circle, or of coordinates in each unit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index

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
