"""Lengths, bars, heights and given points that contradict the set-ups are named; left out, the rest is right."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.network import Network, network, sigmas

from metrocli.formats import hdf5
from metrocli.project.job import load
from metrocli.project.runner import content
from metrocli.tasks.adjust_network import task as adjust_network

Metrocli = Callable[..., Any]


def hall(seed: int = 5) -> Network:
    return network(np.random.default_rng(seed), stations=3, points=12, mixed=True)


def length(net: Network) -> Network:
    lengths = net.lengths.copy()
    lengths[0, 3] += 5000.0
    return replace(net, lengths=lengths)


def height(net: Network) -> Network:
    return replace(net, heights=tuple((a, b, v + 4000.0 * (i == 0)) for i, (a, b, v) in enumerate(net.heights)))


def test_one_reading_is_named(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("adjust-network", height(hall()).write(tmp_path))
    assert ran.code == 5 and "height difference P001/P005 by 4 m" in ran.err, ran.err
    assert not (tmp_path / "result.h5").exists()


def test_one_bar_of_two_does_not_bend_the_network(tmp_path: Path, metrocli: Metrocli) -> None:
    """The median of two residuals is as far off as the wrong one: nothing but the set-ups tells which it is."""
    net = hall()
    (first, second, value), other = net.bars[0], net.bars[-1]
    ran = metrocli("adjust-network", replace(net, bars=((first, second, value + 90_000.0), other)).write(tmp_path))
    assert ran.code == 5 and "contradict the set-ups: bar" in ran.err and "by 90 m" in ran.err, ran.err


@pytest.mark.alike
@pytest.mark.parametrize("wrong", [length, height])
def test_one_reading_is_left_out(wrong: Callable[[Network], Network], tmp_path: Path, metrocli: Metrocli) -> None:
    net = hall()
    ran = metrocli("adjust-network", wrong(net).write(tmp_path, more="outliers: remove\n"))
    assert ran.code == 0, ran.err
    result = hdf5.read(tmp_path / "result.h5")[0]
    assert len(result.tables["rejected"]) == 1
    order = [net.names.index(name) for name in result.tables["points"].texts("point")]
    assert np.abs(result.tables["points"].stacked("xyz") - net.points[order]).max() < 0.1


def bars_in_metres(net: Network) -> Network:
    return replace(net, bars=tuple((a, b, v / 1000) for a, b, v in net.bars))


def heights_in_metres(net: Network) -> Network:
    return replace(net, heights=tuple((a, b, v / 1000) for a, b, v in net.heights))


WHOLE = {"write length_m in the heading": bars_in_metres, "write dh_m in the heading": heights_in_metres}


@pytest.mark.alike
@pytest.mark.parametrize("words", WHOLE)
def test_a_wrong_unit_is_found(words: str, tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("adjust-network", WHOLE[words](hall()).write(tmp_path))
    assert ran.code == 3 and words in ran.err, ran.err
    assert "contradict the set-ups: most of them are off by" in ran.err


def test_two_wrong_given_points_are_named_together(tmp_path: Path, metrocli: Metrocli) -> None:
    net = hall(15)
    near = net.near.copy()
    near[5:9] = net.points[5:9] + np.random.default_rng(3).normal(0, 0.01, (4, 3))
    near[0] += [0.3, 0.0, 0.2]
    near[2] += [0.0, -0.4, 0.0]
    ran = metrocli("diagnose", replace(net, near=near, given=(0, 1, 2, 3, 5, 6, 7, 8)).write(tmp_path), "--quick")
    assert ran.code == 0, ran.err
    assert "given-point P001" in ran.out and "given-point P003" in ran.out


@pytest.mark.slow
def test_wrong_exact_points_are_named_with_their_sizes(tmp_path: Path, metrocli: Metrocli) -> None:
    """Each of them ends a bar or a height difference too; the list of one is off by what its mark has moved back."""
    net = hall(15)
    wrong = {0: [0.3, 0.0, 0.2], 4: [0.0, -0.4, 0.1]}
    near = net.points.copy()
    for point, by in wrong.items():
        near[point] += by
    job = replace(net, near=near, given=tuple(range(9))).write(tmp_path)
    path = tmp_path / "points.csv"
    path.write_text(path.read_text().replace(",0.01\n", ",0\n"))
    ran = metrocli("diagnose", job, "--quick", "--json")
    assert ran.code == 0, ran.err
    found = {one["where"]["point"]: one for one in json.loads(ran.out)["effects"]}
    assert {one["name"] for one in found.values()} == {"given-point"} and set(found) == {"P001", "P005"}
    for point, by in wrong.items():
        sizes = found[f"P{point + 1:03d}"]["parameters"]
        assert all(abs(sizes[f"d{axis}"]["value"] - size) < 0.03 for axis, size in zip("xyz", by, strict=True)), sizes
    # the job with both of them in its model fits
    ran = metrocli("adjust-network", tmp_path / "job.extended.yaml")
    assert ran.code == 0, ran.out + ran.err


def under_another_name(net: Network, station: int, point: int, other: int) -> Network:
    """The network whose station reads a point under the name of another one, which it does not see."""
    kept = ~((net.station == station) & (net.point == other))
    named = np.where((net.station == station) & (net.point == point), other, net.point)[kept]
    return replace(net, station=net.station[kept], point=named, face=net.face[kept], seen=net.seen[kept])


def far_off(net: Network, station: int, point: int) -> Network:
    seen = net.seen.copy()
    seen[(net.station == station) & (net.point == point), 2] *= 3
    return replace(net, seen=seen)


@pytest.mark.parametrize("seed", [1, 6])
def test_a_few_points_do_not_turn_a_set_up_after_a_wrong_name(seed: int, tmp_path: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(seed), stations=2, points=8, levelled=seed == 1)
    ran = metrocli("adjust-network", under_another_name(net, 1, 1, 6).write(tmp_path))
    assert ran.code == 3 and "P007 at station S2 is P002, line" in ran.err, ran.err


@pytest.mark.parametrize("listed", [True, False])
def test_a_whole_sighting_is_left_out(listed: bool, tmp_path: Path, metrocli: Metrocli) -> None:
    """By single angles and distances nothing but a mixture of the right and the wrong sighting may remain."""
    net = network(np.random.default_rng(41), stations=2 if listed else 3, points=11, listed=listed)
    ran = metrocli("adjust-network", under_another_name(net, 1, 4, 8).write(tmp_path, more="outliers: remove\n"))
    assert ran.code == 0, ran.err
    rejected = hdf5.read(tmp_path / "result.h5")[0].tables["rejected"]
    assert set(zip(rejected.texts("station"), rejected.texts("point"), strict=True)) == {("S2", "P009")}
    assert len(rejected) == 3


def test_two_sightings_alone_are_both_named(tmp_path: Path, metrocli: Metrocli) -> None:
    net = far_off(network(np.random.default_rng(42), stations=2, points=9, listed=False), 1, 4)
    ran = metrocli("adjust-network", net.write(tmp_path, more="outliers: remove\n"))
    assert ran.code == 5 and "S1/P005 (line 6)" in ran.err and "S2/P005 (line 15)" in ran.err, ran.err
    assert "Nothing else shows which" in ran.err


def test_an_adjustment_that_does_not_converge_names_the_sighting(tmp_path: Path, metrocli: Metrocli) -> None:
    net = far_off(network(np.random.default_rng(3), stations=4, points=8, levelled=True, listed=False), 0, 2)
    ran = metrocli("adjust-network", net.write(tmp_path))
    assert ran.code == 5 and "S1/P003 (line 4) by" in ran.err and "`outliers: remove` leaves" in ran.err, ran.err


def test_a_sighting_left_out_is_tested_where_the_others_put_its_point(tmp_path: Path, metrocli: Metrocli) -> None:
    """The point starts where the first station sees it, which is the wrong one here: it would have w = 0 there."""
    net = far_off(network(np.random.default_rng(12), stations=4, points=9, listed=False), 0, 3)
    ran = metrocli("adjust-network", net.write(tmp_path, more="outliers: remove\n"))
    assert ran.code == 0, ran.err
    rejected = hdf5.read(tmp_path / "result.h5")[0].tables["rejected"]
    tests = dict(zip(rejected.texts("quantity"), rejected.numbers("w").tolist(), strict=True))
    assert tests["d"] > 1e5 and max(tests["az"], tests["el"]) < 5


@pytest.mark.parametrize(("seed", "station", "point"), [(62, 0, 5), (64, 0, 2), (66, 0, 4)])
def test_right_readings_of_its_point_stay_beside_a_wrong_distance(
    seed: int, station: int, point: int, tmp_path: Path, metrocli: Metrocli
) -> None:
    """Two set-ups determine a point with few readings: a wrong one gives right ones more than half of its test."""
    net = network(np.random.default_rng(seed), stations=2, points=9)
    change = np.zeros_like(net.seen)
    change[(net.station == station) & (net.point == point), 2] = 0.2
    ran = metrocli("adjust-network", net.with_effect(change).write(tmp_path, more="outliers: remove\n"))
    assert ran.code == 0, ran.err
    rejected = hdf5.read(tmp_path / "result.h5")[0].tables["rejected"]
    names = list(zip(*(rejected.texts(key) for key in ("station", "point", "quantity")), strict=True))
    assert names == [(f"S{station + 1}", net.names[point], "d")]


def test_a_station_whose_distances_have_another_scale_is_doubtful_and_named(tmp_path: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(71), stations=4, points=20)
    change = np.zeros_like(net.seen)
    change[net.station == 1, 2] = 0.02 * net.seen[net.station == 1, 2]
    ran = metrocli("adjust-network", net.with_effect(change).write(tmp_path, more="outliers: remove\n"))
    assert ran.code == 6 and "readings of station S2 are left out as outliers (" in ran.out, ran.out


def test_a_job_that_leaves_outliers_out_is_not_advised_to(tmp_path: Path) -> None:
    net = hall()
    change = np.random.default_rng(2).normal(0, [3e-4, 3e-4, 2.0], net.seen.shape)
    change[0, 2] += 3000.0
    job = net.with_effect(change).write(tmp_path, more="outliers: remove\n")
    (absurd,) = (text for text in adjust_network.run(content(load(job))).warnings if "does not fit the" in text)
    assert "`outliers: remove`" not in absurd


@pytest.mark.parametrize("wrong", [length, height])
def test_a_job_without_its_outliers_is_diagnosed(
    wrong: Callable[[Network], Network], tmp_path: Path, metrocli: Metrocli
) -> None:
    """The adjustment of all readings fails, and advised `outliers: remove` to a job that has it."""
    ran = metrocli("diagnose", wrong(hall()).write(tmp_path, more="outliers: remove\n"), "--quick")
    assert ran.code == 0, ran.err
    assert "without the reading that `outliers: remove` leaves out" in ran.out


@pytest.mark.parametrize("seed", [34, 56])
def test_wrong_readings_do_not_hide_each_other(seed: int, tmp_path: Path) -> None:
    """A twentieth of the readings off by 8 to 60 sigma: sigma0 was above 7, and most of them stayed."""
    rng = np.random.default_rng([77, seed])
    net = network(rng)
    sigma = sigmas(net.seen)
    wrong = rng.random(sigma.shape) < 0.05
    off = np.where(wrong, sigma * rng.uniform(8, 60, sigma.shape) * rng.choice([-1, 1], sigma.shape), 0.0)
    job = load(net.with_effect(off).write(tmp_path, "outliers: remove\n"))
    assert adjust_network.run(content(job)).statistics["sigma0"] < 1.3
