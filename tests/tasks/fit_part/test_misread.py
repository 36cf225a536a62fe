"""Coordinates of exchanged columns, wrong signs or wrong units are refused or doubtful; right ones are fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.castings import Array, casting

Metrocli = Callable[..., Any]
OPEN = ("left", "front", "bottom", "bore-1", "bore-2")
"""Surfaces without an opposite one"""
MIRRORED: dict[str, Callable[[Array], Array]] = {
    "a sign": lambda points: points * [1.0, -1.0, 1.0],
    "two columns": lambda points: points[:, [2, 1, 0]],
}
UNITS: dict[str, Callable[[Array], Array]] = {
    "multiplied by 0.001 in x (mm in a column that is headed m)": lambda points: points * [1000.0, 1.0, 1.0],
    "multiplied by 1000 (m in a column that is headed mm)": lambda points: points / 1000.0,
    "multiplied by 25.4 (inches in a column that is headed mm)": lambda points: points / 25.4,
    "multiplied by 0.1 (mm in a column that is headed cm)": lambda points: points * 10.0,
}
SMALL = 0.2
"""Size of a small casting, of which the overstock is a larger share"""


def written(
    folder: Path, change: Callable[[Array], Array], surfaces: tuple[str, ...] = (), seed: int = 71, scale: float = 1.0
) -> Path:
    """A job on a casting, of some of its surfaces, whose coordinates are changed in the file."""
    made = casting(seed, scale=scale)
    kept = np.isin(made.surface, surfaces or made.surface)
    job = replace(made, points=change(made.points[kept]), surface=made.surface[kept]).write(folder, scale=scale)
    if surfaces:
        part = folder / "part.yaml"
        lines = part.read_text().splitlines()
        named = [line for line in lines if any(f"name: {name}," in line for name in surfaces)]
        part.write_text("\n".join([lines[0], *named]) + "\n")
    return job


@pytest.mark.parametrize("scale", [1.0, SMALL])
@pytest.mark.parametrize("how", MIRRORED)
def test_a_mirror_image_that_fits_far_better_is_named(
    how: str, scale: float, tmp_path: Path, metrocli: Metrocli
) -> None:
    ran = metrocli("fit-part", written(tmp_path, MIRRORED[how], scale=scale))
    assert ran.code == 3 and "the points are a mirror image of the part" in ran.err, ran.err


@pytest.mark.parametrize("how", MIRRORED)
def test_a_mirror_image_that_fits_alike_is_doubtful(how: str, tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("fit-part", written(tmp_path, MIRRORED[how], OPEN))
    assert ran.code == 6 and "a mirror image of the points fits the surfaces as well" in ran.out, ran.out


@pytest.mark.parametrize(("surfaces", "scale"), [((), SMALL), (OPEN, 1.0)], ids=["whole", "open"])
@pytest.mark.parametrize("words", UNITS)
def test_another_unit_is_named(
    words: str, surfaces: tuple[str, ...], scale: float, tmp_path: Path, metrocli: Metrocli
) -> None:
    ran = metrocli("fit-part", written(tmp_path, UNITS[words], surfaces, scale=scale))
    assert ran.code == 3 and words in ran.err, ran.err


@pytest.mark.parametrize(("minimum", "code"), [("0.1", 6), pytest.param("0.5", 4, marks=pytest.mark.slow)])
def test_a_flat_column_that_fits_alike_is_named(minimum: str, code: int, tmp_path: Path, metrocli: Metrocli) -> None:
    job = written(tmp_path, lambda points: points / [1.0, 1.0, 1000.0], OPEN, scale=SMALL)
    job.write_text(job.read_text().replace("minimum: 0.5 mm", f"minimum: {minimum} mm"))
    ran = metrocli("fit-part", job)
    assert ran.code == code and "multiplied by 1000 in z (m in a column that is headed mm)" in ran.out + ran.err


@pytest.mark.alike
@pytest.mark.parametrize("seed", range(72, 77))
def test_right_coordinates_are_not_doubted(seed: int, tmp_path: Path, metrocli: Metrocli) -> None:
    """Points near one end of each surface are far from those that the file gives of its planes."""
    ends = casting(seed)
    near = (ends.points - ends.pose[:3])[:, 0] < 900.0
    half = replace(ends, points=ends.points[near], surface=ends.surface[near])
    ran = metrocli("fit-part", half.write(tmp_path))
    assert ran.code == 0 and "mirror" not in ran.out + ran.err, ran.out + ran.err


def test_a_part_is_not_laid_on_the_wrong_side_of_one_surface(tmp_path: Path, metrocli: Metrocli) -> None:
    """Three of four surfaces fit exactly with the part beside its points, and all four nearly where it is."""
    made = casting(1065, stock=(2.5, 5.0), angle=0.5)
    kept = np.isin(made.surface, ("right", "top", "front", "back"))
    job = replace(made, points=made.points[kept], surface=made.surface[kept]).write(tmp_path)
    ran = metrocli("fit-part", job)
    assert ran.code == 0, ran.err


def test_many_points_on_one_surface_are_no_mirror_image(tmp_path: Path, metrocli: Metrocli) -> None:
    """A block without its bottom is its own mirror image, and the even pose has a level for its top."""
    made = casting(81, each=1500, rough=0.05, stock=(3.0, 3.2), scale=0.1)
    sides = np.isin(made.surface, ("left", "right", "front", "back")) & (np.arange(len(made.surface)) % 150 == 0)
    kept = sides | (made.surface == "top")
    job = replace(made, points=made.points[kept], surface=made.surface[kept]).write(tmp_path, scale=0.1)
    ran = metrocli("fit-part", job)
    assert ran.code == 0, ran.err


def test_a_column_that_grows_does_not_make_a_rough_part_fit(tmp_path: Path, metrocli: Metrocli) -> None:
    made = casting(82, each=12, rough=0.12, stock=(1.0, 1.2), scale=0.02, angle=0.0, sigma=0.01)
    kept = np.isin(made.surface, ("left", "right", "front", "back", "top"))
    job = replace(made, points=made.points[kept], surface=made.surface[kept]).write(tmp_path, scale=0.02)
    ran = metrocli("fit-part", job)
    assert ran.code == 0, ran.err


@pytest.mark.parametrize(("factor", "words"), [(25.4, "by 25.4 (inches"), (1 / 25.4, "by 0.03937 (mm in a column")])
def test_inches_of_a_block_without_bores_are_named(
    factor: float, words: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    """Planes have no size of their own: with levels of their own they fit in any unit."""
    planes = ("left", "right", "front", "back", "bottom", "top")
    ran = metrocli("fit-part", written(tmp_path, lambda points: points / factor, planes, scale=SMALL))
    assert ran.code == 3 and words in ran.err, ran.err


def test_points_that_are_all_the_same_determine_too_little(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("fit-part", written(tmp_path, np.zeros_like, ("left", "front", "bottom")))
    assert ran.code == 4 and "independent constraints of the 6 that a pose needs" in ran.err, ran.err


def test_exchanged_names_of_surfaces_are_no_other_unit(tmp_path: Path, metrocli: Metrocli) -> None:
    """The part stays on the other surfaces, so those with the wrong names contradict each other."""
    made = casting(2001, angle=1.0)
    names = {"left": "right", "right": "left"}
    job = replace(made, surface=np.array([names.get(name, name) for name in made.surface])).write(tmp_path)
    ran = metrocli("fit-part", job)
    assert ran.code == 4 and "contradict each other: left and right" in ran.err, ran.err
    assert "multiplied" not in ran.err


@pytest.mark.parametrize("axis", range(3))
def test_a_target_outside_the_part_is_named(axis: int, tmp_path: Path, metrocli: Metrocli) -> None:
    """Nothing checked the targets, which the next job takes the part from."""
    made = casting(72)
    off = made.targets.copy()
    off[2, axis] += 2500.0
    ran = metrocli("fit-part", replace(made, targets=off).write(tmp_path))
    assert ran.code == 6 and "targets lie far outside the part: T2 by" in ran.out, ran.out


@pytest.mark.parametrize("chosen", [slice(6), slice(2, 3)])
def test_a_target_on_a_fixture_beside_the_part_is_not_wrong(chosen: slice, tmp_path: Path, metrocli: Metrocli) -> None:
    """It made the fit doubtful, also where it was the only one."""
    made = casting(72)
    beside = made.targets.copy()
    beside[2] = made.points.mean(axis=0) + [1350.0, 0.0, 0.0]
    ran = metrocli("fit-part", replace(made, targets=beside[chosen]).write(tmp_path))
    assert ran.code == 0 and "outside" not in ran.out + ran.err, ran.out
