"""Several cameras of other programs with their poses: by formulas of numpy and scipy, there and back, and in use."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from imports import camera_texts as texts
from scipy.spatial.transform import Rotation

from benchmarks.apart import rig
from metrocli.errors import InputError
from metrocli.formats import hdf5
from metrocli.imports import ImportOptions
from metrocli.imports.cameras import as_yaml, files
from metrocli.imports.lines import TextLines

Metrocli = Callable[..., Any]
RNG = np.random.default_rng(31)
TURNS = [Rotation.from_rotvec(RNG.normal(0, 0.4, 3)) for _ in range(3)]
SHIFTS = RNG.normal(0, 0.2, (3, 3))
"""Of points of a common frame to each of three cameras [m]"""


def lines(name: str, text: str) -> TextLines:
    return TextLines(name, text.splitlines())


def pose_of(text: str, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation and shift [mm] of a camera of rig.yaml, `Rz(gamma) Ry(beta) Rx(alpha)`."""
    pose = yaml.safe_load(text)["cameras"][name]["pose"]
    value = {key: float(entry.split()[0]) for key, entry in pose.items()}
    turn = Rotation.from_euler("xyz", [value["alpha"], value["beta"], value["gamma"]]).as_matrix()
    return turn, np.array([value[key] for key in "xyz"])


def must_be(text: str, name: str, number: int) -> None:
    """A point of the camera goes to the common frame and from there to the first camera."""
    point = np.array([0.3, -0.2, 1.7])
    common = TURNS[number].inv().apply(point - SHIFTS[number])
    turn, shift = pose_of(text, name)
    np.testing.assert_allclose(turn @ (1000 * point) + shift, 1000 * (TURNS[0].apply(common) + SHIFTS[0]), atol=2e-10)


def chain(step: Callable[[np.ndarray], str]) -> str:
    """A camchain of three cameras, with each matrix T_cn_cnm1 as `step` writes it."""
    matrices = [np.eye(4) for _ in TURNS]
    for matrix, turn, shift in zip(matrices, TURNS, SHIFTS, strict=True):
        matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), shift
    body = texts.CHAIN.partition("cam1:")[0].partition("cam0:")[2]
    text = ""
    for number, matrix in enumerate(matrices):
        given = step(matrix @ np.linalg.inv(matrices[number - 1])) if number else ""
        text += f"cam{number}:{body}{given}"
    return text


def in_rows(matrix: np.ndarray) -> str:
    return "  T_cn_cnm1:\n" + "".join(f"  - {row}\n" for row in matrix.tolist()) + "  rostopic: /cam/image_raw\n"


def in_brackets(matrix: np.ndarray) -> str:
    return f"  T_cn_cnm1: {matrix.tolist()}\n"


def one_a_line(matrix: np.ndarray) -> str:
    rows = (
        "\n".join(f"  {'- ' if k == 0 else '  '}- {value!r}" for k, value in enumerate(row)) for row in matrix.tolist()
    )
    return "  T_cn_cnm1:\n" + "\n".join(rows) + "\n"


@pytest.mark.parametrize("step", [in_rows, in_brackets, one_a_line], ids=lambda one: one.__name__)
def test_kalibr_states_each_camera_from_the_one_before(step: Callable[[np.ndarray], str]) -> None:
    text = files(lines("camchain.yaml", chain(step)), ImportOptions())["rig.yaml"]
    must_be(text, "cam1", 1)
    must_be(text, "cam2", 2)
    assert as_yaml(lines("camchain.yaml", chain(step))) == text


def test_mrcal_states_each_camera_from_its_reference() -> None:
    given = []
    for name, turn, shift in zip("abc", TURNS, SHIFTS, strict=True):
        place = ", ".join(map(repr, [*turn.as_rotvec().tolist(), *shift.tolist()]))
        model = f"{{\n 'lensmodel': 'LENSMODEL_PINHOLE',\n 'extrinsics': [ {place} ],\n"
        model += " 'intrinsics': [ 500, 501, 320, 240 ],\n 'imagersize': [ 640, 480 ],\n}\n"
        given.append(lines(f"dir/{name}.cameramodel", model))
    text = files(given[0], ImportOptions(others=tuple(given[1:])))["rig.yaml"]
    must_be(text, "b", 1)
    must_be(text, "c", 2)


def test_colmap_and_opencv_state_cameras_without_a_unit() -> None:
    """The second camera beside the first, in cm."""
    turn = TURNS[1] * TURNS[0].inv()
    shift = 100 * (SHIFTS[1] - turn.apply(SHIFTS[0]))
    x, y, z, w = turn.as_quat().tolist()
    rigs = f"# RIG_ID ...\n1 2 CAMERA 1 CAMERA 2 1 {w} {x} {y} {z} {' '.join(map(repr, shift.tolist()))}\n"
    options = ImportOptions(unit="cm", others=(lines("rigs.txt", rigs),))
    must_be(files(lines("cameras.txt", texts.COLMAP), options)["rig.yaml"], "camera-2", 1)
    one = texts.FILESTORAGE.replace("%YAML:1.0\n", "").replace("camera_matrix", "M{0}").replace("dist_coeff", "D{0}")
    matrices = {"R": (3, 3, turn.as_matrix()), "T": (3, 1, shift)}
    pair = f"%YAML:1.0\n{one.format(1)}{one.format(2)}image_width: 640\nimage_height: 480\n" + "".join(
        f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: {values.ravel().tolist()}\n"
        for key, (rows, columns, values) in matrices.items()
    )
    must_be(files(lines("stereo.yml", pair), ImportOptions(unit="cm"))["rig.yaml"], "camera-2", 1)
    without = files(lines("stereo.yml", pair), ImportOptions())
    assert list(without) == ["camera-1.yaml", "camera-2.yaml"] and "give the unit by --unit" in without["camera-1.yaml"]


def test_poses_with_faults_are_refused() -> None:
    def faults(text: str, *others: TextLines) -> str:
        with pytest.raises(InputError) as caught:
            files(lines("their.txt", text), ImportOptions(others=others, unit="mm" if others else ""))
        return str(caught.value.faults)

    assert "not a rotation" in faults(chain(lambda matrix: in_rows(matrix * [1, 1, -1, 1])))
    assert "T_cn_cnm1 of cam1 has 12 numbers" in faults(chain(lambda matrix: in_rows(matrix[:3])))
    assert "the file has no pose of the camera cam2" in faults(chain(in_rows).rpartition("  T_cn_cnm1")[0])
    rigs = lines("rigs.txt", "1 2 CAMERA 1 CAMERA 7 1 1 0 0 0 5 0 0\n")
    assert "a sensor of the rig: CAMERA 7" in faults(texts.COLMAP, rigs)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of two cameras calibrated in a taper, without noise, and of a part that they see."""
    from metrocli.cli.commands import run

    folder = tmp_path_factory.mktemp("rig")
    rig.write_jobs(folder, None)
    assert run(["calibrate-camera", str(folder / "cam.yaml"), "--quiet"]) == 0
    return folder


EXPORTED = {
    "kalibr": ("camchain.yaml",),
    "opencv-yaml": ("left.yml", "right.yml"),
    "mrcal": ("left.cameramodel", "right.cameramodel"),
    "colmap": ("cameras.txt", "rigs.txt"),
}


@pytest.mark.parametrize("program", EXPORTED)
def test_a_rig_comes_back_from_each_format(program: str, calibrated: Path, metrocli: Metrocli, tmp_path: Path) -> None:
    ran = metrocli("export", calibrated / "cam.h5", "--to", program, "--out", tmp_path)
    assert ran.code == 0, ran.err
    paths = [tmp_path / name for name in EXPORTED[program]]
    ran = metrocli("import", *paths, "--from", program, "--out", tmp_path / "in")
    assert ran.code == 0, ran.err
    text = (tmp_path / "in/rig.yaml").read_text()
    _, second = yaml.safe_load(text)["cameras"]
    turn, shift = pose_of(text, second)
    table = hdf5.read(calibrated / "cam.h5")[0].tables["cameras"]
    place = {key: table.numbers(key)[1] for key in ("x", "y", "z", "alpha", "beta", "gamma")}
    np.testing.assert_allclose(shift, [place[key] for key in "xyz"], rtol=1e-12, atol=1e-12)
    true = Rotation.from_euler("xyz", [place[key] for key in ("alpha", "beta", "gamma")]).as_matrix()
    np.testing.assert_allclose(turn, true, atol=1e-12)


@pytest.mark.parametrize("file", ["camchain.yaml", "rig.yaml"])
def test_a_rig_of_kalibr_locates_a_part(file: str, calibrated: Path, metrocli: Metrocli, tmp_path: Path) -> None:
    """As it is, and as import writes it; the part is where it was drawn."""
    assert metrocli("export", calibrated / "cam.h5", "--to", "kalibr", "--out", tmp_path).code == 0
    if file == "rig.yaml":
        assert metrocli("import", tmp_path / "camchain.yaml", "--from", "kalibr", "--out", tmp_path).code == 0
    turn, place = rig.HELD["left"]
    angles = turn.as_euler("xyz").tolist()
    held = {**dict(zip("xyz", map("{!r} mm".format, place.tolist()), strict=True))}
    held |= dict(zip(("alpha", "beta", "gamma"), map("{!r} rad".format, angles), strict=True))
    job = yaml.safe_load((calibrated / "job.yaml").read_text())
    job["inputs"] = {key: str(calibrated / name) for key, name in job["inputs"].items()} | {"camera": file}
    job |= {"camera": {"extrinsics": held}, "cameras": {"cam0": "left*.png", "cam1": "right*.png"}}
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(job))
    ran = metrocli("align-part", tmp_path / "job.yaml", "--json")
    assert ran.code == 0, ran.err
    assert "the camera file of kalibr states no covariance" in ran.err
    found = json.loads(ran.out)["estimates"]
    assert {name: one["value"] for name, one in found.items()} == pytest.approx(rig.TRUTH, abs=2e-4)
