"""A project of many independent jobs: what it costs to have nothing to do, here and with other programs."""

from __future__ import annotations

import compileall
import os
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

from benchmarks.beside.environments import program_of
from metrocli.formats import hdf5
from metrocli.project import fingerprint, runner
from metrocli.project.running import memo
from metrocli.project.steps import load_project

ROOT = Path(__file__).parents[2]
RUN = [sys.executable, "-m", "metrocli", "run"]


def write(count: int, trials: int = 1000) -> None:
    """Write the project into the working folder."""
    Path("jobs").mkdir()
    for n in range(count):
        Path(f"jobs/j{n}.yaml").write_text(
            f"metrocli: 1\njob: report-uncertainty\nquantities: {{a: {{value: {n} mm, std: 1 um}}}}\n"
            f"measurands: {{l: {{model: 2*a, unit: mm}}}}\nmonte_carlo: {{trials: {trials}}}\n"
            f"output: ../results/j{n}.h5\n"
        )
    Path("metrocli.yaml").write_text("jobs:\n" + "".join(f"- jobs/j{n}.yaml\n" for n in range(count)))


def write_campaign(count: int) -> None:
    """Write a project of one job for each row of a list into the working folder."""
    Path("jobs").mkdir()
    Path("parts.csv").write_text("part,length\n" + "".join(f"p{n},{n}\n" for n in range(count)))
    Path("jobs/part.yaml").write_text(
        "metrocli: 1\njob: report-uncertainty\nfor: {part: ../parts.csv}\n"
        "quantities: {a: {value: '{length} mm', std: 1 um}}\nmeasurands: {l: {model: 2*a, unit: mm}}\n"
        "monte_carlo: {trials: 1000}\noutput: '../results/{part}.h5'\n"
    )
    Path("metrocli.yaml").write_text("jobs: [jobs/part.yaml]\n")


def idle_campaign(count: int) -> dict[str, float | str]:
    """Return the CPU times [ms] of runs of a campaign with nothing to do: as `idle`."""
    write_campaign(count)
    return _own_idle()


def idle(count: int) -> dict[str, float | str]:
    """Return the CPU times [ms] of runs: as `_own_idle`, and those of other programs with nothing to do.

    For one that is not there or takes too long, that is returned in words.
    """
    write(count)
    return _own_idle() | {name: _by_another(name, count) for name in OTHERS}


ONE_TO_DO, NO_MEMO = "one job to do", "without memo"
"""Runs that are not held to the bounds of a run with nothing to do"""


def _own_idle() -> dict[str, float | str]:
    """Return the CPU times [ms] of a run with one job to do, and of runs with nothing to do.

    These are the next one, one when all files have settled, one after all files moved and one without a memo.
    """
    _make_all()
    compileall.compile_dir(str(ROOT / "metrocli"), quiet=1)  # as pip does
    found: dict[str, float | str] = {name: cpu_of([*RUN, "--quiet"]) for name in (ONE_TO_DO, "the next")}
    time.sleep(3)  # the times of younger files do not count
    cpu_of([*RUN, "--quiet"])
    found["settled"] = cpu_of([*RUN, "--quiet"])
    for path in filter(Path.is_file, Path().rglob("[!.]*")):
        path.touch()  # as a checkout does
    found["moved"] = cpu_of([*RUN, "--quiet"])
    Path(memo.NAME).unlink()
    return found | {NO_MEMO: cpu_of([*RUN, "--quiet"])}


def _make_all() -> None:
    """Write the results of all jobs of the project in the working folder but the last."""
    *jobs, _ = (step.job for step in load_project(Path()))
    result, record = runner.compute(jobs[0])
    for job in jobs:
        hdf5.write(job.output, result, replace(record, job_text=job.text, meaning=fingerprint.of_job(job)))


def made(count: int) -> None:
    """Write a project whose jobs are all done but one into the working folder."""
    write(count)
    _make_all()
    compileall.compile_dir(str(ROOT / "metrocli"), quiet=1)  # as pip does


def prepared(name: str, count: int) -> list[str] | None:
    """Write as many jobs that another program copies; return its command, None if it is not there."""
    program = program_of(name)
    if program is None:
        return None
    write(count)
    Path(f"{name}-out").mkdir()
    return _prepared(name, program, [(f"jobs/j{n}.yaml", f"{name}-out/j{n}") for n in range(count)])


def bound(count: int) -> float:
    """Return the longest CPU time [ms] that a run of so many jobs may take with nothing to do."""
    return 100.0 if count <= 50 else 1000.0 if count <= 1000 else 5000.0


OTHERS = ("make", "doit", "snakemake", "dvc")
"""Programs that are measured too; those in Python come from PyPI if they are absent"""
PATIENCE_S = 300
"""Longest time for another program to copy all jobs, and then to see that all are copied [s]"""


def _by_another(name: str, count: int) -> float | str:
    """Return the CPU time [ms] of another program that copies each job to a file, when all are copied."""
    program = program_of(name)
    if program is None:
        return "is not there"
    Path(f"{name}-out").mkdir()
    try:
        command = _prepared(name, program, [(f"jobs/j{n}.yaml", f"{name}-out/j{n}") for n in range(count)])
        subprocess.run(command, check=True, capture_output=True, timeout=PATIENCE_S)
        return cpu_of(command, PATIENCE_S)
    except subprocess.TimeoutExpired:
        return f"takes more than {PATIENCE_S} s"


def _prepared(name: str, program: str, pairs: list[tuple[str, str]]) -> list[str]:
    """Write what another program reads and return its command."""
    if name == "make":
        rules = "".join(f"{made}: {job}\n\tcp $< $@\n" for job, made in pairs)
        Path("Makefile").write_text(f"all: {' '.join(made for _, made in pairs)}\n{rules}")
        return [program, "--silent"]
    if name == "doit":
        Path("dodo.py").write_text(
            f"def task_copy():\n    for job, made in {pairs!r}:\n"
            "        yield {'name': made, 'actions': [['cp', job, made]], 'file_dep': [job], 'targets': [made]}\n"
        )
        return [program, "-v0"]
    if name == "snakemake":
        wanted = ", ".join(repr(made) for _, made in pairs)
        Path("Snakefile").write_text(
            f"rule all:\n    input: {wanted}\nrule copy:\n    input: 'jobs/{{name}}.yaml'\n"
            "    output: 'snakemake-out/{name}'\n    shell: 'cp {input} {output}'\n"
        )
        return [program, "--cores", "1", "--quiet", "all"]
    subprocess.run([program, "init", "--no-scm", "--quiet"], check=True)
    stages = "".join(
        f"  s{n}:\n    cmd: cp {j} {m}\n    deps: [{j}]\n    outs: [{m}]\n" for n, (j, m) in enumerate(pairs)
    )
    Path("dvc.yaml").write_text(f"stages:\n{stages}")
    return [program, "repro", "--quiet"]


def cpu_of(command: list[str], patience: float | None = None) -> float:
    """Return the CPU time of a command in ms; raises if it fails, or takes longer than `patience` [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    null = subprocess.DEVNULL
    subprocess.run(command, check=True, env=environment(), stdout=null, stderr=null, timeout=patience)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return 1e3 * (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def environment() -> dict[str, str]:
    """Return the environment of programs that run this source."""
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
