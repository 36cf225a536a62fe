"""Where a result comes from: jobs and files back to the measurements, by content."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

from metrocli.errors import InputError
from metrocli.formats import hdf5
from metrocli.formats.file_bytes import read_bytes
from metrocli.formats.seal import Label
from metrocli.frozen import dataclass
from metrocli.record import InputFile

AS_READ, CHANGED, MISSING = "as read", "changed since", "missing"
_FEWEST_ALIKE = 4
"""Files of a kind in one folder from which on one line stands for all"""


@dataclass(frozen=True)
class Origin:
    """A file that a result was made from, or the result itself, and what it was made from in turn."""

    path: Path
    digest: str
    """Of the result, or of the bytes of a file"""
    state: str
    """Whether the file still has the content that was read: AS_READ, CHANGED or MISSING"""
    label: Label | None = None
    """Of a result as it was read; None for all other files"""
    job: Path | None = None
    origins: tuple[Origin, ...] = ()
    files: int = 1
    """Number of files that it stands for"""


def shortened(origin: Origin) -> Origin:
    """Return a lineage in which one line stands for many files of a kind in one folder, such as `img/*.png`."""
    kept: list[Origin] = []
    alike: dict[tuple[Path, str], list[Origin]] = {}
    for parent in origin.origins:
        group = alike.setdefault((parent.path.with_name(f"*{parent.path.suffix}"), parent.state), [])
        if parent.label is not None:
            kept.append(shortened(parent))
        else:
            group.append(parent)
    for (pattern, state), group in alike.items():
        if len(group) < _FEWEST_ALIKE:
            kept += group
        else:
            digests = "".join(origin.digest for origin in group)
            kept.append(Origin(pattern, sha256(digests.encode()).hexdigest(), state, files=len(group)))
    return replace(origin, origins=tuple(sorted(kept, key=lambda origin: str(origin.path))))


def links_of(origin: Origin) -> Iterator[tuple[Origin, Origin]]:
    """Yield each pair of a file and the result that was made from it, once."""
    seen: set[tuple[Path, Path]] = set()
    waiting = [origin]
    while waiting:
        result = waiting.pop(0)
        for below in result.origins:
            if (below.path, result.path) not in seen:
                seen.add((below.path, result.path))
                yield below, result
                waiting.append(below)


def files_of(origin: Origin) -> tuple[Origin, ...]:
    """Return all files of a lineage, each once, the result first."""
    return tuple(({origin.path: origin} | {below.path: below for below, _ in links_of(origin)}).values())


def name_from(home: Path, origin: Origin) -> str:
    """Return the path of a file from a folder; one that stands for many with their number."""
    name = Path(os.path.relpath(origin.path, home)).as_posix()
    return name if origin.files == 1 else f"{name} ({origin.files} files)"


def trace(path: Path) -> Origin:
    """Return the lineage of a result file; raises InputError if it cannot be believed."""
    label = hdf5.read_label(path)
    return _of_result(path, label, label.content)


def _of_result(path: Path, label: Label, content: str) -> Origin:
    job = Path(os.path.normpath(path.parent / label.job_file)) if label.job_file else None
    folder = job.parent if job else path.parent
    origins = tuple(_of_input(Path(os.path.normpath(folder / file.path)), file) for file in label.inputs)
    return Origin(path, content, AS_READ, label, job, origins)


def _of_input(path: Path, recorded: InputFile) -> Origin:
    digest = recorded.sha256
    if not path.is_file():
        return Origin(path, digest, MISSING)
    try:
        label = hdf5.read_label(path)
        # made again with the same content is as good as the same bytes
        if label.content and label.content == recorded.content:
            return _of_result(path, label, label.content)
        return Origin(path, digest, CHANGED)
    except InputError:
        pass
    try:
        return Origin(path, digest, AS_READ if read_bytes(path).sha256 == digest else CHANGED)
    except InputError:
        return Origin(path, digest, MISSING)
