"""200 jobs on a Dask cluster of two worker processes: the results of one computer, whatever dies on the way."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks.diagnosis_speed import measurements
from benchmarks.projects.hard_ends import NOT_TRIED
from benchmarks.projects.many_jobs import RUN, cpu_of, environment, write
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.verdict import as_data
from metrocli.formats import hdf5
from metrocli.uncertainty.workers.dask_cluster import ordered_on

TRIALS = 100_000
LONG_TRIALS = 1_000_000
TOO_LATE = f"{NOT_TRIED}: the workers had done all jobs before; take more of them"
SCHEDULER = ["-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
WORKER = ["-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard", "--no-nanny"]


@contextlib.contextmanager
def cluster(workers: int = 2) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Yield the scheduler file of a cluster in a folder of its own, and its processes: the scheduler, then workers."""
    with tempfile.TemporaryDirectory() as elsewhere, open(os.devnull, "wb") as log:
        file = Path(elsewhere) / "scheduler.json"

        def start(words: list[str]) -> subprocess.Popen[bytes]:
            command = [sys.executable, *words, "--scheduler-file", str(file)]
            return subprocess.Popen(command, cwd=elsewhere, env=environment(), stdout=log, stderr=log)

        begun = [start(SCHEDULER)]
        while not file.is_file():
            time.sleep(0.1)
        begun += [start([*WORKER, "--local-directory", elsewhere]) for _ in range(workers)]
        try:
            yield str(file), begun
        finally:
            for process in begun:
                process.kill()
                process.wait(20)


def cluster_runs(count: int) -> Iterator[tuple[str, str]]:
    """Yield each run of the project on a cluster with what went wrong, empty for nothing."""
    write(count, TRIALS)
    begun = time.monotonic()
    subprocess.run([*RUN, "--jobs", "2"], check=True, capture_output=True, env=environment())
    local = time.monotonic() - begun
    wanted = _contents()
    with cluster() as (file, _):
        seconds, wrong = _run(file, wanted)
        yield f"{count} jobs on two workers, {seconds:.1f} s (here with --jobs 2: {local:.1f} s)", wrong
    with cluster() as (file, processes):
        seconds, wrong = _run(file, wanted, processes[1])
        yield f"one worker killed in the middle, {seconds:.1f} s", wrong
    with cluster() as (file, processes):
        yield "the scheduler killed in the middle", _without_scheduler(file, wanted, processes[0])


def overhead(count: int) -> tuple[float, float, float, float]:
    """Return the CPU time of a job here with --jobs 2 and on a cluster [ms], and what a run needs beside its jobs [ms].

    All processes count: on the cluster the scheduler, the workers and the run that asks. Two projects of different size
    separate what is the same for any number of jobs, above all imports. The least of three times counts.
    """
    few, sizes = max(count // 10, 1), {}
    for jobs in (few, count + few):
        Path(str(jobs)).mkdir()
        with contextlib.chdir(str(jobs)):
            write(jobs, LONG_TRIALS)
        sizes[jobs] = [float("inf"), float("inf")]
    with cluster() as (file, processes):
        for _ in range(3):
            for jobs, least in sizes.items():
                for place, how in enumerate((["--jobs", "2"], ["--scheduler", file])):
                    before = sum(map(_cpu, processes))
                    shutil.rmtree(f"{jobs}/results", ignore_errors=True)
                    asking = cpu_of([*RUN, str(jobs), *how])
                    least[place] = min(least[place], asking + 1e3 * (sum(map(_cpu, processes)) - before))
    (here, there), (all_here, all_there) = sizes.values()
    own, sent = (all_here - here) / count, (all_there - there) / count
    return own, sent, here - few * own, there - few * sent


def trials_overhead(millions: int) -> tuple[float, float, str]:
    """Return the CPU time [s] of millions of trials of one job here and on one worker, and what went wrong.

    All processes count. A job of a million trials separates what is the same for any number, above all imports. The
    least of three times counts.
    """
    spent: dict[tuple[int, str], float] = {}
    bits = {}
    with cluster(1) as (file, processes):
        for trials in (1, millions + 1) * 3:
            for how in (("--workers", "1"), ("--scheduler", file)):
                job = f"big-{trials}{how[0]}.yaml"
                Path(job).write_text(
                    "metrocli: 1\njob: report-uncertainty\n"
                    "quantities: {a: {value: 1 mm, std: 1 um}, b: {value: 2 mm, half_width: 3 um}}\n"
                    "measurands: {l: {model: a + sqrt(a**2 + b**2), unit: mm}}\n"
                    f"monte_carlo: {{trials: {trials}000000}}\noutput: {job}.h5\n"
                )
                before = sum(map(_cpu, processes))
                asking = cpu_of([*RUN[:-1], "report-uncertainty", job, "--force", *how])
                used = asking / 1e3 + sum(map(_cpu, processes)) - before
                spent[trials, how[0]] = min(spent.get((trials, how[0]), used), used)
                bits[trials, how[0]] = hdf5.read(Path(f"{job}.h5"))[0].details
    here, there = (spent[millions + 1, how] - spent[1, how] for how in ("--workers", "--scheduler"))
    alike = all(repr(bits[trials, "--workers"]) == repr(bits[trials, "--scheduler"]) for trials in (1, millions + 1))
    return here, there, "" if alike else "other results than here"


def shared_trials(millions: int) -> tuple[list[float], str]:
    """Return the CPU time [s] of each of two workers on a project of one Monte Carlo job, and what went wrong."""
    write(1, millions * 1_000_000)
    subprocess.run([*RUN, "--quiet"], check=True, capture_output=True, env=environment())
    wanted = _contents()
    with cluster() as (file, (_, *workers)):
        _, wrong = _run(file, wanted)
        return [_cpu(worker) for worker in workers], wrong


def diagnosis_on_cluster() -> Iterator[tuple[str, str]]:
    """Yield each diagnosis with the CPU time [s] here and on a cluster, and what went wrong, empty for nothing."""
    for name, adjusted, _ in measurements():
        here, own = _diagnosed(adjusted, "")
        with cluster() as (file, processes):
            with ordered_on(file) as ordered:
                list(ordered(_imported, range(8)))
            before = sum(map(_cpu, processes[1:]))
            there, asking = _diagnosed(adjusted, file)
            workers = sum(map(_cpu, processes[1:])) - before
        text = f"{name.strip()}: {own:.1f} s here, {asking:.1f} s here with {workers:.1f} s on two workers"
        yield text, "" if here == there else "another diagnosis than here"


def _diagnosed(adjusted: Callable[[], AdjustedJob], scheduler: str) -> tuple[str, float]:
    """Return a diagnosis as text and the CPU time of this process [s]."""
    job = adjusted()
    begun = time.process_time()
    with ordered_on(scheduler) as ordered:
        found = diagnose(job, ordered=ordered)
    return json.dumps(as_data(found)), time.process_time() - begun


def _imported(number: int) -> int:
    """Return the number; a worker that calls this has imported what a diagnosis needs, which it does once."""
    return number


def _cpu(process: subprocess.Popen[bytes]) -> float:
    """Return the CPU time of a running process [s]."""
    words = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def _contents() -> dict[str, str]:
    return {path.stem: hdf5.read_label(path).content for path in Path("results").glob("*.h5")}


def _begin(file: str) -> subprocess.Popen[bytes]:
    shutil.rmtree("results", ignore_errors=True)
    return subprocess.Popen([*RUN, "--scheduler", file], stdout=-1, stderr=-1, env=environment())


def _kill_in_the_middle(victim: subprocess.Popen[bytes], running: subprocess.Popen[bytes], jobs: int) -> bool:
    """Kill a process after the first tenth of the results; return whether that was before the last."""
    while running.poll() is None and len(list(Path().glob("results/*.h5"))) < jobs / 10:
        time.sleep(0.02)
    victim.send_signal(signal.SIGKILL)
    return len(list(Path().glob("results/*.h5"))) < jobs


def _run(file: str, wanted: dict[str, str], victim: subprocess.Popen[bytes] | None = None) -> tuple[float, str]:
    begun = time.monotonic()
    process = _begin(file)
    in_time = victim is None or _kill_in_the_middle(victim, process, len(wanted))
    error = process.communicate()[1].decode()
    wrong = f"exit code {process.returncode}: {error[-300:]}" if process.returncode else "" if in_time else TOO_LATE
    return time.monotonic() - begun, wrong or ("" if _contents() == wanted else "other results than here")


def _without_scheduler(file: str, wanted: dict[str, str], scheduler: subprocess.Popen[bytes]) -> str:
    process = _begin(file)
    _kill_in_the_middle(scheduler, process, len(wanted))
    error = process.communicate()[1].decode()
    kept = _contents()
    if not process.returncode and kept == wanted:
        return TOO_LATE
    if process.returncode != 3 or "the cluster has ended" not in error or "Traceback" in error:
        return f"exit code {process.returncode}: {error[-300:]}"
    if not 0 < len(kept) < len(wanted) or not kept.items() <= wanted.items():
        return f"{len(kept)} results were kept"
    times = {path: path.stat().st_mtime_ns for path in Path("results").glob("*.h5")}
    subprocess.run([*RUN, "--jobs", "2"], check=True, capture_output=True, env=environment())
    again = [path.name for path, before in times.items() if path.stat().st_mtime_ns != before]
    return f"made again: {again}" if again else "" if _contents() == wanted else "other results than here"
