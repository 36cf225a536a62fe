"""What the last run with nothing to do looked at: while none of it moves, there is again nothing to do.

docs/decisions/082-memo-of-a-run.md has what it rests on. Loads fast: neither YAML nor numpy is needed to use it.
"""

from __future__ import annotations

import os

from metrocli import __version__

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from metrocli.project.steps import Step

NAME = ".metrocli-seen"
_SETTLED_NS = 2_500_000_000
"""Age that a file must have [ns]: within it, a second change may leave size and times as they are"""

_MOST_BYTES = 200_000_000


def unmoved_jobs(project_file: str) -> list[list[str]] | None:
    """Return the names and results of all jobs, if all files of the project are as when all results were up to date.

    Returns None if anything moved, or nothing is remembered.
    """
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
        for name, seen in files.items():
            if _signature(os.path.join(folder, name)) != seen:
                return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    return jobs


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
    import json
    from contextlib import suppress

    from metrocli.errors import InputError
    from metrocli.formats.aside import write_bytes

    folder = project_file.parent
    files: dict[str, list[int]] = {}
    with suppress(OSError, InputError):
        for path in _looked_at(project_file, steps):
            found = _signature(os.fspath(path))
            if max(found[1:3]) > begun_ns - _SETTLED_NS:
                return
            files[os.path.relpath(path, folder)] = found
        jobs = [[step.name, os.path.relpath(step.job.output, folder)] for step in steps]
        held = {"version": __version__, "project": project_file.name, "jobs": jobs, "files": files}
        write_bytes(folder / NAME, json.dumps(held).encode())


def now_ns() -> int:
    """Return the time [ns] for `remember`."""
    import time

    return time.time_ns()


def _signature(path: str) -> list[int]:
    """Return what changes whenever a file or folder does; its ctime cannot be set back by its owner."""
    found = os.stat(path)
    return [found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino]


def _looked_at(project_file: Path, steps: Iterable[Step]) -> Iterable[Path]:
    """Yield all files and folders that decide whether results are up to date; OSError for what cannot be listed."""
    yield project_file
    for step in steps:
        yield step.job.file
        if step.job.wishes.part is not None and step.job.wishes.part.file is not None:
            yield step.job.wishes.part.file
        yield step.job.output
        yield from step.job.own.files
        yield from (one.file for one in step.job.packages if one.file is not None)
        if step.job.own.project is not None:
            yield step.job.own.project
        for item in step.job.inputs:
            yield from item.paths
            for pattern in item.node.items or (item.node,):
                if isinstance(item.value, tuple) and set(pattern.text) & set("*?["):
                    place = pattern.source.folder / pattern.text
                    if set(str(place.parent)) & set("*?["):
                        raise OSError("not listed: new folders may match")
                    yield place.parent
