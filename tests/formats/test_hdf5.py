"""Result files: the layout that others read, whole or not at all, the same bytes for the same result."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from metrocli.errors import InputError
from metrocli.formats import hdf5
from metrocli.record import CriterionVerdict, InputFile, Record
from metrocli.result import Estimate, Result, ShownTable
from metrocli.table import Table

RESULT = Result(
    kind="align-part",
    title="Gehäuse µ",
    estimates=(Estimate("x", 1.5, 0.1, "mm"), Estimate("gamma_s", 0.1, 0.001, "rad")),
    covariance=np.array([[0.01, 1e-5], [1e-5, 1e-6]]),
    statistics={
        "observations": 10,
        "sigma0": 1.25,
        "p_value": 0.5,
        "rms": {"px": 0.1},
        "robust": True,
        "datum": "points",
    },
    tables={
        "residuals": Table(
            {"image": np.array(["a", "ß"]), "residual": np.array([0.1, np.nan]), "used": np.array([True, False])},
            {"residual": "px"},
        ),
        "tables/EXX": Table({"position": np.array([1.0]), "n": np.array([3])}, {"position": "mm"}),
        "empty": Table({"name": np.array([], dtype=np.str_), "x": np.array([])}, {"x": "mm"}),
    },
    arrays={"points_covariance": np.stack([np.eye(3), np.diag([1.0, 4.0, 9.0])])},
    warnings=("one", "zwölf"),
    shown=(ShownTable("residuals"),),
    notes=("R = [[1, 0], …]",),
)
RECORD = Record(
    job_text="metrocli: 1\n# Kommentar µ\n",
    inputs=(InputFile("obs.csv", "ab" * 32, 12),),
    metrocli_version="0.1.0",
    created="2026-01-02T03:04:05Z",
    verdicts=(CriterionVerdict("sigma0", "< 1.5", 1.25, "", True),),
)


def written(folder: Path) -> Path:
    path = folder / "results" / "r.h5"
    hdf5.write(path, RESULT, RECORD)
    return path


def same(a: object, b: object) -> bool:
    """Compare values deeply; NaN equals NaN."""
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f") and a.dtype.kind == b.dtype.kind
    return a == b


def test_a_result_reads_back_as_it_was(tmp_path: Path) -> None:
    result, record = hdf5.read(written(tmp_path))
    assert same(RESULT, result)
    assert record == RECORD
    assert hdf5.read_record(tmp_path / "results" / "r.h5") == ("align-part", RECORD)


def test_the_comparison_of_these_tests_sees_a_difference() -> None:
    assert not same(RESULT, dataclasses.replace(RESULT, covariance=RESULT.covariance * 2))
    assert not same(RESULT, dataclasses.replace(RESULT, tables={}))


def test_the_layout_is_plain_hdf5(tmp_path: Path) -> None:
    with h5py.File(written(tmp_path)) as file:
        for name, value in {
            "format": "metrocli-result", "version": 1, "kind": "align-part", "title": "Gehäuse µ", "complete": True,
            "metrocli_version": "0.1.0", "created": "2026-01-02T03:04:05Z", "NX_class": "NXroot", "default": "plot",
        }.items():  # fmt: skip
            assert file.attrs[name] == value
        assert file["job"].asstr()[()] == RECORD.job_text
        assert file["inputs"].dtype.names == ("path", "sha256", "bytes", "content")
        assert file["parameters"].dtype.names == ("name", "value", "std", "unit")
        assert file["parameters"]["name"].tolist() == [b"x", b"gamma_s"]
        assert (
            file["parameters"].dtype["name"].metadata == {"h5py_encoding": "utf-8"}
            or h5py.check_string_dtype(file["parameters"].dtype["name"]).encoding == "utf-8"
        )
        assert file["covariance"].shape == (2, 2)
        assert list(file["residuals"].attrs["units"]) == ["", "px", ""]
        assert dict(file["statistics"].attrs)["sigma0"] == 1.25
        assert file["statistics/rms"].attrs["px"] == 0.1
        assert isinstance(file["effects"], h5py.Group)
        assert file["tables/EXX"]["position"].tolist() == [1.0]
        assert file[file.attrs["default"]].attrs["NX_class"] == "NXdata"
        assert file["plot"].attrs["signal"] in file["plot"]


def test_the_same_result_gives_the_same_bytes(tmp_path: Path) -> None:
    first = written(tmp_path).read_bytes()
    time.sleep(1.1)  # longer than the clock of an HDF5 timestamp ticks
    assert written(tmp_path).read_bytes() == first


def test_nothing_else_is_left_in_the_folder(tmp_path: Path) -> None:
    assert [path.name for path in written(tmp_path).parent.iterdir()] == ["r.h5"]


def test_a_failure_leaves_what_was_there(tmp_path: Path) -> None:
    path = written(tmp_path)
    before = path.read_bytes()
    broken = dataclasses.replace(RESULT, arrays={"x": object()})
    with pytest.raises(TypeError):
        hdf5.write(path, broken, RECORD)
    assert path.read_bytes() == before
    assert [path.name for path in path.parent.iterdir()] == ["r.h5"]


@pytest.mark.parametrize("length", [0, 1, 7, 100, 600, 700, 2000, -1])
def test_a_truncated_file_is_refused(tmp_path: Path, length: int) -> None:
    path = written(tmp_path)
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(InputError, match=r"r\.h5: error: the result file is damaged"):
        hdf5.read(path)


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.h5"
    with pytest.raises(InputError, match="no such file"):
        hdf5.read(path)
    path.write_text("hello")
    with pytest.raises(InputError, match="not a result file"):
        hdf5.read(path)
    assert hdf5.kind_of(path) is None
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "other"
    with pytest.raises(InputError, match="not a result file of metrocli"):
        hdf5.read(path)
    assert hdf5.kind_of(path) is None


def test_a_newer_format_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_bytes(path.read_bytes().replace(b"metrocli-result 1 ", b"metrocli-result 2 ", 1))
    with pytest.raises(InputError, match="version 2"):
        hdf5.read(path)


KILLED = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from test_hdf5 import RESULT, RECORD
import dataclasses, numpy as np
from metrocli.formats import hdf5
big = dataclasses.replace(RESULT, arrays={"big": np.random.default_rng(0).normal(size=1_000_000)})
print("ready", flush=True)
while True:
    hdf5.write(Path(sys.argv[1]), big, RECORD)
"""


def test_kill_at_any_moment_leaves_a_whole_result_or_none(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path), str(Path(__file__).parent)], stdout=subprocess.PIPE
    )
    assert process.stdout is not None
    process.stdout.readline()
    random = np.random.default_rng(0)
    while not path.exists():
        time.sleep(0.01)
    for _ in range(8):
        time.sleep(float(random.uniform(0.005, 0.06)))
        os.kill(process.pid, signal.SIGSTOP)  # as good as killed for who reads now
        if path.exists():
            assert len(hdf5.read(path)[0].arrays["big"]) == 1_000_000
        os.kill(process.pid, signal.SIGCONT)
    process.kill()
    process.wait()
    process.stdout.close()
    assert path.exists()
    assert len(hdf5.read(path)[0].arrays["big"]) == 1_000_000


@pytest.mark.parametrize(
    ("texts", "size"), [(["abcdef", "a", "bcd"], 3), (["abcdef", "ß", "€"], 3), (["abcdef", "", ""], 1)]
)
def test_a_text_column_is_as_wide_as_its_longest_text(tmp_path: Path, texts: list[str], size: int) -> None:
    """In bytes of UTF-8; the column was cut from one with longer texts."""
    column = np.array(texts)[1:]
    hdf5.write(tmp_path / "r.h5", dataclasses.replace(RESULT, tables={"names": Table({"name": column})}), RECORD)
    with h5py.File(tmp_path / "r.h5") as file:
        assert file["names"].dtype["name"].itemsize == size
    assert hdf5.read(tmp_path / "r.h5")[0].tables["names"].texts("name") == texts[1:]


def test_others_find_numbers_as_numbers_and_empty_lists_as_text(tmp_path: Path) -> None:
    hdf5.write(tmp_path / "r.h5", RESULT, dataclasses.replace(RECORD, verdicts=()))
    with h5py.File(tmp_path / "r.h5") as file:
        assert file["parameters"].dtype["value"].kind == "f"
        assert file["requirements"].dtype["name"].kind in "SO"
