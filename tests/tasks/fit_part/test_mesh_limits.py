"""Many points on a mesh: the largest least overstock is that of all of them, and a part does not slide out of its mesh."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry.test_triangles import SIZE, block
from scipy.optimize import linprog
from simulated.castings import Array
from tasks.fit_part.test_faults import stl

from metrocli.formats import hdf5
from metrocli.geometry.rotations import rotation_from_vector
from metrocli.tasks.fit_part.contradiction import contradictions
from metrocli.tasks.fit_part.fit import max_least_overstock_of_many
from metrocli.tasks.fit_part.nominals import OfMesh
from metrocli.tasks.fit_part.stock import Stock

Metrocli = Callable[..., Any]
COUNT = 600
"""Points on each side of the block"""
UNMOVED = np.zeros(6)


def on_block(level: float, rough: float, rough_top: float) -> tuple[Array, Array]:
    """Points at a level over each side of the block, away from its edges, and the side of each: axis and end."""
    rng = np.random.default_rng(6)
    points, sides = [], []
    for axis in range(3):
        for end in (0, 1):
            places = 5 + rng.uniform(0, 1, (COUNT, 3)) * (SIZE - 10)
            scatter = rough_top if (axis, end) == (2, 1) else rough
            off = level + scatter * rng.uniform(-1, 1, COUNT)
            places[:, axis] = SIZE[axis] + off if end else -off
            points.append(places)
            sides.append(np.tile([axis, end], (COUNT, 1)))
    return np.concatenate(points), np.concatenate(sides)


def largest_least(points: Array, sides: Array) -> float:
    """The same from the planes of the block: linear programmes over all points, each about the pose of the one before."""
    axis, end = sides.T
    normal = np.eye(3)[axis] * np.where(end, 1.0, -1.0)[:, None]
    least, reach = -np.inf, 0.1
    while reach > 1e-5:
        off = (normal * points).sum(axis=1) - np.where(end, SIZE[axis], 0.0)
        least = max(least, float(off.min()))
        rows = np.concatenate([normal, np.cross(points, normal)], axis=1)
        limits = [(-100 * reach, 100 * reach)] * 3 + [(-reach, reach)] * 3 + [(None, None)]
        against = np.column_stack([-rows, np.ones(len(off))])
        step = linprog(np.append(np.zeros(6), -1.0), against, off, bounds=limits).x
        points, reach = points @ rotation_from_vector(step[3:6]).T + step[:3], reach / 3
    return least


def stock_of(points: Array) -> Stock:
    nominal = OfMesh(block(3))
    return Stock(nominal, points, nominal.nearest(points))


@pytest.mark.slow
def test_the_lowest_points_may_all_lie_on_one_side() -> None:
    """They alone would leave unlimited overstock."""
    points, sides = on_block(3.0, 0.05, 2.0)
    lowest = np.argsort(stock_of(points).at(UNMOVED).overstock)[:100]
    assert (sides[lowest] == (2, 1)).all()
    points, sides = np.repeat(points, 4, axis=0), np.repeat(sides, 4, axis=0)
    points = points + np.random.default_rng(2).uniform(-0.001, 0.001, points.shape)
    _, least, duals = max_least_overstock_of_many(stock_of(points), UNMOVED)
    assert least == pytest.approx(largest_least(points, sides), abs=1e-3)
    assert {tuple(one) for one in sides[duals > 1e-9]} >= {(2, 0), (2, 1)}


@pytest.mark.slow
def test_points_inside_contradict_each_other_on_opposite_sides() -> None:
    points, sides = on_block(-3.0, 0.2, 0.2)
    stock = stock_of(points)
    pose, _, _ = max_least_overstock_of_many(stock, UNMOVED)
    found = contradictions(stock, 0.5, pose)
    assert len(found) == 3
    for one in found:
        rows = np.isin(stock.surface, [stock.nominal.names.index(name) for name in one.surfaces])
        assert {tuple(side) for side in sides[rows]} in [{(k, 0), (k, 1)} for k in range(3)]
        assert one.least == pytest.approx(largest_least(points[rows], sides[rows]), abs=1e-3)
    first = [stock.nominal.names.index(name) for name in found[0].surfaces]
    others = [largest_least(points[stock.surface != k], sides[stock.surface != k]) for k in first]
    assert found[0].without == pytest.approx(others, abs=1e-3)


def test_points_on_one_side_leave_three_motions_open_or_the_part_where_it_is(
    tmp_path: Path, metrocli: Metrocli
) -> None:
    stl(tmp_path / "part.stl", block(2).corners)
    top = np.random.default_rng(1).uniform(0, 1, (40, 3)) * [50, 30, 0.2] + [5, 5, 22]
    rows = [f"P{n},{x:.4f},{y:.4f},{z:.4f}" for n, (x, y, z) in enumerate(top.tolist())]
    (tmp_path / "points.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm", *rows, ""]))
    job = tmp_path / "job.yaml"
    job.write_text(
        "metrocli: 1\njob: fit-part\ninputs: {points: points.csv, nominal: part.stl}\nnoise: 0.02 mm\n"
        "overstock: {minimum: 0.5 mm, aim: even}\noutput: part.h5\n"
    )
    ran = metrocli("fit-part", job)
    assert ran.code == 4 and "3 independent constraints of the 6" in ran.err
    for motion in ("a turn about the direction z", "a shift along x", "a shift along y"):
        assert motion in ran.err
    ran = metrocli("fit-part", job, "--set", "overstock.aim=least-motion")
    assert ran.code == 0 and "there the part stays where it was" in ran.err
    pose = hdf5.read(tmp_path / "part.h5")[0].estimates
    assert [one.value for one in pose] == [0.0] * 6 and all(one.std == 0.0 for one in pose)
