"""Refusals of a part with a notch: the surfaces that they name contradict each other, and each of them is needed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulated.notch import largest_least, notched, plane_of, raw

from metrocli.errors import UndeterminedError
from metrocli.table import Table
from metrocli.tasks.fit_part.contradiction import contradictions
from metrocli.tasks.fit_part.fit import EVEN, max_least_overstock_of_many
from metrocli.tasks.fit_part.nominals import OfMesh
from metrocli.tasks.fit_part.settings import Inputs, Overstock, Settings
from metrocli.tasks.fit_part.solve import prepare, solve
from metrocli.tasks.fit_part.stock import Stock

MINIMUM = 0.5
DEEP = [(seed, (3, 9), 0.0) for seed in (8, 18, 56)]
"""Parts with much missing, and points up to the edges"""
OTHERS = [(16, (2, 5), 0.08), (18, (2, 5), 0.08), *DEEP[1:]]


@pytest.mark.parametrize(
    ("seed", "missing", "to_edges"),
    [(5, (2, 5), 0.08), *(pytest.param(*one, marks=pytest.mark.slow) for one in (DEEP[0], *OTHERS))],
)
def test_named_surfaces_contradict_each_other_and_each_is_needed(
    seed: int, missing: tuple[float, float], to_edges: float
) -> None:
    """By the planes that the points were made on: next to an edge a point far too low is nearer to another one."""
    points, of = raw(seed, missing, to_edges)
    nominal = OfMesh(notched())
    stock = Stock(nominal, points, nominal.nearest(points))
    pose, least, _ = max_least_overstock_of_many(stock, np.zeros(6))
    assert least < MINIMUM
    for found in contradictions(stock, MINIMUM, pose):
        named = [plane_of(nominal, name) for name in found.surfaces]
        rows = np.isin(of, named)
        assert largest_least(points[rows], of[rows]) < MINIMUM
        for one in named:
            others = np.isin(of, [other for other in named if other != one])
            assert largest_least(points[others], of[others]) >= MINIMUM


@pytest.mark.parametrize(
    ("seed", "named"), [(139, [[0, 2]]), pytest.param(395, [[0, 2], [1, 3]], marks=pytest.mark.slow)]
)
def test_a_point_counts_for_a_patch_beyond_the_next_and_one_of_no_level_for_none(
    seed: int, named: list[list[int]]
) -> None:
    """Walls that lack half of their thickness: points far inside are next to a patch two edges away from their own.

    Both parts then named a further pair of faces, which by their planes leave 0.96 and 1.45 mm together.
    """
    points, _ = raw(seed, (3, 9), 0.0)
    mesh, names = notched(), np.array([f"P{n}" for n in range(len(points))])
    table = Table({"point": names, **{axis: points[:, k] for k, axis in enumerate("xyz")}})
    settings = Settings(
        Inputs(points=Path("points.csv"), nominal=Path("part.stl")), Overstock(MINIMUM, EVEN), noise=0.02
    )
    with pytest.raises(UndeterminedError) as raised:
        solve(settings, prepare(settings, mesh, table))
    lines = [line.strip().partition(": ") for line in str(raised.value).splitlines()]
    sets = [text.partition(" (")[0] for start, _, text in lines if start.startswith(("surfaces that", "beside"))]
    assert [[plane_of(OfMesh(mesh), name) for name in one.split(" and ")] for one in sets] == named
