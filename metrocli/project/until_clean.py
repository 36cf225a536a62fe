"""The loop diagnose, extend, run, diagnose again, until a job is clean or nothing more is gained."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from metrocli.diagnosis.evidence.gain import Gain
from metrocli.diagnosis.extended_fit import result_change
from metrocli.diagnosis.findings import Diagnosis, Verdict
from metrocli.diagnosis.laws.definition import written
from metrocli.errors import NoSolutionError
from metrocli.frozen import dataclass
from metrocli.progress import SILENT, Progress
from metrocli.project import runner
from metrocli.project.diagnosed import carry_out, write_extended
from metrocli.project.job import JobFile, JobOptions, load
from metrocli.project.runner import Done

MOST = 5
"""Largest number of extensions unless given"""


class End(StrEnum):
    """Why the loop ended."""

    CLEAN = "clean"
    UNEXPLAINED = "unexplained, and no law was found"
    NOTHING_GAINED = "nothing that could be added predicts held-out readings better"
    MOST = "the largest number of extensions is reached"
    MISTAKEN = "a file of the job is wrong"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Extension:
    """One extension of the job, and what it changed."""

    job: Path
    done: Done
    added: tuple[str, ...]
    """The effects, with their places, and the law"""
    p_value: float
    """Level of the least significant of them"""
    before: float
    after: float
    """Held-out error without and with them, in the internal unit of the readings"""
    shift: float | None
    """Largest change of the delivered result by one of the effects, or by all that was added if a law is among it"""


@dataclass(frozen=True)
class Loop:
    """The extensions of a job up to the end, with the first and the last diagnosis."""

    first: Diagnosis
    last: Diagnosis
    extensions: tuple[Extension, ...]
    end: End
    pending: tuple[str, ...] = ()
    """What an interrupted diagnosis had found and would have added"""


def until_clean(
    job: JobFile,
    diagnose: Callable[[JobFile], Diagnosis] = carry_out,
    most: int = MOST,
    progress: Progress = SILENT,
    force: bool = False,
) -> Loop:
    """Extend a job by what is found in it, as long as held-out readings show a gain; all jobs and results are written.

    `diagnose` carries out a diagnosis; one that is interrupted is the last.
    Extended jobs are `NAME.step1.yaml`, `NAME.step2.yaml`, ... beside the job, their results beside its output. Raises
    InputError if a file there is no extended job or was edited, unless forced.
    """
    current, extensions = job, list[Extension]()
    first = last = diagnose(job)
    while True:
        gained = replace(
            last,
            findings=tuple(finding for finding in last.findings if finding.gain.shown),
            scatters=tuple(scatter for scatter in last.scatters if scatter.gain.shown),
            laws=tuple(law for law in last.laws if law.chosen and law.gain.shown),
        )
        end = _end(last, gained, len(extensions) == most)
        if end is not None:
            names = tuple(name for name, *_ in _parts(gained)) if end is End.INTERRUPTED else ()
            return Loop(first, last, tuple(extensions), end, names)
        number = len(extensions) + 1
        path = job.file.with_name(f"{job.stem}.step{number}.yaml")
        result = job.output.with_name(f"{job.output.stem}.step{number}.h5")
        simpler = tuple(law for law in last.laws if law.gain.shown) if gained.laws else ()
        try:
            extended = write_extended(current, replace(gained, laws=simpler), path, force, result)
        except NoSolutionError:
            return Loop(first, last, tuple(extensions), End.NOTHING_GAINED)
        # the laws with which the job cannot be adjusted are none
        law = None if extended is None else extended.law
        gained = replace(gained, laws=() if law is None else (law,))
        if extended is None or not _adds(gained):
            path.unlink(missing_ok=True)
            return Loop(first, last, tuple(extensions), End.NOTHING_GAINED)
        current = load(path, JobOptions(accept_doubtful=job.accept_doubtful))
        extensions.append(_extension(path, runner.carry_out(current, force, progress), gained))
        before, last = last, diagnose(current)
        if gained.laws:
            extensions[-1] = replace(extensions[-1], shift=_moved(before, last))


def _end(last: Diagnosis, gained: Diagnosis, spent: bool) -> End | None:
    """Return why the loop ends after a diagnosis, or None if it goes on with what is gained."""
    if last.interrupted:
        return End.INTERRUPTED
    if last.verdict is Verdict.MISTAKEN:
        return End.MISTAKEN
    if last.verdict is Verdict.CLEAN:
        return End.CLEAN
    if not _adds(gained):
        return End.UNEXPLAINED if last.verdict is Verdict.UNEXPLAINED and not last.laws else End.NOTHING_GAINED
    return End.MOST if spent else None


def _adds(gained: Diagnosis) -> bool:
    """Return whether something is gained that can be added to the job."""
    return bool(gained.findings or gained.scatters or gained.laws)


def _extension(path: Path, done: Done, gained: Diagnosis) -> Extension:
    names, levels, gains = zip(*_parts(gained), strict=True)
    before, after = max(gain.before for gain in gains), min(gain.after for gain in gains)
    shifts = [finding.shift for finding in gained.findings] + [scatter.shift for scatter in gained.scatters]
    return Extension(path, done, names, max(levels), before, after, max(shifts, default=None))


def _moved(before: Diagnosis, after: Diagnosis) -> float | None:
    """Return the largest change of the delivered result between two diagnoses; None if they are of other members."""
    old, new = before.job, after.job
    names = old.delivered.blocks
    same = all(old.model.blocks[name].members == new.model.blocks[name].members for name in names)
    return result_change(old, new) if same else None


def _parts(gained: Diagnosis) -> Iterator[tuple[str, float, Gain]]:
    """Yield what is added: in words, with its level and its gain."""
    for finding in gained.findings:
        yield str(finding.effect.alternative), float(np.exp(finding.effect.log_level)), finding.gain
    for scatter in gained.scatters:
        yield f"{scatter.effect.name} everywhere", float(np.exp(scatter.log_level)), scatter.gain
    for law in gained.laws:
        place = " ".join(name for _, name in law.terms[0].spot.where)
        yield f"law {'; '.join(written(law).adds.values())} {place}".strip(), law.p_value, law.gain
