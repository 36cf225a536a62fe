"""Result files that metrocli did not write, or not so: no flipped bit is believed, and no file can do harm."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from resealing import resealed

from metrocli.errors import InputError
from metrocli.formats import hdf5
from metrocli.record import CriterionVerdict, InputFile, Record
from metrocli.result import Estimate, Result, ShownTable
from metrocli.table import Table

RESULT = Result(
    kind="align-part",
    title="part",
    estimates=(Estimate("x", 1.5, 0.1, "mm"), Estimate("y", 0.1, 0.001, "rad")),
    covariance=np.array([[0.01, 1e-5], [1e-5, 1e-6]]),
    statistics={"observations": 10, "sigma0": 1.25, "rms": {"px": 0.1}},
    tables={
        "residuals": Table({"image": np.array(["a", "b"]), "residual": np.array([0.1, np.nan])}, {"residual": "px"})
    },
    arrays={"points_covariance": np.stack([np.eye(3), np.diag([1.0, 4.0, 9.0])])},
    shown=(ShownTable("residuals"),),
)
RECORD = Record("metrocli: 1\n", (InputFile("obs.csv", "ab" * 32, 12),), "0.1.0", "2026-01-02T03:04:05Z",
                (CriterionVerdict("sigma0", "< 1.5", 1.25, "", True),))  # fmt: skip


def written(folder: Path) -> Path:
    hdf5.write(folder / "r.h5", RESULT, RECORD)
    return folder / "r.h5"


def test_no_flipped_bit_is_believed(tmp_path: Path) -> None:
    path = written(tmp_path)
    whole = path.read_bytes()
    random = np.random.default_rng(1)
    for at in [*range(0, 8 * 90, 5), *random.integers(8 * len(whole), size=150).tolist()]:
        damaged = bytearray(whole)
        damaged[at // 8] ^= 1 << at % 8
        path.write_bytes(damaged)
        for reader in (hdf5.read, hdf5.read_record, hdf5.read_label):
            with pytest.raises(InputError, match=r"r\.h5"):
                reader(path)
        assert hdf5.kind_of(path) == "", "the next run replaces it"


def test_an_edited_file_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path)
    with h5py.File(path, "a") as file:
        file["parameters"][0] = (b"x", 99.0, 0.1, b"mm")
    with pytest.raises(InputError, match="damaged or was edited"):
        hdf5.read(path)


def test_a_missing_object_is_a_fault_of_the_file(tmp_path: Path) -> None:
    result, _ = hdf5.read(written(tmp_path))
    asked: list[tuple[str, Callable[[], object]]] = [
        ("table tables/EYZ", lambda: result.tables["tables/EYZ"]),
        ("array owed", lambda: result.arrays["owed"]),
        ("column residuals/sigma", lambda: result.tables["residuals"].numbers("sigma")),
    ]
    for name, ask in asked:
        with pytest.raises(InputError, match=rf"r\.h5: error: the result file has no {name}"):
            ask()
    assert result.tables["residuals"].numbers("sigma", 1.0).tolist() == [1.0, 1.0]


def test_a_pipe_and_a_device_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    for path in (tmp_path / "pipe.h5", Path("/dev/zero")):
        with pytest.raises(InputError, match="a pipe or a device"):
            hdf5.read(path)


def test_a_result_that_comes_out_the_same_is_not_touched(tmp_path: Path) -> None:
    path, record = tmp_path / "r.h5", dataclasses.replace(RECORD, content="digest of the values")
    assert hdf5.write(path, RESULT, record)
    os.utime(path, ns=(1, 1))
    first = path.read_bytes()
    assert not hdf5.write(path, RESULT, dataclasses.replace(record, created="2030-01-01T00:00:00Z"))
    assert (path.read_bytes(), path.stat().st_mtime_ns) == (first, 1)
    assert not hdf5.write(path, RESULT, dataclasses.replace(record, metrocli_version="0.1.1"))
    assert (hdf5.read_label(path).metrocli_version, path.stat().st_mtime_ns) == ("0.1.1", 1)
    assert hdf5.write(path, RESULT, dataclasses.replace(record, content="another"))
    assert path.stat().st_mtime_ns > 1


def linked(file: h5py.File) -> None:
    del file["points_covariance"]
    file["points_covariance"] = h5py.ExternalLink("secret.h5", "/secret")


def stored_elsewhere(file: h5py.File) -> None:
    del file["notes"]
    file.create_dataset("notes", shape=(5,), dtype="S8", external=[("secret.txt", 0, 40)])


def declared_huge(file: h5py.File) -> None:
    del file["points_covariance"]
    file.create_dataset("points_covariance", shape=(1 << 40, 3, 3), dtype="f8")


def packed_huge(file: h5py.File) -> None:
    file.create_dataset("zeros", data=np.zeros((1000, 1000)), compression="gzip")


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout(shape=(3,), dtype="f8")
    layout[:] = h5py.VirtualSource("secret.h5", "/secret", shape=(3,))
    file.create_virtual_dataset("virtual", layout)


def circle(file: h5py.File) -> None:
    file["effects/again"] = file["effects"]


def group_for_dataset(file: h5py.File) -> None:
    del file["parameters"]
    file.create_group("parameters")


def text_for_numbers(file: h5py.File) -> None:
    del file["covariance"]
    file["covariance"] = np.array([[b"a", b"b"], [b"c", b"d"]])


def texts_for_estimates(file: h5py.File) -> None:
    units = file["parameters"].attrs["units"]
    rows = np.array([(b"x", b"1", b"1", b"mm")] * 2, dtype=[(n, "S2") for n in ("name", "value", "std", "unit")])
    del file["parameters"]
    file["parameters"] = rows
    file["parameters"].attrs["units"] = units
    file["parameters"][1] = (b"y", b"??", b"1", b"mm")


def reference_in_statistics(file: h5py.File) -> None:
    file["statistics"].attrs["sigma0"] = file["covariance"].ref


def other_title(file: h5py.File) -> None:
    file.attrs["title"] = np.arange(4)


def unknown_dimension(file: h5py.File) -> None:
    file["parameters"].attrs["dimensions"] = ["lightyears", ""]


def asymmetric(file: h5py.File) -> None:
    file["covariance"][0, 1] = 0.0


def not_positive(file: h5py.File) -> None:
    file["covariance"][...] = [[0.01, 2e-4], [2e-4, 1e-6]]


def other_variance(file: h5py.File) -> None:
    file["covariance"][0, 0] = 0.02


def negative_variance(file: h5py.File) -> None:
    file["points_covariance"][1, 2, 2] = -9.0


def too_few_rows(file: h5py.File) -> None:
    del file["covariance"]
    file["covariance"] = np.eye(1) * 0.01


HARMFUL = {
    linked: "link to elsewhere", stored_elsewhere: "in another file", declared_huge: "not the values", packed_huge: "in pieces",
    virtual: "in pieces", circle: "one object under two names", group_for_dataset: "damaged", text_for_numbers: "damaged",
    texts_for_estimates: "damaged", reference_in_statistics: "neither number nor text", other_title: "not a text",
    unknown_dimension: "lightyears", asymmetric: "not symmetric", not_positive: "not positive",
    other_variance: "contradicts the standard uncertainties", negative_variance: "negative variance",
    too_few_rows: "another size than the parameters",
}  # fmt: skip


@pytest.mark.parametrize("change", HARMFUL, ids=lambda change: change.__name__)
def test_a_file_made_to_harm_is_refused(change: Callable[[h5py.File], None], tmp_path: Path) -> None:
    """The seal is not a secret: what is behind it is checked as well."""
    path = written(tmp_path)
    (path.parent / "secret.txt").write_text("forty letters that nobody else shall see")
    with h5py.File(path.parent / "secret.h5", "w") as file:
        file["secret"] = np.arange(3.0)
    resealed(path)
    hdf5.read(path)
    resealed(path, change)
    with pytest.raises(InputError, match=HARMFUL[change]):
        hdf5.read(path)


def test_a_label_that_contradicts_the_file_is_refused(tmp_path: Path) -> None:
    for label in ({"status": "doubtful"}, {"kind": "multilaterate"}, {"inputs": ()}):
        path = written(tmp_path)
        resealed(path, **label)
        with pytest.raises(InputError):
            hdf5.read(path)


def test_covariances_of_what_is_not_determined_are_left_out(tmp_path: Path) -> None:
    estimates = (*RESULT.estimates, Estimate("z", 0.0, np.inf, "mm"))
    covariance = np.full((3, 3), np.nan)
    covariance[:2, :2] = RESULT.covariance
    hdf5.write(tmp_path / "r.h5", dataclasses.replace(RESULT, estimates=estimates, covariance=covariance), RECORD)
    assert hdf5.read(tmp_path / "r.h5")[0].estimates == estimates


@pytest.mark.parametrize("text", ["[]", '{"number": 1}', '{"laboratory": "L"}', '{"item": {"name": ["x"]}}', "{"])
def test_a_certificate_holds_texts_only(tmp_path: Path, text: str) -> None:
    path = tmp_path / "r.h5"
    stated = {"number": "1", "item": {"name": "Prüfling"}, "references": {"a/b.csv": "2"}}
    hdf5.write(path, RESULT, dataclasses.replace(RECORD, certificate=stated))
    found, record = hdf5.read(path)
    assert record.certificate == stated and "certificate" not in found.arrays

    def change(file: h5py.File) -> None:
        del file["certificate"]
        file.create_dataset("certificate", data=text, dtype=h5py.string_dtype("utf-8"))

    resealed(path, change)
    with pytest.raises(InputError, match="damaged"):
        hdf5.read(path)
