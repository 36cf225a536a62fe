"""Result files in HDF5, readable with h5py, h5ls and MATLAB without metrocli; written completely or not at all.

The same result gives the same bytes but for the attribute `created`: objects have no timestamps, names are sorted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from metrocli.doubt import doubts_of
from metrocli.errors import Fault, InputError
from metrocli.formats.aside import written_aside
from metrocli.record import InputFile, Record, Verdict
from metrocli.result import Estimate, Result, ShownTable
from metrocli.table import Table

FORMAT = "metrocli-result"
VERSION = 1
SIGNATURE = b"\x89HDF\r\n\x1a\n"
_TEXT = h5py.string_dtype("utf-8")
_OWN = ("job", "inputs", "parameters", "covariance", "statistics", "requirements", "warnings", "notes", "doubts")
_SCALING = (  # of the covariance, for noise declared, estimated, structured
    "for the declared noise", "scaled by sigma0 squared, because the noise was estimated",
    "for the noise estimated from the residuals, and errors that readings share")  # fmt: skip


def write(path: Path, result: Result, record: Record) -> None:
    """Write a result file to `path` and replace any file there; if writing fails, that file stays unchanged."""
    with written_aside(path) as aside:
        try:
            with h5py.File(aside, "w") as file:
                _write_all(file, result, record)
                file.attrs["complete"] = True
        except OSError as error:
            raise OSError(error.errno, f"{error}") from error


def _write_all(file: h5py.File, result: Result, record: Record) -> None:
    attributes = {
        "format": FORMAT, "version": VERSION, "kind": result.kind, "title": result.title,
        "metrocli_version": record.metrocli_version, "created": record.created, "NX_class": "NXroot",
        "status": record.status,
    }  # fmt: skip
    for name, value in attributes.items():
        file.attrs[name] = value
    _write_texts(file, "job", record.job_text)
    _write_table(file, "inputs", _table_of([asdict(item) for item in record.inputs], ("path", "sha256", "bytes")))
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
    verdicts = ("name", "condition", "value", "unit", "met")
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
    try:
        encoded = values.astype(np.bytes_)  # letters of ASCII only; many times faster
    except UnicodeEncodeError:
        encoded = np.char.encode(values, "utf-8")
    letters = (
        np.ascontiguousarray(encoded).view(np.uint8).reshape(encoded.size, -1) if encoded.size else np.zeros((1, 0))
    )
    longest = int(np.flatnonzero(letters.any(axis=0)).max(initial=0)) + 1
    return encoded.astype(h5py.string_dtype("utf-8", longest))


def read(path: Path, shown: str = "") -> tuple[Result, Record]:
    """Return the content of a result file.

    Raises InputError if it is not a result file, or if it is truncated, damaged or incomplete.
    """
    with _opened(path, shown or str(path)) as file:
        try:
            return _read_result(file), _read_record(file)
        except (KeyError, OSError, ValueError, RuntimeError, TypeError) as error:
            raise InputError([Fault(f"the result file is damaged: {error}", shown or str(path))]) from error


def read_record(path: Path, shown: str = "") -> tuple[str, Record]:
    """Return only the kind of job and the record of a result file; raises InputError as `read`."""
    with _opened(path, shown or str(path)) as file:
        try:
            return str(file.attrs["kind"]), _read_record(file)
        except (KeyError, OSError, ValueError, RuntimeError, TypeError) as error:
            raise InputError([Fault(f"the result file is damaged: {error}", shown or str(path))]) from error


def kind_of(path: Path) -> str | None:
    """Return the kind of job of a result file, "" if it is damaged or empty, None if it is not a result file.

    Raises InputError if it cannot be read.
    """
    head = _first_bytes(path, str(path))
    if not head:
        return ""
    if head != SIGNATURE:
        return None
    try:
        with h5py.File(path, "r") as file:
            return str(file.attrs.get("kind", "")) if file.attrs.get("format") == FORMAT else None
    except OSError:
        return ""


def _first_bytes(path: Path, shown: str) -> bytes:
    try:
        with path.open("rb") as raw:
            return raw.read(len(SIGNATURE))
    except OSError as error:
        raise InputError([Fault(f"cannot be read: {error.strerror}", shown)]) from error


def _opened(path: Path, shown: str) -> h5py.File:
    """Open a result file for reading; raises InputError if it is not complete or of an unknown version."""
    if path.is_dir():
        raise InputError([Fault("this is a folder, not a result file", shown)])
    if not path.is_file():
        raise InputError([Fault("there is no such file", shown)])
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        if _first_bytes(path, shown) == SIGNATURE:
            raise InputError([Fault("the result file is truncated or damaged; run its job again", shown)]) from error
        raise InputError([Fault("this is not a result file (HDF5)", shown)]) from error
    try:
        reason = _reason_to_refuse(file)
    except OSError:
        reason = "the result file is truncated or damaged; run its job again"
    if reason:
        file.close()
        raise InputError([Fault(reason, shown)])
    return file


def _reason_to_refuse(file: h5py.File) -> str:
    if file.attrs.get("format") != FORMAT:
        return "this HDF5 file is not a result of metrocli"
    if file.attrs.get("version", 0) > VERSION:
        return f"the file has version {file.attrs['version']} of the format; this metrocli reads up to {VERSION}"
    return "" if file.attrs.get("complete") else "the result file is incomplete; run its job again"


def _read_result(file: h5py.File) -> Result:
    columns = _read_table(file["parameters"]).columns
    count = len(columns["name"])
    dimensions = map(str, file["parameters"].attrs.get("dimensions", [""] * count))
    estimates = zip(columns["name"], columns["value"], columns["std"], columns["unit"], dimensions, strict=True)
    tables: dict[str, Table] = {}
    arrays: dict[str, Any] = {}
    file.visititems(lambda name, item: _sort_in(name, item, tables, arrays))
    return Result(
        kind=str(file.attrs["kind"]),
        title=str(file.attrs["title"]),
        estimates=tuple(Estimate(str(n), float(v), float(s), str(u), d) for n, v, s, u, d in estimates),
        covariance=file["covariance"][()],
        statistics=_read_values(file["statistics"]),
        tables=tables,
        arrays=arrays,
        warnings=_read_texts(file["warnings"]),
        shown=tuple(_shown_of(str(text)) for text in file.attrs["shown"]),
        notes=_read_texts(file["notes"]),
        details=_read_values(file["details"]) if "details" in file else {},
    )


def _shown_text(shown: ShownTable) -> str:
    """Return a shown table as text for the file: `name`, or `name: column, column`."""
    return f"{shown.name}: {', '.join(shown.columns)}" if shown.columns else shown.name


def _shown_of(text: str) -> ShownTable:
    name, _, columns = text.partition(":")
    return ShownTable(name, tuple(column.strip() for column in columns.split(",")) if columns else ())


def _sort_in(name: str, item: Any, tables: dict[str, Table], arrays: dict[str, Any]) -> None:
    if name in _OWN or name.startswith("plot/") or not isinstance(item, h5py.Dataset):
        return
    if item.dtype.names:
        tables[name] = _read_table(item)
    else:
        arrays[name] = item[()]


def _read_record(file: h5py.File) -> Record:
    inputs = _rows(file["inputs"])
    verdicts = tuple(Verdict(**row) for row in _rows(file["requirements"]))
    # files written before results had a status are judged by what they hold
    doubts = _read_texts(file["doubts"]) if "doubts" in file else doubts_of(_read_result(file), verdicts)
    return Record(
        job_text=file["job"].asstr()[()],
        inputs=tuple(InputFile(**row) for row in inputs),
        metrocli_version=str(file.attrs["metrocli_version"]),
        created=str(file.attrs["created"]),
        verdicts=verdicts,
        doubts=doubts,
    )


def _rows(data: h5py.Dataset) -> list[dict[str, Any]]:
    columns = _read_table(data).columns
    lists = [column.tolist() for column in columns.values()]
    return [dict(zip(columns, row, strict=True)) for row in zip(*lists, strict=True)]


def _read_table(data: h5py.Dataset) -> Table:
    rows = data[()]
    names = rows.dtype.names or ()
    columns = {name: _column(rows[name]) for name in names}
    found = [str(unit) for unit in data.attrs["units"]]
    return Table(columns, {name: unit for name, unit in zip(names, found, strict=True) if unit})


def _column(values: Any) -> Any:
    return np.char.decode(values, "utf-8") if values.dtype.kind == "S" else np.ascontiguousarray(values)


def _read_texts(data: h5py.Dataset) -> tuple[str, ...]:
    return tuple(data.asstr()[()])


def _read_values(group: h5py.Group) -> dict[str, Any]:
    values: dict[str, Any] = {name: _plain(value) for name, value in group.attrs.items()}
    return values | {name: _read_values(below) for name, below in group.items()}


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else value
