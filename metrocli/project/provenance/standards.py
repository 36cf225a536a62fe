"""The standards that a result rests on by way of the results that it was made from."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from metrocli.formats import hdf5
from metrocli.project.provenance.lineage import Origin, files_of, trace
from metrocli.record import Record


def with_standards(result: Path, record: Record) -> Record:
    """Return the record of a result with the certificates that the jobs of the results below it state.

    Files are named as the job of this result would name them. What the job itself states stays as it is.
    """
    origin, *below = files_of(trace(result))
    home = origin.job.parent if origin.job else result.parent
    own = {name for name, _ in record.references()}
    found = dict(pair for one in below if one.label is not None for pair in _stated(one, home))
    return replace(record, below=tuple((name, number) for name, number in found.items() if name not in own))


def _stated(origin: Origin, home: Path) -> Iterator[tuple[str, str]]:
    record = hdf5.read_record(origin.path)[1]
    files = {one.path for one in record.inputs}
    folder = origin.job.parent if origin.job else origin.path.parent
    for name, number in record.references():
        if number:
            yield Path(os.path.relpath(folder / name, home)).as_posix() if name in files else name, number
