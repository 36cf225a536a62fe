"""The targets of an image job, from a list or from a printed pattern, and how well their places are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.errors import InputError, all_faults
from metrocli.frozen import dataclass
from metrocli.table import Columns, Table, columns
from metrocli.targets.pattern import Pattern, pattern_points
from metrocli.tasks.shared.lists import SIGMAS, refuse, sigmas

TARGETS = Columns(
    (*columns("target [text]", "x y z [length]"), *SIGMAS, *columns("radius?* [length]")),
    key=("target",),
    description="coordinates of targets",
)


@dataclass(frozen=True)
class TargetCoordinates:
    """A list of targets and how well each coordinate is known."""

    names: tuple[str, ...]
    points: Array
    """(m, 3) mm"""
    sigma: Array
    """(m, 3) mm: 0 exact, nan unknown"""
    radius: Array
    """(m,) mm, nan if it is not given"""


def known_targets(
    pattern: Pattern | None, targets: Table | None, unknown_sigma: float, of_pattern: float = 0.0
) -> TargetCoordinates:
    """Return the targets of the list, or without a list those of the printed pattern.

    A target without a radius in the list has that of the pattern. `unknown_sigma` [mm] is the standard deviation in a
    list without a sigma column, `of_pattern` that of a pattern without a list. Raises InputError without list and
    pattern.
    """
    if targets is not None:
        known = read_targets(targets, unknown_sigma)
    elif pattern is not None:
        known = targets_of(pattern, of_pattern)
    else:
        raise InputError("there is no list of targets")
    if pattern is not None and pattern.diameter is not None:
        known = replace(known, radius=np.where(np.isnan(known.radius), pattern.diameter / 2, known.radius))
    return known


def read_targets(table: Table, default_sigma: float = 0.0) -> TargetCoordinates:
    """Return the targets of a list; without a sigma column their sigma is `default_sigma` [mm] (nan: unknown).

    Raises InputError that names every row with a negative standard deviation or a radius that is not above zero.
    """
    radius = table.numbers("radius", np.nan)
    with all_faults() as each:
        with each():
            sigma = sigmas(table, default_sigma)
        with each():
            refuse(table, {"a radius is not above zero": np.asarray(radius <= 0)})
    return TargetCoordinates(tuple(table.texts("target")), table.stacked("xyz"), sigma, radius)


def targets_of(pattern: Pattern, sigma: float = 0.0) -> TargetCoordinates:
    """Return the targets of a printed pattern with a standard deviation [mm]; nan: unknown."""
    names, points = pattern_points(pattern)
    return TargetCoordinates(tuple(names), points, np.full_like(points, sigma), np.full(len(names), np.nan))


def images_needed(targets: TargetCoordinates) -> Index:
    """Return in how many images each target has to be seen, (m,): two if a coordinate of it is unknown, else one."""
    return np.where(np.isnan(targets.sigma).any(axis=1), 2, 1)
