"""What is wrong with the input of the image jobs is said in words, with its place; nothing is written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from tasks.shared.images import small_jobs

Metrocli = Callable[..., Any]
Edit = Callable[[Path], None]
Rows = list[list[str]]


def rows(file: str, change: Callable[[Rows], Sequence[Sequence[object]]]) -> Edit:
    """Change the rows of a CSV file below its header."""

    def edit(folder: Path) -> None:
        header, *lines = (folder / file).read_text().splitlines()
        changed = change([line.split(",") for line in lines])
        (folder / file).write_text("\n".join([header, *(",".join(map(str, row)) for row in changed)]) + "\n")

    return edit


def cells(file: str, column: int, change: Callable[[str], object]) -> Edit:
    """Change a column of a CSV file."""
    return rows(file, lambda table: [[*row[:column], change(row[column]), *row[column + 1 :]] for row in table])


def text(file: str, old: str, new: str) -> Edit:
    """Change the first occurrence of a text in a file."""

    def edit(folder: Path) -> None:
        before = (folder / file).read_text()
        assert old in before
        (folder / file).write_text(before.replace(old, new, 1))

    return edit


def column(file: str, name: str, value: object) -> Edit:
    """Add a column with one value."""

    def edit(folder: Path) -> None:
        header, *lines = (folder / file).read_text().splitlines()
        (folder / file).write_text("\n".join([f"{header},{name}", *(f"{line},{value}" for line in lines)]) + "\n")

    return edit


def both(*edits: Edit) -> Edit:
    """Make several edits."""

    def edit(folder: Path) -> None:
        for each in edits:
            each(folder)

    return edit


@dataclass(frozen=True)
class Case:
    """A job that is spoilt, and what the program has to say."""

    job: str
    code: int
    words: tuple[str, ...]
    edit: Edit | None = None
    sets: tuple[str, ...] = field(default=())


def keep(test: Callable[[list[str]], bool]) -> Edit:
    """Keep the readings that pass a test."""
    return rows("observations.csv", lambda table: [row for row in table if test(row)])


OBS = "observations.csv"
CASES = {
    # the files
    "unknown target": Case(
        "align", 3, ("observations.csv:6: error: target 'M7' is not in the list of targets", "add it to the targets file"),
        text(OBS, "M3", "M7"),
    ),
    "pose missing for an image": Case(
        "align", 3, ("poses.csv: error: there is no pose for image 'image8'", "add a row with its spindle position"),
        rows("poses.csv", lambda table: table[:-1]),
    ),
    "camera file without extrinsics": Case(
        "align", 3, ("the camera file has no extrinsics", "extrinsics: {x: -2.1 mm"),
        text("camera.yaml", "extrinsics", "# extrinsics"),
    ),
    "half of the images with too few targets": Case(
        "board", 3, ("3 of 6 images cannot be used, more than a third: view01.png, view02.png, view03.png", "view01.png has 1 targets, fewer than 4"),
        keep(lambda row: not (row[0] in ("view01.png", "view02.png", "view03.png") and row[1] != "T1")),
    ),
    "a view copied under another name": Case(
        "board", 3, ("observations.csv: error: image view01.png, copy: the readings are the same, value for value", "remove the copy"),
        rows(OBS, lambda table: table + [["copy", *row[1:]] for row in table if row[0] == "view01.png"]),
    ),
    "another image size": Case(
        "board", 3, ("readings lie outside an image of 640 x 480 px", "check image_size"),
        text("job.yaml", "[2592, 1944]", "[640, 480]"),
    ),
    "u and v exchanged, board": Case(
        "board", 3, ("readings lie outside an image of 2592 x 1944 px", "the columns"), text(OBS, "u_px,v_px", "v_px,u_px")
    ),
    "u and v exchanged, part": Case(
        "align", 3, ("readings lie outside an image", "the first: image image1, target M1 at"), text(OBS, "u_px,v_px", "v_px,u_px")
    ),
    "readings in mm": Case(
        "board", 3, ("observations.csv:1:14: error", "accepted: u_px", "accepted: v_px"), text(OBS, "u_px,v_px", "u_mm,v_mm")
    ),
    "readings without a unit": Case(
        "board", 3, ("observations.csv:1:14: error: the column 'u' has no unit",), text(OBS, "u_px,v_px", "u,v")
    ),
    "duplicate observation": Case(
        "board", 3, ("observations.csv:206:1: error: image view01.png, target T0: a second row", "first in line 2"),
        rows(OBS, lambda table: [*table, table[0]]),
    ),
    "nan": Case("board", 3, ("observations.csv:2:15: error: column 'u_px': 'nan' is not a finite number",), cells(OBS, 2, lambda cell: "nan")),
    "no row": Case("board", 3, ("observations.csv:1:1: error: there is a header and no row",), keep(lambda row: False)),
    "negative sigma of a target": Case("cmm", 3, ("targets.csv:2: error: a standard deviation is negative",), cells("targets.csv", 4, lambda cell: "-0.01")),
    "sigma_px zero": Case("board", 3, ("observations.csv:2: error: the standard deviation of an image point is not above zero",), column(OBS, "sigma_px", 0)),
    "sigma_px negative": Case("align", 3, ("observations.csv:2: error: the standard deviation of an image point is not above zero",), column(OBS, "sigma_px", -1)),
    "scale bar end unknown": Case("network", 3, ("bars.csv:2: error: scale bar end 'T44' is not in the list of targets",), text("bars.csv", "T4", "T44")),
    "scale bar end seen once": Case(
        "network", 3, ("bars.csv:2: error: scale bar end 'T7' is seen in fewer than two images",),
        both(text("bars.csv", "T4", "T7"), keep(lambda row: row[1] != "T7" or row[0] == "view01.png")),
    ),
    "scale bar without uncertainty": Case("network", 3, ("bars.csv:2: error: the sigma of the scale bar is not above zero",), text("bars.csv", "0.005", "0")),
    "scale bars on a board": Case("board", 3, ("job.yaml:4:76: error: scale bars belong to rig: network",), text("job.yaml", "targets.csv}", "targets.csv, scale_bars: targets.csv}")),
    # the settings
    "noise zero": Case("board", 3, ("noise: 0 px is not above zero",), sets=("noise=0 px",)),
    "noise without a unit": Case("board", 3, ("noise", "0.1 px"), sets=("noise=0.1",)),
    "f with fx": Case("board", 3, ("f is one focal length for both axes: name either f, or fx and fy",), sets=("camera.estimate=[f,fx,fy]",)),
    "fx without fy": Case("board", 3, ("fx and fy come together",), sets=("camera.estimate=[fx,cx]",)),
    "aspect with fx": Case("board", 3, ("aspect goes with f",), sets=("camera.estimate=[fx,fy,aspect]",)),
    "unknown parameter": Case("board", 3, ("camera.estimate[2]: unknown word 'skwe'", "did you mean 'skew'?"), sets=("camera.estimate=[f,skwe]",)),
    "parameter twice": Case("board", 3, ("camera.estimate",), sets=("camera.estimate=[f,f]",)),
    "angle alone": Case("align", 3, ("part-pose is missing",), sets=("estimate=[clamping-angle]",)),
    # what cannot be determined
    "fewer targets than a view needs": Case("board", 4, ("no image shows 4 or more targets of the list",), keep(lambda row: row[1] in ("T0", "T1", "T2"))),
    "one row": Case("board", 4, ("no image shows 4 or more targets",), rows(OBS, lambda table: table[:1])),
    "one row, network": Case("network", 4, ("no image shows 4 or more targets",), rows(OBS, lambda table: table[:1])),
    "one row, cmm": Case("cmm", 4, ("1 readings in all: the pose of a camera needs at least 4",), rows(OBS, lambda table: table[:1])),
    "one row, part": Case("align", 4, ("there are fewer readings than unknowns: 2 readings, 7 unknowns",), rows(OBS, lambda table: table[:1])),
    "one view": Case(
        "board", 4, ("undetermined: f, z of view", "what would determine it: more images"),
        keep(lambda row: row[0] == "view01.png"), ("camera.estimate=[f,cx,cy]",),
    ),
    "all views parallel": Case(
        "parallel", 4, ("undetermined: z of all images, fy, fx", "why: all views are parallel to the board", "views tilted by 20 to 45 degrees"),
        sets=("camera.estimate=[fx,fy,cx,cy]",),
    ),
    "all views parallel, with distortion": Case(
        "parallel", 4, ("z of all images", "why: all views are parallel to the board"), sets=("camera.estimate=[f,k1]",)
    ),
    "all targets in one plane": Case(
        "plane", 4, ("undetermined: z of camera, f", "why: all targets lie in one plane", "targets at several distances"), sets=("camera.estimate=[f]",)
    ),
    "all targets in one plane, with distortion": Case("plane", 4, ("z of camera, f", "why: all targets lie in one plane")),
    "one position of the spindle": Case(
        "position", 4, ("undetermined: ", "gamma_s", "rz of the part", "why: the clamping angle and the part's rotation change the images in the same way", "images from several positions of the spindle"),
    ),
    "one target": Case("align", 4, ("why: 1 targets in 2 images", "three or more targets not on a line"), keep(lambda row: row[1] == "M1")),
    "two targets": Case("align", 4, ("undetermined: r", "why: 2 targets in 4 images"), keep(lambda row: row[1] in ("M1", "M2"))),
    "targets at one place, board": Case("board", 4, ("all 35 targets that are seen lie on one line or at one place",), rows("targets.csv", lambda table: [[row[0], 1, 1, 0] for row in table])),
    "targets at one place, cmm": Case("cmm", 4, ("lie on one line or at one place",), rows("targets.csv", lambda table: [[row[0], 1, 1, 500, 0.01] for row in table])),
    "targets at one place, network": Case("network", 4, ("lie on one line or at one place",), rows("targets.csv", lambda table: [[row[0], 1, 1, 0, ""] for row in table])),
    "targets at one place, part": Case("align", 4, ("of the part", "three or more targets not on a line"), rows("targets.csv", lambda table: [[row[0], 1, 1, 0, 0] for row in table])),
    "targets on a line": Case("board", 4, ("lie on one line",), cells("targets.csv", 2, lambda cell: 0)),
    # hostile
    "one reading far outside, board": Case("board", 3, ("1 of", "one of them far: image"), rows(OBS, lambda table: [[*table[0][:2], 28000, table[0][3]], *table[1:]])),
    "one reading far outside, part": Case("align", 3, ("1 of 8 readings", "one of them far: image"), rows(OBS, lambda table: [[*table[0][:2], table[0][2], -4000], *table[1:]])),
    "huge readings": Case("align", 3, ("8 of 8 readings lie outside an image",), cells(OBS, 2, lambda cell: 1e6)),
    "an overflow for a coordinate": Case("align", 3, ("column 'x_mm': 1e+200 is beyond what it can hold", "is it an overload marker"), cells("targets.csv", 1, lambda cell: 1e200)),
    "all readings alike": Case("board", 5, ("check that image points and targets belong together",), rows(OBS, lambda table: [[*row[:2], 1000, 1000] for row in table])),
    "targets in another order": Case(
        "board", 5, ("check that image points and targets belong together",),
        rows(OBS, lambda table: [[*a[:2], *b[2:]] for a, b in zip(table, table[::-1], strict=True)]),
    ),
}  # fmt: skip


LONG = (
    "all views parallel",
    "all views parallel, with distortion",
    "all targets in one plane",
    "targets at one place, part",
    "all readings alike",
    "targets in another order",
)


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in CASES])
def test_what_is_wrong_is_said_and_nothing_is_written(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Metrocli
) -> None:
    case = CASES[name]
    small_jobs.JOBS[case.job](tmp_path)
    if case.edit is not None:
        case.edit(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    kind = "align-part" if case.job in ("align", "position") else "calibrate-camera"
    ran = metrocli(kind, "job.yaml", *(part for value in case.sets for part in ("--set", value)))
    assert ran.code == case.code, ran.err
    assert all(words in ran.err for words in case.words), ran.err
    assert "Traceback" not in ran.err
    assert sorted(tmp_path.iterdir()) == before
    assert ran.out == ""


@pytest.mark.parametrize("job", [name for name in small_jobs.JOBS if name not in ("parallel", "plane", "position")])
def test_the_jobs_have_no_fault_before_they_are_spoilt(
    job: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Metrocli
) -> None:
    small_jobs.JOBS[job](tmp_path)
    monkeypatch.chdir(tmp_path)
    ran = metrocli("align-part" if job == "align" else "calibrate-camera", "job.yaml")
    assert ran.code == 0, ran.err


WARNED = {
    "a target in the list that no image shows": (
        "board", rows("targets.csv", lambda table: [*table, ["X9", 900, 900, 0]]), "1 target of the list seen in no image: X9",
    ),
    "an image with too few targets": (
        "board", keep(lambda row: row[0] != "view06.png" or row[1] in ("T0", "T1", "T2")), "image view06.png has 3 targets, fewer than 4: left out",
    ),
    "a target that one image shows": (
        "network", keep(lambda row: row[1] != "T7" or row[0] == "view01.png"), "left out: 1 target is seen in one image only, which places none: T7",
    ),
    "poses without a sighting": ("align", keep(lambda row: row[0] != "image8"), "1 pose has no sighting: image8"),
    "a camera without covariance": ("align", None, "the camera is taken as exact: its file contains no covariance"),
    "noise declared too small": ("cmm", text("job.yaml", "noise: 0.05 px", "noise: 0.01 px"), "the residuals are larger than the declared noise;"),
}  # fmt: skip


@pytest.mark.parametrize("name", WARNED)
def test_what_is_odd_is_warned_of(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Metrocli
) -> None:
    job, edit, words = WARNED[name]
    small_jobs.JOBS[job](tmp_path)
    if edit is not None:
        edit(tmp_path)
    monkeypatch.chdir(tmp_path)
    ran = metrocli("align-part" if job == "align" else "calibrate-camera", "job.yaml")
    assert ran.code == 0, ran.err
    assert words in ran.err


def test_an_outlier_is_named_and_can_be_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Metrocli
) -> None:
    from metrocli.formats import hdf5

    small_jobs.board(tmp_path)
    monkeypatch.chdir(tmp_path)
    spoil = rows(OBS, lambda table: [[*row[:2], float(row[2]) + 5 * (i == 40), row[3]] for i, row in enumerate(table)])
    spoil(tmp_path)
    image, target = (tmp_path / OBS).read_text().splitlines()[41].split(",")[:2]
    ran = metrocli("calibrate-camera", "job.yaml")
    assert f"{image}/{target} (w = " in ran.err
    assert metrocli("calibrate-camera", "job.yaml", "--force", "--set", "outliers=remove").code == 0
    rejected = hdf5.read(tmp_path / "camera.h5")[0].tables["rejected"]
    assert (rejected.texts("image"), rejected.texts("target")) == ([image], [target])


def test_positions_close_together_are_warned_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Metrocli
) -> None:
    small_jobs.one_position(tmp_path, 2, 5.0)
    monkeypatch.chdir(tmp_path)
    ran = metrocli("align-part", "job.yaml")
    assert ran.code == 0, ran.err
    assert "gamma_s and the part's gamma are correlated" in ran.err
    assert "take images from positions further apart" in ran.err


def test_the_camera_of_a_board_has_no_place_in_the_taper(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Metrocli
) -> None:
    (tmp_path / "board").mkdir()
    assert metrocli("calibrate-camera", small_jobs.board(tmp_path / "board")).code == 0
    small_jobs.align(tmp_path)
    ran = metrocli("align-part", tmp_path / "job.yaml", "--set", "inputs.camera=board/camera.h5")
    assert ran.code == 3
    assert "the camera was calibrated with rig board; only rig cmm determines its place in the taper" in ran.err
    assert not (tmp_path / "part.h5").exists()


def test_a_camera_with_known_parameters_only_poses_the_board(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Metrocli
) -> None:
    job = small_jobs.board(tmp_path)
    known = "f: 2813.2 px, cx: 1286.8 px, cy: 999 px, k1: 0.2372, k2: -0.1213, p1: -1.7e-4, p2: 9.6e-4"
    job.write_text(job.read_text().replace("estimate: [f, cx, cy, k1, k2, p1, p2]", f"estimate: [], {known}"))
    ran = metrocli("calibrate-camera", job, "--json")
    assert ran.code == 0, ran.err
    assert '"estimates": {}' in ran.out


@pytest.mark.parametrize(
    ("job", "far"), [pytest.param("board", 1e6, marks=pytest.mark.slow), ("cmm", 1e6), ("align", 9e6)]
)
def test_huge_coordinates_end_in_words(
    job: str, far: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Metrocli
) -> None:
    small_jobs.JOBS[job](tmp_path)
    cells("targets.csv", 1, lambda cell: float(cell) + far)(tmp_path)
    monkeypatch.chdir(tmp_path)
    ran = metrocli("align-part" if job == "align" else "calibrate-camera", "job.yaml")
    assert ran.code in (0, 4, 5), ran.err
    assert "Traceback" not in ran.err
    assert (ran.code == 0) == any(tmp_path.glob("*.h5"))


def test_less_noise_than_declared_is_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Metrocli
) -> None:
    small_jobs.board(tmp_path)
    monkeypatch.chdir(tmp_path)
    ran = metrocli("calibrate-camera", "job.yaml", "--set", "noise=0.5 px")
    assert ran.code == 0
    assert "the residuals are smaller than the declared noise;" in ran.out
    assert "sigma0" not in ran.err
