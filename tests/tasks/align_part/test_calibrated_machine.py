"""align-part on a machine with errors: a simulated machine and camera in plain formulas, calibrated and not."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from simulated import camera
from simulated import machine as sim

from metrocli.formats import csv, hdf5
from metrocli.geometry import poses
from metrocli.record import Record
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.align_part.spindle_poses import SpindlePoses
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.uncertainty.comparison import compare

Array = npt.NDArray[np.float64]
Metrocli = Callable[..., Any]
LENS = {"f": 2600.0, "cx": 1210.0, "cy": 885.0}
MOUNT = np.array([-2.0, 1.5, -320.0])
PLACE, TURN = np.array([110.0, -170.0, -250.0]), np.array([2e-3, -1e-3, 8e-3])
NOISE = 0.05
JOB = """metrocli: 1
job: align-part
inputs: {camera: camera.yaml, poses: poses.csv, targets: targets.csv, observations: observations.csv%s}
noise: 0.05 px
simulation: {part: {x: 110 mm, y: -170 mm, z: -250 mm, alpha: 2 mrad, beta: -1 mrad, gamma: 8 mrad}}
output: part.h5
"""


def targets() -> Array:
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(0, 380, 5), np.linspace(0, 340, 5)))
    return np.column_stack([x, y, 30 * np.cos(x / 40) * np.sin(y / 50)])


def spindle(rng: np.random.Generator) -> tuple[Array, Array]:
    """Commanded positions (24, 3) over the part and angles c (24,) of the spindle."""
    x, y, z = (part.ravel() for part in np.meshgrid([150.0, 300.0, 450.0], [-120.0, 0, 120.0], [-310.0, -200.0]))
    at = np.column_stack([x, y, z]) + rng.uniform(-30, 30, (len(x), 3))
    return at, rng.integers(4, size=len(at)) * np.pi / 2


def about_z(angle: float) -> Array:
    return sim.rotation(np.array([0.0, 0.0, angle]))


def seen(machine: sim.Machine, at: Array, c: Array, rng: np.random.Generator) -> Table:
    """What the camera reads while the spindle is displaced and turned by the errors of the machine."""
    held = at + sim.displacements(machine, at, np.zeros(3))
    turns = sim.rotations(machine, at)
    part = poses.rotation_of(poses.pose_from_euler(PLACE, TURN))
    points = targets() @ part.T + PLACE
    rows: dict[str, list[Array]] = {"image": [], "target": [], "u": [], "v": []}
    for i in range(len(at)):
        stands = sim.rotation(turns[i]) @ about_z(c[i])
        uv = camera.image((points - held[i]) @ stands - MOUNT, LENS) + NOISE * rng.normal(size=(2, len(points)))
        shown = np.flatnonzero(((uv > 5) & (uv < np.array(camera.SIZE)[:, None] - 5)).all(axis=0))
        rows["image"].append(np.repeat(f"i{i + 1}", len(shown)))
        rows["target"].append(np.array([f"M{k}" for k in shown]))
        rows["u"].append(uv[0, shown])
        rows["v"].append(uv[1, shown])
    columns = {name: np.concatenate(parts) for name, parts in rows.items()}
    return Table(columns, {"u": "px", "v": "px"})


def calibrated(machine: sim.Machine, seed: int, tools: Any = sim.THREE, **more: object) -> Result:
    points = sim.points(machine, np.random.default_rng(seed), 150, tools)
    return calibrate_machine.run(
        calibrate_machine.TASK.job(sim.settings(tools=tools, knots=machine.knots, **more), points=points)
    )


def written(folder: Path, machine: sim.Machine, result: Result | None, seed: int) -> Path:
    """Write an alignment on this machine, with the result of its calibration as input."""
    rng = np.random.default_rng(seed)
    at, c = spindle(rng)
    listed = targets()
    csv.write(
        folder / "targets.csv",
        Table(
            {"target": np.array([f"M{k}" for k in range(len(listed))]), **dict(zip("xyz", listed.T, strict=True))},
            dict.fromkeys("xyz", "mm"),
        ),
    )
    names = {"image": np.array([f"i{i + 1}" for i in range(len(at))])}
    zero = np.zeros(len(at))
    angles = dict.fromkeys("abc", "rad")
    held = names | dict(zip("xyz", at.T, strict=True)) | {"a": zero, "b": zero, "c": c}
    csv.write(folder / "poses.csv", Table(held, dict.fromkeys("xyz", "mm") | angles))
    csv.write(folder / "observations.csv", seen(machine, at, c, rng))
    lens = "".join(f"{name}: {value} px\n" for name, value in LENS.items())
    mount = ", ".join(f"{axis}: {value} mm" for axis, value in zip("xyz", MOUNT, strict=True))
    (folder / "camera.yaml").write_text(
        f"image_size: {list(camera.SIZE)}\n{lens}extrinsics: {{{mount}, alpha: 0 rad, beta: 0 rad, gamma: 0 rad}}\n"
    )
    if result is not None:
        hdf5.write(folder / "machine.h5", result, Record("", (), "0", "2026-01-01T00:00:00Z", doubts=result.doubts))
    job = folder / "job.yaml"
    job.write_text(JOB % ("" if result is None else ", machine: machine.h5"))
    return job


def off(path: Path) -> tuple[Array, Array]:
    """Deviation of the pose in a result file from the truth, and its covariance."""
    found = hdf5.read(path)[0]
    return np.array([one.value for one in found.estimates[:6]]) - np.concatenate([PLACE, TURN]), found.covariance[
        :6, :6
    ]


@pytest.fixture(scope="module")
def machine() -> sim.Machine:
    return sim.random_machine(np.random.default_rng(31), knots=(5, 4, 4), size=0.03)


@pytest.fixture(scope="module")
def result(machine: sim.Machine) -> Result:
    return calibrated(machine, 32)


def test_the_errors_of_the_machine_are_in_the_pose_without_them_and_not_with_them(
    tmp_path: Path, metrocli: Metrocli, machine: sim.Machine, result: Result
) -> None:
    job = written(tmp_path, machine, result, 33)
    ran = metrocli("align-part", job)
    assert ran.code == 0, ran.err
    wrong, covariance = off(tmp_path / "part.h5")
    std = np.sqrt(np.diag(covariance))
    assert np.abs(wrong / std).max() < 4
    assert wrong @ np.linalg.solve(covariance, wrong) < 22.5  # 0.1 % of chi-square with 6
    text = job.read_text()
    job.write_text(text.replace(", machine: machine.h5", ""))
    assert metrocli("align-part", job, "--accept-doubtful").code in (0, 6)
    without, alone = off(tmp_path / "part.h5")
    assert np.abs(without / np.sqrt(np.diag(alone))).max() > 20
    # the tables' uncertainty is in that of the part
    assert (std > 1.2 * np.sqrt(np.diag(alone))).any()


@pytest.mark.slow
def test_poses_of_machines_that_are_calibrated_anew_scatter_as_stated(tmp_path: Path, metrocli: Metrocli) -> None:
    squares = []
    for seed in range(12):
        machine = sim.random_machine(np.random.default_rng(100 + seed), "YXZ", knots=(4, 4, 3), size=0.03)
        home = tmp_path / str(seed)
        home.mkdir()
        job = written(home, machine, calibrated(machine, 200 + seed, chain="wYXZt"), 300 + seed)
        assert metrocli("align-part", job).code == 0
        wrong, covariance = off(home / "part.h5")
        squares.append(wrong @ np.linalg.solve(covariance, wrong))
    assert np.mean(squares) == pytest.approx(6, abs=3 * np.sqrt(12 / len(squares)))


@pytest.mark.slow
def test_a_diagnosis_has_causes_without_the_machine_and_is_clean_with_it(
    tmp_path: Path, metrocli: Metrocli, machine: sim.Machine, result: Result
) -> None:
    job = written(tmp_path, machine, result, 34)
    text = job.read_text()
    job.write_text(text.replace(", machine: machine.h5", ""))
    before = json.loads(metrocli("diagnose", job, "--json", "--limit", "5 s").out)
    assert before["verdict"] != "clean"
    job.write_text(text)
    ran = metrocli("diagnose", job, "--json")
    assert ran.code == 0, ran.err
    assert json.loads(ran.out)["verdict"] == "clean"


@pytest.mark.slow
def test_an_axis_that_grew_since_its_calibration_is_named_on_top_of_the_tables(
    tmp_path: Path, metrocli: Metrocli, machine: sim.Machine, result: Result
) -> None:
    longer = machine.tables["EXX"] + 150e-6 * machine.positions("X")
    job = written(tmp_path, replace(machine, tables={**machine.tables, "EXX": longer}), result, 35)
    found = json.loads(metrocli("diagnose", job, "--json").out)
    (effect,) = found["effects"]
    assert (effect["name"], effect["where"]) == ("machine-scale", {"axis": "x"})
    scale = effect["parameters"]["scale"]
    assert abs(scale["value"] - 150e-6) < 4 * scale["std"]


def test_the_spindle_stands_where_actual_minus_commanded_says(machine: sim.Machine, result: Result) -> None:
    at = np.array([[300.0, 120.0, -200.0], [90.0, -210.0, -480.0]])
    table = Table({"image": np.array(["a", "b"]), **dict(zip("xyz", at.T, strict=True))}, dict.fromkeys("xyz", "mm"))
    motion = SpindlePoses(table, result).motion(np.arange(2))
    truth = np.concatenate([sim.displacements(machine, at, np.zeros(3)), sim.rotations(machine, at)], axis=1)
    std = np.sqrt(np.einsum("nak,nak->na", motion.spread, motion.spread))
    assert np.abs((motion.mean - truth) / std).max() < 4
    assert np.abs(truth / std).max() > 20
    held = SpindlePoses(table, result).moved(np.arange(2), motion.mean)
    assert np.allclose(held[:, :3] - at, motion.mean[:, :3], atol=1e-12)
    for pose, turn in zip(held, motion.mean[:, 3:], strict=True):
        assert np.allclose(poses.rotation_of(pose), sim.rotation(turn), atol=1e-12)


def test_poses_beyond_the_axes_are_refused_with_image_and_axis(
    tmp_path: Path, metrocli: Metrocli, machine: sim.Machine, result: Result
) -> None:
    job = written(tmp_path, machine, result, 36)
    lines = (tmp_path / "poses.csv").read_text().splitlines()
    cells = lines[3].split(",")
    lines[3] = ",".join([cells[0], "700", *cells[2:]])
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n")
    for command in ("check", "align-part"):
        ran = metrocli(command, job)
        assert ran.code == 3
        assert "poses.csv:4: error: the commanded x 700 mm of image 'i3' is outside the calibrated axis" in ran.err
        assert "expected 0 to 600 mm: leave the image out" in ran.err


def test_a_machine_that_was_measured_with_one_tool_does_not_tell_how_the_spindle_turns(
    tmp_path: Path, metrocli: Metrocli, machine: sim.Machine
) -> None:
    job = written(tmp_path, machine, calibrated(machine, 37, sim.ONE), 37)
    ran = metrocli("align-part", job)
    assert ran.code == 3
    assert "does not determine ECY, EAZ, EBZ, ECZ" in ran.err
    assert "three tools that are not on one line" in ran.err


def test_errors_that_the_machines_job_leaves_out_count_as_zero_with_a_warning(
    tmp_path: Path, metrocli: Metrocli, machine: sim.Machine
) -> None:
    kept = tuple(name for name in (*sim.NAMES, "A0Z", "B0Z", "C0Y") if name not in ("EAZ", "EBZ", "ECZ", "ECY"))
    tables = {name: values * (name in kept) for name, values in machine.tables.items()}
    simpler = replace(machine, tables=tables)
    job = written(tmp_path, simpler, calibrated(simpler, 38, sim.ONE, estimate=kept), 38)
    ran = metrocli("align-part", job)
    assert ran.code == 0, ran.err
    assert "does not estimate ECY, EAZ, EBZ, ECZ: the poses count them as zero" in ran.out + ran.err
    wrong, covariance = off(tmp_path / "part.h5")
    assert wrong @ np.linalg.solve(covariance, wrong) < 22.5


def test_effects_of_the_machines_result_are_named_as_not_corrected(result: Result) -> None:
    table = Table({"value": np.array([0.004])})
    found = replace(result, tables={**result.tables, "effects/backlash.x/parameters": table})
    (warning,) = SpindlePoses(Table({}), found).warnings()
    assert "backlash.x; the poses are not corrected" in warning


def test_a_result_of_another_kind_and_a_doubtful_one_are_refused(
    tmp_path: Path, metrocli: Metrocli, machine: sim.Machine, result: Result
) -> None:
    job = written(tmp_path, machine, replace(result, doubts=("its residuals contradict its noise",)), 39)
    ran = metrocli("align-part", job)
    assert (ran.code, "machine.h5" in ran.err) == (3, True)
    assert "its residuals contradict its noise" in ran.err
    assert metrocli("align-part", job, "--accept-doubtful").code in (0, 6)
    job.write_text(job.read_text().replace("machine.h5", "part.h5").replace("output: part.h5", "output: other.h5"))
    ran = metrocli("align-part", job)
    assert ran.code == 3
    assert "calibrate-machine" in ran.err


def test_simulated_readings_have_the_errors_of_the_machine(
    tmp_path: Path, metrocli: Metrocli, machine: sim.Machine, result: Result
) -> None:
    job = written(tmp_path, machine, result, 40)
    made = metrocli("simulate", job, "--out", tmp_path / "new", "--seed", "4")
    assert made.code == 0, made.err
    (tmp_path / "observations.csv").write_bytes((tmp_path / "new" / "observations.csv").read_bytes())
    assert metrocli("align-part", job).code == 0
    wrong, covariance = off(tmp_path / "part.h5")
    assert wrong @ np.linalg.solve(covariance, wrong) < 22.5


@pytest.mark.slow
def test_two_parts_on_one_machine_share_the_errors_of_its_calibration(
    tmp_path: Path, metrocli: Metrocli, machine: sim.Machine, result: Result
) -> None:
    """The same part measured twice: the machine's errors cancel in the difference, and are counted once."""
    squares, apart = [], []
    for pair in range(6):
        folders = [tmp_path / f"{pair}{which}" for which in "ab"]
        for number, folder in enumerate(folders):
            folder.mkdir()
            assert metrocli("align-part", written(folder, machine, result, 400 + 2 * pair + number)).code == 0
        one, other = (hdf5.read(folder / "part.h5")[0] for folder in folders)
        found = compare(one, other)
        assert found.counted_once == ("machine",)
        squares.append(found.chi2)
        both = np.sqrt(np.diag(one.covariance)[:6] + np.diag(other.covariance)[:6])
        std = {item.name: item.std for item in found.compared}
        apart.append([std[name.name] for name in one.estimates[:6]] / both)
    assert np.mean(squares) == pytest.approx(6, abs=3 * np.sqrt(12 / len(squares)))
    assert np.min(apart) < 0.8 and np.max(apart) <= 1 + 1e-9
    ran = metrocli("compare", tmp_path / "0a" / "part.h5", tmp_path / "0b" / "part.h5")
    assert ran.code == 0 and "machine" in ran.out


def test_another_calibration_is_not_shared(
    tmp_path: Path, metrocli: Metrocli, machine: sim.Machine, result: Result
) -> None:
    found = []
    for name, one in (("a", result), ("b", calibrated(machine, 41))):
        (tmp_path / name).mkdir()
        assert metrocli("align-part", written(tmp_path / name, machine, one, 42)).code == 0
        found.append(hdf5.read(tmp_path / name / "part.h5")[0])
    assert compare(*found).counted_once == ()


def test_a_project_calibrates_the_machine_and_then_aligns_the_part(
    tmp_path: Path, metrocli: Metrocli, machine: sim.Machine
) -> None:
    written(tmp_path, machine, None, 43)
    csv.write(tmp_path / "points.csv", sim.points(machine, np.random.default_rng(44), 150, sim.THREE))
    axes = zip("xyz", sim.LOW, sim.HIGH, machine.knots, strict=True)
    ranges = ", ".join(f"{axis}: {{range: [{low} mm, {high} mm], knots: {knots}}}" for axis, low, high, knots in axes)
    tools = ", ".join(f"{name}: [{', '.join(f'{x} mm' for x in tool)}]" for name, tool in sim.THREE.items())
    (tmp_path / "machine.yaml").write_text(
        "metrocli: 1\njob: calibrate-machine\nmethod: standstill\ninputs: {points: points.csv}\n"
        f"machine: {{chain: wXbYZt, axes: {{{ranges}}}, tools: {{{tools}}}}}\n"
        "noise: {beam: 1 um, lateral: {constant: 2 um, proportional: 3 um/m}}\noutput: machine.h5\n"
    )
    (tmp_path / "part.yaml").write_text(JOB % ", machine: machine.h5")
    (tmp_path / "metrocli.yaml").write_text("project: chain\njobs: [part.yaml, machine.yaml]\n")
    ran = metrocli("run", tmp_path)
    assert ran.code == 0, ran.err
    wrong, covariance = off(tmp_path / "part.h5")
    assert wrong @ np.linalg.solve(covariance, wrong) < 22.5  # 0.1 % of chi-square with 6
    told = metrocli("lineage", tmp_path / "part.h5").out
    assert "machine.h5" in told and "points.csv" in told
    # a machine that is calibrated from other points makes the part anew
    csv.write(tmp_path / "points.csv", sim.points(machine, np.random.default_rng(45), 150, sim.THREE))
    assert "part" in metrocli("status", tmp_path).out
    assert metrocli("run", tmp_path).code == 0
    again, _ = off(tmp_path / "part.h5")
    assert not np.array_equal(again, wrong)
    # a machine that is not fit for use stops the part
    text = (tmp_path / "machine.yaml").read_text()
    (tmp_path / "machine.yaml").write_text(
        text.replace("beam: 1 um", "beam: 0.1 um").replace("2 um, prop", "0.2 um, prop")
    )
    ran = metrocli("run", tmp_path)
    assert ran.code == 6 and "machine" in ran.err + ran.out
