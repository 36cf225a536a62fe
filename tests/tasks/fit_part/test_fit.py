"""Castings fitted by the command line, against a dense solver that shares nothing with it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize
from simulated.castings import NAMES, Array, Casting, casting, turn

from metrocli.formats import hdf5
from metrocli.result import Result

Metrocli = Callable[..., Any]
SCALE = np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])
"""Steps of the dense solver: mm and mrad"""


_FITTED: dict[object, Result] = {}


def fitted(job: Path, metrocli: Metrocli, *options: str) -> Result:
    """Fit a part, unless the result of the same files and options is known."""
    key = *(path.read_bytes() for path in sorted(job.parent.iterdir()) if path.suffix != ".h5"), options
    if key not in _FITTED:
        ran = metrocli("fit-part", job, "--force", *options)
        assert ran.code == 0, ran.err
        _FITTED[key] = hdf5.read(job.parent / "part.h5")[0]
    return _FITTED[key]


def pose_of(result: Result) -> Array:
    return np.array([one.value for one in result.estimates])


def dense(one: Casting, start: Array, value: Callable[[Array], float], minimum: float) -> Array:
    """The pose with the least value that has the minimum everywhere, by SLSQP with all points."""
    found = minimize(
        lambda p: value(start + p * SCALE),
        np.zeros(6),
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda p: one.overstock_at(start + p * SCALE) - minimum},
        options={"ftol": 1e-15, "maxiter": 500},
    )
    return start + found.x * SCALE


def largest_least(one: Casting, start: Array) -> tuple[Array, float]:
    """The pose with the largest least overstock, by SLSQP with that overstock as a seventh unknown.

    Moves are at most 50 mm: one surface alone has no largest overstock, and the search would run away.
    """
    x = np.append(np.zeros(6), one.overstock_at(start).min())
    for _ in range(3):
        x = minimize(
            lambda p: -p[6],
            x,
            method="SLSQP",
            constraints={"type": "ineq", "fun": lambda p: one.overstock_at(start + p[:6] * SCALE) - p[6]},
            bounds=[(-50.0, 50.0)] * 6 + [(None, None)],
            options={"ftol": 1e-15, "maxiter": 500},
        ).x
    pose = start + x[:6] * SCALE
    return pose, float(one.overstock_at(pose).min())


def even(one: Casting) -> Callable[[Array], float]:
    return lambda pose: float(one.overstock_at(pose).var())


def moved(one: Casting) -> Callable[[Array], float]:
    return lambda pose: float((((one.points - pose[:3]) @ turn(pose[3:]) - one.points) ** 2).sum(axis=1).mean())


@pytest.mark.parametrize("minimum", [0.5, 2.0])
def test_even_is_the_least_variation(minimum: float, tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(11)
    result = fitted(one.write(tmp_path, minimum=minimum), metrocli)
    pose = pose_of(result)
    best = dense(one, one.pose, even(one), minimum)
    assert np.abs((pose - best) / SCALE).max() < 2e-3
    assert even(one)(pose) <= even(one)(best) + 1e-9
    assert one.overstock_at(pose).min() >= minimum - 1e-9
    held = one.overstock_at(pose) < minimum + 1e-8
    assert held.sum() == len(result.tables["holding"]) == result.statistics["active"]
    assert (minimum == 2.0) == bool(held.any())


def test_least_motion_is_the_least_move(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(12)
    pose = pose_of(fitted(one.write(tmp_path, aim="least-motion"), metrocli))
    best = dense(one, pose_of(fitted(one.write(tmp_path, aim="even"), metrocli)), moved(one), 0.5)
    assert moved(one)(pose) <= moved(one)(best) * (1 + 1e-7)
    assert one.overstock_at(pose).min() == pytest.approx(0.5, abs=1e-9)


def test_most_is_the_largest_least_overstock_and_its_duals_prove_it(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(13)
    result = fitted(one.write(tmp_path, aim="most"), metrocli)
    _, least = largest_least(one, one.pose)
    assert one.overstock_at(pose_of(result)).min() == pytest.approx(least, abs=1e-6)
    assert result.statistics["least_overstock"] == pytest.approx(least, abs=1e-6)
    duals = result.tables["holding"].numbers("dual")
    assert duals.sum() == pytest.approx(1) and len(duals) <= 7
    # weighted by the duals, no small motion raises the points that hold it
    rows = [int(name[1:]) for name in result.tables["holding"].texts("point")]
    step = 1e-4
    for k in range(6):
        move = step * SCALE * np.eye(6)[k]
        change = one.overstock_at(pose_of(result) + move)[rows] - one.overstock_at(pose_of(result) - move)[rows]
        assert abs(duals @ change) / (2 * step) < 1e-4


@pytest.mark.slow
def test_the_duals_are_the_price_of_the_minimum(tmp_path: Path, metrocli: Metrocli) -> None:
    """The sum of the duals is what half the mean square of the variation grows by per mm of minimum."""
    one = casting(11)
    low, high, middle = (fitted(one.write(tmp_path, minimum=minimum), metrocli) for minimum in (1.999, 2.001, 2.0))
    growth = (even(one)(pose_of(high)) - even(one)(pose_of(low))) / 2 / 0.002
    assert middle.tables["holding"].numbers("dual").sum() == pytest.approx(growth, rel=1e-3)


def test_degrees_of_freedom_are_those_that_pose_and_mean_overstock_leave(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(11)
    statistics = fitted(one.write(tmp_path, minimum=0.5), metrocli).statistics
    steps = 1e-4 * SCALE * np.eye(6)
    moves = [one.overstock_at(one.pose + step) - one.overstock_at(one.pose - step) for step in steps]
    columns = np.stack([*moves, np.ones(len(moves[0]))], axis=1)
    left = len(columns) - np.linalg.matrix_rank(columns / np.linalg.norm(columns, axis=0), tol=1e-6)
    assert statistics["dof"] == left == statistics["observations"] - statistics["unknowns"]
    # points that hold the fit make it another than least squares
    assert "dof" not in fitted(one.write(tmp_path, minimum=2.0), metrocli).statistics


def test_named_surfaces_need_no_start(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(14, angle=3.0)
    pose = pose_of(fitted(one.write(tmp_path), metrocli))
    assert np.abs(turn(pose[3:]) - turn(one.pose[3:])).max() < 0.01
    assert one.overstock_at(pose).min() > 0.5


def test_surfaces_are_found_within_ten_degrees(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(15, angle=0.09)
    named = pose_of(fitted(one.write(tmp_path), metrocli))
    found = fitted(one.write(tmp_path, named=False), metrocli)
    assert np.allclose(pose_of(found), named, atol=1e-6)
    assert found.tables["overstock"].texts("surface") == one.surface.tolist()


def test_a_start_replaces_the_ten_degrees(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(16, angle=2.5)
    named = pose_of(fitted(one.write(tmp_path), metrocli))
    at = ", ".join(f"{n}: {v + 30:.1f} mm" for n, v in zip("xyz", one.pose[:3], strict=True))
    turned = ", ".join(
        f"{n}: {v + 0.05:.3f} rad" for n, v in zip(("alpha", "beta", "gamma"), one.pose[3:], strict=True)
    )
    found = pose_of(fitted(one.write(tmp_path, f"start: {{{at}, {turned}}}", named=False), metrocli))
    assert np.allclose(found, named, atol=1e-6)


def test_tables_state_the_overstock(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(11)
    result = fitted(one.write(tmp_path, minimum=2.0), metrocli)
    expected = one.overstock_at(pose_of(result))
    table = result.tables["overstock"]
    assert np.allclose(table.numbers("overstock"), expected, atol=1e-9)
    assert np.allclose(table.numbers("s_overstock"), one.sigma)
    chance = table.numbers("below")
    held = expected < 2.0 + 1e-8
    assert np.allclose(chance[held], 0.5, atol=1e-5)
    draw = np.random.default_rng(5).normal(size=(20000, 1)) * one.sigma + expected
    assert np.allclose(chance, (draw < 2.0).mean(axis=0), atol=0.015)
    surfaces = result.tables["surfaces"]
    for row, name in enumerate(surfaces.texts("surface")):
        own = expected[one.surface == name]
        stated = [surfaces.numbers(column)[row] for column in ("least", "mean", "largest")]
        assert np.allclose(stated, [own.min(), own.mean(), own.max()], atol=1e-9)
        assert surfaces.numbers("below")[row] == pytest.approx(1 - np.prod(1 - chance[one.surface == name]), abs=1e-9)
    assert surfaces.texts("surface") == list(NAMES)


def test_targets_are_carried_into_the_part_frame(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(11)
    result = fitted(one.write(tmp_path), metrocli)
    pose = pose_of(result)
    table = result.tables["targets"]
    assert table.texts("target") == [f"T{n}" for n in range(6)]
    assert np.allclose(table.stacked(("x", "y", "z")), (one.targets - pose[:3]) @ turn(pose[3:]), atol=1e-6)
    # a draw of the pose and of the targets
    rng = np.random.default_rng(6)
    poses = rng.multivariate_normal(pose, result.covariance, 3000)
    places = one.targets + rng.normal(size=(3000, 6, 3)) * one.sigma
    drawn = np.array([((p - at[:3]) @ turn(at[3:])).ravel() for p, at in zip(places, poses, strict=True)])
    common = result.arrays["targets_common"].reshape(18, 6)
    joint = common @ common.T
    for k, own in enumerate(result.arrays["targets_own"]):
        joint[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += own
    expected = np.cov(drawn.T)
    assert np.abs(joint - expected).max() < 0.08 * expected.max()
    assert np.allclose(table.numbers("sigma_y") ** 2, np.diag(joint)[1::3])


@pytest.mark.slow
def test_chips_and_flash_are_left_out_and_named(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(17)
    clean = pose_of(fitted(one.write(tmp_path), metrocli))
    outward = (one.overstock_at(one.pose + 0)[:, None] * 0) + np.array([0.0, 0.0, 1.0]) @ turn(one.pose[3:]).T
    top = np.flatnonzero(one.surface == "top")
    points = one.points.copy()
    points[top[0]] -= 9 * outward[0]
    points[top[1]] += 12 * outward[0]
    spoilt = Casting(one.pose, one.surface, points, one.exact, one.targets, one.sigma)
    job = spoilt.write(tmp_path)
    ran = metrocli("fit-part", job, "--force")
    assert ran.code == 0
    result = hdf5.read(tmp_path / "part.h5")[0]
    rejected = result.tables["rejected"]
    assert rejected.texts("point") == [f"P{top[0]}", f"P{top[1]}"] and rejected.texts("reason") == ["chip", "flash"]
    assert f"P{top[0]}" in ran.err and "the surface stays unclean there" in ran.err
    kept = np.ones(len(one.points), dtype=bool)
    kept[top[:2]] = False
    alone = Casting(one.pose, one.surface[kept], one.points[kept], one.exact[kept], one.targets, one.sigma)
    assert np.allclose(pose_of(result), pose_of(fitted(alone.write(tmp_path), metrocli)), atol=1e-9)
    assert np.abs(pose_of(result)[:3] - clean[:3]).max() < 0.2
    spoilt.write(tmp_path, "outliers: report")
    assert metrocli("fit-part", job, "--force").code == 4


def test_a_point_off_by_a_metre_is_no_chip(tmp_path: Path, metrocli: Metrocli) -> None:
    """It was said that a metre of material is missing, and that the surface stays unclean there."""
    one = casting(17)
    points = one.points.copy()
    points[3] += 1000 * (points.mean(axis=0) - points[3]) / np.linalg.norm(points.mean(axis=0) - points[3])
    job = replace(one, points=points).write(tmp_path)
    ran = metrocli("fit-part", job, "--force")
    assert ran.code == 0 and "1 point is left out as wrong: P3, up to " in ran.err
    assert "unclean" not in ran.err and "chip:" not in ran.err


def test_clean_castings_lose_no_point(tmp_path: Path, metrocli: Metrocli) -> None:
    assert not len(fitted(casting(21).write(tmp_path), metrocli).tables["rejected"])


def test_infeasible_castings_are_refused_with_what_contradicts(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(18, less={"left": -6.0, "right": -2.0})
    ran = metrocli("fit-part", one.write(tmp_path))
    assert ran.code == 4 and not (tmp_path / "part.h5").exists()
    (line,) = [line for line in ran.err.splitlines() if "contradict each other" in line]
    named = line.partition(": ")[2].replace(" and ", ", ").split(", ")
    _, whole = largest_least(one, one.pose)
    assert whole < 0.5
    assert f"`minimum: {np.floor(whole * 100) / 100:.2f} mm` would do" in ran.err or "material is missing" in ran.err

    def least(names: list[str]) -> float:
        rows = np.isin(one.surface, names)
        part = Casting(one.pose, one.surface[rows], one.points[rows], one.exact[rows], one.targets, one.sigma)
        return largest_least(part, one.pose)[1]

    assert {"left", "right"} <= set(named)
    assert f"at most {least(named):.3f} mm" in ran.err and least(named) < 0.5
    for name in named:
        rest = [other for other in named if other != name]
        assert not rest or least(rest) >= 0.5 - 1e-6


@pytest.mark.slow
def test_all_contradictions_are_listed(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(18, less=dict.fromkeys(("left", "right"), -6.0) | dict.fromkeys(("bottom", "top"), -5.0))
    ran = metrocli("fit-part", one.write(tmp_path))
    assert ran.code == 4 and "surfaces that contradict each other: left and right" in ran.err, ran.err

    def least(names: set[str]) -> float:
        rows = np.isin(one.surface, list(names))
        part = replace(one, surface=one.surface[rows], points=one.points[rows], exact=one.exact[rows])
        return largest_least(part, one.pose)[1]

    every = set(NAMES)
    each = " and ".join(f"{least(every - {name}):.3f} mm without {name}" for name in ("left", "right"))
    assert f"the whole part leaves {each}" in ran.err
    assert f"beside them: bottom and top (at most {least({'bottom', 'top'}):.3f} mm)" in ran.err
    assert ran.err.count("beside them") == 1 and least(every - {"left", "bottom"}) > 0.5


@pytest.mark.slow
def test_chances_are_those_of_the_minimum_that_is_wanted(tmp_path: Path, metrocli: Metrocli) -> None:
    """The aim `most` holds the points far above it."""
    result = fitted(casting(13).write(tmp_path, aim="most"), metrocli)
    assert result.statistics["minimum"] == 0.5 and result.statistics["least_overstock"] > 1.5
    assert result.tables["surfaces"].numbers("below").max() == 0 == len(result.warnings)
    high = fitted(
        casting(13).write(tmp_path, aim="most", minimum=result.statistics["least_overstock"] - 0.03), metrocli
    )
    held = high.tables["overstock"].numbers("overstock").argmin()
    assert high.tables["overstock"].numbers("below")[held] == pytest.approx(0.1587, abs=1e-3)  # one sigma above


@pytest.mark.slow
def test_the_minimum_that_would_do_does(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(18, less={"left": -5.0, "right": -2.0})
    job = one.write(tmp_path, minimum=1.5)
    ran = metrocli("fit-part", job)
    possible = ran.err.partition("`minimum: ")[2].partition("`")[0]
    assert ran.code == 4 and possible
    assert metrocli("fit-part", job, "--set", f"overstock.minimum={possible}").code == 0


@pytest.mark.parametrize(
    ("kept", "open_motion"),
    [
        (("top", "bottom", "left", "right"), "a shift along y"),
        pytest.param(("bore-1",), "a shift along z", marks=pytest.mark.slow),
        (("left", "front", "bottom"), "since the overstock of all points changes alike"),
    ],
)
def test_motions_that_the_points_leave_open_are_named(
    kept: tuple[str, ...], open_motion: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    whole = casting(19)
    rows = np.isin(whole.surface, kept)
    one = Casting(whole.pose, whole.surface[rows], whole.points[rows], whole.exact[rows], whole.targets, whole.sigma)
    ran = metrocli("fit-part", one.write(tmp_path))
    assert ran.code == 4 and open_motion in ran.err and "what would determine it" in ran.err
    ran = metrocli("fit-part", one.write(tmp_path, aim="least-motion"))
    assert ran.code == 0, ran.err


def test_the_summary_states_what_holds_the_part(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(11)
    ran = metrocli("fit-part", one.write(tmp_path, minimum=2.0), "--json")
    summary = json.loads(ran.out)
    assert set(summary["estimates"]) == {"x", "y", "z", "alpha", "beta", "gamma"}
    assert any("held by: " in line for line in summary["notes"])
    assert summary["statistics"]["optimality"] < 1e-6
    shown = metrocli("show", tmp_path / "part.h5")
    assert shown.code == 0 and "surfaces" in shown.out
