"""Bad input is found and named: wrong mountings by trying the alternatives, wrong rows by their line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.grid import DECLARED, PITCH, grid, without

from metrocli.formats import csv, hdf5
from metrocli.geometry.rotations import rotation_from_vector
from metrocli.tasks.selfcal_grid import task as selfcal_grid

JOB = """metrocli: 1
job: selfcal-grid
inputs: {views: views.csv}
grid: {size: [5, 5, 5], pitch: 65 mm}
views: [{name: "1"}, {name: "2", rotate: {axis: z, angle: 90 deg}}, {name: "3", rotate: {axis: x, angle: 90 deg}}, {name: "4", shift: [1, 0, 0]}]
noise: 0.5 um
output: o.h5
"""
Metrocli = Callable[..., Any]
Rows = list[list[str]]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    csv.write(tmp_path / "views.csv", grid(5, seed=2).read(np.random.default_rng(1)))
    (tmp_path / "job.yaml").write_text(JOB)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def change(folder: Path, edit: Callable[[Rows], Rows]) -> None:
    path = folder / "views.csv"
    rows = [line.split(",") for line in path.read_text().splitlines()]
    path.write_text("\n".join(",".join(row) for row in [rows[0], *edit(rows[1:])]) + "\n")


def swapped(first: str, second: str) -> Callable[[Rows], Rows]:
    other = {first: second, second: first}
    return lambda rows: [[other.get(row[0], row[0]), *row[1:]] for row in rows]


def exchanged(a: int, b: int, views: str = "1234") -> Callable[[Rows], Rows]:
    """Rows with two index columns exchanged in some views."""
    order = list(range(7))
    order[a], order[b] = b, a
    return lambda rows: [[row[k] for k in order] if row[0] in views else row for row in rows]


def set_cell(row: int, cell: int, text: str) -> Callable[[Rows], Rows]:
    return lambda rows: [
        [text if (n, k) == (row, cell) else old for k, old in enumerate(line)] for n, line in enumerate(rows)
    ]


CASES: dict[str, tuple[str, Callable[[Rows], Rows], str]] = {
    "rotation sense about z": ("angle: 90 deg}}, {name: \"3\"=angle: -90 deg}}, {name: \"3\"", lambda rows: rows, "view '2' stands turned by 90 deg about z, declared turned by -90 deg about z; is the sense of its rotation wrong?"),
    "rotation sense about x": ("x, angle: 90 deg=x, angle: -90 deg", lambda rows: rows, "view '3' stands turned by 90 deg about x, declared turned by -90 deg about x; is the sense"),
    "wrong axis": ("axis: x=axis: y", lambda rows: rows, "view '3' stands turned by 90 deg about x, declared turned by 90 deg about y"),
    "shift of the other sign": ("[1, 0, 0]=[-1, 0, 0]", lambda rows: [row for row in rows if row[0] != "4" or row[1] in "01"], "view '4' stands shifted by [1, 0, 0] pitches relative to the others, declared [-1, 0, 0]"),
    "views 2 and 3 swapped": ("", swapped("2", "3"), "views '2' and '3' are exchanged"),
    "views 1 and 2 swapped": ("", swapped("1", "2"), "views '1' and '2' are exchanged"),
    "views 1 and 4 swapped": ("", swapped("1", "4"), "views '1' and '4' are exchanged"),
    "i and j exchanged": ("", exchanged(1, 2), "in all views i and j are exchanged"),
    "j and k exchanged in one view": ("", exchanged(2, 3, "3"), "in view '3' j and k are exchanged"),
    "the columns x and y exchanged": ("", lambda rows: [[*row[:4], row[5], row[4], row[6]] for row in rows], "in all views x and y are exchanged"),
    "i, j, k turned round": ("", lambda rows: [[row[0], row[2], row[3], row[1], *row[4:]] for row in rows], "in all views the readings fit the artefact with i, j, k read as k, i, j"),
    "counted from 1": ("", lambda rows: [[row[0], *(str(int(index) + 3) for index in row[1:4]), *row[4:]] for row in rows], "i, j, k count from 1; they count from the middle ball"),
    "another pitch": ("pitch: 65=pitch: 60", lambda rows: rows, "the balls are read 65 mm apart, the pitch is 60 mm"),
    "one view in another unit": ("", lambda rows: [[*row[:4], *(str(float(x) * 1000) for x in row[4:])] if row[0] == "3" else row for row in rows], "the balls of view '3' are read 65001 mm apart"),
    "i counted backwards": ("", lambda rows: [[row[0], str(-int(row[1])), *row[2:]] for row in rows], "in all views i counts against its axis"),
    "an index outside": ("", set_cell(3, 2, "7"), "views.csv:5: error: ball (-2, 7, 1) is outside the grid of 5 x 5 x 5"),
    "a wrong index inside": ("", lambda rows: [row for n, row in enumerate(set_cell(3, 1, "1")(rows)) if n == 3 or row[:4] != ["1", "1", "-2", "1"]], "views.csv:5: error: ball (1, -2, 1) of view '1' is read 195.1 mm from its place, where ball (-2, -2, 1) stands"),
    "a duplicate without repeat": ("", lambda rows: [*rows, rows[7]], "view 1, i -2, j -1, k 0: a second row"),
    "an unknown view": ("", set_cell(0, 0, "7"), "views.csv:2: error: view '7' is not among the job's views"),
    "an even grid": ("[5, 5, 5]=[5, 4, 5]", lambda rows: rows, "4 is even"),
    "an odd angle": ("x, angle: 90 deg=x, angle: 45 deg", lambda rows: rows, "only multiples of 90 deg"),
    "a name twice": ("name: \"4\"=name: \"3\"", lambda rows: rows, "two views have the name '3'"),
    "a reading off by a metre": ("", set_cell(9, 4, "870.0"), "views.csv:11: error: ball (-2, -1, 2) of view '1' is read 1000 mm from its place\n"),
    "a reading in another row's place": ("", set_cell(9, 5, "0.0"), "views.csv:11: error: ball (-2, -1, 2) of view '1' is read 65.4 mm from its place, where ball (-2, 0, 2) stands"),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_it_is_refused_and_told(name: str, folder: Path, metrocli: Metrocli) -> None:
    job, edit, words = CASES[name]
    if job:
        old, new = job.split("=")
        assert old in JOB
        (folder / "job.yaml").write_text(JOB.replace(old, new))
    change(folder, edit)
    ran = metrocli("selfcal-grid", "job.yaml")
    assert ran.code == 3, ran.err
    assert words in ran.err
    assert not (folder / "o.h5").exists()


def test_an_entry_of_a_list_is_set_by_its_number(folder: Path, metrocli: Metrocli) -> None:
    ran = metrocli("selfcal-grid", "job.yaml", "--set", "views.2.rotate.angle=-90 deg")
    assert ran.code == 3
    assert "view '2' stands turned by 90 deg about z, declared turned by -90 deg about z" in ran.err
    assert metrocli("selfcal-grid", "job.yaml", "--set", "views.4.name=4", "--set", "grid.size.3=5").code == 0
    for number in ("0", "5"):
        ran = metrocli("selfcal-grid", "job.yaml", "--set", f"views.{number}.name=x")
        assert ran.code == 2
        assert f"'views' has 4 entries, counted from 1; there is no {number}" in ran.err


def test_the_good_input_is_good(folder: Path, metrocli: Metrocli) -> None:
    """Or the tests above would pass whatever is refused."""
    ran = metrocli("selfcal-grid", "job.yaml")
    assert ran.code == 0, ran.err
    assert ran.err == ""


def test_only_the_wrong_view_is_named(folder: Path, metrocli: Metrocli) -> None:
    change(folder, swapped("2", "3"))
    assert metrocli("selfcal-grid", "job.yaml").err.count("error") == 1


def test_a_mounting_off_by_degrees_is_no_fault(folder: Path, metrocli: Metrocli) -> None:
    """Three degrees are a bad mounting, not another one: the adjustment finds them, exact rotations hold."""
    one = grid(5, seed=2)
    one.mountings["2"] = (np.array([3.0, 1.0, -2.0]), np.array([0.02, -0.05, 0.03]))
    csv.write(folder / "views.csv", one.read(np.random.default_rng(1), noise=0.0))
    ran = metrocli("selfcal-grid", "job.yaml", "--quiet")
    assert ran.code == 0, ran.err
    found = hdf5.read(folder / "o.h5")[0].tables["machine_error"].stacked(["ex", "ey", "ez"])
    assert np.abs(found - one.machine).max() < 1e-9


@pytest.mark.alike
@pytest.mark.parametrize("tilt", [0.05, 0.1])
def test_a_large_grid_may_stand_askew(tilt: float) -> None:
    """The outer balls are then far from their sites, yet none is taken for another; that they are off is told."""
    one = grid(9, seed=2)
    one.mountings["3"] = (np.zeros(3), np.array([tilt, -tilt / 2, tilt / 2]))
    settings = one.settings(leave_one_out="no")
    result = selfcal_grid.run(selfcal_grid.TASK.job(settings, one.read(np.random.default_rng(1), noise=0.0)))
    assert np.abs(result.tables["machine_error"].stacked(["ex", "ey", "ez"]) - one.machine).max() < 1e-9
    told = [line for line in result.warnings if "pitches from its sites" in line]
    assert len(told) == 1
    assert told[0].startswith("view '3'")


@pytest.mark.alike
@pytest.mark.parametrize("axes", [("i", "j", "k"), ("k", "i", "j"), ("j", "k", "i")])
def test_a_plate_that_stands_the_other_way_is_told(
    axes: tuple[str, str, str], folder: Path, metrocli: Metrocli
) -> None:
    """A plane of balls does not span space, but its turn is that of its rows."""
    lay = "ijk".index(axes[2])
    size = [5, 5, 5]
    size[lay] = 1
    normal = "xyz"[lay]
    one = grid(5, "1", seed=3)
    flat = one.balls[one.balls[:, lay] == 0]
    turn = np.rint(rotation_from_vector(np.eye(3)[lay] * np.pi / 2))
    rows = [
        [name, *map(str, ball), *map(str, PITCH * (matrix @ ball + step))]
        for name, matrix, step in (("1", np.eye(3), 0), ("2", turn, 0), ("3", np.eye(3), np.eye(3)[(lay + 1) % 3]))
        for ball in flat.tolist()
    ]
    change(folder, lambda _: rows)
    shift = np.eye(3, dtype=int)[(lay + 1) % 3].tolist()
    job = JOB.replace("[5, 5, 5]", str(size)).replace(JOB[JOB.index("views: [") : JOB.index("noise")], "VIEWS\n")
    for sense, code in (("90", 0), ("-90", 3), ("180", 3)):
        views = f'views: [{{name: "1"}}, {{name: "2", rotate: {{axis: {normal}, angle: {sense} deg}}}}, {{name: "3", shift: {shift}}}]'
        (folder / "job.yaml").write_text(job.replace("VIEWS", views))
        ran = metrocli("selfcal-grid", "job.yaml", "--quiet")
        assert ran.code == code, ran.err
        if code:
            assert f"view '2' stands turned by 90 deg about {normal}, declared turned by {sense} deg" in ran.err


def test_a_pitch_that_is_a_little_off_is_told() -> None:
    one = grid(5, seed=2)
    settings = one.settings(leave_one_out="no")
    table = one.read(np.random.default_rng(1))
    off = replace(settings, grid=replace(settings.grid, pitch=66.0))
    assert any(
        "are read 65" in line and "the pitch is 66 mm" in line
        for line in selfcal_grid.run(selfcal_grid.TASK.job(off, table)).warnings
    )


def test_a_few_rough_balls_are_no_other_pitch() -> None:
    """Two neighbours of the middle ball are off by a tenth of the pitch, and one view is of these three alone."""
    one = grid(5, "1234", seed=2)
    near = [np.flatnonzero((one.balls == ball).all(axis=1))[0] for ball in ((1, 0, 0), (0, 1, 0))]
    one.artefact[near] += 6.0 * np.eye(3)[:2]
    table = one.read(np.random.default_rng(1))
    ball = np.stack([table.numbers(k) for k in "ijk"], axis=1)
    three = (ball >= 0).all(axis=1) & (ball.sum(axis=1) <= 1) & (ball[:, 2] == 0)
    few = without(table, (np.array(table.texts("view")) == "2") & ~three)
    result = selfcal_grid.run(selfcal_grid.TASK.job(one.settings(leave_one_out="no"), few))
    assert result.tables["views"].numbers("readings")[1] == 3


def test_a_view_without_readings_is_told() -> None:
    one = grid(5, "1234", seed=2)
    settings = replace(one.settings(leave_one_out="no"), views=(*one.settings().views, DECLARED["5"]))
    result = selfcal_grid.run(selfcal_grid.TASK.job(settings, one.read(np.random.default_rng(1))))
    assert result.warnings == ("view '5' has no readings",)


def test_a_row_of_balls_is_not_enough(folder: Path, metrocli: Metrocli) -> None:
    change(folder, lambda rows: [row for row in rows if row[2:4] == ["0", "0"]])
    ran = metrocli("selfcal-grid", "job.yaml")
    assert ran.code == 4
    assert "the balls stand in one row" in ran.err


def test_one_view_is_not_enough(folder: Path, metrocli: Metrocli) -> None:
    change(folder, lambda rows: [row for row in rows if row[0] == "1"])
    ran = metrocli("selfcal-grid", "job.yaml")
    assert ran.code == 4
    assert "one view shows only the sum of machine and artefact error" in ran.err


@pytest.mark.parametrize("second", ["-2,0,0,2,0,0,261.1,0.001", "0,-2,1,0,2,1,261.1,0.001"])
def test_lengths_that_contradict_each_other_are_named(second: str, folder: Path, metrocli: Metrocli) -> None:
    (folder / "lengths.csv").write_text(
        f"i1,j1,k1,i2,j2,k2,length_mm,sigma_mm\n-2,0,0,2,0,0,260.2,0.001\n{second}\n0,0,-2,0,0,2,260.2,0.5\n"
    )
    (folder / "job.yaml").write_text(JOB.replace("views.csv}", "views.csv, lengths: lengths.csv}"))
    ran = metrocli("selfcal-grid", "job.yaml", "--set", "leave_one_out=no")
    assert ran.code == 6
    told = [line for line in ran.out.splitlines() if line.startswith("DOUBTFUL: lengths do not agree")]
    assert len(told) == 1
    ends = ", ".join(second.split(",")[:3]), ", ".join(second.split(",")[3:6])
    assert "(-2, 0, 0) to (2, 0, 0)" in told[0]
    assert f"({ends[0]}) to ({ends[1]})" in told[0]
    assert "(0, 0, -2)" not in told[0]
    table = hdf5.read(folder / "o.h5")[0].tables["lengths"]
    assert np.abs(table.numbers("residual")[:2].sum()) < 0.01
    assert table.numbers("residual")[1] == pytest.approx(0.45, abs=0.1)


BAD_LENGTHS = {
    "a ball outside": ("1,-2,-2,-2,2,2,9,450.3,0.001", "ball (2, 2, 9) is not in the views"),
    "an exact length": ("1,-2,-2,-2,2,2,2,450.33,0", "must be above zero"),
    "a ball to itself": ("1,2,0,0,2,0,0,0.0,0.001", "a length from ball (2, 0, 0) to itself"),
    "a view that is none": ("7,-2,-2,-2,2,2,2,450.33,0.001", "view '7' has no readings"),
    "another length": ("1,-2,-2,-2,2,2,2,45.033,0.001", "these balls are 450.333 mm apart"),
}


@pytest.mark.parametrize("copy", ["1,-2,-2,-2,2,2,2", "1,2,2,2,-2,-2,-2"])
def test_a_length_that_stands_twice_is_told(copy: str, folder: Path, metrocli: Metrocli) -> None:
    rows = "1,-2,-2,-2,2,2,2,450.33,0.001\n1,-2,-2,2,2,2,-2,450.31,0.001"
    heading = "view,i1,j1,k1,i2,j2,k2,length_mm,sigma_mm"
    (folder / "lengths.csv").write_text(f"{heading}\n{rows}\n{copy},450.33,0.001\n")
    (folder / "job.yaml").write_text(JOB.replace("views.csv}", "views.csv, lengths: lengths.csv}"))
    ran = metrocli("selfcal-grid", "job.yaml")
    assert ran.code == 3
    assert "lengths.csv:4: error: the list has this length in row 1" in ran.err
    # a second calibration of the same balls is another reading
    (folder / "lengths.csv").write_text(f"{heading}\n{rows}\n{copy},450.332,0.001\n")
    assert "the list has this length" not in metrocli("selfcal-grid", "job.yaml").err


@pytest.mark.parametrize("name", BAD_LENGTHS)
def test_bad_lengths_are_told(name: str, folder: Path, metrocli: Metrocli) -> None:
    row, words = BAD_LENGTHS[name]
    (folder / "lengths.csv").write_text(f"view,i1,j1,k1,i2,j2,k2,length_mm,sigma_mm\n{row}\n")
    (folder / "job.yaml").write_text(JOB.replace("views.csv}", "views.csv, lengths: lengths.csv}"))
    ran = metrocli("selfcal-grid", "job.yaml")
    assert ran.code == 3
    assert "lengths.csv:2: error" in ran.err
    assert words in ran.err
