"""Mistakes in the files of a job: a wrong unit, swapped or mirrored axes.

Each correction is tried by an adjustment with it. They are tried only if a job fails, or if its result is beyond
anything that an effect causes (decision 019).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.errors import InputError, NotConvergedError, UndeterminedError
from metrocli.table import Table
from metrocli.units import DIMENSIONS, INCH

if TYPE_CHECKING:
    from metrocli.table import Values

_ABSURD = 10.0
"""Median residual, in declared standard deviations, above which mistakes in the files are tried"""
_BETTER = 10.0
"""How many times closer to the plausible a job must be after a correction"""
_AS_GOOD = 2.0
"""Corrections up to so many times as far from the plausible as the best one are reported with it"""

Inputs = Mapping[str, object]
Adjust = Callable[[Inputs], AdjustedJob]


@dataclass(frozen=True)
class Mistake:
    """A possible mistake in one input."""

    input: str
    words: str
    write: str
    """What to write in the file instead"""
    shrinks: float = 1.0
    """Factor by which its correction makes numbers smaller, and with them their residuals whatever is wrong"""

    def __str__(self) -> str:
        return f"{self.input}: {self.words}"


@dataclass(frozen=True)
class Mistaken:
    """The mistakes that explain the state of a job, the best first, and the job after the correction of that one."""

    mistakes: tuple[Mistake, ...]
    job: AdjustedJob
    before: float
    """`strangeness` of the job with the mistake, inf if it failed"""
    after: float


def without_mistakes(inputs: Inputs, adjust: Adjust) -> tuple[AdjustedJob, Mistaken | None]:
    """Return the adjusted job, and the mistake in a file without which it was adjusted, if there is one.

    Corrections are tried if the job fails or is absurd. If none explains that, the exception of the job as it is is
    raised.
    """
    failure: Exception | None = None
    job, before = None, float("inf")
    try:
        job = adjust(inputs)
        before = strangeness(job)
    except (UndeterminedError, NotConvergedError, InputError) as error:
        failure = error
    if job is not None and before <= 1:
        return job, None
    found = _explaining(inputs, adjust, before)
    if found is not None:
        return found.job, found
    if job is None:
        raise failure or RuntimeError("a job that gave nothing")
    return job, None


def strangeness(job: AdjustedJob) -> float:
    """Return how far a job is beyond the plausible: by its median residual, or by its places compared with the files.

    Above 1 it is absurd.
    """
    medians = []
    for group in job.model.readings:
        residual = group.observations.whitened(group.residuals(job.model.blocks))
        medians.append(float(np.median(np.abs(residual))))
    return max(max(medians, default=0.0) / _ABSURD, job.astray)


def _explaining(inputs: Inputs, adjust: Adjust, before: float) -> Mistaken | None:
    tried: list[tuple[float, Mistake, AdjustedJob]] = []
    for mistake, changed in altered(inputs):
        try:
            job = adjust(changed)
        except (UndeterminedError, NotConvergedError, InputError):
            continue
        value = strangeness(job)
        if value <= 1 and value * _BETTER <= before * mistake.shrinks:
            tried.append((value, mistake, job))
    if not tried:
        return None
    tried.sort(key=lambda one: one[0])
    best = tried[0]
    alike = tuple(mistake for value, mistake, _ in tried if value <= max(_AS_GOOD * best[0], _AS_GOOD / _ABSURD))
    return Mistaken(alike, best[2], before, best[0])


def altered(inputs: Inputs) -> Iterator[tuple[Mistake, Inputs]]:
    """Yield each possible mistake in the files, with the corrected inputs."""
    for key, table in inputs.items():
        if isinstance(table, Table):
            for words, write, factor, changed in _of_table(table):
                yield Mistake(key, words, write, min(abs(factor), 1.0)), {**inputs, key: changed}


def _of_table(table: Table) -> Iterator[tuple[str, str, float, Table]]:
    """Yield what may be wrong, what to write instead, the factor of the numbers, and the corrected table."""
    lengths = [name for name, unit in table.units.items() if unit == "mm" and not name.startswith("sigma")]
    per_metre = next(unit.times for unit in DIMENSIONS["length"].units if unit.symbol == "m")
    units = (
        ("written in inches, read as millimetres", "_in", INCH),
        ("written in millimetres, read as inches", "_mm", 1 / INCH),
        ("a thousand times too small (metres for millimetres, millimetres for micrometres)", "_m or _mm", per_metre),
        (
            "a thousand times too large (millimetres for metres, micrometres for millimetres)",
            "_mm or _um",
            1 / per_metre,
        ),
    )
    heading = "the unit in the headings of the columns of {}, such as {}"
    for words, ending, factor in units if lengths else ():
        yield words, heading.format("lengths", ending), factor, _scaled(table, lengths, factor)
    angles = [name for name, unit in table.units.items() if unit == "rad"]
    if angles:
        degree = next(unit.inside(1.0) for unit in DIMENSIONS["angle"].units if unit.symbol == "deg")
        yield "degrees, read as radians", heading.format("angles", "_deg"), degree, _scaled(table, angles, degree)
        yield (
            "radians, read as degrees",
            heading.format("angles", "_rad"),
            1 / degree,
            _scaled(table, angles, 1 / degree),
        )
    for one, other in combinations(angles, 2):
        yield (
            f"{one} and {other} are swapped",
            f"{other} for {one} and {one} for {other} in the headings",
            1.0,
            _swapped(table, one, other),
        )
    for angle in angles:
        yield f"{angle} has the wrong sign", f"{angle} with the other sign", 1.0, _scaled(table, [angle], -1.0)
    axes = [name for name in "xyz" if name in table]
    for one, other in combinations(axes, 2):
        yield (
            f"{one} and {other} are swapped",
            f"{other} for {one} and {one} for {other} in the headings",
            1.0,
            _swapped(table, one, other),
        )
    for axis in axes:
        yield f"{axis} has the wrong sign", f"{axis} with the other sign", 1.0, _scaled(table, [axis], -1.0)


def _scaled(table: Table, names: list[str], factor: float) -> Table:
    columns: dict[str, Values] = {**table.columns}
    columns |= {name: table.numbers(name) * factor for name in names}
    return replace(table, columns=columns)


def _swapped(table: Table, one: str, other: str) -> Table:
    columns: dict[str, Values] = {**table.columns}
    columns[one], columns[other] = table.columns[other], table.columns[one]
    return replace(table, columns=columns)
