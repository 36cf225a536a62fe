"""What a result lists as not controlled leaves the sum of squares alone, and moves the result as far as it states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import machine as sim
from simulated import machine_lengths as lengths
from simulated.castings import casting, nominal
from simulated.grid import grid
from tasks.fit_part.test_uncertainty import file_of, solved_of
from tasks.shared.images import small_jobs

from metrocli.formats import hdf5
from metrocli.result import Result
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.fit_part import report as fit_report
from metrocli.tasks.selfcal_grid import task as selfcal_grid

Metrocli = Callable[..., Any]


def carried_out(job: Path, metrocli: Metrocli, *sets: str) -> Result:
    ran = metrocli("calibrate-camera", job, *(word for one in sets for word in ("--set", one)))
    assert ran.code == 0, ran.err
    return hdf5.read(job.parent / "camera.h5")[0]


def scaled(file: Path, columns: slice, factor: float) -> None:
    """Multiply columns of a CSV file."""
    header, *rows = file.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    for row in cells:
        row[columns] = [repr(float(cell) * factor) for cell in row[columns]]
    file.write_text("\n".join([header, *(",".join(row) for row in cells)]) + "\n")


def hidden(result: Result, word: str) -> float:
    table = result.tables["not_controlled"]
    (size,) = [
        size for effect, size in zip(table.texts("effect"), table.numbers("hides"), strict=True) if word in effect
    ]
    return float(size)


def test_the_scale_of_a_board_is_not_controlled(tmp_path: Path, metrocli: Metrocli) -> None:
    job = small_jobs.board(tmp_path)
    before = carried_out(job, metrocli)
    scaled(tmp_path / "targets.csv", slice(1, 4), 1.001)
    after = carried_out(job, metrocli)
    assert after.statistics["chi2"] == pytest.approx(before.statistics["chi2"], rel=1e-6)
    distance = [np.linalg.norm(one.tables["views"].stacked("xyz"), axis=1) for one in (before, after)]
    assert hidden(before, "pitch") == pytest.approx(float(np.median(distance[1] - distance[0])), rel=1e-3)
    lens = [np.array([estimate.value for estimate in one.estimates]) for one in (before, after)]
    assert np.allclose(*lens, rtol=1e-6, atol=1e-9)


def test_the_pixel_size_is_not_controlled(tmp_path: Path, metrocli: Metrocli) -> None:
    job = small_jobs.board(tmp_path)
    before = carried_out(job, metrocli)
    after = carried_out(job, metrocli, "camera.pixel_size=2.2022 um")
    assert after.statistics["chi2"] == before.statistics["chi2"]
    focal = next(estimate.value for estimate in before.estimates if estimate.name == "f")
    assert hidden(before, "pixel_size") == pytest.approx(focal * (2.2022e-3 - 2.2e-3), rel=1e-3)


def test_the_principal_point_of_a_camera_file_moves_the_part_across_the_view(
    tmp_path: Path, metrocli: Metrocli
) -> None:
    job = small_jobs.align(tmp_path)
    results = []
    for cx in ("1286.8", "1287.8"):
        text = small_jobs.CAMERA_FILE.replace("cx: 1286.8", f"cx: {cx}")
        (tmp_path / "camera.yaml").write_text(text)
        assert metrocli("align-part", job).code == 0
        results.append(hdf5.read(tmp_path / "part.h5")[0])
    at = [np.array([estimate.value for estimate in one.estimates[:3]]) for one in results]
    # the distortion beside it makes 6 %
    assert hidden(results[0], "cx and cy") == pytest.approx(float(np.linalg.norm(at[1] - at[0])), rel=0.1)


def test_the_scale_of_a_measuring_machine_is_not_controlled(tmp_path: Path, metrocli: Metrocli) -> None:
    job = small_jobs.cmm(tmp_path)
    before = carried_out(job, metrocli)
    scaled(tmp_path / "targets.csv", slice(1, 4), 1 + 1e-5)
    after = carried_out(job, metrocli)
    assert after.statistics["chi2"] == pytest.approx(before.statistics["chi2"], rel=1e-4)  # sigma_mm is not scaled
    place = [np.array([e.value for e in one.estimates if e.name in "xyz"]) for one in (before, after)]
    targets = np.array([row.split(",")[1:4] for row in (tmp_path / "targets.csv").read_text().splitlines()[1:]], float)
    nearer = np.linalg.norm(place[1] - targets.mean(axis=0)) - np.linalg.norm(
        place[0] - targets.mean(axis=0) / (1 + 1e-5)
    )
    assert hidden(before, "common scale") == pytest.approx(nearer, rel=1e-3)


def test_the_pitch_of_a_ball_grid_is_not_controlled() -> None:
    one = grid(3, seed=4)
    table = one.read(np.random.default_rng(5))
    settings = one.settings(leave_one_out="no")
    longer = replace(settings, grid=replace(settings.grid, pitch=settings.grid.pitch * (1 + 1e-5)))
    before, after = (selfcal_grid.run(selfcal_grid.TASK.job(each, table)) for each in (settings, longer))
    assert after.statistics["chi2"] == pytest.approx(before.statistics["chi2"], rel=1e-4)
    change = [one.tables["machine_error"].stacked(("ex", "ey", "ez")) for one in (before, after)]
    moved = change[1] - change[0]
    corners = np.linalg.norm(moved[:, None] - moved[None], axis=2).max()
    assert hidden(before, "pitch") == pytest.approx(corners, rel=1e-3)


def test_the_scale_of_a_tracker_is_not_controlled() -> None:
    """A longer wavelength is growth of the positioning errors: over the diagonal of the volume as much as stated."""
    rng = np.random.default_rng(7)
    table = sim.points(sim.random_machine(rng), rng, 250, sim.THREE)
    grown = {axis: table.numbers(axis) * (1 + 0.96e-6) for axis in ("mx", "my", "mz")}
    settings = sim.settings(tools=sim.THREE)
    before, after = (
        calibrate_machine.run(calibrate_machine.TASK.job(settings, points=each))
        for each in (table, replace(table, columns={**table.columns, **grown}))
    )
    # the known distances between the tools, 200 mm, show a little of it
    assert after.statistics["chi2"] == pytest.approx(before.statistics["chi2"], rel=0.01)
    spans = []
    for name in ("EXX", "EYY", "EZZ"):
        change = after.tables[f"tables/{name}"].numbers("value") - before.tables[f"tables/{name}"].numbers("value")
        spans.append(np.ptp(change))
    assert hidden(before, "wavelength") == pytest.approx(float(np.linalg.norm(spans)), rel=0.05)


def test_a_wrong_vector_of_the_only_tool_is_not_controlled() -> None:
    rng = np.random.default_rng(8)
    table = sim.points(sim.random_machine(rng), rng, 250, sim.ONE)
    longer = {"T1": (0.0, 0.0, 120.1)}
    before, after = (
        calibrate_machine.run(calibrate_machine.TASK.job(sim.settings(tools=tools), points=table))
        for tools in (sim.ONE, longer)
    )
    assert after.statistics["chi2"] == pytest.approx(before.statistics["chi2"], rel=0.01)
    assert 0 < hidden(before, "only tool") < 0.1 * 1e-3  # angles of the machine are below 1 mrad


@pytest.mark.parametrize(
    ("aim", "minimum"),
    [
        ("even", 0.5),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in (("even", 2.3), ("least-motion", 0.5), ("most", 0.5))),
    ],
)
def test_the_scale_of_a_raw_part_is_not_controlled(tmp_path: Path, aim: str, minimum: float) -> None:
    (tmp_path / "part.yaml").write_text(nominal())
    one, part = casting(48), file_of(tmp_path)
    middle, stock = one.points.mean(axis=0), []
    for scale in (1.0, 1 + 1e-5):
        solved = solved_of(replace(one, points=middle + (one.points - middle) * scale), part, aim, minimum)
        stock.append(fit_report.report(solved).tables)
    moved = stock[1]["overstock"].numbers("overstock") - stock[0]["overstock"].numbers("overstock")
    used = stock[0]["overstock"].numbers("used") > 0
    listed = stock[0]["not_controlled"]
    (size,) = listed.numbers("hides")[["common scale" in effect for effect in listed.texts("effect")]]
    assert float(np.abs(moved[used]).max()) == pytest.approx(float(size), rel=0.02)


def without_rigid_motion(vectors: lengths.Array, places: lengths.Array) -> lengths.Array:
    """Return vectors (n, 3) without the shift and small turn that fit them best, solved as one system."""
    turned = np.stack([np.cross(axis, places - places.mean(axis=0)).ravel() for axis in np.eye(3)])
    design = np.concatenate([np.tile(np.eye(3), len(places)), turned]).T
    found, *_ = np.linalg.lstsq(design, vectors.ravel())
    return vectors - (design @ found).reshape(-1, 3)


def test_the_sense_of_an_axis_is_not_controlled_by_lengths_with_one_tool() -> None:
    """Each axis counts backwards in turn; the largest change of the error in the volume is the stated one."""
    rng = np.random.default_rng(3009)
    table = lengths.measured(sim.random_machine(rng), rng, 200, sim.ONE)
    settings = lengths.settings(tools=sim.ONE)
    results = [calibrate_machine.run(calibrate_machine.TASK.job(settings, lengths=table))]
    for number, axis in enumerate("xyz"):
        backwards = sim.LOW[number] + sim.HIGH[number] - table.numbers(axis)
        other = replace(table, columns={**table.columns, axis: backwards})
        results.append(calibrate_machine.run(calibrate_machine.TASK.job(settings, lengths=other)))
    before, *after = (one.tables["volume"] for one in results)
    places, error = (before.stacked(names) for names in (("x", "y", "z"), ("ex", "ey", "ez")))
    changes = [without_rigid_motion(one.stacked(("ex", "ey", "ez")) - error, places) for one in after]
    assert [one.statistics["chi2"] for one in results] == pytest.approx([results[0].statistics["chi2"]] * 4, rel=1e-3)
    largest = max(float(np.linalg.norm(change, axis=1).max()) for change in changes)
    assert hidden(results[0], "sense of X, Y, Z") == pytest.approx(largest, rel=0.01)


def test_tools_or_listed_stations_control_the_sense_of_an_axis() -> None:
    rng = np.random.default_rng(3010)
    table = lengths.measured(sim.random_machine(rng), rng, 200, lengths.TWO)
    job = calibrate_machine.TASK.job(lengths.settings(), lengths=table)
    assert "sense of Y:" in " ".join(calibrate_machine.run(job).tables["not_controlled"].texts("effect"))
    listed = replace(job.settings.inputs, stations=sim.NOWHERE)
    job = calibrate_machine.TASK.job(
        replace(job.settings, inputs=listed), lengths=table, stations=lengths.listed(lengths.STATIONS[:4])
    )
    assert "sense of" not in " ".join(calibrate_machine.run(job).tables["not_controlled"].texts("effect"))
