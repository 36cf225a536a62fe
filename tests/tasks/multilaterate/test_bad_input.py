"""Bad input is refused in words, with the line where there is one."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import SAMPLES
from simulated.lengths import network

from metrocli.formats import csv
from metrocli.table import Table

JOB = """metrocli: 1
job: multilaterate
inputs: {lengths: lengths.csv, points: points.csv, tracers: tracers.csv}
noise: {constant: 0.1 um, proportional: 0.1 um/m}
output: o.h5
"""
Metrocli = Callable[..., Any]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    net = network(25, 5, seed=1)
    csv.write(tmp_path / "lengths.csv", net.lengths())
    csv.write(tmp_path / "points.csv", net.point_table())
    csv.write(tmp_path / "tracers.csv", net.tracer_table())
    (tmp_path / "job.yaml").write_text(JOB)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def lines(path: Path) -> list[str]:
    return path.read_text().splitlines()


def change(path: Path, edit: Callable[[list[str]], list[str]]) -> None:
    path.write_text("\n".join(edit(lines(path))) + "\n")


def of_tracer(rows: list[str], name: str, edit: Callable[[list[float]], Any]) -> list[str]:
    """Rows with the lengths of one tracer changed."""
    mine = [i for i, row in enumerate(rows) if f",{name}," in row]
    values = edit([float(rows[i].split(",")[2]) for i in mine])
    for i, value in zip(mine, values, strict=True):
        rows[i] = ",".join([*rows[i].split(",")[:2], repr(float(value))])
    return rows


def shuffled(values: list[float]) -> Any:
    return np.random.default_rng(0).permutation(values)


CASES: dict[str, tuple[str, Callable[[list[str]], list[str]], str]] = {
    "a length repeated": ("lengths.csv", lambda rows: [*rows, rows[7]], "point P1, tracer T1: a second row"),
    "a point without nominal": (
        "lengths.csv",
        lambda rows: [*rows, "P99,T0,500.0"],
        "lengths.csv:127: error: point 'P99' is not in points.csv",
    ),
    "a tracer unknown": (
        "lengths.csv",
        lambda rows: [*rows, "P3,T9,500.0"],
        "lengths.csv:127: error: tracer 'T9' is not in tracers.csv",
    ),
    "a negative path": (
        "tracers.csv",
        lambda rows: [f"{rows[0]},dead_path_mm", *(f"{row},-2000" for row in rows[1:])],
        "lengths.csv:2: error: length plus dead path is -",
    ),
    "all lengths equal": (
        "lengths.csv",
        lambda rows: [rows[0], *(",".join([*row.split(",")[:2], "500.0"]) for row in rows[1:])],
        "lengths.csv: error: the lengths of tracer T0 do not belong to these points",
    ),
    "one tracer's lengths shuffled": (
        "lengths.csv",
        lambda rows: of_tracer(rows, "T2", shuffled),
        "the lengths of tracer T2 do not belong to these points",
    ),
    "lengths in another unit": (
        "lengths.csv",
        lambda rows: [rows[0].replace("_mm", "_um"), *rows[1:]],
        "check the units of both files",
    ),
    "points in another unit": (
        "points.csv",
        lambda rows: [rows[0].replace("_mm", "_m"), *rows[1:]],
        "check the units of both files",
    ),
    "the other sign": (
        "lengths.csv",
        lambda rows: [rows[0], *(",".join([*row.split(",")[:2], repr(-float(row.split(",")[2]))]) for row in rows[1:])],
        "they fit with the other sign",
    ),
    "a negative sigma": (
        "points.csv",
        lambda rows: [f"{rows[0]},sigma_mm", *(f"{row},-1" for row in rows[1:])],
        "a standard deviation is negative",
    ),
    "no lengths": ("lengths.csv", lambda rows: rows[:1], "lengths.csv"),
}


@pytest.mark.parametrize("name", CASES)
def test_it_is_refused_and_told(name: str, folder: Path, metrocli: Metrocli) -> None:
    file, edit, words = CASES[name]
    change(folder / file, edit)
    ran = metrocli("multilaterate", "job.yaml")
    assert ran.code == 3, ran.err
    assert words in ran.err
    assert not (folder / "o.h5").exists()


@pytest.mark.parametrize("command", [("check",), ("multilaterate", "--dry-run")])
def test_all_faults_are_told_at_once_without_computing(
    command: tuple[str, ...], folder: Path, metrocli: Metrocli
) -> None:
    change(folder / "lengths.csv", lambda rows: [*rows, "P99,T0,500.0", "P3,T9,500.0"])
    change(folder / "points.csv", lambda rows: [f"{rows[0]},sigma_mm", *(f"{row},-1" for row in rows[1:])])
    ran = metrocli(*command, "job.yaml")
    assert ran.code == 3
    for words in ("point 'P99' is not in", "tracer 'T9' is not in", "points.csv:2: error: a standard deviation is"):
        assert words in ran.err


def test_check_looks_at_distances_effects_and_probing(folder: Path, metrocli: Metrocli) -> None:
    (folder / "bars.csv").write_text("from,to,length_mm,sigma_mm\nP1,P1,10,1e-3\nP2,P3,-5,1e-3\nP4,P5,5,0\n")
    (folder / "probing.csv").write_text("feature,point,x_mm,y_mm,z_mm\nplane,Q1,1,2,-3000\n")
    more = "effects: [{name: tracer-scale, tracer: T9}]\n"
    (folder / "job.yaml").write_text(
        JOB.replace("tracers.csv}", "tracers.csv, distances: bars.csv, probing: probing.csv}") + more
    )
    ran = metrocli("check", "job.yaml")
    assert ran.code == 3
    assert "bars.csv:2: error: a distance of a point to itself" in ran.err
    assert "bars.csv:3: error: a distance is not above zero" in ran.err
    assert "bars.csv:4: error: the standard deviation of a distance is not above zero" in ran.err
    assert "there is no tracer 'T9'" in ran.err
    assert "probing.csv:2: error: probing point 'Q1' has no replayed point" in ran.err


def test_the_good_input_is_good(folder: Path, metrocli: Metrocli) -> None:
    """Or the tests above would pass whatever is refused."""
    ran = metrocli("multilaterate", "job.yaml")
    assert ran.code == 0, ran.err
    assert ran.err == ""


def test_the_shuffled_tracer_alone_is_named(folder: Path, metrocli: Metrocli) -> None:
    change(folder / "lengths.csv", CASES["one tracer's lengths shuffled"][1])
    listed_at = metrocli("multilaterate", "job.yaml").err
    assert listed_at.count("do not belong") == 1
    assert "no other unit, sign or order of rows that was tried fits" in listed_at


def test_files_in_different_units_that_say_so_are_one(folder: Path, metrocli: Metrocli) -> None:
    """Lengths in m and points in mm, each in its header, are not a fault."""
    change(
        folder / "lengths.csv",
        lambda rows: [
            rows[0].replace("_mm", "_m"),
            *(",".join([*row.split(",")[:2], repr(float(row.split(",")[2]) / 1000)]) for row in rows[1:]),
        ],
    )
    assert metrocli("multilaterate", "job.yaml").code == 0


@pytest.mark.slow
def test_a_mirrored_list_of_points_is_told_by_the_tracers(folder: Path, metrocli: Metrocli) -> None:
    """Lengths fit the mirror image as well: the list of tracers alone shows it."""
    assert "far from their listed places" not in metrocli("multilaterate", "job.yaml").err
    change(folder / "points.csv", lambda rows: [rows[0].replace("x_mm,y_mm", "y_mm,x_mm"), *rows[1:]])
    ran = metrocli("multilaterate", "job.yaml")
    assert ran.code == 3
    # both lists may be the wrong one: the first is the error, the other as good
    both = [(one, f"{one}.csv: error: x and y are swapped") for one in ("points", "tracers")]
    (first,) = [one for one, words in both if words in ran.err]
    other = {"points": "tracers", "tracers": "points"}[first]
    assert f"as good: {other}.csv: x and y are swapped" in ran.err


def test_one_gross_error_is_not_taken_for_a_shuffle(folder: Path, metrocli: Metrocli) -> None:
    def spoil(values: list[float]) -> list[float]:
        return [values[0] + 300.0, *values[1:]]

    change(folder / "lengths.csv", lambda rows: of_tracer(rows, "T2", spoil))
    ran = metrocli("multilaterate", "job.yaml", "--set", "outliers=remove")
    assert ran.code == 0, ran.err
    from metrocli.formats import hdf5

    rejected: Table = hdf5.read(folder / "o.h5")[0].tables["rejected"]
    assert (rejected.texts("point"), rejected.texts("tracer")) == (["P0"], ["T2"])
    assert "1 length is left out as wrong: P0/T2" in ran.err


def test_several_gross_errors_of_one_tracer_are_named(folder: Path, metrocli: Metrocli) -> None:
    """Three of 25 lengths of one tracer, too many for least squares to start from."""

    def spoil(values: list[float]) -> list[float]:
        return [values[0] + 300.0, values[1] - 1000.0, *values[2:9], values[9] + 1000.0, *values[10:]]

    change(folder / "lengths.csv", lambda rows: of_tracer(rows, "T2", spoil))
    ran = metrocli("multilaterate", "job.yaml", "--set", "outliers=remove")
    assert ran.code == 0, ran.err
    assert "3 lengths are left out as wrong: P0/T2, P1/T2, P9/T2" in ran.err


def test_lengths_in_inches_are_named_where_outliers_are_removed(folder: Path, metrocli: Metrocli) -> None:
    """Nearly all are left out then, and the rest determines nothing: no layout is to blame."""

    def edit(rows: list[str]) -> list[str]:
        head, *rest = rows
        at = head.split(",").index("length_mm")
        cells = [row.split(",") for row in rest]
        inches = [[*row[:at], repr(float(row[at]) / 25.4), *row[at + 1 :]] for row in cells]
        return [head, *(",".join(row) for row in inches)]

    change(folder / "lengths.csv", edit)
    ran = metrocli("multilaterate", "job.yaml", "--set", "outliers=remove")
    assert ran.code == 3 and "they fit if they are multiplied by 25.4, as numbers in inches" in ran.err, ran.err


@pytest.mark.slow
def test_lengths_of_other_rows_are_no_fault_of_the_layout(tmp_path: Path, metrocli: Metrocli) -> None:
    """Where outliers are removed, so many contradict the others that the rest determines nothing."""
    metrocli("init", tmp_path / "gear", "--sample", "gear-m3d3")
    file = tmp_path / "gear" / "data" / "lengths.csv"
    head, *rest = file.read_text().splitlines()
    names, values = zip(*(row.rsplit(",", 1) for row in rest), strict=True)
    file.write_text("\n".join([head, *map(",".join, zip(names, [*values[1:], values[0]], strict=True))]) + "\n")
    ran = metrocli("multilaterate", tmp_path / "gear/jobs/tip3.yaml", "--set", "outliers=remove")
    assert ran.code == 4 and "lengths contradict each other; without them the points are not determined" in ran.err, (
        ran.err
    )


def test_a_wrong_entry_among_the_points_is_named(folder: Path, metrocli: Metrocli) -> None:
    """A typing error of 1 mm: the frame follows it by 1/25 of that, so it must not pass in silence."""

    def edit(rows: list[str]) -> list[str]:
        name, x, *rest = rows[9].split(",")
        return [*rows[:9], ",".join([name, repr(float(x) + 1.0), *rest]), *rows[10:]]

    change(folder / "points.csv", edit)
    ran = metrocli("multilaterate", "job.yaml")
    assert ran.code == 6, ran.err
    assert "the list of points may be wrong at P8: up to 0.969 mm from the adjusted place" in ran.out


@pytest.mark.parametrize("key", ["tolerance: 2 mm", "correction: {tip: 0.3 um}"])
def test_settings_of_probed_points_need_them(key: str, folder: Path, metrocli: Metrocli) -> None:
    (folder / "job.yaml").write_text(JOB + key + "\n")
    ran = metrocli("check", "job.yaml")
    assert ran.code == 3 and "this is of probed points" in ran.err


def gear(folder: Path, change: Callable[[list[str]], list[str]], tracer: str = "LT3") -> Path:
    """The sample gear, the lengths of one of whose tracers are changed."""
    shutil.copytree(SAMPLES / "gear-m3d3", folder, dirs_exist_ok=True)
    file = folder / "data" / "tip4_lengths.csv"
    rows = [line.split(",") for line in lines(file)]
    own = [row for row in rows if row[1] == tracer]
    for row, value in zip(own, change([row[2] for row in own]), strict=True):
        row[2] = value
    file.write_text("\n".join(map(",".join, rows)) + "\n")
    return folder / "jobs" / "tip4.yaml"


@pytest.mark.slow
def test_rows_of_one_tracer_that_are_moved_are_named(tmp_path: Path, metrocli: Metrocli) -> None:
    """Its points lie near one another, so that the misfit is small beside the volume: nothing was named."""
    job = gear(tmp_path, lambda lengths: [*lengths[1:], lengths[0]])
    for command in ("multilaterate", "diagnose"):
        ran = metrocli(command, job)
        assert ran.code == 5
        assert ran.err.splitlines()[1:] == ["  lengths of LT3: they fit if they are moved down by one of its rows"]


@pytest.mark.slow
def test_a_tracer_that_sticks_is_named(tmp_path: Path, metrocli: Metrocli) -> None:
    """Twenty points were listed, and their places in the list of points blamed."""
    ran = metrocli("multilaterate", gear(tmp_path, lambda lengths: [*lengths[:50], *[lengths[50]] * 20, *lengths[70:]]))
    # the failure that it causes varies
    assert ran.code in (4, 5) and "length_mm of LT3 stays the same in 20 rows in a row" in ran.err
    assert "from where the list puts it" not in ran.err


def test_a_tracer_that_sticks_is_named_where_its_lengths_fit_no_points(tmp_path: Path, metrocli: Metrocli) -> None:
    shutil.copytree(SAMPLES / "laboratory-effects", tmp_path, dirs_exist_ok=True)
    file = tmp_path / "data" / "lengths.csv"
    rows = [line.split(",") for line in lines(file)]
    own = [row for row in rows if row[1] == "LT1"]
    for row in own[10:]:
        row[2] = own[10][2]
    file.write_text("\n".join(map(",".join, rows)) + "\n")
    ran = metrocli("multilaterate", tmp_path / "jobs/hall.yaml")
    assert ran.code == 3 and "length_mm of LT1 stays the same in 30 rows in a row" in ran.err.splitlines()[0]


def test_two_tracers_with_the_names_of_each_other_are_named(tmp_path: Path, metrocli: Metrocli) -> None:
    job = gear(tmp_path, lambda lengths: lengths)
    file = tmp_path / "data" / "tracers.csv"
    file.write_text(file.read_text().replace("LT1", "LTX").replace("LT2", "LT1").replace("LTX", "LT2"))
    ran = metrocli("multilaterate", job)
    assert ran.code == 6 and "each stands at the listed place of the other" in ran.err
