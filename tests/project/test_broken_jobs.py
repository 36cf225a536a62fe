"""A corpus of broken jobs: each is refused with file, line and column, in words, and nothing is written."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

HEAD = "metrocli: 1\njob: straight-line\n"
GOOD = HEAD + "inputs: {readings: readings.csv}\nnoise: 0.1 mm\n"
BOMB = "a0: &a0 [x, x]\n" + "".join(f"a{n + 1}: &a{n + 1} [*a{n}, *a{n}]\n" for n in range(40))

# name: (text of the job, line:column, message, hint)
BROKEN = {
    "tab": (GOOD + "limits:\n\trange: [1 mm, 2 mm]\n", "6:1", "the line is indented with a tab", "spaces"),
    "indentation": (GOOD + "  title: x\n", "5:8", "indented too far", "alike"),
    "dedent": (GOOD + "limits:\n    robust: true\n  range: [1 mm, 2 mm]\n", "7:3", "does not fit", "alike"),
    "colon": (GOOD + "title: part: 3\n", "5:12", "a second ': '", "quotes"),
    "open list": (GOOD + "estimate: [slope\n", "5:11", "not closed", "[a, b, c]"),
    "open mapping": (GOOD + "limits: {range: [1 mm, 2 mm]\n", "5:9", "not closed", "{a: 1, b: 2}"),
    "open quote": (GOOD + "title: 'abc\n", "5:8", "quotation mark", "close it"),
    "at sign": (GOOD + "title: @abc\n", "5:8", "cannot begin", "quotes"),
    "no colon": (GOOD + "title\n", "5:1", "a key without ': '", "key: value"),
    "alias bomb": (BOMB + GOOD, "15:18", "more than", "CSV"),
    "alias": (GOOD + "title: *a\n", "5:8", "no value above has the anchor &a", "write the value out"),
    "tag": (GOOD + "title: !!python/name:os.system x\n", "5:8", "tag", "plain value"),
    "deep": (GOOD + f"title: {'[' * 5000}\n", "5:37", "more than 30 nested levels", ""),
    "two documents": (GOOD + "---\na: 1\n", "5:1", "second document", "one document"),
    "duplicate key": (GOOD + "noise: 0.2 mm\n", "5:1", "the key 'noise' is repeated", "line 4"),
    "empty": ("", "1:1", "empty", ""),
    "only comments": ("# nothing\n", "1:1", "empty", ""),
    "a list": ("- a\n", "1:1", "a job file must be a mapping", "metrocli: 1"),
    "a word": ("hello\n", "1:1", "a job file must be a mapping", ""),
    "binary": ("\x00\x01\x02", "1:1", "control character", ""),
    "no kind": ("metrocli: 1\n", "1:1", "the key 'job' is missing", "kind of job: one of"),
    "unknown kind": (GOOD.replace("straight", "strait"), "2:6", "unknown kind of job", "did you mean 'straight-line'?"),
    "version": (GOOD.replace("metrocli: 1", "metrocli: 2"), "1:11", "version 1", "write metrocli: 1"),
    "no version": (GOOD.replace("metrocli: 1\n", ""), "1:1", "'metrocli' is missing", ""),
    "unknown key": (GOOD + "tolerence: 1\n", "5:1", "unknown key 'tolerence'", "allowed"),
    "near key": (GOOD + "iteration: 3\n", "5:1", "unknown key 'iteration'", "did you mean 'iterations'?"),
    "near inner key": (HEAD + "inputs: {reading: readings.csv}\nnoise: 1 mm\n", "3:10", "unknown key 'reading' in 'inputs'",
                       "did you mean 'readings'?"),
    "merge key": (GOOD + "<<: {title: x}\n", "5:1", "unknown key '<<'", ""),
    "missing key": (HEAD + "inputs: {readings: readings.csv}\n", "1:1", "the key 'noise' is missing", "noise of y"),
    "no unit": (GOOD.replace("0.1 mm", "0.1"), "4:8", "noise: 0.1 has no unit", "write e.g. '0.1 mm'"),
    "wrong unit": (GOOD.replace("mm", "kg"), "4:8", "'kg' is the unit of a mass", "allowed: mm"),
    "decimal comma": (GOOD.replace("0.1", "0,1"), "4:8", "decimal comma", "write '0.1 mm'"),
    "megametre": (GOOD.replace("0.1 mm", "5 Mm"), "4:8", "unknown unit 'Mm'", "did you mean 'mm'?"),
    "negative noise": (GOOD.replace("0.1", "-0.1"), "4:8", "not above zero", "a length"),
    "nan": (GOOD.replace("0.1 mm", ".nan"), "4:8", "not a number", "0.1 mm"),
    "near word": (GOOD.replace("0.1 mm", "estimate"), "4:8", "'estimate' is not expected", "estimated"),
    "exponent without unit": (GOOD + "alpha: 1e-6\n", "5:8", "alpha: 1e-6 has no unit", "1/K"),
    "not a number": (GOOD + "weight: heavy\n", "5:9", "'heavy' is not a plain number", "a number"),
    "number with comma": (GOOD + "weight: 0,5\n", "5:9", "decimal comma", "0.5"),
    "number out of range": (GOOD + "weight: 0\n", "5:9", "out of range", "above 0"),
    "not whole": (GOOD + "iterations: 2.5\n", "5:13", "iterations", "a whole number"),
    "whole out of range": (GOOD + "iterations: 51\n", "5:13", "out of range", "at most 50"),
    "no flag": (GOOD + "limits: {range: [1 mm, 2 mm], robust: yes}\n", "5:39", "limits.robust", "true or false"),
    "no word": (GOOD + "estimate: [slope, ofset]\n", "5:19", "unknown word 'ofset'", "did you mean 'offset'?"),
    "word twice": (GOOD + "estimate: [slope, slope]\n", "5:19", "in the list twice", ""),
    "no list": (GOOD + "estimate: slope\n", "5:11", "estimate", "a list"),
    "list too short": (GOOD + "limits: {range: [1 mm]}\n", "5:17", "1 values instead of 2", ""),
    "no value": (GOOD + "title:\n", "5:7", "there is no value", "text"),
    "a mapping for text": (GOOD + "title: {a: b}\n", "5:8", "a mapping is not expected", "text"),
    "keys that do not go together": (
        GOOD + "iterations: 1\nlimits: {range: [1 mm, 2 mm], robust: true}\n", "6:39", "more than one iteration", ""),
    "missing file": (GOOD.replace("readings.csv", "reedings.csv"), "3:20", "no such file", "did you mean 'readings.csv'?"),
    "missing folder": (GOOD.replace("readings.csv", "data/r.csv"), "3:20", "no such file", "the folder data does not exist"),
    "a folder": (GOOD.replace("readings.csv", "."), "3:20", "a folder, not a file", ""),
    "no images": (GOOD.replace("{", "{images: img/*.jpg, "), "3:18", "no file matches 'img/*.jpg'", ""),
    "result of nothing": (GOOD.replace("{", "{known: results/other.h5, "), "3:17", "no such file", ""),
    "wrong kind of file": (GOOD.replace("{", "{known: readings.csv, "), "3:17", "does not end in", ".yaml file"),
    "table that is none": (GOOD.replace("readings.csv", "line.h5"), "3:20", "is not a CSV file", ""),
    "unknown effect": (GOOD + "effects: [{name: bend}]\n", "5:18", "unknown effect 'bend'", "no effect"),
    "effect without name": (GOOD + "effects: [bend]\n", "5:11", "needs a name", ""),
    "range of no column": (GOOD + "ranges: {yy: 3 mm}\n", "5:14", "no file of this job has a column 'yy'", "allowed: x, y"),
    "range without unit": (GOOD + "ranges: {y: 3}\n", "5:13", "3 has no unit", "write e.g. '3 mm'"),
    "range below zero": (GOOD + "ranges: {y: -3 mm}\n", "5:13", "not the size of a number", "above zero"),
    "ranges as a list": (GOOD + "ranges: [y]\n", "5:9", "this is not a mapping", "{phi1: 3600 deg}"),
    "requirement": (GOOD + "require: {sigma0: 1.5}\n", "5:19", "not a comparison", "< 1.5"),
    "output": (GOOD + "output: result.csv\n", "5:9", "not the name of a result file", ".h5"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
@pytest.mark.parametrize("command", ["check", pytest.param("straight-line", marks=pytest.mark.slow)])
def test_a_broken_job_is_refused_in_its_place(
    name: str, command: str, job: Path, metrocli: Callable[..., object]
) -> None:
    text, place, message, hint = BROKEN[name]
    job.write_text(text)
    before = sorted(Path().rglob("*"))
    ran = metrocli(command, job)
    assert ran.code == 3
    assert ran.out == ""
    assert f"line.yaml:{place}: error: " in ran.err
    assert message in ran.err
    assert hint in ran.err
    assert "Traceback" not in ran.err
    assert sorted(Path().rglob("*")) == before


def test_all_faults_are_told_at_once_in_order(job: Path, metrocli: Callable[..., object]) -> None:
    job.write_text(
        HEAD
        + "inputs: {readings: nope.csv, images: '*.png'}\nnoise: 0.1\nestimate: [slop, slob]\nweigt: 1\noutput: x\n"
    )
    ran = metrocli("check", job)
    places = [line.split(": error")[0] for line in ran.err.splitlines() if ": error: " in line]
    assert places == [f"line.yaml:{at}" for at in ("3:20", "3:38", "4:8", "5:12", "5:18", "6:1", "7:9")]


def test_the_caret_stands_under_the_fault(job: Path, metrocli: Callable[..., object]) -> None:
    job.write_text(GOOD.replace("0.1 mm", "0.1 kg"))
    lines = metrocli("check", job).err.splitlines()
    assert lines[1] == "     4 | noise: 0.1 kg"
    assert lines[2].startswith("       |        ^ allowed: mm")


@pytest.mark.parametrize("command", ["check", "multilaterate", "diagnose"])
def test_a_fault_of_a_row_shows_the_row(command: str, job: Path, metrocli: Callable[..., object]) -> None:
    job.write_text("""metrocli: 1
job: multilaterate
inputs: {lengths: lengths.csv, points: points.csv}
noise: {constant: 1 um}
output: r.h5
""")
    Path("lengths.csv").write_text("point,tracer,length_mm\na,A,5\nb,A,6\n")
    Path("points.csv").write_text("# by hand\npoint,x_mm,y_mm,z_mm,sigma_mm\na,0,0,0,0\nb, 1,0,0,-2\n")
    ran = metrocli(command, job)
    row = "points.csv:4: error: a standard deviation is negative, in column 'sigma_mm'\n     4 | b, 1,0,0,-2\n"
    assert (ran.code, ran.err) == (3, row)


def test_a_file_that_is_not_utf8_is_refused(job: Path, metrocli: Callable[..., object]) -> None:
    job.write_bytes(GOOD.encode() + "title: 5 µm\n".encode("latin-1"))
    ran = metrocli("check", job)
    assert (ran.code, ran.err.startswith("line.yaml:5:1: error: the file is not text in UTF-8")) == (3, True)


def test_a_job_may_allow_what_a_column_cannot_usually_hold(job: Path, metrocli: Callable[..., object]) -> None:
    Path("readings.csv").write_text("point,x_mm,y_mm\na,0,-10000000\nb,1,0\nc,2,10000000\nd,3,20000000\n")
    ran = metrocli("straight-line", job)
    assert ran.code == 3
    assert (
        "readings.csv:5:5: error: column 'y_mm': 20000000 is beyond what it can hold, -10000000 to 10000000 mm"
        in ran.err
    )
    job.write_text(GOOD + "ranges: {y: 30000 m, x: 2 mm}\n")
    ran = metrocli("straight-line", job)
    assert ran.code == 3
    assert "readings.csv:5:3: error: column 'x_mm': 3 is beyond what it can hold, -2 to 2 mm" in ran.err
    assert ran.err.count("error: ") == 1
    job.write_text(GOOD + "ranges: {y: 30000 m}\n")
    assert metrocli("straight-line", job).code == 0


def test_a_job_that_does_not_exist(job: Path, metrocli: Callable[..., object]) -> None:
    ran = metrocli("straight-line", "none.yaml")
    assert (ran.code, ran.err) == (3, "none.yaml: error: there is no such file\n")


def test_a_yaml_input_is_checked_with_the_job(job: Path, metrocli: Callable[..., object]) -> None:
    job.write_text(GOOD.replace("{", "{known: known.yaml, "))
    Path("known.yaml").write_text("slop: 1 mm/m\n")
    ran = metrocli("check", job)
    assert ran.code == 3
    assert "known.yaml:1:1: error: unknown key 'slop'" in ran.err
    Path("known.yaml").write_text("slope: 1 mm/m\n")
    assert metrocli("check", job).code == 0


@pytest.mark.parametrize("text", ["\ufeff" + GOOD, GOOD.replace("\n", "\r\n"), "%YAML 1.2\n---\n" + GOOD])
def test_harmless_variants_are_read(text: str, job: Path, metrocli: Callable[..., object]) -> None:
    job.write_text(text, newline="")
    assert metrocli("check", job).code == 0


@pytest.mark.parametrize(("make", "found"), [("pipe", "a pipe or a device"), ("link", "a link that leads nowhere")])
def test_what_is_no_file_is_named(make: str, found: str, job: Path, metrocli: Callable[..., object]) -> None:
    Path("readings.csv").unlink()
    if make == "pipe":
        os.mkfifo("readings.csv")
    else:
        Path("readings.csv").symlink_to("nowhere.csv")
    ran = metrocli("straight-line", job)
    assert ran.code == 3 and found in ran.err and "readings.csv" in ran.err


@pytest.fixture
def away(job: Path) -> Path:
    """A link to `elsewhere/below`; beside that folder are other files of the names that are beside the job."""
    Path("elsewhere/below").mkdir(parents=True)
    for folder in (Path(), Path("elsewhere")):
        Path(folder, "line.yaml").write_text(GOOD)
        Path(folder, "readings.csv").write_text("point,x_mm,y_um\na,0,1\nb,1,2\n")
        Path(folder, "known.yaml").write_text("slope: 1 mm/m\n")
        Path(folder, "a.png").write_bytes(b"")
    Path("elsewhere/metrocli.yaml").write_text("jobs: [line.yaml]\n")
    Path("away").symlink_to("elsewhere/below")
    return Path("away")


@pytest.mark.parametrize("inputs", [
    "readings: away/../readings.csv", "readings: readings.csv, known: away/../known.yaml",
    "readings: readings.csv, images: away/../*.png", "readings: readings.csv, images: [away/../a.png]",
])  # fmt: skip
def test_a_path_that_a_link_makes_another_file_is_refused(
    inputs: str, away: Path, metrocli: Callable[..., Any]
) -> None:
    """The system follows the link before it goes up; the path as it is written goes up from the link."""
    Path("line.yaml").write_text(GOOD.replace("readings: readings.csv", inputs))
    ran = metrocli("check", "line.yaml")
    assert (ran.code, "leads through a link to" in ran.err, "line.yaml:3:" in ran.err) == (3, True, True)


@pytest.mark.parametrize("place", ["away/../line.yaml", "away/.."])
def test_a_job_behind_a_link_reads_no_files_of_another_folder(
    place: str, away: Path, metrocli: Callable[..., Any]
) -> None:
    assert "leads through a link to" in metrocli("check", place).err


def test_a_link_whose_way_up_leads_to_the_same_file_is_no_fault(away: Path, metrocli: Callable[..., Any]) -> None:
    away.unlink()
    away.symlink_to("elsewhere")
    Path("line.yaml").write_text(GOOD.replace("readings.csv", "away/../readings.csv"))
    assert metrocli("check", "line.yaml").code == 0
