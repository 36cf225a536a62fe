"""Wrong inputs of fit-part: each is refused with its place, what was found and what to do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry.test_triangles import SIZE, block
from simulated.castings import casting

from metrocli.formats import hdf5
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.fit_part.readings import read
from metrocli.tasks.fit_part.settings import Inputs, Overstock, Settings

Metrocli = Callable[..., Any]


def changed(path: Path, before: str, after: str) -> None:
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after, 1))


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (",left\n", ",lefft\n", "did you mean 'left'?"),
        ("P3,", ",", "point"),
        ("0.03,left", ",left", "has no standard deviation"),
        ("0.03,left", "-0.03,left", "a standard deviation is negative"),
    ],
)
def test_points(before: str, after: str, message: str, tmp_path: Path, metrocli: Metrocli) -> None:
    job = casting(1).write(tmp_path)
    changed(tmp_path / "points.csv", before, after)
    for command in (("fit-part", job), ("check", job)):
        ran = metrocli(*command)
        assert ran.code == 3 and message in ran.err and "points.csv:" in ran.err


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("radius: 60.0 mm, ", "", "a cylinder also needs radius"),
        ("type: plane, ", "type: plane, radius: 3 mm, ", "a plane has no radius"),
        ("normal: [-1.0, 0.0, 0.0]", "normal: [0, 0, 0]", "cannot be [0, 0, 0]"),
        ("name: left", "name: right", "two surfaces have the name 'right'"),
        ("type: plane", "type: plain", "did you mean 'plane'?"),
    ],
)
def test_nominals(before: str, after: str, message: str, tmp_path: Path, metrocli: Metrocli) -> None:
    job = casting(1).write(tmp_path)
    changed(tmp_path / "part.yaml", before, after)
    ran = metrocli("check", job)
    assert ran.code == 3 and message in ran.err and "part.yaml:" in ran.err


def test_the_unit_of_a_mesh_is_none_of_surfaces(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("check", casting(1).write(tmp_path), "--set", "nominal_unit=cm")
    assert ran.code == 3 and "nominal_unit: this is of a mesh" in ran.err


@pytest.mark.parametrize(
    ("before", "after", "name"),
    [
        ("normal: [0.0, 0.0, 1.0]", "normal: [0.0, 0.0, -1.0]", "top"),
        pytest.param("material: inside", "material: outside", "boss", marks=pytest.mark.slow),
    ],
)
def test_a_surface_with_the_material_on_the_wrong_side(
    before: str, after: str, name: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    job = casting(2).write(tmp_path)
    changed(tmp_path / "part.yaml", before, after)
    ran = metrocli("fit-part", job)
    assert ran.code in (3, 4) and f"the points of {name} lie on the wrong side" in ran.err


@pytest.mark.slow
def test_all_surfaces_with_the_material_on_the_wrong_side(tmp_path: Path, metrocli: Metrocli) -> None:
    """No surface differs from the others then: what shows it is that all points are inside."""
    job = casting(2).write(tmp_path)
    changed(tmp_path / "part.yaml", "material: inside", "material: other")
    text = (tmp_path / "part.yaml").read_text().replace("outside", "inside").replace("other", "outside")
    for one, other in (("1.0", "-1.0"), ("-1.0", "1.0")):
        for axis in ("[{}, 0.0, 0.0]", "[0.0, {}, 0.0]", "[0.0, 0.0, {}]"):
            text = text.replace(f"normal: {axis.format(one)}", f"turned: {axis.format(other)}")
    (tmp_path / "part.yaml").write_text(text.replace("turned:", "normal:"))
    ran = metrocli("fit-part", job)
    assert ran.code == 4 and "the points of every surface lie on the wrong side" in ran.err, ran.err


@pytest.mark.slow
def test_points_inside_of_a_mesh(tmp_path: Path, metrocli: Metrocli) -> None:
    job = points_on_block(tmp_path, count=120)
    corners = block(2).corners
    stl(tmp_path / "part.stl", corners + np.where(corners > SIZE / 2, 8.0, -8.0))
    ran = metrocli("fit-part", job)
    assert ran.code == 4 and "the points of every surface lie on the wrong side" in ran.err, ran.err
    assert "the mesh may be that of the raw part" in ran.err


def test_a_negative_minimum_is_said(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(1, less={"left": -6.0, "right": -2.0})
    ran = metrocli("fit-part", one.write(tmp_path, minimum=-3.0))
    value = hdf5.read(tmp_path / "part.h5")[0].tables["overstock"].numbers("overstock")
    assert ran.code == 0 and value.min() < -0.1
    assert f"up to 3 mm of material may be missing at a point; it is at {(value < 0).sum()} of {len(value)}" in ran.err
    assert "the points of left lie on the wrong side" in ran.err


def test_an_empty_and_a_repeated_name_are_both_reported(tmp_path: Path, metrocli: Metrocli) -> None:
    job = casting(1).write(tmp_path)
    changed(tmp_path / "points.csv", "\nT3,", "\n,")
    changed(tmp_path / "points.csv", "\nT4,", "\nT2,")
    ran = metrocli("check", job)
    assert ran.code == 3 and "column 'point': an empty cell" in ran.err and "point T2: a second row" in ran.err


def test_targets_and_surfaces_that_no_point_has(tmp_path: Path, metrocli: Metrocli) -> None:
    job = casting(1).write(tmp_path, "targets: [X*]", "surfaces: {top: [Z9]}")
    ran = metrocli("check", job)
    assert ran.code == 3
    assert "targets: no point has the name 'X*'" in ran.err and "surfaces: no point has the name 'Z9'" in ran.err
    assert "P39 and 92 more" in ran.err and "P40" not in ran.err


def test_points_of_a_result_come_with_their_covariance() -> None:
    """As calibrate-camera (rig network) and multilaterate give them; the surfaces are named by patterns."""
    rng = np.random.default_rng(6)
    names, places = ["A1", "A2", "B1", "T1"], rng.normal(size=(4, 3))
    covariance = np.stack([np.diag(rng.uniform(1e-4, 1e-3, 3)) for _ in names])
    table = Table({"point": np.array(names), **{axis: places[:, k] for k, axis in enumerate("xyz")}})
    result = Result(
        "calibrate-camera", "", (), np.zeros((0, 0)), {}, {"points": table}, {"points_covariance": covariance}
    )
    files = Inputs(points=Path("points.h5"), nominal=Path("part.yaml"))
    settings = Settings(files, Overstock(0.5), targets=("T*",), surfaces={"a": ("A*",), "b": ("B1",)})
    found = read(settings, result, ("a", "b"), False)
    assert found.surface_points.names == ("A1", "A2", "B1") and found.targets.names == ("T1",)
    assert found.surface is not None and found.surface.tolist() == [0, 0, 1]
    assert np.array_equal(found.surface_points.covariance, covariance[:3])
    assert np.array_equal(found.targets.points, places[3:])


def test_points_that_are_neither_on_a_surface_nor_named_as_targets_are_left_out(
    tmp_path: Path, metrocli: Metrocli
) -> None:
    """Such as the ends of scale bars; without `targets` they would be coded targets."""
    job = casting(1).write(tmp_path, "targets: [T1, T2, T3, T4]")
    ran = metrocli("fit-part", job)
    assert ran.code == 0 and "2 points are neither on a surface nor among `targets`" in ran.err and "T0, T5" in ran.err
    assert hdf5.read(tmp_path / "part.h5")[0].tables["targets"].texts("target") == ["T1", "T2", "T3", "T4"]


@pytest.mark.parametrize(("of_mesh", "kept"), [(True, ("A1", "A2", "B1")), (False, ("A1", "B1"))])
def test_beside_marked_targets_a_point_without_surface_is_no_target(of_mesh: bool, kept: tuple[str, ...]) -> None:
    places = np.random.default_rng(7).normal(size=(4, 3))
    columns = {"point": ["A1", "A2", "B1", "T1"], "surface": ["a", "", "b", "target"], "sigma": [0.1] * 4}
    axes = {axis: places[:, k] for k, axis in enumerate("xyz")}
    table = Table({name: np.array(values) for name, values in columns.items()} | axes)
    files = Inputs(points=Path("points.csv"), nominal=Path("part.yaml"))
    found = read(Settings(files, Overstock(0.5)), table, ("a", "b"), of_mesh)
    assert found.surface_points.names == kept and found.targets.names == ("T1",)
    assert any("A2" in warning for warning in found.warnings) is not of_mesh


def stl(path: Path, corners: np.typing.NDArray[np.float64]) -> None:
    lines = ["solid part"]
    for face in corners:
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x!r} {y!r} {z!r}" for x, y, z in face.tolist())]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid part", ""]))


def points_on_block(folder: Path, axes: tuple[int, ...] = (0, 1, 2), count: int = 300) -> Path:
    """Points 2 to 4 mm outside of the faces of a block across some axes, turned a little."""
    rng = np.random.default_rng(3)
    rows = ["point,x_mm,y_mm,z_mm,sigma_mm"]
    for n in range(count):
        axis, side = axes[n % len(axes)], (n // len(axes)) % 2
        place = rng.uniform(0.1, 0.9, 3) * SIZE
        place[axis] = SIZE[axis] * side + (2 * side - 1) * rng.uniform(2, 4)
        x, y, z = np.array([[0.995, -0.0998, 0], [0.0998, 0.995, 0], [0, 0, 1]]) @ place + [3, -2, 1]
        rows.append(f"P{n},{x:.6f},{y:.6f},{z:.6f},0.02")
    (folder / "points.csv").write_text("\n".join(rows) + "\n")
    job = folder / "job.yaml"
    job.write_text(
        "metrocli: 1\njob: fit-part\ninputs: {points: points.csv, nominal: part.stl}\n"
        "overstock: {minimum: 0.5 mm, aim: even}\noutput: part.h5\n"
    )
    return job


def test_a_mesh_gives_what_its_planes_give(tmp_path: Path, metrocli: Metrocli) -> None:
    job = points_on_block(tmp_path)
    stl(tmp_path / "part.stl", block(4).corners)
    assert metrocli("fit-part", job).code == 0
    mesh = hdf5.read(tmp_path / "part.h5")[0]
    lines = ["surfaces:"]
    for axis in range(3):
        for side in (0, 1):
            point, normal = SIZE / 2, np.zeros(3)
            point[axis], normal[axis] = SIZE[axis] * side, 2 * side - 1
            place = ", ".join(f"{value} mm" for value in point)
            lines.append(f"- {{name: s{axis}{side}, type: plane, point: [{place}], normal: {normal.tolist()}}}")
    (tmp_path / "part.yaml").write_text("\n".join(lines) + "\n")
    assert metrocli("fit-part", job, "--force", "--set", "inputs.nominal=part.yaml").code == 0
    planes = hdf5.read(tmp_path / "part.h5")[0]
    for one, other in zip(mesh.estimates, planes.estimates, strict=True):
        assert one.value == pytest.approx(other.value, abs=1e-5)
        assert one.std == pytest.approx(other.std, rel=1e-3)
    assert mesh.tables["surfaces"].texts("surface") == [f"face-{n}" for n in range(1, 7)]


def test_meshes_that_cannot_be_used(tmp_path: Path, metrocli: Metrocli) -> None:
    job = points_on_block(tmp_path)
    corners = block(2).corners
    for wrong, message in (
        (corners[1:], "is open: 3 edges"),
        (corners[:, ::-1], "is inverted"),
        (corners / 25.4, "the mesh are in inch, not in mm: write `nominal_unit: inch`"),
        (
            corners / 1000,
            "the mesh are in m, not in mm: write `nominal_unit: m`; or the coordinates of the points are in um",
        ),
        (
            corners * 1000,
            "the mesh are in um, not in mm: write `nominal_unit: um`; or the coordinates of the points are in m",
        ),
        (corners / 7, "expected points on the part"),
    ):
        stl(tmp_path / "part.stl", wrong)
        ran = metrocli("check", job)
        assert ran.code == 3 and message in ran.err, ran.err
    stl(tmp_path / "part.stl", corners / 25.4)
    assert metrocli("fit-part", job, "--set", "nominal_unit=inch").code == 0


def test_points_in_inches_are_found_against_the_mesh(tmp_path: Path, metrocli: Metrocli) -> None:
    job = points_on_block(tmp_path)
    stl(tmp_path / "part.stl", block(2).corners)
    lines = [line.split(",") for line in (tmp_path / "points.csv").read_text().splitlines()]
    rows = [[row[0], *(f"{float(value) / 25.4:.6f}" for value in row[1:4]), row[4]] for row in lines[1:]]
    (tmp_path / "points.csv").write_text("\n".join(",".join(row) for row in [lines[0], *rows]) + "\n")
    ran = metrocli("check", job)
    assert ran.code == 3 and "the points are in inch, though they are read as mm: multiply them by 25.4" in ran.err


def test_fewer_than_six_constraints(tmp_path: Path, metrocli: Metrocli) -> None:
    one = casting(1)
    some = [0, 1, 14, 28, 56]
    few = replace(one, surface=one.surface[some], points=one.points[some], exact=one.exact[some])
    ran = metrocli("fit-part", few.write(tmp_path))
    assert ran.code == 4 and "independent constraints of the 6 that a pose needs" in ran.err


@pytest.mark.alike
@pytest.mark.parametrize(("axes", "left"), [((0,), 3), ((1,), 3), ((2,), 3), ((0, 1), 1)])
def test_points_on_some_faces_of_a_mesh_leave_motions_open(
    axes: tuple[int, ...], left: int, tmp_path: Path, metrocli: Metrocli
) -> None:
    """They must not wander along these until other faces are the nearest."""
    job = points_on_block(tmp_path, axes, 80)
    stl(tmp_path / "part.stl", block(1).corners)
    ran = metrocli("fit-part", job)
    assert ran.code == 4 and f"the points give {6 - left} independent constraints" in ran.err, ran.err
    for shift in {0, 1, 2} - set(axes):
        assert f"a shift along {'xyz'[shift]}" in ran.err


def test_targets_need_names(tmp_path: Path, metrocli: Metrocli) -> None:
    job = casting(1).write(tmp_path)
    changed(tmp_path / "points.csv", "\nT3,", "\n,")
    ran = metrocli("fit-part", job)
    assert ran.code == 3 and "column 'point': an empty cell" in ran.err


def test_commands_that_the_kind_does_not_have(tmp_path: Path, metrocli: Metrocli) -> None:
    job = casting(1).write(tmp_path)
    for command in ("diagnose", "simulate", "plan"):
        options = ("--out", tmp_path / "out") if command == "simulate" else ()
        ran = metrocli(command, job, *options)
        assert ran.code == 2 and "fit-part jobs cannot be" in ran.err
