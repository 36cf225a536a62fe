"""The diagnosis of a job: its files are read, it is adjusted, and the extended job is written beside it."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from itertools import count
from pathlib import Path

from metrocli import tasks
from metrocli.adjust.allowance import allowance
from metrocli.diagnosis.adjusted_job import AdjustedJob, Ordered
from metrocli.diagnosis.corrections import Mistake
from metrocli.diagnosis.detectability import Detectability
from metrocli.diagnosis.diagnose import LIMIT, Attended, diagnose, no_interrupt, what_can_be_seen
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.job_entries import (
    REMOVE,
    as_job,
    correlated_as_job,
    declares,
    proposed_correlated,
    proposed_noise,
    proposed_variances,
    removes_wrong_readings,
    scatter_as_job,
    variance_groups_as_job,
    with_declared,
    with_model,
)
from metrocli.diagnosis.laws.definition import as_define, as_wanted
from metrocli.diagnosis.laws.law import Law
from metrocli.diagnosis.linear.memory import as_fits
from metrocli.diagnosis.mistakes import without_mistakes
from metrocli.effects.own import columns
from metrocli.errors import Fault, InputError, NoSolutionError, NotConvergedError, UndeterminedError
from metrocli.formats.csv_text import numeric
from metrocli.formats.file_bytes import atomic_write
from metrocli.formats.own_files import refuse_inputs
from metrocli.frozen import dataclass
from metrocli.nodes import Node, node_of, relocated, with_entry
from metrocli.progress import SILENT, Named, Progress, counted
from metrocli.project import yaml_text
from metrocli.project.adjuster import adjuster, cleared, others_of
from metrocli.project.inputs import placed, read_inputs
from metrocli.project.job import JobFile, JobOptions, load
from metrocli.project.runner import counting, simulate
from metrocli.simulation import SimulationOptions

_STEPS = 400
"""Steps of a try of an extended job, its starts included: a law that needs more is not determined"""
_NAMED = " with the effects that metrocli diagnose named"
_SHARED = " with the noise that metrocli diagnose proposes"
_RIGHT = " with the setting that metrocli diagnose corrected"
"""Ends of the first line of an extended job, by which it is recognised before it is overwritten"""
_DIGEST = "# sha256 of the lines below, by which diagnose sees whether they were edited: "
"""Begin of its second line"""


@placed
def adjusted_job_of(job: JobFile) -> AdjustedJob:
    """Return the adjusted job as diagnosis takes it; raise UsageError if its kind has no diagnosis."""
    held, without_outliers = read_inputs(job), cleared(job)
    try:
        return adjuster(job)(held)
    except NoSolutionError:
        if without_outliers is None:
            raise
        return without_outliers(held)


@placed
def carry_out(
    job: JobFile,
    progress: Progress = SILENT,
    limit: float = LIMIT,
    attended: Attended = no_interrupt,
    ordered: Ordered = map,
    quick: bool = False,
    first: Callable[[Diagnosis], None] | None = None,
) -> Diagnosis:
    """Adjust a job, correct a mistake in its files if one is found, and diagnose it within a limit of CPU time [s].

    `ordered` computes the folds of cross-validation, perhaps on other processors. `first` takes the answer of a quick
    diagnosis, before the whole one begins.
    """
    more = columns.variables(((item.spec, item.paths) for item in job.inputs), numeric)
    inputs = tuple(replace(item, spec=columns.reading_all(item.spec, more)) for item in job.inputs)
    job = replace(job, inputs=inputs) if more else job
    adjust = adjuster(job, more)
    progress = Named(job.file, progress)
    progress.doing("adjusting")
    held = counting(read_inputs(job), progress)
    adjusted, mistaken = without_mistakes(
        held, adjust, others_of(job, held, adjust), tasks.KINDS[job.kind].task().unplaced, cleared(job, more)
    )
    answer = None if first is None else diagnose(adjusted, progress, limit, attended, ordered, quick=True)
    if first is not None and answer is not None:
        first(answer)
    if answer is not None and answer.interrupted:  # one interruption ends both
        diagnosis = answer
    else:
        diagnosis = diagnose(adjusted, progress, limit, attended, counted(ordered, progress), quick)
    if answer is not None and answer.findings and diagnosis.found_nothing_yet:
        # what was shown as found stays
        diagnosis = replace(answer, design=diagnosis.design, limited=diagnosis.limited, quick=False)
    if mistaken is not None and not mistaken.mended and diagnosis.findings:
        # a wrong list that no correction mends explains less than an effect does
        noticed = (*diagnosis.job.noticed, *map(str, mistaken.mistakes))
        diagnosis, mistaken = replace(diagnosis, job=replace(diagnosis.job, noticed=noticed)), None
    return replace(diagnosis, mistaken=mistaken)


def design_of(job: JobFile, progress: Progress = SILENT) -> tuple[AdjustedJob, Detectability]:
    """Return what the measurement of a job can detect; readings that do not exist yet are simulated."""
    wanted = tasks.KINDS[job.kind].measured
    progress = Named(job.file, progress)
    held = counting(read_inputs(job, wanted), progress)
    if not set(wanted) & set(held) and any(item.key in wanted for item in job.inputs):
        files = simulate(job, SimulationOptions()).files
        made = {Path(name).stem: table for name, table in files.items()}
        held |= {item.key: made[item.key] for item in job.inputs if item.key in wanted and item.key in made}
    progress.doing("adjusting")
    adjusted = as_fits(adjuster(job)(held))
    progress.doing("computing what the measurement can detect")
    return adjusted, what_can_be_seen(adjusted)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


@dataclass(frozen=True)
class Extended:
    """An extended job that was written."""

    path: Path
    law: Law | None
    """The law in it; None without laws with which the job can be adjusted"""


def write_extended(
    job: JobFile, diagnosis: Diagnosis, path: Path | None = None, force: bool = False, result: Path | None = None
) -> Extended | None:
    """Write the job extended by the named effects, by default beside it as `NAME.extended.yaml`; return it.

    `result` is the output of that job, by default `NAME.extended.h5` beside the output of this one. Structure that is
    left stands in it as correlated errors, as a law with `cause: unknown` (the chosen one, or the next simpler one with
    which the job can be adjusted), or as structured noise. Returns None if nothing changes, or if the report states
    that the job cannot be adjusted with the named effects. In another folder, its paths lead to the same files.
    Parameters that the readings do not determine separately are 0. Raises InputError if the file there is no extended
    job or was edited since, unless forced, and if it is an input. Raises NoSolutionError if the job cannot be adjusted
    with what was found, such as a noise so large that nothing is determined.
    """
    path = path or job.file.with_name(f"{job.stem}.extended.yaml")
    stated = proposed_noise(diagnosis) or proposed_correlated(diagnosis) or _correction(diagnosis)
    # a file that is wrong is mended first: its places are as noisy as the mistake makes them
    noisy = diagnosis.mistaken is None and proposed_variances(diagnosis)
    others = bool(stated or noisy or diagnosis.scatters or any(one.confirmed for one in diagnosis.findings))
    # the job with the named effects has no solution; a mistake is mended all the same
    unsolved = diagnosis.mistaken is None and not diagnosis.adjusts
    if unsolved or (not others and diagnosis.law is None):
        return None
    refuse_inputs([path], (*job.stated_in, *job.files))
    _refuse_foreign(path, force)
    why = None
    for law in (*_from_the_chosen(diagnosis), *([None] if others else [])):
        _write(job, diagnosis, law, (path, result))
        # where a file is to be mended first, the job without a law fails until then
        why = None if law is None and diagnosis.mistaken is not None else _refusal(path, law)
        if why is None:
            return Extended(path, law)
    path.unlink(missing_ok=True)
    if others and why is not None:
        raise type(why)(f"the job cannot be adjusted with what was found: {why}", why.misfit)
    return None


def _from_the_chosen(diagnosis: Diagnosis) -> Sequence[Law]:
    """Return the chosen law and the simpler ones, from the longest on."""
    chosen = diagnosis.law
    simpler = [] if chosen is None else [law for law in diagnosis.laws if len(law.terms) < len(chosen.terms)]
    return [*([] if chosen is None else [chosen]), *sorted(simpler, key=lambda law: len(law.terms), reverse=True)]


def _refusal(path: Path, law: Law | None) -> NoSolutionError | None:
    """Return why an extended job cannot be adjusted; None if it can.

    A law in the linearised readings need not hold in the model, and noise that was found there need not leave any.
    """
    job = load(path, JobOptions(accept_doubtful=True))
    try:
        with nullcontext() if law is None else allowance(_STEPS):
            adjusted_job_of(job)
    except (NotConvergedError, UndeterminedError) as error:
        return error
    return None


def _write(job: JobFile, diagnosis: Diagnosis, law: Law | None, place: tuple[Path, Path | None]) -> None:
    """Write the extended job, with a law or without, to a path; its result has the path beside it, or the usual one."""
    path, result = place
    scatters = [scatter for scatter in diagnosis.scatters if not declares(job.root.get("noise"), scatter)]
    named = [
        *map(scatter_as_job, scatters),
        *(as_job(finding.effect) for finding in diagnosis.findings if finding.confirmed),
    ]
    called = _free_name(diagnosis)
    new = [node_of(job.root, entry) for entry in (*named, *([] if law is None else [as_wanted(law, called)]))]
    defined = [] if law is None else [node_of(job.root, as_define(law, called))]
    body = yaml_text.emit(_extended(job, new, defined, diagnosis, (path.parent, result)))
    how = _NAMED if new or diagnosis.scatters else _RIGHT if _correction(diagnosis) else _SHARED
    text = f"# {job.file.name}{how}\n{_DIGEST}{_digest(body)[:16]}\n{body}"
    with atomic_write(path) as aside:
        aside.write_text(text, encoding="utf-8")


def _refuse_foreign(path: Path, force: bool) -> None:
    """Raise InputError if a file exists that is not an extended job, or one that was edited, unless forced."""
    if force or not path.is_file():
        return
    try:
        first, _, rest = path.read_text(encoding="utf-8", errors="replace").partition("\n")
    except OSError as error:
        fault = Fault(f"cannot be read: {error.strerror}", str(path), hint="give another --out")
        raise InputError([fault]) from error
    if not first.rstrip().endswith((_NAMED, _SHARED, _RIGHT)):
        raise InputError([Fault("the file exists and is not an extended job", str(path), hint="give another --out")])
    digest, _, body = rest.partition("\n")
    if digest != f"{_DIGEST}{_digest(body)[:16]}":
        message = "the extended job is not as diagnose wrote it; it was edited and is kept"
        raise InputError([Fault(message, str(path), hint="give another --out, or replace it with --force")])


def _free_name(diagnosis: Diagnosis) -> str:
    """Return the first of law-1, law-2, ... that no effect has."""
    taken = {effect.name for effect in diagnosis.job.effects}
    return next(name for name in (f"law-{number}" for number in count(1)) if name not in taken)


def _extended(
    job: JobFile, effects: Sequence[Node], defined: Sequence[Node], diagnosis: Diagnosis, to: tuple[Path, Path | None]
) -> Node:
    folder, result = to
    correlated = [node_of(job.root, correlated_as_job(error)) for error in proposed_correlated(diagnosis)]
    below = {
        "define": _longer(job, "define", defined),
        "effects": _longer(job, "effects", effects),
        "correlated": _longer(job, "correlated", correlated),
        "variance_groups": node_of(job.root, variance_groups_as_job(diagnosis, job.heading.variance_groups)),
    }
    output = result or job.output.with_name(f"{job.output.stem}.extended.h5")
    moved: Callable[[Node], Node] = lambda value: relocated(value, job.folder, folder)  # noqa: E731
    noise: Callable[[Node], Node] = lambda value: _noise(job, value, diagnosis)  # noqa: E731
    changed = {"inputs": moved, "effects_from": moved, "noise": noise}
    kept = [
        (key, changed[key.text](value) if key.text in changed else value)
        for key, value in _corrected(job, diagnosis)
        if key.text not in (*below, "output")
    ]
    more = [(node_of(job.root, key), items) for key, items in below.items() if items.items]
    if removes_wrong_readings(diagnosis):
        kept = [entry for entry in kept if entry[0].text != "outliers"]
        kept.append((node_of(job.root, "outliers"), node_of(job.root, REMOVE)))
    written = node_of(job.root, "output"), node_of(job.root, os.path.relpath(output, folder))
    return replace(job.root, entries=(*kept, *more, written))


def _correction(diagnosis: Diagnosis) -> Mistake | None:
    """Return the mistake in a section of the job whose right entries are known; None without one."""
    first = None if diagnosis.mistaken is None else diagnosis.mistaken.mistakes[0]
    return first if first is not None and first.entries else None


def _corrected(job: JobFile, diagnosis: Diagnosis) -> Sequence[tuple[Node, Node]]:
    """Return the sections of a job, that of a mistake with the right entries."""
    wrong = _correction(diagnosis)
    if wrong is None:
        return job.root.entries
    root = job.root
    for path, value in wrong.entries.items():
        root = with_entry(root, path.split("."), value)
    return root.entries


def _longer(job: JobFile, key: str, more: Sequence[Node]) -> Node:
    """Return the list under a key of a job with more entries."""
    listed = job.root.get(key)
    return replace(job.root, kind="list", text="", entries=(), items=(*(listed.items if listed else ()), *more))


def _noise(job: JobFile, declared: Node, diagnosis: Diagnosis) -> Node:
    """Return the noise of a job with the scatters that it can declare, and the model that is proposed."""
    for scatter in diagnosis.scatters:
        declared = with_declared(declared, scatter) if declares(declared, scatter) else declared
    return with_model(job.root, declared, model) if (model := proposed_noise(diagnosis)) else declared
