"""Refusals of a part with a notch: the surfaces that they name contradict each other, and each of them is needed."""

from __future__ import annotations

import numpy as np
import pytest
from simulated.notch import largest_least, notched, plane_of, raw

from metrocli.tasks.fit_part.contradiction import contradictions
from metrocli.tasks.fit_part.fit import most_of_many
from metrocli.tasks.fit_part.nominals import OfMesh
from metrocli.tasks.fit_part.stock import Stock

MINIMUM = 0.5
DEEP = [(seed, (3, 9), 0.0) for seed in (8, 18, 56)]
"""Parts with much missing, and points up to the edges"""


@pytest.mark.parametrize(
    ("seed", "missing", "to_edges"), [(5, (2, 5), 0.08), (16, (2, 5), 0.08), (18, (2, 5), 0.08), *DEEP]
)
def test_named_surfaces_contradict_each_other_and_each_is_needed(
    seed: int, missing: tuple[float, float], to_edges: float
) -> None:
    """By the planes that the points were made on: next to an edge a point far too low is nearer to another one."""
    points, of = raw(seed, missing, to_edges)
    nominal = OfMesh(notched())
    stock = Stock(nominal, points, nominal.nearest(points))
    pose, least, _ = most_of_many(stock, np.zeros(6))
    assert least < MINIMUM
    for found in contradictions(stock, MINIMUM, pose):
        named = [plane_of(nominal, name) for name in found.surfaces]
        rows = np.isin(of, named)
        assert largest_least(points[rows], of[rows]) < MINIMUM
        for one in named:
            others = np.isin(of, [other for other in named if other != one])
            assert largest_least(points[others], of[others]) >= MINIMUM
