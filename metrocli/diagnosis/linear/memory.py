"""The memory that a diagnosis takes, estimated before anything is computed.

It is linear in the readings. A diagnosis that would take more than there is would be ended by the system without a
word, so it is refused with the numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear.linearised import shared_unknowns
from metrocli.diagnosis.linear.smooth_terms import columns_of_smooth
from metrocli.effects.effect import Effect
from metrocli.effects.model import Model
from metrocli.errors import InputError

_MOST = 4e9
"""Most memory that a diagnosis takes, wherever it runs [bytes]"""
_FIXED = 0.3e9
"""What it takes for few readings: noise that is drawn, samples, modules [bytes]"""
_COPIES = 4
"""Times that the derivatives by the shared unknowns are held at once, and candidates beside their own making"""
_HELD = 2.5
_STATISTICS = "/sys/fs/cgroup/memory.stat"


def must_fit(job: AdjustedJob) -> None:
    """Raise InputError, with the numbers, if a diagnosis of many readings would take more memory than there is."""
    need, most = needed(job), at_hand()
    # few readings take what the program takes anyhow, so that fewer of them would not help
    if need > max(most, 2 * _FIXED):
        readings = sum(group.observations.readings.size for group in job.model.readings)
        raise InputError(
            f"diagnose needs about {need / 1e9:.1f} GB for {readings} readings, and can take {most / 1e9:.1f} GB\n"
            f"diagnose a part of the measurement, such as one point or pose in {math.ceil(need / most)}"
        )


def needed(job: AdjustedJob) -> float:
    """Return the memory that a diagnosis takes at its largest, `f + 8 n (4 u + 2.5 k)` [bytes].

    n are the rows, u the shared unknowns, k the columns of candidates that change a row; f is for few readings. The
    factors are those of measured networks of 10,000 and 100,000 points.
    """
    rows = sum(group.observations.readings.size for group in job.model.groups)
    columns = columns_of_smooth(job) + _columns_of_effects(job)
    return _FIXED + 8.0 * rows * (_COPIES * shared_unknowns(job.model) + _HELD * columns)


def _columns_of_effects(job: AdjustedJob) -> int:
    """Return how many columns of effects each row has at most, those of a step once."""
    sought = (one for one in job.effects if not one.of_one_reading and one.name not in job.not_sought)
    return sum(len(one.parameters) * math.prod(_tried(job.model, one)) for one in sought)


def _tried(model: Model, effect: Effect) -> Iterator[int]:
    """Yield how many values of each scanned parameter are tried at most."""
    for parameter in () if effect.is_step else effect.scanned:
        place = model.places.get(parameter.place)
        yield parameter.tried if place is None else len(place.names)


def at_hand() -> float:
    """Return the memory that a diagnosis can take [bytes]: what is free, within the limits of process and group."""
    return max(min(_MOST, *_free(), *_left_by_limits()), 0.0)


def _free() -> list[float]:
    """Return what the system and the control group of the process have left, where they say so."""
    found = []
    for line in _text("/proc/meminfo").splitlines():
        if line.startswith("MemAvailable:"):
            found.append(float(line.split()[1]) * 1024)
    most, taken = (_text(f"/sys/fs/cgroup/memory.{name}").strip() for name in ("max", "current"))
    if most.isdigit() and taken.isdigit():
        # files that were read stay in memory until it is needed
        kept = [float(line.split()[1]) for line in _text(_STATISTICS).splitlines() if line.startswith("inactive_file ")]
        found.append(float(most) - float(taken) + sum(kept))
    return found


def _left_by_limits() -> list[float]:
    try:
        import resource
    except ImportError:
        return []  # Windows sets no such limit
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    taken = _text("/proc/self/statm").split()
    if limit == resource.RLIM_INFINITY or not taken:
        return []
    return [limit - float(taken[0]) * resource.getpagesize()]


def _text(path: str) -> str:
    """Return the text of a file of the system; nothing where there is no such file."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError:
        return ""
