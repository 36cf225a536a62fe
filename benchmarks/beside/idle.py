"""A project whose jobs are all done: what a run with nothing to do takes, its start included."""

from __future__ import annotations

import os
import subprocess
import tempfile

from benchmarks.beside.work import Values, Work


def ours(jobs: int) -> Work:
    """`metrocli run`."""
    from benchmarks.projects.many_jobs import RUN, environment, made

    os.chdir(tempfile.mkdtemp())
    made(jobs)
    return _call([*RUN, "--quiet"], environment())


def make(jobs: int) -> Work:
    """GNU Make, on as many files that are copied."""
    return _other("make", jobs)


def doit(jobs: int) -> Work:
    """doit."""
    return _other("doit", jobs)


def snakemake(jobs: int) -> Work:
    """Snakemake."""
    return _other("snakemake", jobs)


def dvc(jobs: int) -> Work:
    """DVC."""
    return _other("dvc", jobs)


def _other(name: str, jobs: int) -> Work:
    from benchmarks.projects.many_jobs import prepared

    os.chdir(tempfile.mkdtemp())
    command = prepared(name, jobs)
    if command is None:
        raise SystemExit(f"{name} is not there")
    return _call(command, dict(os.environ))


def _call(command: list[str], environment: dict[str, str]) -> Work:
    subprocess.run(command, check=True, capture_output=True, env=environment)

    def run() -> Values:
        subprocess.run(command, check=True, capture_output=True, env=environment)
        return []

    return run
