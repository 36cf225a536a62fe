"""The HDF5 part of a result file: what metrocli writes is read, all else that HDF5 can hold is refused."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import h5py
import numpy as np

from metrocli import units
from metrocli.arrays import Array
from metrocli.errors import Fault, InputError
from metrocli.formats.seal import Label
from metrocli.record import CriterionVerdict, Record
from metrocli.result import SCALE, Estimate, Result, ShownTable
from metrocli.table import Table

_OWN = ("job", "inputs", "parameters", "covariance", "statistics", "requirements", "warnings", "notes", "doubts",
        "certificate")  # fmt: skip
_PARTS = ("laboratory", "customer", "item", "references")
"""Keys of a certificate that hold texts by name"""
_MOST_OBJECTS, _MOST_TEXTS, _DEEPEST = 100_000, 100_000, 8
_CROSS = ("views_lens_covariance",)
"""Covariances between two different sets of quantities, which need not be symmetric"""
_TOLERANCE = 1e-6
"""Largest negative eigenvalue of a correlation matrix, and relative difference of variances, left by rounding"""
_ROUNDING = 1e-12
"""Largest negative variance left by rounding, relative to the largest variance"""


class _Held(dict[str, Any]):
    """Objects of a file by name; a missing one that is asked for is a fault of the file, which others may have made."""

    def __init__(self, what: str, shown: str) -> None:
        super().__init__()
        self.what, self.shown = what, shown

    def __missing__(self, name: str) -> Any:
        hint = "run its job again with this version"
        raise InputError([Fault(f"the result file has no {self.what}{name}", self.shown, hint=hint)])


def content_of(label: Label, body: memoryview, shown: str) -> tuple[Result, Record]:
    """Return result and record; raise InputError if the file has anything that metrocli does not write."""
    try:
        file, datasets = _opened(body)
        with file:
            result = _read_result(file, datasets, shown)
            record = _read_record(file, label)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # the libraries raise errors of many kinds for a file that others made
        raise InputError([Fault(f"the result file is damaged: {error}", shown)]) from error
    if result.kind != label.kind or record.status != label.status:
        raise InputError([Fault("the label of the result file contradicts its content", shown)])
    contradiction = contradictions(result)
    if contradiction:
        raise InputError([Fault(f"the result file is damaged: {message}", shown) for message in contradiction])
    return result, record


def record_of(label: Label, body: memoryview, shown: str) -> Record:
    """Return only the record; raises InputError as `content_of`."""
    try:
        with _opened(body)[0] as file:
            return _read_record(file, label)
    except MemoryError:
        raise
    except Exception as error:
        raise InputError([Fault(f"the result file is damaged: {error}", shown)]) from error


def _opened(body: memoryview) -> tuple[h5py.File, dict[str, h5py.Dataset]]:
    """Open an HDF5 file in memory, and return its datasets by their paths.

    All objects lie in it: no links, no external data, no size beyond it.
    """
    file = h5py.File(h5py.h5f.open_file_image(body))
    datasets = {path: item for path, item in _walk(file, "", 0, set()) if isinstance(item, h5py.Dataset)}
    for item in datasets.values():
        _refuse_unusual(item)
    return file, datasets


def _walk(group: h5py.Group, above: str, depth: int, seen: set[int]) -> Iterator[tuple[str, Any]]:
    for name in group:
        # a link could lead to another file of this computer, which would then be part of a result
        if group.id.links.get_info(name.encode()).type != h5py.h5l.TYPE_HARD:
            raise ValueError(f"'{name}' is a link to elsewhere")
        item = group[name]
        address = h5py.h5o.get_info(item.id).addr
        # a cycle of hard links would never end
        if address in seen or len(seen) > _MOST_OBJECTS or depth > _DEEPEST:
            raise ValueError(f"'{name}' is one object under two names, or one of too many")
        seen.add(address)
        yield above + name, item
        if isinstance(item, h5py.Group):
            yield from _walk(item, f"{above}{name}/", depth + 1, seen)


def _refuse_unusual(data: h5py.Dataset) -> None:
    """Raise ValueError for a dataset that is not stored in one piece in the file itself."""
    stored = data.id.get_create_plist()
    if stored.get_layout() not in (h5py.h5d.COMPACT, h5py.h5d.CONTIGUOUS) or stored.get_external_count():
        raise ValueError(f"{data.name} is stored in pieces or in another file")
    whole = data.dtype
    # a shape of 1e15 numbers takes a few bytes in the file and all memory when it is read
    if data.shape is None or data.size * whole.itemsize > data.id.get_storage_size():
        raise ValueError(f"{data.name} has a shape, but not the values for it")
    types = [whole[name] for name in whole.names] if whole.names else [whole]
    if any(
        # objects other than texts are references and the like, which lead elsewhere
        kind.kind not in "biufSO" or kind.hasobject != (h5py.check_string_dtype(kind) is not None and kind.kind == "O")
        for kind in types
    ):
        raise ValueError(f"{data.name} holds values of a type that results do not have")
    if whole.hasobject and (whole.names or data.size > _MOST_TEXTS):
        raise ValueError(f"{data.name} holds more texts than a result has")


def _read_result(file: h5py.File, datasets: dict[str, h5py.Dataset], shown: str) -> Result:
    columns = _read_table(file["parameters"]).columns
    count = len(columns["name"])
    dimensions = map(str, file["parameters"].attrs.get("dimensions", [""] * count))
    rows = zip(columns["name"], columns["value"], columns["std"], columns["unit"], dimensions, strict=True)
    estimates = tuple(Estimate(str(n), float(v), float(s), str(u), d) for n, v, s, u, d in rows)
    unknown = {estimate.dimension for estimate in estimates} - {"", SCALE, *units.DIMENSIONS}
    if unknown:
        raise ValueError(f"unknown dimensions of estimates: {', '.join(sorted(unknown))}")
    tables, arrays = _Held("table ", shown), _Held("array ", shown)
    for name, item in datasets.items():
        _sort_in(name, item, tables, arrays)
    return Result(
        kind=_text(file, "kind"),
        title=_text(file, "title"),
        estimates=estimates,
        covariance=np.asarray(file["covariance"][()], dtype=float),
        statistics=_read_values(file["statistics"]),
        tables=tables,
        arrays=arrays,
        warnings=_read_texts(file["warnings"]),
        shown=tuple(_shown_of(str(text)) for text in file.attrs["shown"]),
        notes=_read_texts(file["notes"]),
        details=_read_values(file["details"]) if "details" in file else {},
    )


def _text(file: h5py.File, name: str) -> str:
    value = file.attrs[name]
    if not isinstance(value, str):
        raise TypeError(f"the attribute {name} is not a text")
    return value


def _shown_of(text: str) -> ShownTable:
    name, _, columns = text.partition(":")
    return ShownTable(name, tuple(column.strip() for column in columns.split(",")) if columns else ())


def _sort_in(name: str, item: h5py.Dataset, tables: _Held, arrays: _Held) -> None:
    if name in _OWN or name.startswith("plot/"):
        return
    if item.dtype.names:
        table = _read_table(item)
        columns = _Held(f"column {name}/", tables.shown)
        columns.update(table.columns)
        tables[name] = replace(table, columns=columns)
    else:
        if item.ndim == 0 or item.dtype.kind not in "biuf":
            raise ValueError(f"{name} is not an array of numbers")
        arrays[name] = item[()]


def _read_record(file: h5py.File, label: Label) -> Record:
    record = Record(
        job_text=file["job"].asstr()[()],
        inputs=label.inputs,
        metrocli_version=label.metrocli_version,
        created=_text(file, "created"),
        verdicts=tuple(_verdict(**row) for row in _rows(file["requirements"])),
        doubts=_read_texts(file["doubts"]),
        meaning=label.meaning,
        content=label.content,
        job_file=label.job_file,
        certificate=_certificate(file),
    )
    listed = [(row["path"], row["sha256"]) for row in _rows(file["inputs"])]
    if listed != [(file.path, file.sha256) for file in label.inputs]:
        raise ValueError("the inputs of the label are not those of the file")
    return record


def _certificate(file: h5py.File) -> dict[str, Any]:
    """Return what the job states for a certificate; raise TypeError if a key holds what no job states there."""
    certificate: dict[str, Any] = json.loads(file["certificate"].asstr()[()]) if "certificate" in file else {}
    parts = [text if name in _PARTS and isinstance(text, dict) else {name: text} for name, text in certificate.items()]
    if not all(isinstance(text, str) and name not in _PARTS for part in parts for name, text in part.items()):
        raise TypeError("the certificate holds what no job states")
    return certificate


def _verdict(name: str, condition: str, value: float, unit: str, met: bool, decision: str = "") -> CriterionVerdict:
    return CriterionVerdict(name, condition, float(value), unit, bool(met), decision)


def _rows(data: h5py.Dataset) -> list[dict[str, Any]]:
    columns = _read_table(data).columns
    lists = [column.tolist() for column in columns.values()]
    return [dict(zip(columns, row, strict=True)) for row in zip(*lists, strict=True)]


def _read_table(data: h5py.Dataset) -> Table:
    rows = data[()]
    names = rows.dtype.names or ()
    columns = {name: _column(rows[name]) for name in names}
    symbols = [str(unit) for unit in data.attrs["units"]]
    return Table(columns, {name: unit for name, unit in zip(names, symbols, strict=True) if unit})


def _column(values: Any) -> Any:
    if values.dtype.kind != "S":
        return np.ascontiguousarray(values)
    try:
        return values.astype(str)  # ASCII alone, in a third of the time
    except UnicodeDecodeError:
        return np.char.decode(values, "utf-8")


def _read_texts(data: h5py.Dataset) -> tuple[str, ...]:
    return tuple(data.asstr()[()])


def _read_values(group: h5py.Group) -> dict[str, Any]:
    values: dict[str, Any] = {name: _plain(value) for name, value in group.attrs.items()}
    return values | {name: _read_values(below) for name, below in group.items()}


def _plain(value: Any) -> Any:
    """Return a value of an attribute as a number, a text or a list of these; raise TypeError for anything else."""
    plain = value.tolist() if hasattr(value, "tolist") else value
    for item in plain if isinstance(plain, list) else [plain]:
        if not isinstance(item, str | float | int):
            raise TypeError("an attribute is neither number nor text")
    return plain


def contradictions(result: Result) -> list[str]:
    """Return a sentence for each covariance of a result that no quantities can have; empty for a sound result.

    With D the diagonal, `D^(-1/2) C D^(-1/2)` must be symmetric with eigenvalues above -1e-6, and D of the estimates
    must be the squares of their standard uncertainties. Rows of undetermined quantities (infinite or nan) are left out.
    """
    return [f"{name} {fault}" for name, fault in _faults(result)]


def _faults(result: Result) -> Iterator[tuple[str, str]]:
    stds = np.array([estimate.std for estimate in result.estimates], dtype=float)
    if (stds < 0).any():
        yield "parameters", "have a negative standard uncertainty"
    if result.covariance.shape != (len(stds), len(stds)):
        yield "covariance", "has another size than the parameters"
    else:
        known = np.isfinite(stds)
        matrix = result.covariance[np.ix_(known, known)]
        if fault := _fault(matrix):
            yield "covariance", fault
        elif not np.allclose(np.sqrt(np.maximum(np.diag(matrix), 0)), stds[known], rtol=_TOLERANCE, atol=1e-300):
            yield "covariance", "contradicts the standard uncertainties of the parameters"
    for name, array in result.arrays.items():
        square = array.ndim >= 2 and array.shape[-1] == array.shape[-2] and array.dtype.kind == "f"
        if name.endswith("covariance") and name not in _CROSS and square and (fault := _fault(array)):
            yield name, fault


def _fault(matrices: Array) -> str:
    """Return what is wrong with one covariance, or any of a stack of them (..., n, n); empty for nothing."""
    variances = np.diagonal(matrices, axis1=-2, axis2=-1)
    known = np.isfinite(variances)
    if (variances[known] < -_ROUNDING * np.abs(variances[known]).max(initial=0.0)).any():
        return "has a negative variance"
    size = np.sqrt(np.where(known & (variances > 0), variances, 1.0))
    both = known[..., :, None] & known[..., None, :]
    # rows of undetermined quantities become those of a unit matrix, which passes
    scaled = np.where(both, matrices / size[..., :, None] / size[..., None, :], np.eye(matrices.shape[-1]))
    if not np.isfinite(scaled).all():
        return "has infinite values"
    if (np.abs(scaled - np.swapaxes(scaled, -1, -2)) > _TOLERANCE).any():
        return "is not symmetric"
    try:
        # shifted by what is allowed: a factor exists exactly where no eigenvalue is
        # below minus that, and costs less than these
        np.linalg.cholesky(scaled + _TOLERANCE * np.eye(matrices.shape[-1]))
    except np.linalg.LinAlgError:
        return "is not positive: no quantities have these correlations"
    return ""
