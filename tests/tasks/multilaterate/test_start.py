"""Places of tracers and dead paths are found from nothing but lengths and nominal points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated.lengths import CORNERS, VOLUME, Network, network, places, settings, without_motion

from metrocli.adjust.allowance import allowance
from metrocli.errors import InputError, NotConvergedError, UndeterminedError
from metrocli.formats import csv
from metrocli.instruments.tracer_start import start
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.problem import build
from metrocli.tasks.multilaterate.settings import Files
from metrocli.tasks.multilaterate.solve import solve
from metrocli.tasks.shared import tracers
from metrocli.tasks.shared.lengths import LengthNoise

LAYOUTS = 500


@pytest.mark.slow
def test_of_random_layouts() -> None:
    """Points in a volume of any shape, one tracer anywhere in or around it, the mover off by 20 um."""
    rng = np.random.default_rng(0)
    lost = []
    for layout in range(LAYOUTS):
        size = 10 ** rng.uniform(2, 3.7, 3)
        n = int(rng.integers(8, 60))
        points = rng.uniform(0, 1, (n, 3)) * size + rng.normal(0, 5000, 3)
        while True:
            place = points.mean(axis=0) + rng.uniform(-1.5, 1.5, 3) * size.max()
            if np.linalg.norm(points - place, axis=1).min() > 20:
                break
        dead = rng.normal(0, 2000)
        length = np.linalg.norm(points - place, axis=1) - dead
        found = start(points + rng.normal(0, 0.02, points.shape), length)
        predicted = np.linalg.norm(points - found[:3], axis=1) - found[3]
        # what the mover's errors make of a length, and no more: a wrong place cannot do that
        if np.sqrt(((predicted - length) ** 2).mean()) > 0.06:
            lost.append(layout)
    assert lost == []


def test_of_points_in_one_plane() -> None:
    """The two places mirrored at the plane predict the same: either is right, and nothing else."""
    rng = np.random.default_rng(1)
    for _ in range(100):
        points = np.column_stack([rng.uniform(0, 1000, (20, 2)), np.zeros(20)])
        place = np.array([*rng.uniform(-800, 1800, 2), rng.uniform(200, 1500) * rng.choice([-1, 1])])
        dead = rng.normal(0, 500)
        found = start(points, np.linalg.norm(points - place, axis=1) - dead)
        assert np.abs(np.abs(found) - np.abs([*place, dead])).max() < 1e-4


def test_of_absolute_distances() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        points = rng.uniform(0, 1000, (8, 3))
        place = rng.uniform(-2000, 3000, 3)
        found = start(points, np.linalg.norm(points - place, axis=1), absolute=True)
        assert np.abs(found[:3] - place).max() < 1e-6
        assert found[3] == 0


@pytest.mark.parametrize(
    "share", [0.05, pytest.param(0.2, marks=pytest.mark.slow), pytest.param(0.3, marks=pytest.mark.slow)]
)
def test_lengths_that_are_far_off_do_not_spoil_it(share: float) -> None:
    """Errors of 0.1 mm to 2 m; the place is as near as the mover's errors of 20 um and so many lost lengths allow."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        points = rng.uniform(0, 1, (40, 3)) * [800, 600, 500]
        place = points.mean(axis=0) + rng.choice([-1, 1], 3) * rng.uniform(500, 2000, 3)
        length = np.linalg.norm(points - place, axis=1) - 1000
        wrong = rng.choice(40, round(40 * share), replace=False)
        length[wrong] += rng.choice([-1, 1], len(wrong)) * 10 ** rng.uniform(-1, 3.3, len(wrong))
        found = start(points + rng.normal(0, 0.02, points.shape), length)
        missed = np.abs(np.linalg.norm(points - found[:3], axis=1) - found[3] - length)
        assert np.median(missed) < 0.1


def test_the_same_lengths_have_the_same_place_whatever_is_done_with_it() -> None:
    """The last places are kept; those of other points, lengths, kinds of lengths and listed places are others."""
    rng = np.random.default_rng(12)
    points = np.column_stack([rng.uniform(0, 1000, (20, 2)), np.zeros(20)])
    length = np.linalg.norm(points - [300.0, 400.0, 700.0], axis=1)
    above, below = (start(points, length, near=np.array([300.0, 400.0, z])) for z in (650.0, -650.0))
    assert np.allclose(above, [300.0, 400.0, 700.0, 0.0], atol=1e-6)
    assert np.allclose(below, [300.0, 400.0, -700.0, 0.0], atol=1e-6)
    above[:] = 0.0
    again = start(points, length, near=np.array([300.0, 400.0, 650.0]))
    assert np.allclose(again, [300.0, 400.0, 700.0, 0.0], atol=1e-6)
    assert np.allclose(start(points + 50.0, length, near=again[:3])[:3], [350.0, 450.0, 750.0], atol=1e-6)
    shorter = start(points, length - 30.0, near=again[:3])
    assert np.allclose(shorter, [300.0, 400.0, 700.0, 30.0], atol=1e-6)
    absolute = start(points, length - 30.0, absolute=True, near=again[:3])
    assert absolute[3] == 0.0
    assert not np.allclose(absolute[:3], shorter[:3], atol=1.0)


def test_of_many_lengths() -> None:
    """Of 50,000 lengths, a fifth wrong, some are enough."""
    rng = np.random.default_rng(4)
    points = rng.uniform(0, 1000, (50_000, 3))
    place = np.array([-700.0, 400.0, 900.0])
    length = np.linalg.norm(points - place, axis=1) - 250.0
    length[::5] += rng.uniform(1, 100, 10_000)
    found = start(points + rng.normal(0, 0.02, points.shape), length)
    assert found == pytest.approx([*place, 250.0], abs=0.02)


def test_a_large_network_starts_from_some_of_its_points() -> None:
    """5000 points are as far from the truth as their uncertainties allow, those that the start left out too."""
    net = network(5000, 5, seed=9)
    result = multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table()))
    assert result.statistics["sigma0"] == pytest.approx(1.0, abs=5 / np.sqrt(2 * result.statistics["dof"]))
    error = without_motion(places(result.tables["points"]), net.points) - net.points
    std = result.tables["points"].stacked(["sx", "sy", "sz"])
    assert np.sqrt((error**2 / std**2).mean()) == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_wrong_lengths_do_not_spoil_the_start_of_a_large_network() -> None:
    """Fifty lengths of 25,000 are off by up to 100 mm; the other points stay where they are."""
    net = network(5000, 5, seed=10)
    rng = np.random.default_rng(11)
    wrong = rng.choice(5000, 50, replace=False)
    net.readings[wrong, rng.integers(5, size=50)] += rng.uniform(-100, 100, 50)
    found = {}
    for outliers in ("report", "remove"):
        job = multilaterate.TASK.job(settings(outliers=outliers), net.lengths(), net.point_table())
        found[outliers] = multilaterate.run(job)
    removed = found["remove"]
    assert set(removed.tables["rejected"].texts("point")) == {net.names[i] for i in wrong}
    assert found["report"].tables["suspects"].texts("point")
    points = removed.tables["points"]
    kept = np.isin(net.names, points.texts("point"))
    good = ~np.isin(np.arange(5000), wrong)
    error = without_motion(places(points), net.points[kept])[good[kept]] - net.points[good & kept]
    std = points.stacked(["sx", "sy", "sz"])[good[kept]]
    assert np.sqrt((error**2 / std**2).mean()) == pytest.approx(1.0, abs=0.1)


@pytest.mark.alike
@pytest.mark.parametrize("seed", range(4))
def test_a_job_without_a_list_of_tracers(seed: int, tmp_path: Path, metrocli) -> None:  # type: ignore[no-untyped-def]
    net = network(25, 4 + seed % 3, seed=100 + seed)
    csv.write(tmp_path / "lengths.csv", net.lengths())
    csv.write(tmp_path / "points.csv", net.point_table())
    job = tmp_path / "job.yaml"
    job.write_text(
        "metrocli: 1\njob: multilaterate\ninputs: {lengths: lengths.csv, points: points.csv}\n"
        "noise: {constant: 0.1 um, proportional: 0.1 um/m}\noutput: o.h5\n"
    )
    ran = metrocli("multilaterate", job)
    assert ran.code == 0, ran.err
    from metrocli.formats import hdf5

    result, _ = hdf5.read(tmp_path / "o.h5")
    found = {e.name: e.value for e in result.estimates}
    for j in range(len(net.tracers)):
        assert [found[f"T{j}.{axis}"] for axis in "xyz"] == pytest.approx(net.tracers[j], abs=0.2)
        assert found[f"T{j}.dead_path"] == pytest.approx(net.dead[j], abs=0.2)


def test_a_rough_list_of_tracers_gives_the_same() -> None:
    """Half a metre off, and with dead paths that the list does not have."""
    net = network(25, 5, seed=8)
    found = multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table()))
    rough = multilaterate.run(
        multilaterate.TASK.job(settings(), net.lengths(), net.point_table(), net.tracer_table(500.0))
    )
    for a, b in zip(found.estimates, rough.estimates, strict=True):
        assert a.value == pytest.approx(b.value, abs=1e-6)


@pytest.mark.parametrize("m", [5, 6])
def test_points_in_one_plane_with_tracers_around(m: int) -> None:
    net = network(30, m, seed=7)
    flat = net.points * [1, 1, 0]
    tracers = CORNERS[:m] * VOLUME + [0, 0, 600.0]
    net = replace(net, nominal=flat + np.random.default_rng(1).normal(0, 0.02, flat.shape)).at(flat, tracers)
    result = multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table(), net.tracer_table()))
    assert result.statistics["chi2"] < 1e-6


def poor(net: Network, fewest: int) -> Network:
    """The network with two tracers that read only a few points."""
    rng = np.random.default_rng(len(net.points))
    for j in (0, 1):
        net.readings[rng.permutation(len(net.points))[fewest:], j] = np.nan
    return net


def test_a_tracer_with_four_points_and_no_list_is_refused() -> None:
    """Four lengths tell no start; from anywhere the adjustment may end in the mirror image of the layout."""
    net = poor(network(22, 7, seed=402415), 4)
    with pytest.raises(UndeterminedError, match="tracer T0 reads 4 points, too few to find where it stands"):
        multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table()))


@pytest.mark.alike
@pytest.mark.parametrize(("n", "m", "seed", "scale"), [(29, 6, 794068, 1e-5), (77, 5, 456383, 5e-7), (24, 7, 1, 1e-6)])
def test_a_tracer_with_four_points_that_is_listed(n: int, m: int, seed: int, scale: float) -> None:
    """It is located or refused; nothing is given out that is far from the list."""
    net = poor(network(n, m, seed=seed), 4)
    try:
        result = multilaterate.run(
            multilaterate.TASK.job(settings(scale), net.lengths(), net.point_table(), net.tracer_table())
        )
        error = without_motion(places(result.tables["points"]), net.points) - net.points
        assert np.sqrt((error**2).mean() / (result.tables["points"].stacked(["sx", "sy", "sz"]) ** 2).mean()) < 2
    except UndeterminedError as error:
        assert "T0" in str(error)


def test_the_mirror_image_is_no_result() -> None:
    """It fits the lengths as well as the truth does; started there the adjustment stays there, and says so."""
    net = network(30, 5, seed=3)
    built = build(settings(), Files(net.lengths(), net.point_table()))
    turned = {}
    for name, block in built.blocks.items():
        values = block.values.copy()
        values[:, 0] *= -1
        turned[name] = block.with_values(values)
    datum = replace(built.datum, reference=turned["point"].values) if built.datum else None
    with pytest.raises(
        NotConvergedError, match="mm from their listed places .median.: the adjustment ended in a wrong"
    ):
        solve(built.with_model(replace(built.model, blocks=turned, datum=datum)), remove=False)
    assert solve(built, remove=False).solution.outcome.good


def test_the_factor_of_wrong_lengths_is_sought_for_people_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another reading of a file that fits no better is dropped: nobody reads which factor would have helped it."""
    calls: list[int] = []

    def counted(*given: object) -> object:
        calls.append(1)
        return start(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(tracers, "start", counted)
    rng = np.random.default_rng(8)
    points, place = rng.uniform(0, 1000, (30, 3)), np.array([-700.0, 300, 1900])
    lengths = np.linalg.norm(points - place, axis=1) * 17 + rng.normal(0, 900, 30)
    nowhere, unknown = np.full((1, 3), np.nan), np.full((1, 3), np.nan)
    one = tracers.Tracers(("LT1",), np.zeros(30, dtype=int), nowhere, unknown, np.zeros(1, dtype=int))
    seen = tracers.LengthsToTracers(one, np.arange(30), points, lengths, 1000.0)
    with pytest.raises(InputError, match="do not belong to these points"):
        tracers.places_of(seen)
    for_people = len(calls)
    calls.clear()
    with allowance(24), pytest.raises(NotConvergedError):
        tracers.places_of(seen)
    assert len(calls) < 6 < for_people


def test_a_delay_that_all_ranges_share_is_no_sign_of_wrong_rows() -> None:
    """The delay exceeds the bound of 5 % of the volume; no place takes it in where beacons are known exactly."""
    rng = np.random.default_rng(145)
    points, beacons = rng.uniform(0, 5000, (40, 3)), rng.uniform(-1000, 6000, (6, 3))
    lengths = np.linalg.norm(points - beacons[:, None], axis=2) + 600 + rng.normal(0, 80, (6, 40))
    listed = np.tile(points + rng.normal(0, 50, points.shape), (6, 1))
    names, of_each = [f"A{i}" for i in range(6)], np.repeat(np.arange(6), 40)
    known = tracers.Tracers(tuple(names), of_each, beacons, np.zeros((6, 3)), np.arange(6))
    seen = tracers.LengthsToTracers(known, np.arange(240), listed, lengths.ravel(), 5000.0, absolute=True)
    assert (tracers.places_of(seen)[:, :3] == beacons).all()
    lengths[2] = rng.permutation(lengths[2])
    with pytest.raises(InputError) as raised:
        tracers.places_of(replace(seen, length=lengths.ravel()))
    assert str(raised.value).count("do not belong to these points") == 1
    assert "tracer A2" in str(raised.value)


def test_points_known_no_better_than_their_ranges_are_not_far_from_their_list() -> None:
    """Ranges of 25 mm in a volume of 1 m move the points by more than 2 % of it, and no list is wrong."""
    net = replace(network(30, 6, seed=146), dead=np.zeros(6)).read(np.random.default_rng(148))
    rough = replace(net, readings=net.readings + np.random.default_rng(147).normal(0, 25.0, net.readings.shape))
    list_offset = {}
    for declared in (25.0, 1.0):
        job = replace(settings(measures="absolute"), noise=LengthNoise(declared, 0.0))
        beacons = rough.tracer_table(0.0)
        built = build(job, Files(rough.lengths(), rough.point_table(), beacons))
        list_offset[declared] = solve(built, remove=False).list_offset
    assert list_offset[25.0] < 0.7 < 1 < list_offset[1.0]


@pytest.mark.parametrize("listed", [True, False])
def test_points_far_from_their_list_are_explained_by_what_is_listed(listed: bool) -> None:
    """Where all places of beacons are listed, it does not help to list them."""
    net = replace(network(30, 6, seed=149), dead=np.zeros(6)).read(np.random.default_rng(150))
    beacons = net.tracer_table(0.0) if listed else None
    late = replace(net, readings=net.readings + 300.0)
    built = build(settings(measures="absolute"), Files(late.lengths(), late.point_table(), beacons))
    with pytest.raises(NotConvergedError) as raised:
        solve(replace(built, nominal=built.nominal + 400.0), remove=False)
    assert ("length-offset" in str(raised.value)) == listed
    assert ("inputs: tracers" in str(raised.value)) != listed
