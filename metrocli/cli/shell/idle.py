"""`metrocli run` with nothing to do, answered before the command line is loaded, which takes longer than the answer."""

from __future__ import annotations

import os
import sys

from metrocli.project import PROJECT_FILE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

_QUIET = ("-q", "--quiet")


def nothing_to_do(arguments: Sequence[str]) -> bool:
    """Print that all jobs are up to date and return True, if the last run found so and no file has moved since.

    Returns False, having printed nothing, for all that is not `run [PROJECT] [--quiet]`, and where stdout is closed.
    """
    places = [word for word in arguments[1:] if word not in _QUIET]
    if arguments[:1] != ["run"] or len(places) > 1 or any(word.startswith("-") for word in places):
        return False
    from metrocli.project.running.memo import unmoved_jobs

    place = places[0] if places else "."
    jobs = unmoved_jobs(os.path.join(place, PROJECT_FILE) if os.path.isdir(place) else place)
    if jobs is None:
        return False
    lines = up_to_date_lines(jobs) if len(places) + 1 == len(arguments) else ""
    if not lines.replace("\n", "").isprintable():
        return False
    try:
        sys.stdout.write(lines)
        sys.stdout.flush()
    except (OSError, ValueError):
        return False
    return True


def up_to_date_lines(jobs: Sequence[Sequence[str]]) -> str:
    """Return a line for each job, given with its result."""
    return "".join(f"{name}: up to date\n" for name, _ in jobs)
