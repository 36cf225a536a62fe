"""Covariates of readings, and errors that are correlated over one: piecewise linear functions of it between knots.

An error of unit variance is `B V c`: B the functions at the readings, V the root of the Matern covariance between the
knots, c independent coefficients of variance 1. Method: docs/algorithms/evidence.md (correlated errors).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.settings import Number, Text, setting

if TYPE_CHECKING:
    from metrocli.effects.model import Model

PerReading = Mapping[str, Array]
"""Values (n,) or (k, n) for each group of readings, by its name"""
Numbers = np.ndarray[tuple[int, ...], np.dtype[np.int32]]
"""Numbers of knots; of many readings they are large"""
Values = tuple[Array, Numbers]
"""Functions that are not 0 at each reading: their values (n, m), 1 at their knots, and the numbers of these (n, m)"""


@dataclass(frozen=True)
class Covariate:
    """A quantity that an unknown effect could vary with; smooth functions of it are tried."""

    name: str
    """Its name in the file (t_s, temp_degC), or in words (beam direction)"""
    values: PerReading
    """Values (n,), or (k, n) if it has several coordinates, such as a direction"""
    angle: bool = False
    """Whether it is an angle, so that harmonics of it are tried"""
    periodic: bool = False
    """Whether sines of it are tried, over a scan of periods"""
    together: bool = False
    """Whether its coordinates (k, n) are the terms themselves, for all groups at once (e.g. an unknown rigid motion)"""
    of_units: bool = False
    """Whether errors over it are tried unit by unit only, because an effect is the error that all readings share"""


Covariates = Callable[["Model"], Iterable[Covariate]]
"""Returns the covariates of the readings of a model at its present values"""


@dataclass(frozen=True)
class StatedCorrelation:
    """An entry of `correlated:`: errors that vary smoothly with a covariate."""

    covariate: str = setting(Text(), "quantity over which the errors are correlated, as diagnose names it")
    length: float = setting(Number(above=0, maximum=1), "length of the correlation, as a share of the range")
    std: str = setting(Text(), "standard deviation, with the unit of the readings")
    by: str = setting(Text(), "kind of place with an independent error each, such as tracer or image", default="")
    only: str = setting(Text(), "the one place of that kind that has it", default="")


@dataclass(frozen=True)
class SmoothFunctions:
    """Piecewise linear functions of a covariate between knots, at the readings of each group."""

    values: tuple[Values, ...]
    """Of each group"""
    distances: Array
    """Between knots, as shares of the range, (knots, knots)"""


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
_RESOLVED = 0.6
"""Least length of correlation, in distances of the knots"""
_RICH = 0.02
"""Smallest eigenvalue of a covariance of knots, relative to the largest, that counts in a search"""
_STEPS = 16
"""Distances between knots to a stated length: what runs straight between them leaves 1 % of a standard deviation"""
STATED_RICH = 1e-4
"""The same as `_RICH` for a stated error: what is left out, 2 % of its standard deviation, stands in no uncertainty"""


def smooth_functions(
    covariate: Covariate, groups: Sequence[Group], labels: Sequence[Index], units: int, length: float = 1.0
) -> SmoothFunctions | None:
    """Return the functions of a covariate at the readings of groups, whose units have `labels` (n,) each.

    Errors of a stated `length` have knots close enough for it, as far as the columns allow.
    None where there are too few readings, too many units, or one value in all readings of a unit: the time of an image
    has no length in it.
    """
    several = [np.atleast_2d(covariate.values[group.name]) for group in groups]
    copies = units * sum(len(group.observations.readings) for group in groups)
    rows = sum(group.observations.readings.size for group in groups)
    along = (_AROUND,) if covariate.angle else _KNOTS.get(len(several[0]), _FEW_KNOTS)
    most, fewest = min(_MOST_COLUMNS, _MOST_NUMBERS // rows) // copies, min(map(_fewest, labels))
    dense = max(_ENOUGH, fewest // _READINGS, 1 + int(_STEPS / length))
    count = next((knots for knots in along if knots <= dense and knots ** len(several[0]) <= most), 0)
    if count == 0 or fewest < _FEWEST or not lowest_and_spans(several, labels)[1].any():
        return None
    values, distances = around_circle(several, count) if covariate.angle else between_knots(several, labels, count)
    return SmoothFunctions(tuple(values), distances)


def _fewest(labels: Index) -> int:
    counts = np.bincount(labels)
    return int(counts[counts > 0].min(initial=len(labels)))


def least_length(distances: Array) -> float:
    """Return the least length of correlation that knots some distances apart resolve."""
    return _RESOLVED * float(np.min(distances[distances > 0]))


def kernel(distances: Array, length: float, rich: float = _RICH) -> Array:
    """Return V, (knots, k), with `V V'` the Matern covariance (3/2) of unit variance of knots some distances apart."""
    x = np.sqrt(3) * distances / length
    values, vectors = np.linalg.eigh((1 + x) * np.exp(-x))
    kept = values > rich * values[-1]
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))


def around_circle(several: Sequence[Array], count: int) -> tuple[list[Values], Array]:
    """Return functions of angles (1, n) of each group, and the distances of their knots.

    The distance is the chord, as a share of the diameter: a distance for which the covariance stays one on the circle.
    """
    turns = np.arange(count) / count
    functions = []
    for values in several:
        # the knot that closes the circle is the first one again
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
    places = np.stack([coordinate.ravel() for coordinate in np.meshgrid(*[ends] * len(low), indexing="ij")], axis=1)
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
    # a value at the last knot belongs to the last interval
    at = np.clip(np.searchsorted(knots, values, side="right") - 1, 0, len(knots) - 2).astype(np.int32)
    part = (values - knots[at]) / (knots[at + 1] - knots[at])
    return np.stack([1 - part, part], axis=1), np.stack([at, at + 1], axis=1)
