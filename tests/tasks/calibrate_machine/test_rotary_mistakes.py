"""Mistakes of people with machines that have rotary axes: each is named with what to write, after it was tried."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hints.edits import Edit, cells, exchanged, first, put, then, times
from places import SAMPLES
from simulated import five_axis as sim

from metrocli.project.job import load
from metrocli.project.runner import content
from metrocli.tasks.calibrate_machine.other_settings import other_settings

Metrocli = Callable[..., Any]
FEW = first(45)
GON = 1 / 0.9
MISTAKES: dict[str, tuple[str, Edit, str]] = {
    "c in radians": ("data/after.csv", times(0.0174532925, "c_deg"), "write c_rad in the heading"),
    "c in gon": ("data/after.csv", times(GON, "c_deg"), "write c_gon in the heading"),
    "all in gon": ("data/after.csv", times(GON, "a_deg", "c_deg"), "write a_gon and c_gon in the heading"),
    "headings": ("data/after.csv", put("a_deg,c_deg", "c_deg,a_deg"), "write c for a and a for c in the headings"),
    "sign": ("data/after.csv", times(-1, "a_deg"), "write a_deg with the other sign"),
    "order": ("jobs/after.yaml", put("wCAbXYZt", "wACbXYZt"), "write chain: wCAbXYZt"),
    "tool": ("jobs/after.yaml", put("0 mm, -120 mm]}", "0 mm, 120 mm]}"), "z of T1 has the wrong sign"),
    "twice": ("data/after.csv", lambda text: text + "".join(text.splitlines(keepends=True)[1:]), "remove the copy"),
    "from 0 to 360": (
        "data/after.csv",
        put("-32.546", "327.454"),
        "write -32.546 deg, the same place, or give a a wider",
    ),
    "half a turn": ("jobs/after.yaml", put("[0 deg, 360 deg]", "[-180 deg, 180 deg]"), "or `periodic: true`"),
}
SLOW = ("c in radians", "c in gon", "headings", "sign", "order", "tool")


@pytest.mark.parametrize("name", [pytest.param(one, marks=pytest.mark.slow if one in SLOW else ()) for one in MISTAKES])
def test_a_mistake_is_named(name: str, tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(SAMPLES / "five-axis", tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    file, edit, message = MISTAKES[name]
    data = Path("data/after.csv")
    data.write_text(FEW(data.read_text()))
    assert metrocli("calibrate-machine", "jobs/after.yaml", "--output", "right.h5").code == 0
    Path(file).write_text(then(edit)(Path(file).read_text()))
    ran = metrocli("calibrate-machine", "jobs/after.yaml", "--output", "wrong.h5")
    assert ran.code == 3 and message in ran.err, ran.err
    assert not Path("wrong.h5").exists()


OF_A_BALL = {"has the wrong sign": -1.0, "is in rad": 0.0174532925}


@pytest.mark.parametrize("words", OF_A_BALL)
def test_the_ball_whose_angles_are_wrong_is_named(words: str, tmp_path: Path, metrocli: Metrocli) -> None:
    """It had passed for a ball that is 1e5 times as noisy as the others."""
    shutil.copytree(SAMPLES / "five-axis", tmp_path, dirs_exist_ok=True)
    data, rows = tmp_path / "data" / "after.csv", []
    for line in FEW(data.read_text()).splitlines():
        cells = line.split(",")
        if cells[0] == "K1":
            cells[5] = f"{float(cells[5]) * OF_A_BALL[words]:.9f}"
        rows.append(",".join(cells))
    data.write_text("\n".join(rows) + "\n")
    ran = metrocli("diagnose", tmp_path / "jobs" / "after.yaml", "--quick")
    assert f"c_deg of ball K1 {words}" in ran.out, ran.out + ran.err


def test_the_sign_of_an_axis_is_tried_where_another_one_stands_still(tmp_path: Path) -> None:
    """The first axis decided for all of them, and the turning one of such a ball was passed over."""
    shutil.copytree(SAMPLES / "five-axis", tmp_path, dirs_exist_ok=True)
    data, rows = tmp_path / "data" / "after.csv", []
    for line in FEW(data.read_text()).splitlines():
        cells = line.split(",")
        cells[4] = "0" if cells[0] == "K1" else cells[4]
        rows.append(",".join(cells))
    data.write_text("\n".join(rows) + "\n")
    tried = [wrong.words for wrong, _ in other_settings(content(load(tmp_path / "jobs" / "after.yaml")), False)]
    assert "c_deg of ball K1 has the wrong sign" in tried and "a_deg of ball K1 has the wrong sign" not in tried


def polar(text: str) -> str:
    """Give the points of a tracker as distance, azimuth and elevation."""
    head, *rows = [line.split(",") for line in text.splitlines()]
    at = head.index("mx_mm")
    read = np.array([row[at : at + 3] for row in rows], dtype=float)
    far = np.linalg.norm(read, axis=1)
    angles = np.degrees([np.arctan2(read[:, 1], read[:, 0]), np.arcsin(read[:, 2] / far)])
    seen = [f"{d:.9f},{azimuth:.12f},{elevation:.12f}" for d, azimuth, elevation in zip(far, *angles, strict=True)]
    lines = [",".join([*row[:at], one, *row[at + 3 :]]) for row, one in zip(rows, seen, strict=True)]
    names = ",".join([*head[:at], "distance_mm", "azimuth_deg", "elevation_deg", *head[at + 3 :]])
    return "\n".join([names, *lines, ""])


ANGLES = ("azimuth_deg", "elevation_deg")
OF_TRACKERS: dict[str, tuple[Edit, str]] = {
    "radians": (times(0.0174532925199, *ANGLES), "write azimuth_rad and elevation_rad in the heading"),
    "gon": (times(GON, *ANGLES), "write azimuth_gon and elevation_gon in the heading"),
    "zenith": (cells("elevation_deg", lambda cell: 90 - float(cell)), "elevation_deg has zenith distances"),
    "tools": (exchanged("tool", "T1", "T2"), "the tools T1 and T2 are under each other's names"),
    "both": (
        lambda text: text.replace("t_s", "t_s,mx_mm").replace(".0\n", ".0,1\n"),
        "keep mx, my and mz, or distance",
    ),
}


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.slow if one != "both" else ()) for one in OF_TRACKERS]
)
def test_a_mistake_in_polar_readings_is_named(name: str, tmp_path: Path, metrocli: Metrocli) -> None:
    rng = np.random.default_rng(77)
    machine = sim.drawn(sim.KINDS["head-table"], rng, linear=False)
    job = sim.tracked(tmp_path, machine, rng, 90, (2e-3, 5e-3, 0.0), "bed", workpiece=3)
    job.write_text(job.read_text().replace("estimate: all", "estimate: locations"))
    points = tmp_path / "points.csv"
    points.write_text(polar(points.read_text()))
    right = metrocli("calibrate-machine", job, "--output", tmp_path / "right.h5")
    assert right.code == 6 or right.code == 0, right.err
    edit, message = OF_TRACKERS[name]
    points.write_text(edit(points.read_text()))
    ran = metrocli("calibrate-machine", job, "--output", tmp_path / "wrong.h5")
    assert ran.code == 3 and message in ran.err, ran.err
    assert not (tmp_path / "wrong.h5").exists()


def test_a_stuck_angle_puts_no_axis_elsewhere(tmp_path: Path, metrocli: Metrocli) -> None:
    """A readout that stays at one angle had the result doubt the sign of the place of the other axis."""
    shutil.copytree(SAMPLES / "five-axis", tmp_path, dirs_exist_ok=True)
    data = tmp_path / "data" / "after.csv"
    lines = data.read_text().splitlines()
    column = lines[0].split(",").index("c_deg")
    rows = [line.split(",") for line in lines]
    for row in rows[62:]:
        row[column] = "120.000"
    data.write_text("\n".join(map(",".join, rows)) + "\n")
    ran = metrocli("calibrate-machine", tmp_path / "jobs" / "after.yaml")
    assert ran.code == 6 and "sigma0 = " in ran.out
    assert "wrong sign" not in ran.out and "is `at` right?" not in ran.out + ran.err
