"""Parts whose optimum is not unique: what is open, and what is left to even overstock, is said."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tasks.fit_part.test_fit import Metrocli, fitted

from metrocli.tasks.fit_part.fit import MOST
from metrocli.tasks.fit_part.sentences import exchanged

SIDE, LEVEL = 100.0, 2.0
FACES = {f"{axis}{end}": (k, end) for k, axis in enumerate("xyz") for end in (0, 1)}


def job_of(folder: Path, faces: list[str], aim: str, *lines: str, tall: float = LEVEL) -> Path:
    """A cube with four points over each of some faces, at one level; over the faces across x and y at `tall`."""
    surfaces, points = ["surfaces:"], ["point,x_mm,y_mm,z_mm,surface,sigma_mm"]
    for name in faces:
        k, end = FACES[name]
        normal = (2 * end - 1) * np.eye(3)[k]
        at = SIDE / 2 * (1 + normal)
        place = ", ".join(f"{value:g} mm" for value in at)
        surfaces.append(f"- {{name: {name}, type: plane, point: [{place}], normal: {normal.tolist()}}}")
        for n, (u, v) in enumerate(product((-30.0, 30.0), repeat=2)):
            x, y, z = at + (LEVEL if k == 2 else tall) * normal + np.roll([0.0, u, v], k)
            points.append(f"{name}-{n},{x},{y},{z},{name},0.02")
    (folder / "part.yaml").write_text("\n".join(surfaces) + "\n")
    (folder / "points.csv").write_text("\n".join(points) + "\n")
    head = ("metrocli: 1", "job: fit-part", "inputs: {points: points.csv, nominal: part.yaml}")
    more = (f"overstock: {{minimum: 0.5 mm, aim: {aim}}}", "output: part.h5", *lines, "")
    (folder / "job.yaml").write_text("\n".join([*head, *more]))
    return folder / "job.yaml"


@pytest.mark.slow
def test_points_that_are_equally_low_are_counted(tmp_path: Path, metrocli: Metrocli) -> None:
    found = fitted(job_of(tmp_path, list(FACES), "most"), metrocli)
    held = int(found.statistics["active"])
    assert any(f"{24 - held} more are as low and can hold it as well" in note for note in found.notes)
    assert any("`monte_carlo` fits each anew" in note for note in found.notes)
    assert found.statistics["least_overstock"] == pytest.approx(LEVEL, abs=1e-7)


def test_a_point_that_is_as_low_by_chance_takes_no_share() -> None:
    """Four points of a floor against one of a ceiling have one choice too many; a wall stands for none of them."""
    floor = [np.array([0, 0, 1.0, v, -u, 0]) for u, v in product((-1.0, 1.0), repeat=2)]
    rows = np.array([*floor, [0, 0, -1.0, 0, 0, 0], [1.0, 0, 0, 0, 0, 0]])
    solved: Any = SimpleNamespace(fit=SimpleNamespace(local=SimpleNamespace(rows=rows)), aim=SimpleNamespace(name=MOST))
    assert exchanged(solved, np.ones(6, dtype=bool)).tolist() == [True] * 4 + [False] * 2


@pytest.mark.slow
def test_what_the_thickness_leaves_free_is_made_even(tmp_path: Path, metrocli: Metrocli) -> None:
    """Only bottom and top limit the overstock: shifts across them, and a turn in their plane, are free."""
    found = fitted(job_of(tmp_path, list(FACES), "most", tall=3.0), metrocli)
    (note,) = [note for note in found.notes if note.startswith("motions that no point")]
    for motion in ("a turn about the direction z", "a shift along x", "a shift along y"):
        assert motion in note
    assert "along z" not in note
    pose = np.array([one.value for one in found.estimates])
    assert np.abs(pose[:3]).max() < 1e-4 and np.abs(pose[3:]).max() < 1e-6


def test_a_plate_is_refused_or_stays_where_it_is(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("fit-part", job_of(tmp_path, ["z0", "z1"], "most"))
    assert ran.code == 4 and "3 independent constraints of the 6" in ran.err and "-0" not in ran.err
    found = fitted(job_of(tmp_path, ["z0", "z1"], "least-motion", "monte_carlo: {trials: 20, seed: 1}"), metrocli)
    assert all(one.value == 0.0 and one.std == 0.0 for one in found.estimates)
    assert any(note.startswith("Monte Carlo") and "agree with" in note for note in found.notes)


def test_the_open_turns_of_a_ball_are_named_along_axes(tmp_path: Path, metrocli: Metrocli) -> None:
    job = job_of(tmp_path, [], "most")
    (tmp_path / "part.yaml").write_text(
        "surfaces:\n- {name: ball, type: sphere, point: [0 mm, 0 mm, 0 mm], radius: 20 mm, material: inside}\n"
    )
    rows = [f"P{n},{x},{y},{z},ball,0.02" for n, (x, y, z) in enumerate(22 * np.concatenate([np.eye(3), -np.eye(3)]))]
    (tmp_path / "points.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm,surface,sigma_mm", *rows, ""]))
    ran = metrocli("fit-part", job)
    assert ran.code == 4
    for axis in "xyz":
        assert f"a turn about the direction {axis} through (0, 0, 0) mm" in ran.err
