"""Result files in HDF5 behind a seal, readable with h5py, h5ls and MATLAB; written whole or not at all.

The same result gives the same bytes but for the attribute `created`: objects have no timestamps, names are sorted.
"""

from __future__ import annotations

import os
from pathlib import Path

from metrocli.errors import Fault, InputError
from metrocli.formats.file_bytes import FileBytes, read_bytes, write_bytes
from metrocli.formats.seal import Label, is_remains, sealed, unsealed
from metrocli.record import Record
from metrocli.result import Result

_WHAT = "a result file"


def write(path: Path, result: Result, record: Record) -> bool:
    """Write a result file to `path` and replace any file there; return whether its result is another one than before.

    A file whose result and record come out as before is not touched. If only the record is another one (a new version,
    a comment in an input), the file keeps its time. If writing fails, the old file stays.
    """
    from metrocli.formats.hdf5_writing import image_of

    label = label_of(result, record)
    before = _label_there(path)
    if before == label and label.content:
        return False
    parts = sealed(label, image_of(result, record))
    same = before is not None and before.content == label.content != ""
    times = path.stat() if same else None
    write_bytes(path, *parts)
    if times is not None:
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    return not same


def label_of(result: Result, record: Record) -> Label:
    """Return the label with which a result is written."""
    return Label(
        kind=result.kind,
        status=record.status,
        metrocli_version=record.metrocli_version,
        meaning=record.meaning,
        content=record.content,
        inputs=record.inputs,
        job_file=record.job_file,
        exit_code=record.exit_code,
        warned=not set(result.warnings) <= set(record.doubts),
    )


def _label_there(path: Path) -> Label | None:
    try:
        return read_label(path)
    except InputError:
        return None


def read(path: Path, shown: str = "", held: FileBytes | None = None) -> tuple[Result, Record]:
    """Return the content of a result file; `held` is its content if it is already read.

    Raises InputError if it is not a result file, or if it is damaged or was edited since metrocli wrote it.
    """
    from metrocli.formats.hdf5_reading import content_of

    shown = shown or str(path)
    label, body = unsealed((held or read_bytes(path, _WHAT, shown)).data, shown)
    return content_of(label, body, shown)


def read_record(path: Path, shown: str = "") -> tuple[str, Record]:
    """Return only the kind of job and the record of a result file; raises InputError as `read`."""
    from metrocli.formats.hdf5_reading import record_of

    shown = shown or str(path)
    label, body = unsealed(read_bytes(path, _WHAT, shown).data, shown)
    return label.kind, record_of(label, body, shown)


def read_label(path: Path, shown: str = "") -> Label:
    """Return the label of a result file, after all its content was checked; raises InputError as `read`.

    Reads no HDF5, so that it takes as long as the digest of the file.
    """
    shown = shown or str(path)
    return unsealed(read_bytes(path, _WHAT, shown).data, shown)[0]


def kind_of(path: Path) -> str | None:
    """Return the kind of job of a result file, "" for the remains of one, None if it is not a result file.

    Raises InputError if it cannot be read.
    """
    held = read_bytes(path, _WHAT)
    try:
        return unsealed(held.data, str(path))[0].kind
    except InputError:
        return "" if is_remains(held.data[:4096]) else None


def refuse_foreign(path: Path, kind: str) -> None:
    """Raise InputError if a file exists at `path` that is neither a result of this kind nor the remains of a result."""
    if path.is_dir():
        raise InputError([Fault("the output is a folder", str(path), hint="name a file that ends in .h5")])
    if not os.path.lexists(path):
        return
    if not path.exists():
        raise InputError([Fault("the output is a link to a file that does not exist", str(path), hint="remove it")])
    there = kind_of(path)
    if there in (kind, ""):
        return
    what = "is not a result of metrocli" if there is None else f"is a result of {there}"
    raise InputError([Fault(f"the file exists and {what}", str(path), hint="choose another --output, or use --force")])
