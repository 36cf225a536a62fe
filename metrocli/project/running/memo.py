"""What the last run looked at if it left nothing to do: while none of it changes, there is nothing to do.

A file that moved, as all do in a checkout, is read: it is unchanged if its bytes have the digest that they had.

docs/decisions/082-memo-of-a-run.md has what it rests on. Loads fast: neither YAML nor numpy is needed to use it.
"""

from __future__ import annotations

import os

from metrocli import __version__

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path
    from typing import Any

    from metrocli.formats.seal import Label
    from metrocli.project.steps import ProjectStep

NAME = ".metrocli-seen"
_SETTLED_NS = 2_500_000_000
"""Age from which the times of a file count [ns]: within it, a second change may leave them as they are"""

_MOST_BYTES = 200_000_000


def unmoved_jobs(project_file: str) -> list[list[str]] | None:
    """Return the names and results of all jobs, if all files of the project are as when all results were up to date.

    Returns None if anything changed, or nothing is remembered. Files that only moved are remembered as they are now.
    """
    begun = now_ns()
    folder, name_of_project = os.path.split(project_file)
    text = _text(os.path.join(folder, NAME))
    if not text:
        return None
    import json

    try:
        held = json.loads(text)
        files = held["files"]
        jobs = [[str(name), str(result)] for name, result in held["jobs"]]
        # a memo from elsewhere cannot know the times and inodes of these files
        decisive = {name_of_project, *(result for _, result in jobs)}
        if held["version"] != __version__ or held["project"] != name_of_project or not decisive <= files.keys():
            return None
        moved = [name for name, (seen, _) in files.items() if _signature(os.path.join(folder, name)) != seen]
        now = {name: _seen(os.path.join(folder, name)) for name in moved if _could_be_the_same(folder, name, files)}
        if any(name not in now or now[name][1] != files[name][1] for name in moved):
            return None
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    if moved and moved != [os.curdir]:  # which moves whenever this is written
        _write(project_file, jobs, files | now, begun)
    return jobs


def _could_be_the_same(folder: str, name: str, files: dict[str, list[Any]]) -> bool:
    """Return whether the size of a file is as it was, and its bytes decide; cheaper than reading it."""
    seen, digest = files[name]
    path = os.path.join(folder, name)
    return bool(digest) and (os.path.isdir(path) or os.stat(path).st_size == seen[0])


def _text(path: str) -> str:
    """Return the text of a file, empty if it cannot be read, is not a plain file or too large for a memo."""
    import stat

    try:
        status = os.stat(path)
        if not stat.S_ISREG(status.st_mode) or status.st_size > _MOST_BYTES:
            return ""
        with open(path, encoding="utf-8") as file:
            return file.read()
    except (OSError, ValueError):
        return ""


def remember(
    project_file: Path, steps: Sequence[ProjectStep], begun_ns: int, labels: Mapping[str, Label | None] | None = None
) -> None:
    """Remember that all results are up to date, as of `begun_ns`, when the project was read.

    `labels` are those of the results by the names of the steps, as they were judged or written. Nothing is remembered
    if a file is too young and lacks the bytes that were judged, or if a project file nearer to a job appeared or
    went meanwhile. A folder that cannot be written is not a fault: the next run looks again.
    """
    from contextlib import suppress

    from metrocli.errors import InputError

    folder = project_file.parent
    # a package is more than the file that offers its effects: one that moved may be another
    packages = {package.file for step in steps for package in step.job.packages}
    sought = {path for step in steps for path in step.job.own.sought}
    read = sought & steps[0].job.options.files.held.keys() if steps else sought
    # a nearer project file that came meanwhile would define other effects for the same job
    if any(path.exists() for path in sought - read):
        return
    with suppress(OSError, InputError):
        looked_at = dict.fromkeys((*_looked_at(project_file, steps), *read))
        files: dict[str, list[Any]] = {os.path.relpath(path, folder): [[], ""] for path in sought - read}
        files |= {os.path.relpath(path, folder): _seen(os.fspath(path), path not in packages) for path in looked_at}
        young = {name: digest for name, (seen, digest) in files.items() if not _settled(seen, begun_ns)}
        judged = _judged(folder, steps, labels, young) if young and labels else {}
        # a file that changed within the resolution of its time stamp looks unchanged: of young files only bytes count
        # (docs/decisions/082-memo-of-a-run.md)
        if any(judged.get(name) != {digest} for name, digest in young.items()):
            return
        jobs = [[step.name, os.path.relpath(step.job.output, folder)] for step in steps]
        _write(str(project_file), jobs, files, begun_ns)


def _judged(
    folder: Path, steps: Sequence[ProjectStep], labels: Mapping[str, Label | None], young: Iterable[str]
) -> dict[str, set[str]]:
    """Return the digests of the bytes by which results are up to date, of files by their paths from a folder.

    A file that changed during the run has several, or none. A job may have been computed in another process, which
    loaded it again: it counts if it meant the same there. Raises InputError for a result that cannot be believed.
    """
    from metrocli.formats.file_bytes import read_bytes
    from metrocli.formats.seal import unsealed
    from metrocli.project import fingerprint

    digests: dict[str, set[str]] = {}

    def add(path: Path, digest: str) -> None:
        digests.setdefault(os.path.relpath(path, folder), set()).add(digest)

    for step in steps:
        job, label = step.job, labels.get(step.name)
        if label is None or label.meaning != fingerprint.of_job(job):
            return {}
        if {os.path.relpath(path, job.folder) for path in job.files} != {file.path for file in label.inputs}:
            return {}
        for entry in label.inputs:
            add(job.folder / entry.path, entry.sha256)
        if job.options.part is not None and job.options.part.list is not None:
            add(job.options.part.list.path, job.options.part.list.sha256)
        if os.path.relpath(job.output, folder) in young:
            held = read_bytes(job.output, "a result file")
            add(job.output, held.sha256 if unsealed(held.data, str(job.output))[0] == label else "")
    for path, file in steps[0].job.options.files.held.items():
        add(path, file.bytes.sha256)
    return digests


def _settled(seen: Sequence[int], begun_ns: int) -> bool:
    """Return whether the times of a file decide whether it changed since a run began; so they do if it is not there."""
    return max(seen[1:3], default=0) <= begun_ns - _SETTLED_NS


def _write(project_file: str, jobs: list[list[str]], files: dict[str, list[Any]], begun_ns: int) -> None:
    """Write what is remembered, of young files no times; a folder that cannot be written is not a fault."""
    import json
    from contextlib import suppress
    from pathlib import Path

    from metrocli.errors import InputError
    from metrocli.formats.file_bytes import write_bytes

    files = {name: [seen if _settled(seen, begun_ns) else seen[:1], digest] for name, (seen, digest) in files.items()}
    folder, name = os.path.split(project_file)
    held = {"version": __version__, "project": name, "jobs": jobs, "files": files}
    with suppress(OSError, InputError):
        write_bytes(Path(folder) / NAME, json.dumps(held).encode())


def now_ns() -> int:
    """Return the time [ns] for `remember`."""
    import time

    return time.time_ns()


def _signature(path: str) -> list[int]:
    """Return what changes whenever a file or folder does, empty if it is not there.

    The ctime cannot be set back by the owner of a file.
    """
    try:
        stat = os.stat(path)
    except FileNotFoundError:
        return []
    return [stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino]


def _seen(path: str, by_digest: bool = True) -> list[Any]:
    """Return the signature of a file or folder, and the digest of its bytes or names; OSError if it cannot be read.

    The signature is taken last: if it is older than the run, the digest is that of what the run read. The digest is
    empty if only the signature decides, as for what is neither a file nor a folder.
    """
    import hashlib
    import stat

    kind = os.stat(path).st_mode
    digest = ""
    if by_digest and stat.S_ISDIR(kind):
        names = sorted({*os.listdir(path)} - {NAME})
        digest = hashlib.sha256("\0".join(names).encode("utf-8", "surrogateescape")).hexdigest()
    elif by_digest and stat.S_ISREG(kind):
        with open(path, "rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    return [_signature(path), digest]


def _looked_at(project_file: Path, steps: Iterable[ProjectStep]) -> Iterable[Path]:
    """Yield all files and folders that decide whether results are up to date."""
    yield project_file
    for step in steps:
        yield from (*step.job.stated_in, *step.job.files, step.job.output)
        yield from (package.file for package in step.job.packages if package.file is not None)
        yield from (folder for item in step.job.inputs for folder in item.searched)
