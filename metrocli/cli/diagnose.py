"""metrocli diagnose: what the model of a job gets wrong, why, and what correcting it gains."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli import options
from metrocli.cli.console import Console, echo, echo_json
from metrocli.cli.shell.signals import first_interrupt
from metrocli.errors import InputError, NoSolutionError, UsageError
from metrocli.project import DIAGNOSIS
from metrocli.record import NOT_MET
from metrocli.tasks import KINDS

if TYPE_CHECKING:
    from metrocli.diagnosis.findings import Diagnosis
    from metrocli.project.diagnosed import Extended
    from metrocli.project.job import JobFile, JobOptions

CLEAN = "clean"


@click.command("diagnose", help="Find what the model of a job gets wrong, why, and what correcting it gains.")
@options.JOB
@click.option("--design", is_flag=True, help="List what the measurement can detect at all; also before it is made.")
@click.option("--quick", is_flag=True, help="Look for what explains most: the first answer, in seconds.")
@click.option("--full", is_flag=True, help="List all candidates: what is excluded, and what could not be seen.")
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="FILE.yaml", help="Write the extended job to this file."
)
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE.h5",
    help="Result of the job, beside which the diagnosis is kept.",
)
@click.option("--require", type=click.Choice([CLEAN]), help="Exit code 6 unless the verdict is this one.")
@click.option("--limit", default="120 s", metavar="TIME", help="CPU time of the searches, e.g. '60 s'; default 120 s.")
@click.option("--until-clean", is_flag=True, help="Extend, run and diagnose again until clean or nothing is gained.")
@click.option("--most", default=5, show_default=True, type=click.IntRange(1), help="Most extensions of --until-clean.")
@click.option(
    "--next",
    "following",
    type=click.IntRange(1, 1000),
    metavar="N",
    help="Propose the N readings that help most, such as 5.",
)
@options.SCHEDULER
@options.FORCE
@options.SET
@options.ACCEPT
@options.JSON
@options.QUIET
@options.VERBOSE
def command(
    job: Path, design: bool, out: Path | None, following: int | None, force: bool, as_json: bool, **flags: Any
) -> int:
    """Diagnose, write the extended job where effects were named, and print the report.

    Where the extended job cannot be written, the report is printed with a warning; with `--out` it is an error.
    """
    from metrocli.project.job import JobOptions, load

    if design and flags["scheduler"]:
        raise UsageError("--design has no parts that a cluster could compute: leave --scheduler out")
    if following is not None and (design or flags["until_clean"]):
        raise UsageError("--next needs a diagnosis of its own: leave --design and --until-clean out")
    if flags["quick"] and (design or flags["until_clean"] or following is not None or flags["full"]):
        raise UsageError("--quick is the first answer alone: leave --design, --until-clean, --next and --full out")
    console = Console(flags["quiet"] or as_json, flags["verbose"])
    result = flags["output"]
    if result is not None and result.suffix in (".yaml", ".yml"):
        raise UsageError(f"--output {result}: it names the result of the job, FILE.h5; --out names the extended job")
    asked = JobOptions(flags["overrides"], options.result_file(result), accept_doubtful=flags["accept_doubtful"])
    if design:
        return _design(job, asked, as_json, console)
    if flags["until_clean"]:
        return _loop(load(job, asked), flags, force, as_json)
    return _once(load(job, asked), flags, out, following, force, as_json)


def _design(path: Path, asked: JobOptions, as_json: bool, console: Console) -> int:
    """Print what a measurement can detect."""
    from metrocli.cli.diagnosis_report import findings
    from metrocli.diagnosis import verdict
    from metrocli.project import diagnosed
    from metrocli.project.job import kind_of_job, load

    kind = kind_of_job(path)
    requested = replace(asked, not_needed=KINDS[kind].measured if kind else ())
    adjusted, detectability = diagnosed.design_of(load(path, requested), console)
    if as_json:
        echo_json(verdict.design_data(adjusted, detectability))
    console.print(findings.of_design(adjusted, detectability))
    return 0


def _once(
    loaded: JobFile, flags: dict[str, Any], out: Path | None, following: int | None, force: bool, as_json: bool
) -> int:
    """Print the diagnosis of a job, and write the extended job."""
    from metrocli.cli.diagnosis_report import findings
    from metrocli.cli.diagnosis_report.next_readings import next_lines
    from metrocli.diagnosis.next_readings.choice import as_data, next_readings
    from metrocli.project import diagnosed
    from metrocli.project.own_effects import alike_for
    from metrocli.uncertainty.workers.dask_cluster import ordered_on

    console, limit = Console(flags["quiet"] or as_json, flags["verbose"]), _seconds(flags["limit"])
    with ordered_on(flags["scheduler"], alike_for([(loaded.kind, loaded.own.packages)])) as ordered:
        first = _first_answer if console.is_watched and not (console.quiet or flags["quick"]) else None
        diagnosis = diagnosed.carry_out(loaded, console, limit, first_interrupt, ordered, flags["quick"], first)
    extended = _extended(loaded, diagnosis, out, force)
    proposed = None if following is None else next_readings(diagnosis, following)
    data = _data(loaded, diagnosis, None if extended is None else extended.path)
    if as_json:
        echo_json(data | (as_data(proposed) if proposed else {}))
    console.print(findings.of_diagnosis(diagnosis, extended, flags["full"]))
    if proposed is not None:
        console.print("\n".join(["", *next_lines(proposed)]))
    if not as_json:
        _keep(loaded, data, force, console)
    return 0 if _is_met(flags["require"], diagnosis) else NOT_MET


def _first_answer(diagnosis: Diagnosis) -> None:
    """Print what effects alone explain, while all else is looked for."""
    from metrocli.cli.diagnosis_report.headline import summary

    lines = list(summary(diagnosis)) or ["  no effect explains most of the misfit"]
    echo("\n".join(["first answer, to be refined:", *lines]), err=True)


def _extended(job: JobFile, diagnosis: Diagnosis, out: Path | None, force: bool) -> Extended | None:
    """Write the extended job, where effects were named; what prevents it is an error if a file was asked for."""
    from metrocli.project import diagnosed

    try:
        return diagnosed.write_extended(job, diagnosis, out, force)
    except (InputError, NoSolutionError) as error:
        if out is not None and isinstance(error, InputError):
            raise
        echo(f"warning: no extended job was written: {error}", err=True)
        return None


def _data(job: JobFile, diagnosis: Diagnosis, extended: Path | None) -> dict[str, Any]:
    from metrocli.diagnosis import verdict
    from metrocli.project.fingerprint import of_diagnosed
    from metrocli.project.inputs import input_files

    of = of_diagnosed(job.text, input_files(job))
    return verdict.as_data(diagnosis) | {"extended_job": extended and str(extended), "of": of}


def _keep(job: JobFile, data: dict[str, Any], force: bool, console: Console) -> None:
    """Write a diagnosis beside the result of its job, for figures and pages; what prevents it is a warning."""
    from metrocli.cli import summary
    from metrocli.formats.own_files import write_all

    try:
        for path in write_all({job.output.with_suffix(DIAGNOSIS): f"{summary.as_json(data)}\n".encode()}, force):
            shown = f", shown by metrocli report {job.output}" if job.output.is_file() else ""
            console.print(f"\ndiagnosis: {path}{shown}")
    except InputError as error:
        echo(f"warning: the diagnosis was not saved: {error}", err=True)


def _loop(job: JobFile, flags: dict[str, Any], force: bool, as_json: bool) -> int:
    """Print the steps of the loop until a job is clean."""
    from metrocli.cli.diagnosis_report.loop import loop_data, loop_text
    from metrocli.project.diagnosed import carry_out
    from metrocli.project.job import JobOptions, load
    from metrocli.project.own_effects import alike_for
    from metrocli.project.until_clean import until_clean
    from metrocli.uncertainty.workers.dask_cluster import ordered_on

    console = Console(flags["quiet"] or as_json, flags["verbose"])
    limit = _seconds(flags["limit"])
    with ordered_on(flags["scheduler"], alike_for([(job.kind, job.own.packages)])) as ordered:
        once = partial(carry_out, progress=console, limit=limit, attended=first_interrupt, ordered=ordered)
        loop = until_clean(job, once, flags["most"], console, force)
    if as_json:
        echo_json(loop_data(loop))
    console.print(loop_text(loop))
    if not as_json:
        steps = [extension.job for extension in loop.extensions]
        _keep(job, _data(job, loop.first, steps[0] if steps else None), force, console)
        if steps:
            last = load(steps[-1], JobOptions(accept_doubtful=job.accept_doubtful))
            _keep(last, _data(last, loop.last, None), force, console)
    return 0 if _is_met(flags["require"], loop.last) else NOT_MET


def _is_met(verdict: str | None, diagnosis: Diagnosis) -> bool:
    """Return whether a diagnosis has the required verdict; one that ended early has none that counts."""
    return verdict is None or (diagnosis.verdict == verdict and diagnosis.ended_early == "")


def _seconds(text: str) -> float:
    """Return a limit of time in seconds."""
    from metrocli.units import QuantityError, parse_quantity

    try:
        limit = parse_quantity(text, "time")
    except QuantityError as error:
        raise UsageError(f"--limit: {error}; write a time such as '60 s'") from error
    if limit <= 0:
        raise UsageError(f"--limit: {text} is not above zero")
    return limit
