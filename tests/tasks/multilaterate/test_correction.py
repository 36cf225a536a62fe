"""Probing points corrected by the mover's error at their replayed places, simulated and written as they came."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import SAMPLES
from simulated.lengths import Array, network, settings

from metrocli.diagnosis.adjusted_job import misfit_of
from metrocli.errors import InputError, UndeterminedError
from metrocli.formats import csv
from metrocli.project.job import load
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.multilaterate import settings as length_job
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.layout import distance
from metrocli.tasks.multilaterate.settings import PROBING, Correction, LengthSimulation

SAMPLE = SAMPLES / "gear-m3d3"
CENTRES = np.array([[200.0, 200.0, 150.0], [340.0, 270.0, 205.0], [680.0, 440.0, 340.0]])
"""Spheres of a ball bar, about 166, 400 and 566 mm apart"""


def table(points: Array, key: str, names: list[str]) -> Table:
    return Table(
        {key: np.array(names), **dict(zip("xyz", points.T, strict=True))},
        dict.fromkeys("xyz", "mm"),
        f"{key}s.csv",
        tuple(range(2, len(points) + 2)),
    )


def sphere(points: Array) -> Array:
    """Centre of the sphere through points, least squares."""
    matrix = np.column_stack([2 * points, np.ones(len(points))])
    centre: Array = np.linalg.lstsq(matrix, (points**2).sum(axis=1), rcond=None)[0][:3]
    return centre


@pytest.mark.parametrize("mistake", ["swapped", "mirrored", "metres"])
def test_probing_points_far_from_their_replay_are_a_mistake(mistake: str) -> None:
    """No length shows where the part was probed; the list of the replayed points does."""
    net = network(20, 4, seed=3)
    change = {"swapped": np.eye(3)[[0, 2, 1]], "mirrored": np.diag([-1.0, 1.0, 1.0]), "metres": 1e-3 * np.eye(3)}
    points = {"as it is": net.nominal + 0.2, mistake: net.nominal @ change[mistake]}
    absurd = {}
    for name, at in points.items():
        probing = table(at, "point", net.names)
        probing = replace(probing, columns={"feature": np.repeat(["flank"], 20), **probing.columns})
        job = multilaterate.TASK.job(settings(), net.lengths(), net.point_table(), probing=probing)
        absurd[name] = multilaterate.run(job).list_offset, misfit_of(multilaterate.diagnosed(job)).worst
    assert max(absurd["as it is"]) < 0.1
    # beyond 1 `diagnose` calls it a mistake; the task refuses the file if another reading of it is 1000 times better
    assert min(absurd[mistake]) > 1
    assert (absurd[mistake][0] / absurd["as it is"][0]) ** 2 > 1000


def test_a_ball_bar_is_corrected_to_its_calibrated_lengths() -> None:
    """Härtig et al. table 1: a mover of -25 um/m, wrong by 5 to 14 um, is corrected to about 1 um."""
    rng = np.random.default_rng(5)
    unit = rng.normal(size=(3, 25, 3))
    unit /= np.linalg.norm(unit, axis=2)[:, :, None]
    true = (CENTRES[:, None] + 15 * unit).reshape(-1, 3)
    more = rng.uniform(0, 1, (25, 3)) * [900, 700, 500]
    both = np.concatenate([true, more])
    # the mover reads the sphere where its scale puts it; replayed, it goes where it went
    listed_at = both * (1 - 25e-6)
    net = network(100, 4, seed=3)
    net = replace(net, points=both, nominal=listed_at).read(rng)
    names = net.names[:75]
    probing = table(listed_at[:75], "point", names)
    probing = replace(probing, columns={"feature": np.repeat(["S1", "S2", "S3"], 25), **probing.columns})
    result = multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table(), probing=probing))
    corrected = result.tables["corrected"]
    assert list(corrected) == ["feature", "point", "x", "y", "z", "sx", "sy", "sz"]
    assert corrected.texts("point") == names
    before = np.array([sphere(listed_at[25 * k : 25 * k + 25]) for k in range(3)])
    after = np.array([sphere(corrected.stacked("xyz")[25 * k : 25 * k + 25]) for k in range(3)])
    for i, j in ((0, 1), (1, 2), (0, 2)):
        calibrated = np.linalg.norm(CENTRES[i] - CENTRES[j])
        wrong = np.linalg.norm(before[i] - before[j]) - calibrated
        assert wrong == pytest.approx(-25e-6 * calibrated, abs=1e-5)
        left = np.linalg.norm(after[i] - after[j]) - calibrated
        assert abs(left) < 1e-3
        # a centre of 25 points is not less certain than one point
        assert abs(left) < 3 * distance(result, f"P{25 * i}", f"P{25 * j}").std


@pytest.mark.slow
def test_the_uncertainty_of_a_corrected_point_is_what_it_scatters_by() -> None:
    """40 measurements of a mover that returns to 2 um: at the probing, at the replay, and with a tip of 1 um."""
    rng = np.random.default_rng(15)
    r, p = 0.002, 0.001
    truth = network(30, 6, seed=5)
    job = replace(settings(), correction=Correction(r, p))
    scores = []
    for _ in range(40):
        # the mover reads `nominal` at the replay and stands where it returns to; at the probing it returned elsewhere
        places = truth.nominal + 0.02 * np.sin(truth.nominal / 300)
        replayed = replace(truth, points=places + r * rng.normal(size=places.shape)).read(rng)
        probed = truth.nominal[:10] + p * rng.normal(size=(10, 3)) - r * rng.normal(size=(10, 3))
        probing = table(probed, "point", truth.names[:10])
        probing = replace(probing, columns={"feature": np.repeat("f", 10), **probing.columns})
        result = multilaterate.run(
            multilaterate.TASK.job(
                job, replayed.lengths(), replayed.point_table(), truth.tracer_table(), probing=probing
            )
        )
        found = result.tables["corrected"]
        # against the place of a perfect return, in the frame of the replayed points
        turn, shift = rigid(places, result.tables["points"].stacked("xyz"))
        off = found.stacked("xyz") - (places[:10] @ turn.T + shift)
        scores.append(off / found.stacked(["sx", "sy", "sz"]))
        assert result.arrays["corrected_covariance"].shape == (10, 3, 3)
    # 1,200 scores; those of one measurement hang together by its frame and its tracers
    assert np.mean(np.square(scores)) == pytest.approx(1.0, abs=0.12)


def test_the_returns_of_several_stops_count_once() -> None:
    """Each tracer reads a replay of its own: the mean place has the returns, and 12 measurements scatter as stated."""
    rng = np.random.default_rng(16)
    r, truth = 0.003, network(30, 6, seed=5)
    noise = replace(settings().noise, repeatability=r)
    job = replace(settings(), noise=noise, correction=Correction(r, 0.0))
    places = truth.nominal + 0.02 * np.sin(truth.nominal / 300)
    scores = []
    for _ in range(12):
        net = replace(truth, points=places).read(rng)
        beams = places[:, None] - net.tracers
        beams /= np.linalg.norm(beams, axis=2)[:, :, None]
        net = replace(net, readings=net.readings + r * (beams * rng.normal(size=beams.shape)).sum(axis=2))
        probed = table(truth.nominal[:10] - r * rng.normal(size=(10, 3)), "point", truth.names[:10])
        probed = replace(probed, columns={"feature": np.repeat("f", 10), **probed.columns})
        files = (net.lengths(), net.point_table(), net.tracer_table())
        result = multilaterate.run(multilaterate.TASK.job(job, *files, probing=probed))
        turn, shift = rigid(places, result.tables["points"].stacked("xyz"))
        off = result.tables["corrected"].stacked("xyz") - (places[:10] @ turn.T + shift)
        scores.append(off / result.tables["corrected"].stacked(["sx", "sy", "sz"]))
    # 360 scores; with r twice their mean square would be about 0.6
    assert np.mean(np.square(scores)) == pytest.approx(1.0, abs=0.2)


def rigid(a: Array, b: Array) -> tuple[Array, Array]:
    """The rotation and shift that move points a onto points b, least squares."""
    u, _, vt = np.linalg.svd((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return turn, b.mean(axis=0) - a.mean(axis=0) @ turn.T


def test_points_are_found_by_name_else_by_place() -> None:
    net = network(30, 5, seed=1)
    by_name = replace(
        table(net.nominal[:3], "point", net.names[:3]),
        columns={"feature": np.array(["a", "b", "c"]), **table(net.nominal[:3], "point", net.names[:3]).columns},
    )
    by_place = replace(
        by_name, columns={**by_name.columns, "point": np.array(["", "17", "x"]), "x": by_name.columns["x"] + 0.4}
    )
    run = [
        multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table(), probing=probing))
        for probing in (by_name, by_place)
    ]
    named, placed = (result.tables["corrected"].stacked("xyz") for result in run)
    assert np.abs(placed - named - [0.4, 0, 0]).max() < 1e-12
    points = run[0].tables["points"]
    assert np.abs(named - points.stacked("xyz")[:3]).max() < 1e-12
    error = points.stacked(["error_x", "error_y", "error_z"])[:3]
    assert np.abs(net.nominal[:3] - error - named).max() < 1e-12


def test_probing_points_without_their_replay_are_all_listed() -> None:
    net = network(30, 5, seed=1)
    net.readings[2] = np.nan
    at = np.concatenate([net.nominal[:3], [[5000.0, 0, 0], [0, 5000.0, 0]]])
    probing = table(at, "point", ["P0", "P1", "P2", "Q1", "Q2"])
    probing = replace(probing, columns={"feature": np.repeat("f", 5), **probing.columns})
    with pytest.raises(InputError) as told:
        multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table(), probing=probing))
    assert [fault.line for fault in told.value.faults] == [4, 5, 6]
    assert all("has no replayed point of its name or within 1 mm" in fault.message for fault in told.value.faults)


def test_a_probing_point_whose_replay_was_left_out_is_told_so() -> None:
    """With four tracers a point with a wrong length is left out, and its correction with it."""
    net = network(30, 4, seed=1)
    net.readings[2, 1] += 0.05
    probing = table(net.nominal[:3], "point", ["P0", "P1", "P2"])
    probing = replace(probing, columns={"feature": np.repeat("f", 3), **probing.columns})
    wanted = replace(settings(), outliers="remove")
    with pytest.raises(InputError, match="the replayed point of probing point 'P2' was left out") as told:
        multilaterate.run(multilaterate.TASK.job(wanted, net.lengths(), net.point_table(), probing=probing))
    assert [fault.line for fault in told.value.faults] == [4]


def test_replays_that_were_elsewhere_are_told() -> None:
    net = network(30, 5, seed=1)
    probing = table(net.nominal[:2] + [0, 0, 50.0], "point", ["P0", "P1"])
    probing = replace(probing, columns={"feature": np.repeat("f", 2), **probing.columns})
    result = multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table(), probing=probing))
    assert any("up to 50 mm away from where they were probed" in line for line in result.warnings)


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample, run."""
    from metrocli.cli.commands import run

    folder = tmp_path_factory.mktemp("gear") / "gear"
    assert run(["init", str(folder), "--sample", "gear-m3d3"]) == 0
    assert run(["run", str(folder), "--quiet"]) == 0
    return folder


def test_the_sample_is_corrected_to_the_truth(ran: Path, tmp_path: Path, metrocli) -> None:  # type: ignore[no-untyped-def]
    """The machine's 25 um/m and 2 um are gone from distances across the gear."""
    done = metrocli("export", ran / "results" / "tip3.h5", "--to", "csv", "--out", tmp_path)
    assert done.code == 0
    assert str(tmp_path / "corrected.csv") in done.out
    corrected, probing = (
        csv.read(path, PROBING) for path in (tmp_path / "corrected.csv", ran / "data" / "probing.csv")
    )
    header = next(line for line in (ran / "data" / "probing.csv").read_text().splitlines() if line[0] != "#")
    assert (tmp_path / "corrected.csv").read_text().splitlines()[0] == header + ",sx_mm,sy_mm,sz_mm"
    assert corrected.texts("point") == probing.texts("point")
    job = load(ran / "jobs" / "tip3.yaml")
    points, tracers = (
        csv.read(ran / "data" / name, spec)
        for name, spec in (("points.csv", length_job.POINTS), ("true_tracers.csv", length_job.TRACERS))
    )
    true = (
        multilaterate.simulate(
            multilaterate.TASK.job(job.settings, points=points, tracers=tracers), SimulationOptions(3)
        )
        .files["true_points.csv"]
        .stacked("xyz")[:144]
    )
    across = [(0, 72), (5, 80), (20, 100), (30, 100)]
    for a, b in across:
        right = np.linalg.norm(true[a] - true[b])
        before, after = (
            np.linalg.norm(t.stacked("xyz")[a] - t.stacked("xyz")[b]) - right for t in (probing, corrected)
        )
        assert abs(after) < 1.2e-3 < 5e-3 < abs(before)


def test_the_simulation_makes_the_sample_again(ran: Path) -> None:
    job = load(ran / "jobs" / "tip3.yaml")
    points, tracers = (
        csv.read(ran / "data" / name, spec)
        for name, spec in (("points.csv", length_job.POINTS), ("true_tracers.csv", length_job.TRACERS))
    )
    made = multilaterate.simulate(
        multilaterate.TASK.job(job.settings, points=points, tracers=tracers), SimulationOptions(3)
    )
    there = csv.read(ran / "data" / "lengths.csv", length_job.LENGTHS)
    assert np.abs(made.files["lengths.csv"].numbers("length") - there.numbers("length")).max() < 1e-9
    assert made.files["lengths.csv"].numbers("length")[:4] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("measures", ["changes", "absolute"])
def test_simulated_measurements_give_the_truth_back(measures: str) -> None:
    net = network(40, 5, seed=4)
    chosen = replace(settings(5e-7, measures), simulation=LengthSimulation(0.02, 0.0, 5.0))
    tracers = table(net.tracers, "tracer", net.stations)
    made = multilaterate.simulate(
        multilaterate.TASK.job(chosen, points=net.point_table(), tracers=tracers), SimulationOptions(1)
    )
    result = multilaterate.run(
        multilaterate.TASK.job(chosen, made.files["lengths.csv"], net.point_table(), made.files["tracers.csv"])
    )
    found = {estimate.name: estimate for estimate in result.estimates}
    # the frame is that of the mover's readings, which are 20 um off: distances do not depend on it
    at, true = (
        np.array([[value(f"T{j}.{axis}") for axis in "xyz"] for j in range(5)])
        for value in (lambda name: found[name].value, made.truth.__getitem__)
    )
    order = [estimate.name for estimate in result.estimates]
    places = np.array([[order.index(f"T{j}.{axis}") for axis in "xyz"] for j in range(5)])
    for j, k in itertools.combinations(range(5), 2):
        off = np.linalg.norm(at[j] - at[k]) - np.linalg.norm(true[j] - true[k])
        along = (at[j] - at[k]) / np.linalg.norm(at[j] - at[k])
        gradient = np.zeros(len(order))
        gradient[places[j]], gradient[places[k]] = along, -along
        assert abs(off) < 4 * np.sqrt(gradient @ result.covariance @ gradient) < 0.02
    for name in found.keys() & {f"T{j}.dead_path" for j in range(5)}:
        assert abs(found[name].value - made.truth[name]) < 4 * found[name].std < 0.02
    assert all(made.truth[f"T{j}.dead_path"] == 0 for j in range(5)) is (measures == "absolute")


def test_a_simulation_without_truth_is_refused() -> None:
    with pytest.raises(InputError, match="simulate needs the truth"):
        multilaterate.simulate(
            multilaterate.TASK.job(settings(), points=network(9, 4).point_table()), SimulationOptions()
        )
    with pytest.raises(UndeterminedError):
        net = network(9, 4)
        multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table()))


def test_export_beside_the_result_and_of_nothing(tmp_path: Path, ran: Path, metrocli) -> None:  # type: ignore[no-untyped-def]
    from metrocli.formats import hdf5
    from metrocli.record import Record
    from metrocli.result import Result

    assert metrocli("export", ran / "results" / "tip3.h5", "--to", "csv").code == 0
    assert (ran / "results" / "tip3.corrected.csv").is_file()
    hdf5.write(tmp_path / "empty.h5", Result("x", "", (), np.zeros((0, 0)), {}), Record("", (), "", ""))
    done = metrocli("export", tmp_path / "empty.h5", "--to", "csv", "--out", tmp_path)
    assert done.code == 3 and "no tables" in done.err
    assert metrocli("export", ran / "results" / "tip3.h5", "--to", "word").code == 2
    assert json.loads(metrocli("show", ran / "results" / "tip3.h5", "--json").out)["kind"] == "multilaterate"
