"""The files of a job: read for its task, and hashed for the record in its result."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import wraps
from linecache import getline
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

from metrocli.errors import Fault, InputError
from metrocli.formats.file_bytes import FileBytes, read_bytes
from metrocli.project import fingerprint
from metrocli.project.job import JobFile
from metrocli.project.named_files import Input
from metrocli.record import USABLE, InputFile
from metrocli.settings import ANY_KIND, FileOf, ImageFiles, MeshFile, TableFile

P = ParamSpec("P")
T = TypeVar("T")


def read_inputs(job: JobFile, absent: Collection[str] = ()) -> dict[str, Any]:
    """Return the content of each input under its key: a Table, ImageSet, Result or section of settings.

    Inputs in `absent` are left out where their files do not exist. Files that are named outside `inputs:` are in one
    dict under "files", by the path of their key. Raises InputError with the faults of all files.
    """
    return read_with_files(job, absent)[0]


def read_with_files(job: JobFile, absent: Collection[str] = ()) -> tuple[dict[str, Any], tuple[InputFile, ...]]:
    """Return the content of each input as `read_inputs`, and the record of the very bytes that were read."""
    held: dict[str, Any] = {}
    files: dict[str, InputFile] = {}
    faults: list[Fault] = [] if job.accept_doubtful else unfit_inputs(job, absent)
    for item in job.inputs:
        if item.key in absent and not (item.paths and all(path.is_file() for path in item.paths)):
            continue
        try:
            held[item.key], read = _read(item, job.folder)
            files |= {file.path: file for file in read}
        except InputError as error:
            faults.extend(error.faults)
    if faults:
        raise InputError(faults)
    files |= {file.path: file for file in _of_own(job)}
    elsewhere = {key: value for key, value in held.items() if "." in key}
    named = {key: value for key, value in held.items() if key not in elsewhere}
    return named | ({"files": elsewhere} if elsewhere else {}), tuple(files[path] for path in sorted(files))


def unfit_inputs(job: JobFile, absent: Collection[str] = ()) -> list[Fault]:
    """Return a fault for each result among the inputs that is doubtful or does not meet the requirements of its job.

    Inputs in `absent` are not looked at.
    """
    looked_at = [item for item in job.inputs if item.key not in absent]
    return [fault for item in looked_at for path in item.paths if (fault := _unfit(item, path)) is not None]


def _unfit(item: Input, path: Path) -> Fault | None:
    spec = getattr(item.spec, "value", item.spec)
    if not isinstance(spec, FileOf) or item.held is not None or not path.is_file():
        return None
    from metrocli.formats import hdf5

    try:
        if hdf5.read_label(path).status in USABLE:
            return None
        _, record = hdf5.read_record(path)
    except InputError:
        return None  # reported where the whole file is read
    message = f"{item.node.path}: {path} is not fit for use ({record.status}): {'; '.join(record.reasons)}"
    return item.node.fault(message, "correct its job and run it again, or use it as it is by --accept-doubtful")


def _read(item: Input, folder: Path) -> tuple[Any, list[InputFile]]:
    """Return the content of an input, and the record of its files with paths relative to a folder."""
    if item.bytes is not None:
        return item.held, [_recorded(item.bytes, folder, fingerprint.digest(item.held, folder))]
    if isinstance(item.spec, ImageFiles):
        from metrocli.formats import images

        pictures = images.read_images(list(item.paths))
        read_as = zip(pictures.paths, pictures.digests, pictures.lengths, strict=True)
        return pictures, [_file(path, folder, digest, length, digest) for path, digest, length in read_as]
    if isinstance(item.value, Mapping):
        read = {name: _read_one(item.spec.value, path, item, folder) for name, path in item.value.items()}
        return {name: content for name, (content, _) in read.items()}, [file for _, file in read.values()]
    content, file = _read_one(item.spec, item.value, item, folder)
    return content, [file]


def _read_one(spec: Any, path: Path, item: Input, folder: Path) -> tuple[Any, InputFile]:
    if isinstance(spec, TableFile):
        from metrocli.formats import csv

        held = read_bytes(path, "a CSV file")
        table = csv.read(path, spec.columns, held=held)
        return table, _recorded(held, folder, fingerprint.of_table(table))
    if isinstance(spec, MeshFile):
        from metrocli.formats import own_files as meshes

        held = read_bytes(path, "a mesh")
        return meshes.read(path, held), _recorded(held, folder, held.sha256)
    if isinstance(spec, FileOf):
        from metrocli.formats import hdf5

        held = read_bytes(path, "a result file")
        result, record = hdf5.read(path, held=held)
        if spec.results != ANY_KIND and result.kind not in spec.results:
            message = f"{item.node.path}: {path} is a result of {result.kind}"
            raise InputError([item.node.fault(message, f"expected {spec.expects}")])
        own = _recorded(held, path.parent, record.content)
        return replace(result, made_from=(own, *record.inputs)), _recorded(held, folder, record.content)
    raise TypeError(f"no reader for {spec}")


def placed(function: Callable[Concatenate[JobFile, P], T]) -> Callable[Concatenate[JobFile, P], T]:
    """Return a function of a job whose faults show the row of a table, or name the job file if they have no place."""

    @wraps(function)
    def carry_out(job: JobFile, /, *given: P.args, **named: P.kwargs) -> T:
        try:
            return function(job, *given, **named)
        except InputError as error:
            raise InputError([_placed(fault, str(job.file)) for fault in error.faults]) from error

    return carry_out


def _placed(fault: Fault, job: str) -> Fault:
    if fault.line is None or fault.source is not None:
        return replace(fault, file=fault.file or job)
    return replace(fault, source=getline(fault.file, fault.line).rstrip() or None)


def input_files(job: JobFile) -> tuple[InputFile, ...]:
    """Return the existing files of a job with the hashes of their bytes; paths are relative to the job file."""
    held = {path: item.bytes for item in job.inputs for path in item.paths if item.bytes is not None}
    held |= {path: file.bytes for path, file in job.own.files.items()}
    paths = sorted({path for path in job.files if path.is_file()})
    return tuple(_recorded(held.get(path) or read_bytes(path), job.folder, "") for path in paths)


def content_now(job: JobFile, path: str) -> str:
    """Return the digest of the content of an input as read now, by its path in the record; "" if it has faults."""
    for item in job.inputs:
        if path in {_relative(file, job.folder) for file in item.paths}:
            try:
                return next((file.content for file in _read(item, job.folder)[1] if file.path == path), "")
            except InputError:
                return ""
    return next((file.content for file in _of_own(job) if file.path == path), "")


def _of_own(job: JobFile) -> tuple[InputFile, ...]:
    """Return the record of the files with user-defined effects, as they were read with the job."""
    return tuple(_recorded(file.bytes, job.folder, fingerprint.digest(file.root)) for file in job.own.files.values())


def _recorded(held: FileBytes, folder: Path, content: str) -> InputFile:
    return _file(held.path, folder, held.sha256, len(held.data), content)


def _file(path: Path, folder: Path, digest: str, size: int, content: str) -> InputFile:
    return InputFile(_relative(path, folder), digest, size, content)


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path, folder)).as_posix()
