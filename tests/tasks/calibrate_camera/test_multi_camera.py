"""Several cameras fixed to each other: OpenCV finds the same pose, wrong pairs are named, what is missing is said."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from metrocli.adjust.adjustment import adjust
from metrocli.arrays import Array
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.formats import hdf5
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load
from metrocli.project.runner import content
from metrocli.tasks.calibrate_camera.multi_camera.task import prepared

Metrocli = Callable[..., Any]
SIZE = (1280, 960)
BOARD = np.array([[25.0 * i, 25.0 * j, 0.0] for j in range(5) for i in range(7)])
LENSES = {
    "left": (1100.0, 650.0, 470.0, -0.2, 0.05, 3e-4, -2e-4),
    "right": (1150.0, 630.0, 485.0, -0.15, 0.03, -1e-4, 4e-4),
}
TURN, SHIFT = Rotation.from_rotvec([0.02, -0.15, 0.01]), np.array([95.0, -4.0, 12.0])
"""Pose of the right camera in the frame of the left one"""
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {inputs}
noise: 0.1 px
cameras:
  left: {{images: "left*.png"{left}}}
  right: {{images: "right*.png"{right}}}
output: rig.h5
"""
TABLES = "{observations: obs.csv, targets: targets.csv}"
Seen = dict[str, Array]


def square(name: str) -> Array:
    f, cx, cy = LENSES[name][:3]
    return np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]])


def seen(count: int = 9) -> Seen:
    """The image points of both cameras, by the names of the images, with noise of 0.1 px."""
    rng, found = np.random.default_rng(8), Seen()
    for shot in range(count):
        turn = Rotation.from_euler("zxy", [rng.uniform(-2, 2), *rng.uniform(-0.5, 0.5, 2)])
        points = turn.apply(BOARD - BOARD.mean(axis=0)) + [*rng.uniform(-30, 60, 2), rng.uniform(280, 420)]
        for name, own in (("left", points), ("right", TURN.inv().apply(points - SHIFT))):
            uv = cv2.projectPoints(own, np.zeros(3), np.zeros(3), square(name), np.array(LENSES[name][3:]))[0][:, 0]
            found[f"{name}{shot}.png"] = uv + rng.normal(0, 0.1, uv.shape)
    return found


def job(folder: Path, images: Seen, held: Iterable[str] = ("", "")) -> Path:
    rows = (f"{name},{j},{float(u)},{float(v)}" for name, uv in images.items() for j, (u, v) in enumerate(uv))
    (folder / "obs.csv").write_text("\n".join(["image,target,u_px,v_px", *rows]))
    listed = (f"{j},{x},{y},{z}" for j, (x, y, z) in enumerate(BOARD))
    (folder / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *listed]))
    left, right = (f", image_size: [1280, 960]{one}" for one in held)
    (folder / "rig.yaml").write_text(JOB.format(inputs=TABLES, left=left, right=right))
    return folder / "rig.yaml"


def estimates(path: Path) -> dict[str, tuple[float, float]]:
    with h5py.File(path) as file:
        rows = file["parameters"][:]
    return {row["name"].decode(): (float(row["value"]), float(row["std"])) for row in rows}


def test_lenses_and_pose_are_found(tmp_path: Path, metrocli: Metrocli) -> None:
    images = {name: uv for name, uv in seen().items() if name not in ("left2.png", "right5.png")}
    ran = metrocli("calibrate-camera", job(tmp_path, images))
    assert ran.code == 0, ran.err
    found = estimates(tmp_path / "rig.h5")
    truth = {f"{name}.f": lens[0] for name, lens in LENSES.items()} | {
        f"{name}.cx": lens[1] for name, lens in LENSES.items()
    }
    truth |= dict(zip(("right.x", "right.y", "right.z"), SHIFT, strict=True))
    truth |= dict(zip(("right.alpha", "right.beta", "right.gamma"), TURN.as_euler("xyz"), strict=True))
    for name, value in truth.items():
        assert abs(found[name][0] - value) < 4 * found[name][1], name
    assert "mm from left" in ran.out


def test_requirements_name_the_camera(tmp_path: Path, metrocli: Metrocli) -> None:
    path = job(tmp_path, seen(5))
    text = path.read_text()
    path.write_text(text + 'require: {left.f.std: "< 1 px", right.z.std: "< 1 mm"}\n')
    assert metrocli("check", path).code == 0
    path.write_text(text + 'require: {f: "> 1 px"}\n')
    assert "the result has no value 'f'" in metrocli("check", path).err


def test_images_of_one_exposure_have_errors_of_their_own(tmp_path: Path) -> None:
    """They share the pose of the exposure, and no smooth error: each image has its own functions."""
    m = measurement_of(adjusted_job_of(load(job(tmp_path, seen(5)))))
    (number,) = (number for number, knots in enumerate(m.knots) if knots.by == "image")
    columns = m.correlated(number, 0.25, -1).columns
    image = m.knots[number].unit
    for one in (0, 1):
        others = columns[image == one].any(axis=0) & columns[image != one].any(axis=0)
        assert columns[image == one].any() and not others.any()


def test_opencv_finds_the_same_pose_with_the_same_lenses(tmp_path: Path, metrocli: Metrocli) -> None:
    images, names = seen(), ("f", "cx", "cy", "k1", "k2", "p1", "p2")
    units = [" px"] * 3 + [""] * 4
    held = [
        ", estimate: [], "
        + ", ".join(f"{key}: {value}{unit}" for key, value, unit in zip(names, lens, units, strict=True))
        for lens in LENSES.values()
    ]
    assert metrocli("calibrate-camera", job(tmp_path, images, held)).code == 0
    found = estimates(tmp_path / "rig.h5")
    points = [BOARD.astype(np.float32)] * 9
    sides = [[images[f"{name}{shot}.png"].astype(np.float32) for shot in range(9)] for name in LENSES]
    lenses = [part for name, lens in LENSES.items() for part in (square(name), np.array(lens[3:]))]
    ended = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 300, 1e-12)
    theirs = cv2.stereoCalibrate(points, *sides, *lenses, SIZE, flags=cv2.CALIB_FIX_INTRINSIC, criteria=ended)
    turn, shift = theirs[5], theirs[6].ravel()
    place = [*(-turn.T @ shift), *Rotation.from_matrix(turn.T).as_euler("xyz")]
    for name, value in zip(("x", "y", "z", "alpha", "beta", "gamma"), place, strict=True):
        assert abs(found[f"right.{name}"][0] - value) < 0.01 * found[f"right.{name}"][1], name


@pytest.mark.parametrize(
    ("moved", "told"),
    [
        ({3: 5, 5: 3}, "2 of 6 images of right were not taken with those of left: right3.png not with left3.png, but with left5.png"),
        ({i: (i + 1) % 6 for i in range(6)}, "6 of 6 images"),
    ],
)  # fmt: skip
def test_images_of_wrong_pairs_are_named(moved: dict[int, int], told: str, tmp_path: Path, metrocli: Metrocli) -> None:
    images = seen(6)
    wrong = {f"right{i}.png": images[f"right{j}.png"] for i, j in moved.items()}
    ran = metrocli("calibrate-camera", job(tmp_path, images | wrong))
    assert ran.code == 3 and told in ran.err


def test_a_mirrored_image_of_a_pair_is_named(tmp_path: Path, metrocli: Metrocli) -> None:
    """It was said to be of another pair, and to be renamed."""
    images = seen(6)
    right = images["right3.png"]
    ran = metrocli(
        "calibrate-camera",
        job(tmp_path, images | {"right3.png": np.stack([SIZE[0] - 1 - right[:, 0], right[:, 1]], axis=1)}),
    )
    assert ran.code == 3 and "(image right3.png: the board is seen from the other side" in ran.err, ran.err


@pytest.mark.parametrize("pair", [(16, 18), (4, 29)])
def test_names_exchanged_in_an_image_of_one_camera_are_named(
    tmp_path: Path, metrocli: Metrocli, pair: tuple[int, int]
) -> None:
    """Far ones pulled the pose of their image so far that it was said to be taken with another one."""
    images = seen(6)
    images["right3.png"][[*pair]] = images["right3.png"][[*pair[::-1]]]
    ran = metrocli("diagnose", job(tmp_path, images), "--quick", "--json")
    mistake = json.loads(ran.out)["mistake"]
    assert f"{pair[0]} and {pair[1]} are exchanged in image right3.png" in str(mistake)


def test_cameras_without_a_common_image_are_refused(tmp_path: Path, metrocli: Metrocli) -> None:
    images = {name: uv for name, uv in seen(10).items() if (int(name[-5]) < 5) == name.startswith("left")}
    ran = metrocli("calibrate-camera", job(tmp_path, images))
    assert ran.code == 4 and "right and left have no exposure in common" in ran.err


def test_images_of_no_camera_are_refused(tmp_path: Path, metrocli: Metrocli) -> None:
    images = seen(4)
    ran = metrocli("calibrate-camera", job(tmp_path, {**images, "top.png": images["left0.png"] + 1}))
    assert ran.code == 3 and "images of no camera, or of two: top.png" in ran.err


def test_each_camera_has_its_size_of_images(tmp_path: Path, metrocli: Metrocli) -> None:
    rng = np.random.default_rng(3)
    for name, size in (("left0", (30, 40)), ("left1", (30, 40)), ("right0", (60, 80)), ("right1", (60, 80))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), rng.integers(0, 255, size, dtype=np.uint8))
    inputs = '{images: "*.png"}\npattern: {type: chessboard, columns: 9, rows: 6, pitch: 25 mm}'
    text = JOB.format(inputs=inputs, left="", right="")
    (tmp_path / "rig.yaml").write_text(text)
    assert metrocli("check", tmp_path / "rig.yaml").code == 0
    ran = metrocli("check", tmp_path / "rig.yaml", "--set", "cameras.right.image_size=[40, 30]")
    assert ran.code == 3 and "the images are 80 x 60 px, but cameras: right: image_size is 40 x 30 px" in ran.err
    cv2.imwrite(str(tmp_path / "right2.png"), rng.integers(0, 255, (30, 40), dtype=np.uint8))
    for command in ("check", "calibrate-camera"):
        ran = metrocli(command, tmp_path / "rig.yaml")
        assert ran.code == 3 and "right2.png: error: this image is 40 x 30 pixels" in ran.err, ran.err
        assert "as 2 of 3 are; the images of a camera have one size" in ran.err


def test_faults_are_all_listed(tmp_path: Path, metrocli: Metrocli) -> None:
    text = JOB.format(inputs=TABLES, left="", right="")
    (tmp_path / "rig.yaml").write_text(text + "camera: {image_size: [640, 480]}\n")
    ran = metrocli("check", tmp_path / "rig.yaml")
    told = ("both camera and cameras", "image_size is missing")
    assert ran.code == 3 and all(one in ran.err for one in told), ran.err
    (tmp_path / "rig.yaml").write_text(text.replace("right*", "right"))
    assert "images has not one *" in metrocli("check", tmp_path / "rig.yaml").err


SIMULATED = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: new/observations.csv, targets: targets.csv}
noise: 0.1 px
cameras:
  left: {images: "left*.png", image_size: [1280, 960]}
  right: {images: "right*.png", image_size: [1280, 960]}
simulation:
  cameras:
    left: {lens: {f: 1100 px, k1: -0.2}}
    right: {lens: {f: 1150 px, k1: -0.15}, extrinsics: {x: 60 mm, y: -4 mm, z: 9 mm, alpha: 1 deg, beta: -7 deg, gamma: 2 deg}}
  images: 12
  distance: 400 mm
output: rig.h5
"""


def test_what_is_simulated_is_found_again(tmp_path: Path, metrocli: Metrocli) -> None:
    path = job(tmp_path, {})
    path.write_text(SIMULATED)
    assert metrocli("simulate", path, "--out", tmp_path / "new", "--seed", "4").code == 0
    assert metrocli("calibrate-camera", path).code == 0
    found, truth = estimates(tmp_path / "rig.h5"), json.loads((tmp_path / "new" / "truth.json").read_text())
    assert set(found) - set(truth) == {f"{name}.{term}" for name in LENSES for term in ("k2", "p1", "p2")}
    assert np.sqrt(np.mean([((v - truth.get(name, 0.0)) / std) ** 2 for name, (v, std) in found.items()])) < 1.5


def test_cameras_that_see_one_target_an_image_are_placed_in_the_frame_of_the_machine(
    tmp_path: Path, metrocli: Metrocli
) -> None:
    path = job(tmp_path, {})
    place = "  extrinsics: {x: 1 mm, y: 2 mm, z: -3 mm, alpha: 1 deg, beta: 2 deg, gamma: 3 deg}\n"
    text = SIMULATED.replace("  images: 12\n  distance: 400 mm\n", place).replace("rig: board", "rig: cmm")
    path.write_text(text.replace("960]}", "960], estimate: [f, k1]}"))
    rng = np.random.default_rng(2)
    points = rng.uniform([-60, -90, 350], [130, 90, 600], (40, 3)).tolist()
    listed = [f"T{i},{x},{y},{z}" for i, (x, y, z) in enumerate(points)]
    (tmp_path / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *listed]))
    assert metrocli("simulate", path, "--out", tmp_path / "new", "--seed", "4").code == 0
    assert metrocli("calibrate-camera", path).code == 0
    found, truth = estimates(tmp_path / "rig.h5"), json.loads((tmp_path / "new" / "truth.json").read_text())
    assert {"left.alpha", "right.alpha"} < set(found)
    assert np.sqrt(np.mean([((v - truth[name]) / std) ** 2 for name, (v, std) in found.items()])) < 1.5


def test_points_of_a_network_are_placed_by_all_cameras(tmp_path: Path, metrocli: Metrocli) -> None:
    """Two lists of a camera alone would be two frames: the places are known to 3 mm, and each has few images."""
    rng, images = np.random.default_rng(6), Seen()
    points = rng.uniform([-60, -80, -40], [60, 80, 40], (30, 3))
    for shot in range(6):
        turn = Rotation.from_euler("zxy", [rng.uniform(-2, 2), *rng.uniform(-0.6, 0.6, 2)])
        placed = turn.apply(points) + [*rng.uniform(0, 40, 2), rng.uniform(330, 420)]
        for name, own in (("left", placed), ("right", TURN.inv().apply(placed - SHIFT))):
            uv = cv2.projectPoints(own, np.zeros(3), np.zeros(3), square(name), np.array(LENSES[name][3:]))[0][:, 0]
            images[f"{name}{shot}.png"] = uv + rng.normal(0, 0.1, uv.shape)
    path = job(tmp_path, images)
    rough = 0.04 * (points + rng.normal(0, 3, points.shape))  # the model of another program has any scale
    listed = (f"{j},{x},{y},{z}" for j, (x, y, z) in enumerate(rough.tolist()))
    (tmp_path / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *listed]))
    for name, pairs in (("bars", [(0, 1), (2, 3), (4, 5)]), ("tests", [(6, 7), (8, 9), (10, 11), (12, 13)])):
        far = [(a, b, float(np.linalg.norm(points[a] - points[b])) + rng.normal(0, 0.004)) for a, b in pairs]
        rows = "\n".join(f"{a},{b},{length},0.004" for a, b, length in far)
        (tmp_path / f"{name}.csv").write_text(f"from,to,length_mm,sigma_mm\n{rows}\n")
    inputs = TABLES.replace("}", ", scale_bars: bars.csv, test_lengths: tests.csv}")
    path.write_text(path.read_text().replace("rig: board", "rig: network").replace(TABLES, inputs))
    ran = metrocli("calibrate-camera", path)
    assert ran.code == 0 and "times the size of the list of targets" in ran.err, ran.err
    found = estimates(tmp_path / "rig.h5")
    truth = {
        f"{name}.{key}": v for name, lens in LENSES.items() for key, v in zip(("f", "cx", "cy"), lens, strict=False)
    }
    truth |= {f"right.{key}": v for key, v in zip("xyz", SHIFT.tolist(), strict=True)}
    assert max(abs(found[name][0] - value) / found[name][1] for name, value in truth.items()) < 4
    with h5py.File(tmp_path / "rig.h5") as file:
        errors, known = file["length_errors"][:], file["points"][:]
        assert errors["en"].max() < 1.5 and errors["std"].max() < 0.02
        assert len(known) == 30 and known["rays"].min() >= 2


@pytest.mark.slow
def test_the_shape_of_one_lens_is_found_among_two(tmp_path: Path, metrocli: Metrocli) -> None:
    """A bump of 1 px in the images of the left camera; the right one is asked for its shape and has none."""
    images = seen(16)
    for name in [one for one in images if one.startswith("left")]:
        off = images[name] - [600.0, 400.0]
        images[name] = images[name] + np.exp(-(off**2).sum(axis=1) / (2 * 150**2))[:, None] * [1.0, 0.5]
    path = job(tmp_path, images, (", model: spline", ", model: spline"))
    ran = metrocli("calibrate-camera", path)
    assert ran.code == 0, ran.err
    assert "with u and v exchanged" not in ran.err  # of one reading beyond the image
    told = re.search(r"shape of the lens of left beside its base: ([0-9.]+) px", ran.out)
    assert told is not None
    assert 0.05 < float(told[1]) < 0.5  # the base takes a part of the bump
    assert "no shape of the lens of right" in ran.out
    found = estimates(tmp_path / "rig.h5")
    truth = {f"right.{key}": v for key, v in zip("xyz", SHIFT.tolist(), strict=True)} | {"right.f": LENSES["right"][0]}
    assert max(abs(found[name][0] - value) / found[name][1] for name, value in truth.items()) < 4
    with h5py.File(tmp_path / "rig.h5") as file:
        assert set(file["lens_shape"]["camera"]) == {b"left"}
    ran = metrocli("export", tmp_path / "rig.h5", "--to", "kalibr", "--out", tmp_path / "out", "--within", "2px")
    assert "left: radtan is the nearest model" in ran.err
    assert metrocli("check", path, "--set", "rig=cmm").err.count("takes the model spline of a single camera") == 1


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (", extrinsics: {x: 60 mm, y: -4 mm, z: 9 mm, alpha: 1 deg, beta: -7 deg, gamma: 2 deg}", "", "right needs"),
        ("    left: {lens", "    links: {lens", "the truth is that of left, right"),
        ("lens: {f: 1100 px,", "lens: {", "the focal length is missing"),
        ("z: 9 mm", "z: 9000 mm", "camera right: simulation: no target is inside any image"),
    ],
)
def test_a_truth_that_is_not_that_of_the_cameras_is_refused(
    old: str, new: str, words: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    path = job(tmp_path, {})
    path.write_text(SIMULATED.replace(old, new))
    ran = metrocli("simulate", path, "--out", tmp_path / "new")
    assert ran.code == 3 and words in ran.err, ran.err


@pytest.mark.alike
@pytest.mark.parametrize(
    ("lens", "told"),
    [(", cx: 460 px, estimate: [f, cy, k1, k2]", "right: the principal point is held at"), ("", "")],
)
def test_a_camera_that_contradicts_its_own_readings_is_doubtful(
    lens: str, told: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    path = job(tmp_path, seen(), ("", lens))
    path.write_text(path.read_text().replace("noise: 0.1 px", "noise: estimated"))
    ran = metrocli("calibrate-camera", path)
    assert (ran.code, told in ran.out, "DOUBTFUL" in ran.out) == (6 if told else 0, True, bool(told)), ran.out


def equidistant(points: Array) -> Array:
    angle = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
    along = points[:, :2] / np.hypot(points[:, 0], points[:, 1])[:, None]
    return np.asarray([640.0, 480.0] + 400 * (angle * (1 + 0.02 * angle**2))[:, None] * along)


def wide(fisheyes: Iterable[str]) -> Seen:
    """The image points of two cameras near the board, some of which are fisheyes."""
    rng, images = np.random.default_rng(3), Seen()
    for shot in range(9):
        turn = Rotation.from_euler("zxy", [rng.uniform(-2, 2), *rng.uniform(-0.5, 0.5, 2)])
        points = turn.apply(BOARD - BOARD.mean(axis=0)) + [*rng.uniform(-60, 60, 2), rng.uniform(90, 150)]
        for name, own in (("left", points), ("right", points - [30.0, 0, 0])):
            uv = equidistant(own) if name in fisheyes else [640.0, 480.0] + 400 * own[:, :2] / own[:, 2:]
            inside = ((uv > 0) & (uv < SIZE)).all(axis=1) | (name in fisheyes)
            images[f"{name}{shot}.png"] = np.where(inside[:, None], uv + rng.normal(0, 0.1, uv.shape), np.nan)
    return images


@pytest.fixture(params=[("left", "right"), ("right",)], ids=" and ".join)
def as_pinholes(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[tuple[str, ...], Path]:
    """The names of the cameras that are fisheyes, and a job that calibrates pinholes."""
    path = job(tmp_path, wide(request.param))
    rows = [row for row in (tmp_path / "obs.csv").read_text().splitlines() if "nan" not in row]
    (tmp_path / "obs.csv").write_text("\n".join(rows))
    return request.param, path


@pytest.mark.alike
def test_pinholes_that_are_fisheyes_are_named(as_pinholes: tuple[tuple[str, ...], Path], metrocli: Metrocli) -> None:
    fisheyes, path = as_pinholes
    ran = metrocli("calibrate-camera", path)
    assert ran.code == 6, ran.out
    for name in LENSES:
        assert (f"{name}: the lens is a fisheye" in ran.out) is (name in fisheyes), ran.out


@pytest.mark.slow
@pytest.mark.alike
def test_a_diagnosis_names_the_fisheyes_first(as_pinholes: tuple[tuple[str, ...], Path], metrocli: Metrocli) -> None:
    fisheyes, path = as_pinholes
    ran = metrocli("diagnose", path, "--quick", "--json", "--out", path.with_name("better.yaml"))
    found = json.loads(ran.out)
    assert found["verdict"] == "mistaken", ran.out
    words = f"the lens of {' and '.join(fisheyes)} is a fisheye"
    assert words in ran.out
    # the board fills the middle of these images alone, which is said of a camera as of a single one
    assert "right: readings span" in metrocli("calibrate-camera", path.with_name("better.yaml")).out
    assert metrocli("calibrate-camera", path.with_name("better.yaml"), "--set", "require.corner_std=< 1000").code == 0
    held = yaml.safe_load(path.with_name("better.yaml").read_text())["cameras"]
    assert [name for name, one in held.items() if one.get("model") == "fisheye"] == list(fisheyes)
    assert all(one["images"] == f"{name}*.png" for name, one in held.items())


def test_each_camera_is_warned_of_as_a_single_one(tmp_path: Path, metrocli: Metrocli) -> None:
    """The right camera sees the board in the middle of its images alone: its corners are not known."""
    images = seen()
    near = {name: np.abs(uv - [640, 480]).max(axis=1) < 150 for name, uv in images.items() if name.startswith("right")}
    images |= {name: np.where(chosen[:, None], images[name], np.nan) for name, chosen in near.items()}
    path = job(tmp_path, images, ("", ", estimate: [f, cx, cy, k1, k2, k3]"))
    rows = [row for row in (tmp_path / "obs.csv").read_text().splitlines() if "nan" not in row]
    (tmp_path / "obs.csv").write_text("\n".join(rows))
    ran = metrocli("calibrate-camera", path)
    assert ran.code == 6 and "DOUBTFUL: right: readings span" in ran.out, ran.out
    assert "right: the readings do not reach the corners of the image" in ran.err, ran.err
    assert "left: the readings" not in ran.err
    with h5py.File(tmp_path / "rig.h5") as file:
        assert file["statistics"].attrs["worst_camera"] == "right"
    limit = ran.out.split("require: {corner_std: ")[1].split("}")[0].strip('"')
    assert metrocli("calibrate-camera", path, "--set", f"require.corner_std={limit}").code == 0


def test_views_at_one_angle_are_named_by_camera(tmp_path: Path, metrocli: Metrocli) -> None:
    rng, images = np.random.default_rng(5), Seen()
    for shot in range(6):
        tilt = [1.5 * shot, 20 + rng.uniform(-2, 2), 0]
        own = Rotation.from_euler("zxy", tilt, degrees=True).apply(BOARD - BOARD.mean(axis=0)) + [0, 0, 350]
        for name, points in (("left", own), ("right", TURN.inv().apply(own - SHIFT))):
            uv = cv2.projectPoints(points, np.zeros(3), np.zeros(3), square(name), np.array(LENSES[name][3:]))[0][:, 0]
            images[f"{name}{shot}.png"] = uv + rng.normal(0, 0.3, uv.shape)
    lenses = [", estimate: [f]" + "".join(f", {k}: {v}" for k, v in zip(("k1", "k2", "p1", "p2"), lens[3:], strict=True))
              + f", cx: {lens[1]} px, cy: {lens[2]} px" for lens in LENSES.values()]  # fmt: skip
    ran = metrocli("calibrate-camera", job(tmp_path, images, lenses))
    assert all(f"{name}: all images show the board at one angle" in ran.err for name in LENSES), ran.err


def test_an_image_from_behind_is_named_with_its_camera(tmp_path: Path, metrocli: Metrocli) -> None:
    images = seen(8)
    images["left8.png"] = images["left3.png"] * [-1, 1] + [SIZE[0] - 1, 0]
    ran = metrocli("calibrate-camera", job(tmp_path, images))
    assert "left: image left8.png: the board is seen from the other side" in ran.err, ran.err


def test_the_scale_of_several_cameras_is_not_controlled(tmp_path: Path, metrocli: Metrocli) -> None:
    assert metrocli("calibrate-camera", job(tmp_path, seen())).code == 0
    hidden = hdf5.read(tmp_path / "rig.h5")[0].tables["not_controlled"]
    far = hdf5.read(tmp_path / "rig.h5")[0].tables["cameras"].numbers("x")[1]
    assert hidden.texts("effect")[0].startswith("pitch") and hidden.numbers("hides")[0] == pytest.approx(
        1e-3 * abs(far), rel=0.1
    )


def test_each_camera_alone_starts_where_the_joint_one_did(tmp_path: Path) -> None:
    """What is asked of each camera by itself then takes a tenth of the time of all."""
    loaded = content(load(job(tmp_path, seen())))
    system = prepared(loaded, loaded.settings.cameras or {})
    for one in system.alone.values():
        groups = [one.images, *one.others]
        assert adjust(one.blocks.values(), groups, one.datum).iterations <= 2
