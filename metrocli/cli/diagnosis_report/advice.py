"""What a report advises: to mend a file, to leave wrong readings out, and to run the extended job."""

from __future__ import annotations

from collections.abc import Iterator

from metrocli.cli.columns import text_table
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.job_entries import (
    REMOVE,
    proposed_correlated,
    proposed_noise,
    proposed_variances,
    removes_wrong_readings,
)
from metrocli.diagnosis.laws.law import Law
from metrocli.diagnosis.trials import Mistaken
from metrocli.diagnosis.wrong_readings import Outlier
from metrocli.words import in_a_row, listed

SHOWN = 6
"""Most entries of a list in a line; of wrong readings four times as many have a row"""
DESCRIBED = 4
"""Most effects with lines of their own; the table lists all"""


def mistake_lines(mistaken: Mistaken) -> Iterator[str]:
    """Yield what is wrong in a file or a setting, and what to write instead."""
    mistakes = mistaken.mistakes
    alike = " in one of these ways, which the readings do not distinguish" if mistakes[1:] else ""
    what = "file" if mistakes[0].file else "file or setting"
    yield f"A {what} of this job is wrong{alike}:"
    yield from (f"  {mistake}" for mistake in mistakes[:SHOWN])
    yield f"write: {mistakes[0].write}" + (", if it is the first" if mistakes[1:] else "")
    yield f"All that follows is for the {'corrected job' if mistaken.mended else 'job as it stands'}."


def wrong_readings(outliers: tuple[Outlier, ...], how: str) -> Iterator[str]:
    """Yield the table of wrong readings, each with those that are as likely to be the wrong one, and what to do.

    `how` is what the job does with outliers.
    """
    shown = outliers[: SHOWN * DESCRIBED]
    rows = [("/".join(outlier.keys.values()), f"{outlier.test:.1f} sigma", _others(outlier)) for outlier in shown]
    yield from text_table(("wrong reading", "error", "or instead"), rows)
    if len(outliers) > len(rows):
        yield f"... {len(outliers) - len(rows)} more"
    if all(outlier.others for outlier in outliers):
        yield "These readings do not show which one is wrong: measure them again."
    else:
        own = "The job has `outliers: remove`, which" if how == REMOVE else "`outliers: remove`"
        leave = f"{own} leaves wrong readings out" if how else "Leave the rows of wrong readings out"
        again = "." if how == REMOVE else "; or measure them again."
        yield f"{leave}{again}"


def _others(outlier: Outlier) -> str:
    return listed([*map(str, outlier.effects), *("/".join(keys.values()) for keys in outlier.others)], SHOWN)


def extension(diagnosis: Diagnosis, law: Law | None) -> str:
    """Return what an extended job with a law, or without, has that the job lacks."""
    named = diagnosis.scatters or any(finding.confirmed for finding in diagnosis.findings)
    added = [*(["the named effects"] if named else []), *(["the law"] if law is not None else [])]
    removed = ["`outliers: remove`"] if removes_wrong_readings(diagnosis) else []
    shared = in_a_row([*shared_errors(diagnosis), *removed])
    if not added and not shared:
        return "the job corrected as stated above, and diagnose it again"
    if not added:
        remains = proposed_noise(diagnosis) or proposed_correlated(diagnosis)
        what = "include the structure left" if diagnosis.left is not None else "include the smooth error"
        return f"the job with {shared}: its uncertainties {what if remains else 'are for the noise of each place'}"
    shared = f" and with {shared}" if shared else ""
    return f"the job extended by {' and '.join(added)}{shared}, and diagnose it again"


def shared_errors(diagnosis: Diagnosis) -> list[str]:
    """Return what the extended job has for errors that readings share, and for noisier ones beside these."""
    shared = ["`correlated:` errors"] if proposed_correlated(diagnosis) else []
    shared += [f"`{diagnosis.job.model_key}: {noise}`"] if (noise := proposed_noise(diagnosis)) else []
    return [*shared, *(["`variance_groups:`"] if proposed_variances(diagnosis) else [])]
