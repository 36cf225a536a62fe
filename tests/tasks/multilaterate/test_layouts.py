"""Layouts that cannot carry the answer are named, with exit code 4; good ones are not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulated.lengths import (
    RNG,
    Network,
    all_in_one_plane,
    close_together,
    network,
    on_line,
    on_plane,
    places,
    settings,
    without_motion,
)

from metrocli.errors import UndeterminedError
from metrocli.instruments.tracer import TRACER
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.layout_faults import _strayed


def without(rows: slice, columns: slice) -> Network:
    net = network(30, 5, seed=4)
    net.readings[rows, columns] = np.nan
    return net


CATALOGUE: dict[str, tuple[Callable[[], Network], str]] = {
    "three tracers": (lambda: network(30, 3), "there are 3 tracers; positions from length changes need 4 or more"),
    "two tracers": (lambda: network(30, 2), "there are 2 tracers"),
    "four tracers in a plane": (lambda: on_plane(4), "the 4 tracers stand in one plane"),
    "five tracers in a plane": (lambda: on_plane(5), "the 5 tracers stand in one plane"),
    "points on a line, 4": (lambda: on_line(4), "the points lie on a line: add points away from it"),
    "points on a line, 5": (lambda: on_line(5), "the points lie on a line: add points away from it"),
    "points on a line, 6": (lambda: on_line(6), "the points lie on a line: add points away from it"),
    "everything in a plane": (all_in_one_plane, "the points lie in one plane: add points out of it"),
    "nine points, 4": (lambda: network(9, 4, seed=1), "too few points: 9, where 4 tracers need 10"),
    "five points, 6": (lambda: network(5, 6, seed=1), "too few points: 5, where 6 tracers need 6"),
    "a point read by two": (lambda: without(slice(3, 4), slice(0, 3)), "points read by fewer than three tracers: P3"),
    "a tracer with three points": (lambda: without(slice(3, None), slice(2, 3)), "tracer T2 reads 3 points"),
    "tracers at one place": (close_together, r"tracers T0 and T1 stand nearly at one place \(1.1. mm apart\)"),
}


@pytest.mark.parametrize("name", CATALOGUE)
def test_degenerate_layouts_are_named(name: str) -> None:
    make, words = CATALOGUE[name]
    net = make()
    with pytest.raises(UndeterminedError, match=words) as told:
        multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table()))
    assert told.value.exit_code == 4


def test_three_absolute_tracers_are_not_enough_where_nothing_is_known() -> None:
    net = replace(network(30, 3), dead=np.zeros(3)).read(np.random.default_rng(1))
    with pytest.raises(UndeterminedError, match="positions from absolute distances need 4 or more"):
        multilaterate.run(multilaterate.TASK.job(settings(measures="absolute"), net.lengths(), net.point_table()))


@pytest.mark.slow
def test_good_layouts_raise_no_alarm() -> None:
    """30 layouts: 4 to 8 tracers around a volume, 15 to 80 points in it."""
    rng = np.random.default_rng(8)
    alarms = []
    for seed in range(30):
        net = network(int(rng.integers(15, 80)), int(rng.integers(4, 9)), seed=1000 + seed)
        result = multilaterate.run(
            multilaterate.TASK.job(settings(), net.lengths(), net.point_table(), net.tracer_table())
        )
        alarms += [line for line in result.warnings if "layout" in line]
    assert alarms == []


@pytest.mark.parametrize(("off", "weak"), [(5.0, True), (600.0, False)])
def test_a_weak_layout_is_said_to_be_weak(off: float, weak: bool) -> None:
    net = on_plane(4)
    tracers = net.tracers.copy()
    tracers[3, 2] += off
    net = replace(net, tracers=tracers).read(RNG)
    result = multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table()))
    told = [line for line in result.warnings if "layout is weak" in line and "stand in one plane" in line]
    assert bool(told) is weak
    ratio = result.statistics["weakness"]
    assert isinstance(ratio, float) and (ratio > 10) is weak


def test_six_tracers_in_a_plane_are_enough() -> None:
    net = on_plane(6)
    assert (
        multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table())).statistics["weakness"]
        < 10
    )  # type: ignore[operator]


def test_what_no_residual_shows_is_listed() -> None:
    net = network(30, 4, seed=1)
    result = multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table()))
    hidden = result.tables["not_controlled"]
    effects = hidden.texts("effect")
    for word in ("refractive index", "drift", "growth", "re-seated"):
        assert any(word in effect for effect in effects), word
        assert any(word in note for note in result.notes), word
    assert (hidden.numbers("hides") > 0).all()
    assert all(hidden.texts("control"))
    index = hidden.numbers("hides")[next(i for i, effect in enumerate(effects) if "refractive" in effect)]
    assert index == pytest.approx(0.96e-6 * np.linalg.norm(np.ptp(net.nominal, axis=0)))


@pytest.mark.parametrize("effect", ["index", "drift", "growth", "reseated"])
def test_what_is_said_to_be_hidden_is_hidden(effect: str) -> None:
    """The planted effect moves points by more than their uncertainty and leaves the sum of squares alone."""
    net = network(40, 5, seed=2, noise=0.0)
    points, time = net.points, np.linspace(0, 1, 40)[:, None]
    moved = {
        "index": points * (1 + 1e-6),
        "drift": points + 2e-3 * time * [1, 1, 0],
        "growth": points + 1.15e-6 * time * (points - points.mean(axis=0)),
        "reseated": points + 2e-3 * (time > 0.5) * [1, 0, 0],
    }[effect]
    # a common index scales tracers and dead paths along, as far as lengths can tell
    scale = 1 + 1e-6 if effect == "index" else 1.0
    spoilt = replace(net, dead=net.dead).at(moved, net.tracers * scale)
    result = multilaterate.run(multilaterate.TASK.job(settings(), spoilt.lengths(), spoilt.point_table()))
    assert result.statistics["chi2"] < 1e-4


def test_known_lengths_control_the_index() -> None:
    from metrocli.table import Table

    net = network(30, 4, seed=1)
    bar = {
        "from": np.array(["P0"]),
        "to": np.array(["P1"]),
        "length": np.linalg.norm(net.points[:1] - net.points[1:2], axis=1),
    }
    distances = Table(bar | {"sigma": np.array([1e-4])}, {"length": "mm", "sigma": "mm"})
    result = multilaterate.run(
        multilaterate.TASK.job(settings(), net.lengths(), net.point_table(), distances=distances)
    )
    assert not any("refractive" in effect for effect in result.tables["not_controlled"].texts("effect"))


def test_points_that_too_few_read_are_left_out_on_demand() -> None:
    """One tracer at six stations, a third of the lengths missing: what is left is as good as it says."""
    rng = np.random.default_rng(0)
    net = network(80, 6, seed=3)
    for j in range(6):
        net.readings[rng.permutation(80)[:25], j] = np.nan
    seen = np.isfinite(net.readings).sum(axis=1)
    assert (seen < 3).sum() >= 3
    with pytest.raises(UndeterminedError, match="points read by fewer than three tracers: .*`outliers: remove` leaves"):
        multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table()))
    result = multilaterate.run(multilaterate.TASK.job(settings(outliers="remove"), net.lengths(), net.point_table()))
    rows = [int(name[1:]) for name in result.tables["points"].texts("point")]
    assert rows == np.flatnonzero(seen >= 3).tolist()
    rejected = result.tables["rejected"]
    reasons = rejected.texts("reason")
    assert reasons.count("fewer than three tracers read the point") == seen[seen < 3].sum() >= len(reasons) - 1
    assert any("left out, since too few lengths remain" in line for line in result.warnings)
    error = without_motion(places(result.tables["points"]), net.points[rows]) - net.points[rows]
    assert np.sqrt((error**2).mean() / (result.tables["points"].stacked(["sx", "sy", "sz"]) ** 2).mean()) < 1.6


def test_a_layout_that_wrong_lengths_made_is_not_to_blame() -> None:
    """An adjustment put one tracer 40 m away: its lengths are wrong, and no further tracer mends them."""
    listed = np.array([[0.0, 0, 0], [2000, 0, 0], [0, 2000, 0], [0, 0, 2000], [2000, 2000, 500]])
    found = listed + [[40_000.0, 0, 0], *[[1.0, 1, 1]] * 4]
    for stand, named in ((found, ["T0 (4e+04 mm)"]), (listed, [])):
        network = SimpleNamespace(listed_at=listed)
        solution = SimpleNamespace(
            blocks={TRACER: SimpleNamespace(values=stand, members=tuple(f"T{i}" for i in range(5)))}
        )
        told = list(_strayed(network, solution))  # type: ignore[arg-type]
        assert len(told) == len(named) and all(name in told[0] for name in named)
