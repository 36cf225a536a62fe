"""Piecewise linear functions between knots: of an angle around the circle, or of coordinates in each unit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index


def around_circle(several: Sequence[Array], count: int) -> tuple[list[Array], Array]:
    """Return functions of angles (1, n) of each group, (n, knots), and the distances of their knots.

    The distance is the chord, as a share of the diameter: a distance for which the covariance stays one on the circle.
    """
    turns = np.arange(count) / count
    functions = []
    for values in several:
        own = piecewise(np.mod(values[0] / (2 * np.pi), 1.0), np.append(turns, 1.0))
        own[:, 0] += own[:, -1]
        functions.append(own[:, :-1])
    return functions, np.abs(np.sin(np.pi * (turns[:, None] - turns)))


def between_knots(several: Sequence[Array], labels: Sequence[Index], count: int) -> tuple[list[Array], Array]:
    """Return functions of coordinates (k, n) of each group, (n, knots), and the distances of their knots.

    Knots begin at the lowest value of each unit (`labels`, (n,)) and span the largest range of a unit: views that are
    measured one after the other each have all of them.
    """
    whole, units = np.concatenate(several, axis=1), np.concatenate(labels)
    low, high = np.full((2, len(whole), int(units.max()) + 1), np.inf)
    for axis, values in enumerate(whole):
        np.minimum.at(low[axis], units, values)
        np.minimum.at(high[axis], units, -values)
    spans = np.where(np.isfinite(low), -high - low, 0.0).max(axis=1)
    span = np.where(spans > 0, spans, 1.0)[:, None]
    ends = np.linspace(0.0, 1.0, count)
    functions = []
    for values, label in zip(several, labels, strict=True):
        product = np.ones((values.shape[1], 1))
        for row in (values - low[:, label]) / span:
            product = (product[:, :, None] * piecewise(row, ends)[:, None, :]).reshape(len(product), -1)
        functions.append(product)
    places = np.stack([one.ravel() for one in np.meshgrid(*[ends] * len(whole), indexing="ij")], axis=1)
    return functions, np.asarray(np.linalg.norm(places[:, None] - places, axis=2))


def piecewise(values: Array, knots: Array) -> Array:
    """Return piecewise linear functions of values (n,), each 1 at its knot and 0 at the others, (n, knots)."""
    at = np.clip(np.searchsorted(knots, values, side="right") - 1, 0, len(knots) - 2)
    part = (values - knots[at]) / (knots[at + 1] - knots[at])
    found, rows = np.zeros((len(values), len(knots))), np.arange(len(values))
    found[rows, at], found[rows, at + 1] = 1 - part, part
    return found
