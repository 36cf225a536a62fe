"""Lists of targets that are wrong as a whole: one scatter of all targets, or a stretch, instead of many moved targets."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

COLUMNS, ROWS, PITCH, VIEWS = 7, 5, 40.0, 8
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: obs.csv, targets: targets.csv}
camera: {image_size: [2592, 1944], pixel_size: 2.2 um, estimate: [f, cx, cy, k1, k2]}
noise: 0.03 px
output: r.h5
"""
Metrocli = Callable[..., Any]


def listed() -> np.ndarray:
    x, y = np.meshgrid(np.arange(COLUMNS) * PITCH, np.arange(ROWS) * PITCH)
    return np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)


def turned(angles: np.ndarray) -> np.ndarray:
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    about_x, about_y = [[1, 0, 0], [0, cx, -sx], [0, sx, cx]], [[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]
    return np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]]) @ about_y @ about_x


@pytest.fixture
def measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[np.ndarray, int], Path]:
    """Write the images of a board at these true places, by a pinhole with k1, as the files of a job."""
    monkeypatch.chdir(tmp_path)

    def write(true: np.ndarray, seed: int) -> Path:
        rng = np.random.default_rng([31, seed])
        lines = ["image,target,u_px,v_px"]
        for view in range(VIEWS):
            turn = turned(np.append(rng.normal(0, 0.35, 2), rng.uniform(0, 6)))
            moved = (true - [120.0, 80.0, 0.0]) @ turn.T + [*rng.uniform(-25, 25, 2), rng.uniform(450, 700)]
            x = moved[:, :2] / moved[:, 2:]
            r2 = (x**2).sum(axis=1, keepdims=True)
            pixels = 2500.0 * x * (1 - 0.1 * r2) + [1296.0, 972.0] + rng.normal(0, 0.03, x.shape)
            lines += [f"i{view},T{at},{u!r},{v!r}" for at, (u, v) in enumerate(pixels.tolist())]
        Path("obs.csv").write_text("\n".join(lines) + "\n")
        rows = [f"T{at},{x!r},{y!r},{z!r}" for at, (x, y, z) in enumerate(listed().tolist())]
        Path("targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *rows]) + "\n")
        Path("job.yaml").write_text(JOB)
        return Path("job.yaml")

    return write


@pytest.mark.slow
def test_a_list_that_is_uncertain_throughout_is_one_finding(
    measured: Callable[[np.ndarray, int], Path], metrocli: Metrocli
) -> None:
    true = listed() + np.random.default_rng(32).normal(0, 0.1, listed().shape)
    job = measured(true, 1)
    ran = metrocli("diagnose", job, "--json")
    data = json.loads(ran.out)
    (effect,) = data["effects"]
    assert (data["verdict"], effect["name"], effect["where"]) == ("explained", "moved-target", {})
    std = effect["parameters"]["std"]
    assert std["unit"] == "mm" and abs(std["value"] - 0.1) < 3 * std["std"] < 0.04
    assert effect["gain"]["shown"]
    text = Path("job.extended.yaml").read_text()
    assert "name: moved-target" in text and f"std: {1e3 * std['value']:.3g} um" in text and "target:" not in text
    assert metrocli("calibrate-camera", "job.extended.yaml").code == 0
    with h5py.File("r.extended.h5") as result:
        table = result["effects/moved-target/parameters"][:]
    found = {(str(place, "utf8"), str(name, "utf8")): (value, u) for place, name, value, u, *_ in table.tolist()}
    assert len(found) == 3 * COLUMNS * ROWS
    # the poses take up a common motion of all targets, and the focal length their size: distances of near ones stay
    moved = np.array([[found[f"T{at}", axis][0] for axis in ("dx", "dy")] for at in range(len(true))])
    rest, wanted = moved - affine(moved), (true - listed())[:, :2] - affine((true - listed())[:, :2])
    assert np.sqrt(((rest - wanted) ** 2).mean()) < 0.02 < 0.05 < np.sqrt((wanted**2).mean())
    again = json.loads(metrocli("diagnose", "job.extended.yaml", "--json").out)
    assert (again["verdict"], again["effects"]) == ("clean", [])


def test_the_extended_job_has_the_noise_beside_which_the_size_was_found(
    measured: Callable[[np.ndarray, int], Path], metrocli: Metrocli
) -> None:
    """With the declared noise, six times as large, a list of a stated size would weigh six times as much."""
    job = measured(listed() + np.random.default_rng(32).normal(0, 0.1, listed().shape), 1)
    job.write_text(JOB.replace("0.03 px", "0.2 px"))
    report = metrocli("diagnose", job).out
    assert "the job extended by the named effects and with `noise: estimated`, and diagnose it again" in report
    assert "noise: estimated" in Path("job.extended.yaml").read_text()
    again = json.loads(metrocli("diagnose", "job.extended.yaml", "--json").out)
    assert (again["verdict"], again["effects"]) == ("clean", [])


def test_the_first_answer_is_one_finding_too(measured: Callable[[np.ndarray, int], Path], metrocli: Metrocli) -> None:
    """It had named nearly every target, and each reading of the noisier image as a wrong one."""
    job = measured(listed() + np.random.default_rng(33).normal(0, 0.1, listed().shape), 4)
    rng, lines = np.random.default_rng(34), Path("obs.csv").read_text().splitlines()
    for at, (image, target, *uv) in enumerate(line.split(",") for line in lines):
        if image == "i3":
            lines[at] = ",".join([image, target, *(str(float(one) + rng.normal(0, 1.0)) for one in uv)])
    Path("obs.csv").write_text("\n".join(lines) + "\n")
    data = json.loads(metrocli("diagnose", job, "--quick", "--json").out)
    assert [(one["name"], one["where"]) for one in data["effects"]] == [("moved-target", {})]
    assert not data["outliers"] and [one["image"] for one in data["noise"]["apart"]] == ["i3"]
    assert "not-decided, but image i3 is" in metrocli("diagnose", job, "--quick").out


def affine(moved: np.ndarray) -> np.ndarray:
    """The affine part of moves of the listed targets."""
    columns = np.column_stack([np.ones(len(moved)), listed()[:, :2]])
    return np.asarray(columns @ np.linalg.lstsq(columns, moved, rcond=None)[0])


@pytest.mark.parametrize("places", [(17,), pytest.param((8, 29), marks=pytest.mark.slow)])
def test_few_moved_targets_are_named_one_by_one(
    measured: Callable[[np.ndarray, int], Path], metrocli: Metrocli, places: tuple[int, ...]
) -> None:
    true = listed()
    for at in places:
        true[at] += [0.3, -0.25, 0.0]
    data = json.loads(metrocli("diagnose", measured(true, 2), "--json").out)
    assert sorted(tuple(one["where"].values()) for one in data["effects"]) == sorted((f"T{at}",) for at in places)


@pytest.mark.slow
def test_a_list_stretched_in_x_is_named_and_its_change_is_that_of_the_adjustment(
    measured: Callable[[np.ndarray, int], Path], metrocli: Metrocli
) -> None:
    job = measured(listed() * [1.001, 1.0, 1.0], 3)
    (effect,) = json.loads(metrocli("diagnose", job, "--json").out)["effects"]
    assert effect["name"] == "stretched-targets"
    stretch = effect["parameters"]["stretch"]
    assert abs(stretch["value"] - 1e-3) < 4 * stretch["std"] < 1e-3
    assert metrocli("calibrate-camera", job).code == 6  # doubtful, and written all the same
    assert metrocli("calibrate-camera", "job.extended.yaml").code == 0
    lens = []
    for name in ("r.h5", "r.extended.h5"):
        with h5py.File(name) as result:
            table = result["parameters"][:]
            lens.append({str(row[0], "utf8"): float(row[1]) for row in table.tolist()})
    change = np.linalg.norm([lens[1][key] - lens[0][key] for key in ("f", "cx", "cy")])
    assert np.isclose(effect["gain"]["result_shift"]["value"], change, rtol=1e-3)


@pytest.mark.parametrize(
    ("entry", "fault"),
    [
        ("{name: moved-target, std: 0.1 mm, target: T1}", "'target' beside 'std'"),
        ("{name: moved-target, std: 0 mm}", "std is not above zero"),
        ("{name: moved-target, std: 0.1}", "has no unit"),
        ("{name: aspect-ratio, std: 0.1}", "unknown key 'std'"),
    ],
)
def test_faults_of_effects_at_all_places(
    measured: Callable[[np.ndarray, int], Path], metrocli: Metrocli, entry: str, fault: str
) -> None:
    job = measured(listed(), 4)
    job.write_text(JOB + f"effects: [{entry}]\n")
    ran = metrocli("calibrate-camera", job)
    assert (ran.code, fault in ran.err) == (3, True), ran.err
