"""The files of a job: read for its task, and hashed for the record in its result."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from metrocli.errors import Fault, InputError
from metrocli.project.job import Input, JobFile
from metrocli.record import DONE, InputFile
from metrocli.settings import ANY_KIND, FileOf, ImageFiles, MeshFile, TableFile


def read_inputs(job: JobFile, absent: Collection[str] = ()) -> dict[str, Any]:
    """Return the content of each input under its key: a Table, ImageSet, Result or section of settings.

    Inputs in `absent` are left out where their files do not exist. Files that are named outside `inputs:` are in one
    dict under "files", by the path of their key. Raises InputError with the faults of all files.
    """
    held: dict[str, Any] = {}
    faults: list[Fault] = [] if job.accept_doubtful else unfit_inputs(job)
    for item in job.inputs:
        if item.key in absent and not (item.paths and all(path.is_file() for path in item.paths)):
            continue
        try:
            held[item.key] = _read(item)
        except InputError as error:
            faults.extend(error.faults)
    if faults:
        raise InputError(faults)
    elsewhere = {key: value for key, value in held.items() if "." in key}
    named = {key: value for key, value in held.items() if key not in elsewhere}
    return named | ({"files": elsewhere} if elsewhere else {})


def unfit_inputs(job: JobFile) -> list[Fault]:
    """Return a fault for each result among the inputs that is doubtful or does not meet the requirements of its job."""
    return [fault for item in job.inputs for path in item.paths if (fault := _unfit(item, path)) is not None]


def _unfit(item: Input, path: Path) -> Fault | None:
    spec = getattr(item.spec, "value", item.spec)
    if not isinstance(spec, FileOf) or item.held is not None or not path.is_file():
        return None
    from metrocli.formats import hdf5

    try:
        _, record = hdf5.read_record(path)
    except InputError:
        return None  # reported where the whole file is read
    if record.status == DONE:
        return None
    message = f"{item.node.path}: {path} is not fit for use ({record.status}): {'; '.join(record.reasons)}"
    return item.node.fault(message, "correct its job and run it again, or use it as it is by --accept-doubtful")


def _read(item: Input) -> Any:
    if item.held is not None:
        return item.held
    if isinstance(item.spec, ImageFiles):
        from metrocli.formats import images

        return images.read_images(list(item.paths))
    if isinstance(item.value, Mapping):
        return {name: _read_one(item.spec.value, path, item) for name, path in item.value.items()}
    return _read_one(item.spec, item.value, item)


def _read_one(spec: Any, path: Path, item: Input) -> Any:
    if isinstance(spec, TableFile):
        from metrocli.formats import csv

        return csv.read(path, spec.columns)
    if isinstance(spec, MeshFile):
        from metrocli.formats import meshes

        return meshes.read(path)
    if isinstance(spec, FileOf):
        from metrocli.formats import hdf5

        result, record = hdf5.read(path)
        if spec.results != ANY_KIND and result.kind not in spec.results:
            message = f"{item.node.path}: {path} is a result of {result.kind}"
            raise InputError([item.node.fault(message, f"expected {spec.expects}")])
        return replace(result, made_from=(_hashed(path, path.parent), *record.inputs))
    raise TypeError(f"no reader for {spec}")


def input_files(job: JobFile) -> tuple[InputFile, ...]:
    """Return the existing files of a job with their hashes; paths are relative to the job file."""
    paths = sorted({path for item in job.inputs for path in item.paths if path.is_file()})
    return tuple(_hashed(path, job.folder) for path in paths)


def _hashed(path: Path, folder: Path) -> InputFile:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
        return InputFile(Path(os.path.relpath(path, folder)).as_posix(), digest.hexdigest(), path.stat().st_size)
    except OSError as error:
        raise InputError([Fault(f"cannot be read: {error.strerror}", str(path))]) from error
