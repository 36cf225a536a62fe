"""What the last run with nothing to do looked at: while none of it changes, there is again nothing to do.

A file that moved, as all do in a checkout, is read: it is unchanged if its bytes have the digest that they had.

docs/decisions/082-memo-of-a-run.md has what it rests on. Loads fast: neither YAML nor numpy is needed to use it.
"""

from __future__ import annotations

import os

from metrocli import __version__

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path
    from typing import Any

    from metrocli.project.steps import Step

NAME = ".metrocli-seen"
_SETTLED_NS = 2_500_000_000
"""Age that a file must have [ns]: within it, a second change may leave size and times as they are"""

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
        found = {name: _seen(os.path.join(folder, name)) for name in moved if _could_be_the_same(folder, name, files)}
        if any(name not in found or found[name][1] != files[name][1] for name in moved):
            return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    if moved:
        _write(project_file, jobs, files | found, begun)
    return jobs


def _could_be_the_same(folder: str, name: str, files: dict[str, list[Any]]) -> bool:
    """Return whether the size of a file is as it was, and its bytes decide; cheaper than reading it."""
    (size, *_), digest = files[name]
    path = os.path.join(folder, name)
    return bool(digest) and (os.path.isdir(path) or os.stat(path).st_size == size)


def _text(path: str) -> str:
    """Return the text of a file, empty if it cannot be read, is no plain file or too large for a memo."""
    import stat

    try:
        found = os.stat(path)
        if not stat.S_ISREG(found.st_mode) or found.st_size > _MOST_BYTES:
            return ""
        with open(path, encoding="utf-8") as file:
            return file.read()
    except (OSError, ValueError):
        return ""


def remember(project_file: Path, steps: Sequence[Step], begun_ns: int) -> None:
    """Remember that all results are up to date, as of `begun_ns`, when the project was read.

    Nothing is remembered if any file is too young, or if a pattern of images has wildcards in the name of a folder. A
    folder that cannot be written is no fault: the next run looks again.
    """
    from contextlib import suppress

    folder = project_file.parent
    # a package is more than the file that offers its effects: one that moved may be another
    packages = {one.file for step in steps for one in step.job.packages}
    with suppress(OSError):
        looked_at = dict.fromkeys(_looked_at(project_file, steps))
        files = {os.path.relpath(path, folder): _seen(os.fspath(path), path not in packages) for path in looked_at}
        jobs = [[step.name, os.path.relpath(step.job.output, folder)] for step in steps]
        _write(str(project_file), jobs, files, begun_ns)


def _write(project_file: str, jobs: list[list[str]], files: dict[str, list[Any]], begun_ns: int) -> None:
    """Write what is remembered, unless a file is too young; a folder that cannot be written is no fault."""
    import json
    from contextlib import suppress
    from pathlib import Path

    from metrocli.errors import InputError
    from metrocli.formats.aside import write_bytes

    if any(max(seen[1:3]) > begun_ns - _SETTLED_NS for seen, _ in files.values()):
        return
    folder, name = os.path.split(project_file)
    held = {"version": __version__, "project": name, "jobs": jobs, "files": files}
    with suppress(OSError, InputError):
        write_bytes(Path(folder) / NAME, json.dumps(held).encode())


def now_ns() -> int:
    """Return the time [ns] for `remember`."""
    import time

    return time.time_ns()


def _signature(path: str) -> list[int]:
    """Return what changes whenever a file or folder does; its ctime cannot be set back by its owner."""
    found = os.stat(path)
    return [found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino]


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
        digest = hashlib.sha256("\0".join(sorted(os.listdir(path))).encode("utf-8", "surrogateescape")).hexdigest()
    elif by_digest and stat.S_ISREG(kind):
        with open(path, "rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    return [_signature(path), digest]


def _looked_at(project_file: Path, steps: Iterable[Step]) -> Iterable[Path]:
    """Yield all files and folders that decide whether results are up to date; OSError for what cannot be listed."""
    from metrocli.project.named_files import has_wildcards

    yield project_file
    for step in steps:
        yield from (*step.job.stated_in, *step.job.files, step.job.output)
        yield from (one.file for one in step.job.packages if one.file is not None)
        for folder in (one for item in step.job.inputs for one in item.searched):
            if has_wildcards(folder):
                raise OSError("not listed: new folders may match")
            yield folder
