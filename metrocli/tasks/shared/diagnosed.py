"""What kinds of job share in the form that diagnosis needs: covariates, and the parts that are held out in turn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.arrays import Array, Index
from metrocli.effects.covariates import Covariate
from metrocli.effects.effect import ELAPSED, WARMING

FOLDS = 10
"""Parts of the readings that cross-validation holds out in turn, at most"""


def in_parts(order: Array, count: int) -> Index:
    """Return the part (n,) of each of n measurements: runs in this order, of about equally many.

    Readings at one time, such as the lengths of one stop, are in one part, whatever their order in the file. Too few
    times for so many parts are no order: equal ones then keep that of the file.
    """
    first = np.searchsorted(np.sort(order), order)
    # argsort twice is the rank
    rank = np.argsort(np.argsort(order, kind="stable"), kind="stable")
    together, apart = (np.asarray(each * count // max(len(order), 1), dtype=np.intp) for each in (first, rank))
    return together if len(np.unique(together)) == len(np.unique(apart)) else apart


def in_time(groups: Sequence[Group]) -> Iterator[Covariate]:
    """Yield time and temperature of the readings, as far as all groups have them."""
    for name, condition in (("t_s", ELAPSED), ("temp_degC", WARMING)):
        if groups and all(condition in group.observations.conditions for group in groups):
            yield Covariate(name, {group.name: group.observations.conditions[condition] for group in groups})


def in_order(group: Group) -> Iterator[Covariate]:
    """Yield time and temperature of the readings, and their order where they have no times."""
    yield from in_time([group])
    if ELAPSED not in group.observations.conditions:
        order = np.arange(group.observations.count, dtype=float)
        yield Covariate("order of the readings", {group.name: order})


def of_beam(group: Group, beam: Array) -> Iterator[Covariate]:
    """Yield length and direction of the beams (3, n) of lengths."""
    length = np.sqrt((beam**2).sum(axis=0))
    yield Covariate("length_mm", {group.name: length})
    yield Covariate("beam azimuth", {group.name: np.arctan2(beam[1], beam[0])}, angle=True)
    yield Covariate("beam elevation", {group.name: beam[2] / length})
