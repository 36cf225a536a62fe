"""A result as the HDF5 part of its file, written in memory: a full disk cannot stop the HDF5 library halfway."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import h5py
import numpy as np

from metrocli.formats.seal import FORMAT, VERSION
from metrocli.record import Record
from metrocli.result import Result, ShownTable
from metrocli.table import Table, ascii_letters

_TEXT = h5py.string_dtype("utf-8")
_SCALING = (  # of the covariance, for noise declared, estimated, structured
    "for the declared noise", "scaled by sigma0 squared, because the noise was estimated",
    "for the noise estimated from the residuals, and errors that readings share")  # fmt: skip


def image_of(result: Result, record: Record) -> bytes:
    """Return the HDF5 part of a result file."""
    with h5py.File("result", "w", driver="core", backing_store=False) as file:
        _write_all(file, result, record)
        file.attrs["complete"] = True
        file.flush()
        image: bytes = file.id.get_file_image()
    return image


def _write_all(file: h5py.File, result: Result, record: Record) -> None:
    attributes = {
        "format": FORMAT, "version": VERSION, "kind": result.kind, "title": result.title,
        "metrocli_version": record.metrocli_version, "created": record.created, "NX_class": "NXroot",
        "status": record.status,
    }  # fmt: skip
    for name, value in attributes.items():
        file.attrs[name] = value
    _write_texts(file, "job", record.job_text)
    if record.certificate:
        _write_texts(file, "certificate", json.dumps(record.certificate, ensure_ascii=False))
    columns = ("path", "sha256", "bytes", "content")
    _write_table(file, "inputs", _table_of([asdict(item) for item in record.inputs], columns))
    _write_table(file, "parameters", _table_of([asdict(e) for e in result.estimates], ("name", "value", "std", "unit")))
    file["parameters"].attrs["dimensions"] = _texts([estimate.dimension for estimate in result.estimates])
    covariance = file.create_dataset("covariance", data=np.asarray(result.covariance, dtype=float))
    covariance.attrs["of"] = _texts([estimate.name for estimate in result.estimates])
    covariance.attrs["scaling"] = _SCALING[len({"noise_estimated", "noise_model"} & set(result.statistics))]
    _write_values(file.create_group("statistics"), result.statistics)
    file.create_group("effects")
    if result.details:
        _write_values(file.create_group("details"), result.details)
    for name, table in sorted(result.tables.items()):
        _write_table(file, name, table)
    for name, array in sorted(result.arrays.items()):
        file.create_dataset(name, data=array)
    verdicts = ("name", "condition", "value", "unit", "met", "decision")
    _write_table(file, "requirements", _table_of([asdict(verdict) for verdict in record.verdicts], verdicts))
    for name, lines in (("warnings", result.warnings), ("notes", result.notes), ("doubts", record.doubts)):
        _write_texts(file, name, lines)
    file.attrs["shown"] = _texts([_shown_text(shown) for shown in result.shown])
    _write_plot(file, result)


def _texts(values: Sequence[str]) -> Any:
    return np.array(list(values), dtype=_TEXT)


def _write_texts(file: h5py.File, name: str, value: str | Sequence[str]) -> None:
    data = value if isinstance(value, str) else _texts(value)
    file.create_dataset(name, data=data, dtype=_TEXT)


def _write_values(group: h5py.Group, values: Mapping[str, Any]) -> None:
    """Write values and lists as attributes of a group, and mappings as subgroups with attributes."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            _write_values(group.create_group(name), value)
        else:
            group.attrs[name] = value


def _write_plot(file: h5py.File, result: Result) -> None:
    """Write the default plot for viewers (NeXus): the normalised residuals, else the residuals, else the estimates."""
    residuals = result.tables.get("residuals")
    column = next((name for name in ("normalised", "residual") if residuals is not None and name in residuals), None)
    group = file.create_group("plot")
    group.attrs["NX_class"] = "NXdata"
    if residuals is not None and column is not None:
        data = group.create_dataset(column, data=residuals.numbers(column))
        data.attrs["units"] = residuals.units.get(column, "1")
    else:
        column = "estimates"
        group.create_dataset(column, data=np.array([estimate.value for estimate in result.estimates], dtype=float))
    group.attrs["signal"] = column
    file.attrs["default"] = "plot"


def _table_of(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> Table:
    # without rows numpy would take a column for numbers
    kind = None if rows else np.str_
    return Table({name: np.array([row[name] for row in rows], dtype=kind) for name in names})


def _write_table(file: h5py.File, name: str, table: Table) -> None:
    """Write a table as one compound dataset; its attribute `units` holds one unit per column, empty for none."""
    columns = {column: _storable(table.columns[column]) for column in table}
    rows = np.empty(len(table), dtype=[(column, values.dtype) for column, values in columns.items()])
    for column, values in columns.items():
        rows[column] = values
    data = file.create_dataset(name, data=rows)
    data.attrs["units"] = _texts([table.units.get(column, "") for column in table])


def _storable(values: Any) -> Any:
    """Return a column as it is stored: text becomes UTF-8 of fixed length, that of the longest text."""
    if values.dtype.kind != "U":
        return values
    letters = ascii_letters(values)
    if letters is None:
        encoded = np.char.encode(values, "utf-8")
        letters = np.ascontiguousarray(encoded).view(np.uint8).reshape(values.size, encoded.dtype.itemsize)
    # one letter at least: HDF5 has no texts of length 0
    longest = next((k for k in range(letters.shape[1], 1, -1) if letters[:, k - 1].any()), 1)
    kept = np.ascontiguousarray(letters[:, :longest])
    return kept.view(h5py.string_dtype("utf-8", longest)).ravel()


def _shown_text(shown: ShownTable) -> str:
    """Return a shown table as text for the file: `name`, or `name: column, column`."""
    return f"{shown.name}: {', '.join(shown.columns)}" if shown.columns else shown.name
