"""Mistakes of people with machines that have rotary axes: each is named with what to write, after it was tried."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hints.edits import Edit, first, put, then, times
from places import SAMPLES

Metrocli = Callable[..., Any]
FEW = first(45)
GON = 1 / 0.9
MISTAKES: dict[str, tuple[str, Edit, str]] = {
    "c in radians": ("data/after.csv", times(0.0174532925, "c_deg"), "write c_rad in the heading"),
    "c in gon": ("data/after.csv", times(GON, "c_deg"), "write c_gon in the heading"),
    "all in gon": ("data/after.csv", times(GON, "a_deg", "c_deg"), "write a_gon and c_gon in the heading"),
    "headings": ("data/after.csv", put("a_deg,c_deg", "c_deg,a_deg"), "write c for a and a for c in the headings"),
    "order": ("jobs/after.yaml", put("wCAbXYZt", "wACbXYZt"), "write chain: wCAbXYZt"),
    "tool": ("jobs/after.yaml", put("0 mm, -120 mm]}", "0 mm, 120 mm]}"), "z of T1 has the wrong sign"),
    "twice": ("data/after.csv", lambda text: text + "".join(text.splitlines(keepends=True)[1:]), "remove the copy"),
    "half a turn": ("jobs/after.yaml", put("[0 deg, 360 deg]", "[-180 deg, 180 deg]"), "or `periodic: true`"),
}
SLOW = ("c in gon", "headings", "order", "tool")


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
