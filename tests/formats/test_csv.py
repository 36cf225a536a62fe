"""CSV: units in the header, every fault with its place, what is written reads back exactly."""

from __future__ import annotations

import math
from pathlib import Path
from unicodedata import category

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from texts import texts

from metrocli.errors import InputError
from metrocli.formats import csv, csv_text
from metrocli.formats.csv_header import later_header
from metrocli.table import NUMBER, TEXT, WHOLE, Column, Columns, Table
from metrocli.units import Range
from metrocli.words import composed

COLUMNS = Columns(
    (
        Column("image", TEXT),
        Column("target", TEXT),
        Column("u", "pixel"),
        Column("sigma", "length", required=False, may_be_empty=True),
        Column("t", "time", required=False),
        Column("repeat", WHOLE, required=False),
        Column("scale", NUMBER, required=False),
    ),
    key=("image", "target"),
)
HEAD = "image,target,u_px\n"


def read(folder: Path, text: str | bytes, columns: Columns = COLUMNS) -> Table:
    path = folder / "obs.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return csv.read(path, columns, "obs.csv")


def faults(folder: Path, text: str | bytes, columns: Columns = COLUMNS) -> str:
    with pytest.raises(InputError) as caught:
        read(folder, text, columns)
    return str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "image,target,u_px,t_min\na,1,2.5,3\n",
        "image;target;u_px;t_min\r\na;1;2.5;3\r\n",
        "image\ttarget\tu_px\tt_min\na\t1\t2.5\t3",
        "\ufeff# made by hand\n\nimage, target, u_px, t_min\n# a comment, with commas, in it, and more, of them\n a ,1, 2.5 ,3\n\n",
        't_min,"u_px",target,image\n3,"2.5",1,"a"\n',
        "image,target,u_px,t_min\ra,1,2.5,3\r",
        "image,target,u_px,t_s\na,1,25e-1,180\n",
        "image,target,u_px,t_h\na,1,+2.5,0.05\n",
        'image,target,u_px,t_min\n# of "LT1", "LT2\n"a",1,2.5,3\n\n  # and "LT3"\n',
        'image,target,u_px,t_min\n#,"a\na,1,2.5,3\n#",""\n',
    ],
)
def test_forms_of_the_same_table(tmp_path: Path, text: str) -> None:
    table = read(tmp_path, text)
    assert table.texts("image") == ["a"]
    assert table.texts("target") == ["1"]
    assert table.numbers("u").tolist() == [2.5]
    assert table.numbers("t") == pytest.approx([180.0])
    assert table.units == {"u": "px", "t": "s"}
    assert table.warnings == ()


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1.0), ("m", 1e3), ("um", 1e-3), ("nm", 1e-6)])
def test_each_unit_of_a_length(tmp_path: Path, unit: str, factor: float) -> None:
    table = read(tmp_path, f"l_{unit}\n3\n", Columns((Column("l", "length"),)))
    assert table.numbers("l") == pytest.approx([3 * factor], rel=1e-15)


def test_an_empty_cell_is_nan_only_where_it_may_be(tmp_path: Path) -> None:
    table = read(tmp_path, "image,target,u_px,sigma_um\na,1,2,\na,2,2,5\n")
    assert math.isnan(table.numbers("sigma")[0])
    assert table.numbers("sigma")[1] == pytest.approx(0.005)


def test_rows_know_their_line(tmp_path: Path) -> None:
    assert list(read(tmp_path, "# c\n" + HEAD + "\na,1,2\n# c\nb,1,2\n").lines) == [4, 6]


def test_unknown_columns_are_a_warning(tmp_path: Path) -> None:
    table = read(tmp_path, "image,target,u_px,note,sgma_mm\na,1,2,x,3\n")
    assert table.warnings == (
        "obs.csv: the column 'note' is not used",
        "obs.csv: the column 'sgma_mm' is not used; did you mean 'sigma_mm'?",
    )


BROKEN = {
    "empty": ("", "1:1", "the file is empty", "header"),
    "only comments": ("# a\n\n", "1:1", "the file is empty", ""),
    "only a header": (HEAD, "1:1", "there is a header and no row", ""),
    "no header": ("a,1,2\nb,1,2\n", "1:1", "the column 'image' is missing", ""),
    "only numbers": ("3,1,2\n4,1,2\n", "1:1", "the columns have no names", "first line"),
    "binary": (b"\x89PNG\r\n\x1a\n\0\0", "3:1", "not a text file", ""),
    "utf-16": ("image,target".encode("utf-16"), "1:1", "not a text file", "UTF-8"),
    "latin-1": (HEAD.encode() + b"\xb5,1,2\n", "2:1", "not text in UTF-8", ""),
    "missing column": ("image,target,v_px\na,1,2\n", "1:1", "the column 'u_px' is missing", "accepted: u_px"),
    "misspelt column": ("imag,target,u_px\na,1,2\n", "1:1", "the column 'image' is missing", "'imag'"),
    "no unit": ("image,target,u\na,1,2\n", "1:14", "the column 'u' has no unit", "accepted: u_px"),
    "no unit, not required": (
        "image,target,u_px,sigma\na,1,2,3\n", "1:19", "'sigma' has no unit", "sigma_mm, sigma_m, sigma_um, sigma_nm"),
    "wrong unit": ("image,target,u_mm\na,1,2\n", "1:14", "'u_mm' does not name a distance in the image", "u_px"),
    "unit in brackets": ("image,target,u [px]\na,1,2\n", "1:14", "'u [px]' does not name", "u_px"),
    "two units": ("image,target,u_px,t_s,t_min\na,1,2,3,4\n", "1:23", "two columns hold the same quantity: t_s and t_min", "one"),
    "column twice": ("image,target,u_px,image\na,1,2,a\n", "1:19", "the column 'image' is there twice", ""),
    "column without name": ("image,target,u_px,\na,1,2,5\n", "1:19", "a column has no name", ""),
    "too few cells": (HEAD + "a,1\n", "2:4", "cells in this row: 2; columns in the header: 3", "image, target, u_px"),
    "too many cells": (HEAD + "a,1,2,3\n", "2:7", "cells in this row: 4; columns in the header: 3", "decimal comma"),
    "time of day": ("image,target,u_px,t_s\na,1,2,14:05:08\n", "2:7", "'14:05:08' is not a number", "write the time since one moment"),
    "decimal comma": ("image;target;u_px\na;1;0,5\n", "2:5", "'0,5' is not a number", "write 0.5"),
    "nan": (HEAD + "a,1,2\na,2,NaN\n", "3:5", "column 'u_px': 'NaN' is not a finite number", ""),
    "infinity": (HEAD + "a,1,-inf\n", "2:5", "'-inf' is not a finite number", ""),
    "too large": (HEAD + "a,1,1e999\n", "2:5", "'1e999' is not a finite number", ""),
    "underscore": (HEAD + "a,1,1_0\n", "2:5", "'1_0' has an underscore", "write 10"),
    "full-width digits": (HEAD + "a,1,４.７\n", "2:5", "'４.７' has digits that are not ASCII", "0 to 9"),
    "full-width whole": ("image,target,u_px,repeat\na,1,2,３\n", "2:7", "'３' has digits that are not ASCII", "0 to 9"),
    "inches": ("image,target,u_px,sigma_in\na,1,2,3\n", "1:19", "'sigma_in' is in inches", "write sigma_mm, with the numbers times 25.4"),
    "overload": (HEAD + "a,1,9.9e37\n", "2:5", "9.9e37 is beyond what it can hold, -10000000 to 10000000 px", "overload marker"),
    "overload without a unit": ("image,target,u_px,scale\na,1,2,-9.9e37\n", "2:7", "column 'scale': -9.9e37 is beyond", "overload"),
    "length": ("image,target,u_px,sigma_m\na,1,2,\nb,1,2,-10001\n", "3:7", "-10001 is beyond what it can hold, -10000 to 10000 m",
               "allow it in the job: ranges: {sigma: -10001 m}"),
    "word": (HEAD + "a,1,left\n", "2:5", "'left' is not a number", ""),
    "empty cell": (HEAD + "a,1,\n", "2:5", "column 'u_px': an empty cell", ""),
    "empty text": (HEAD + "a,,2\n", "2:3", "column 'target': an empty cell", ""),
    "nan where empty is allowed": ("image,target,u_px,sigma_mm\na,1,2,nan\n", "2:7", "'nan' is not a finite", ""),
    "not whole": ("image,target,u_px,repeat\na,1,2,1.5\n", "2:7", "'1.5' is not a whole number", ""),
    "whole too large": ("image,target,u_px,repeat\na,1,2,99999999999999999999\n", "2:7", "not a finite", ""),
    "repeated key": (HEAD + "a,1,2\nb,1,2\na,1,3\n", "4:1", "image a, target 1: a second row", "first in line 2, with other values: leave the wrong row out, or give it another image or target"),
    "row twice": ("image,target,u_px,sigma_mm\na,1,2,\na,1,2,\n", "3:1", "image a, target 1: a second row", "with the same values: leave it out"),
    "open quote": (HEAD + 'a,1,2\n"b,1,2\n', "3:1", "quotation mark", ""),
    "long text": (HEAD + f"{'a' * 300},1,2\n", "2:1", "more than 200 characters", ""),
    "number of two lines": (HEAD + '"a",1,"2\n5"\n', "2:7", "'2 5' is not a number", ""),
    "after a quoted comma": (HEAD + '"a,b",1,x\n', "2:9", "'x' is not a number", ""),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_refused_in_its_place(tmp_path: Path, name: str) -> None:
    text, place, message, hint = BROKEN[name]
    told = faults(tmp_path, text)
    assert f"obs.csv:{place}: error: " in told
    assert message in told
    assert hint in told


def test_all_faults_are_told_in_the_order_of_the_file(tmp_path: Path) -> None:
    told = faults(tmp_path, HEAD + "a,1,x\n,2,3\nb,1,nan\n")
    assert [line[:11] for line in told.splitlines() if "error" in line] == ["obs.csv:2:5", "obs.csv:3:1", "obs.csv:4:5"]


@pytest.mark.parametrize("quoted", ["b", '"b"'])
def test_a_row_of_too_few_cells_hides_no_other_fault(quoted: str, tmp_path: Path) -> None:
    told = faults(tmp_path, HEAD + f"a,1,nan\n{quoted},1\na,2,3\nb,2,x\n")
    assert [line[:9] for line in told.splitlines() if "error" in line] == ["obs.csv:2", "obs.csv:3", "obs.csv:5"]


def test_values_at_the_ends_of_a_range_are_read(tmp_path: Path) -> None:
    columns = Columns((Column("a", "angle"), Column("x", "length"), Column("temp", "temperature"), Column("n", WHOLE)))
    table = read(tmp_path, "a_deg,x_m,temp_K,n\n720,10000,0,999999999\n-720,-10000,2000,-5\n", columns)
    assert table.numbers("a") == pytest.approx([4 * math.pi, -4 * math.pi])
    assert table.numbers("temp")[0] == pytest.approx(-273.15)


def test_a_range_of_its_own_replaces_that_of_the_dimension(tmp_path: Path) -> None:
    columns = Columns((Column("a", "angle", allowed=Range(-50.0, 50.0)),))
    assert read(tmp_path, "a_rad\n49\n", columns).numbers("a").tolist() == [49.0]
    assert "51 is beyond what it can hold, -50 to 50 rad" in faults(tmp_path, "a_rad\n51\n", columns)


def test_very_many_faults_are_counted(tmp_path: Path) -> None:
    told = faults(tmp_path, HEAD + "".join(f"a,{n},x\n" for n in range(100)))
    assert told.count("error:") == csv_text.MOST_FAULTS + 1
    assert "and 80 more faults from here on" in told


def test_a_header_of_very_many_columns_is_refused_at_once(tmp_path: Path) -> None:
    wide = ",".join(f"c{n}_mm" for n in range(csv_text.MOST_COLUMNS + 1))
    text = faults(tmp_path, f"# a comment\n{wide}\n{wide}\n")
    assert text.startswith("obs.csv:2: error: the header has 5001 columns, more than 5000")
    assert len(text) < 400, "the header itself is not shown"


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        csv.read(tmp_path / "none.csv", COLUMNS)
    with pytest.raises(InputError, match="folder"):
        csv.read(tmp_path, COLUMNS)


FINITE = st.floats(-1e7, 1e7)
NAMES = texts(8, min_size=1, of=lambda one: category(one) not in ("Cc", "Zs", "Zl", "Zp")).map(
    composed  # the form in which names are read
)


@given(
    st.integers(1, 6).flatmap(
        lambda n: st.tuples(arrays(float, n, elements=FINITE), st.lists(NAMES, min_size=n, max_size=n))
    )
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_what_is_written_reads_back_exactly(tmp_path: Path, columns: tuple[np.ndarray, list[str]]) -> None:
    numbers, names = columns
    table = Table({"name": np.array(names), "x": numbers}, {"x": "mm"})
    path = tmp_path / "there.csv"
    csv.write(path, table)
    back = csv.read(path, Columns((Column("name", TEXT), Column("x", "length"))))
    assert back.texts("name") == names
    assert back.numbers("x").tolist() == numbers.tolist()


@given(st.binary(max_size=60))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_any_bytes_are_read_or_refused(tmp_path: Path, data: bytes) -> None:
    try:
        read(tmp_path, HEAD.encode() + data)
    except InputError as error:
        assert "obs.csv:" in str(error)


def test_a_table_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="cannot be written"):
        csv.write(tmp_path / "file" / "t.csv", Table({"x": np.array([1.0])}))
    assert (tmp_path / "file").read_text() == "x"


@pytest.mark.parametrize("before", [["report of Monday"], ["report", "by Anna"]])
def test_a_header_stands_below_the_lines_of_an_instrument(before: list[str]) -> None:
    lines = [*before, "point,x_mm,y_mm", "a,1,2", "b,3,4"]
    assert later_header(list(enumerate(lines, start=1))) == len(before) + 1


def test_where_every_column_is_wanted_each_has_the_kind_of_its_cells(tmp_path: Path) -> None:
    table = read(tmp_path, "part,l_mm,note\na,1.5,7\nb,2.5,late\n", Columns((), (), "readings", every=True))
    assert (table.texts("part"), table.texts("note")) == (["a", "b"], ["7", "late"])
    assert table.numbers("l_mm").tolist() == [1.5, 2.5]


def test_a_repeated_row_is_named_with_the_numbers_of_its_file(tmp_path: Path) -> None:
    """A time of 3 min was 180.0, in the unit of the program."""
    keyed = Columns(COLUMNS.columns, key=("image", "target", "t", "scale"))
    found = faults(tmp_path, "image,target,u_px,t_min,scale\na,1,2,3,1\na,1,2,3,1\n", keyed)
    assert "image a, target 1, t 3 min, scale 1: a second row" in found


def test_a_whole_number_may_have_a_point(tmp_path: Path) -> None:
    """Programs that write a column with an empty cell write 2.0 for 2."""
    table = read(tmp_path, "image,target,u_px,repeat\na,1,2,2.0\nb,1,2,-3.\n")
    assert table.columns["repeat"].tolist() == [2, -3]
    assert "'2.01' is not a whole number" in faults(tmp_path, "image,target,u_px,repeat\na,1,2,2.01\n")
