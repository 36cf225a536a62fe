"""Runs that end in the middle: killed, out of disk, without the right to write, and two at once."""

from __future__ import annotations

import contextlib
import os
import random
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py

from benchmarks.projects.many_jobs import RUN, environment, write
from metrocli.errors import InputError
from metrocli.formats import hdf5

JOBS = 8
NOT_TRIED = "not tried"
"""How a finding begins that is not a fault"""


@dataclass
class Kills:
    """After how many SIGKILLs something was found."""

    tried: int = 0
    unreadable: int = 0
    """A result could not be read"""
    lost: int = 0
    """A result that was reported or written was gone, or was made again"""
    left: int = 0
    """A process went on; or the next run failed, left a file behind or gave other results than a run nobody killed"""
    within: int = 0
    """The kill came between the first result and the last"""


def kills(count: int, seed: int = 0) -> Iterator[Kills]:
    """Yield what was found so far after each SIGKILL at a random moment; every other run has four workers.

    Of three kills one comes at any moment from the start on, and two after the first result. Every other pair of kills
    hits all processes of the run, as a job scheduler does; the others hit only the one that was asked.
    """
    chance = random.Random(seed)
    write(JOBS, trials=3_000_000)  # more than are kept in memory, so that each job has files of finished chunks
    commands = [[*RUN, "--jobs", str(jobs)] for jobs in (1, 4)]
    spans = [min(_times(command) for _ in range(2)) for command in commands]
    wanted = [hdf5.read_label(path).content for path in _results()]
    found = Kills()
    for number in range(count):
        _remove_results()
        command, (first, last) = commands[number % 2], spans[number % 2]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True, env=environment()
        )
        if number % 3:
            _await_result(process)
            time.sleep(chance.uniform(0, 1.05) * (last - first))
        else:
            time.sleep(chance.uniform(0, 1.05) * last)
        if number % 4 < 2:
            process.kill()
        else:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        finished = [line.rpartition(" -> ")[2] for line in process.communicate()[0].decode().splitlines()]
        written = {path: path.stat().st_mtime_ns for path in Path().glob("results/*.h5")}
        found.tried += 1
        found.within += 0 < len(written) < JOBS
        found.unreadable += any(not _sound(path) for path in written)
        gone = any(not Path(path).exists() for path in finished)
        orphans = _lives_on(process.pid)
        after = subprocess.run(command, capture_output=True, check=False, env=environment())
        well = after.returncode == 0 and not _unexpected() and all(_sound(path) for path in _results())
        found.left += orphans or not well or wanted != [hdf5.read_label(path).content for path in _results()]
        found.lost += gone or any(path.stat().st_mtime_ns != time_ns for path, time_ns in written.items())
        yield found


def _lives_on(group: int) -> bool:
    """Return whether a process of a group is still at work after 2 s."""
    end = time.monotonic() + 2
    while time.monotonic() < end:
        if group not in groups_at_work():
            return False
        time.sleep(0.02)
    return True


def groups_at_work() -> set[int]:
    """Return the groups of all processes that have not ended."""
    groups = set()
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, group = file.read_text().rpartition(")")[2].split()[:3]
            groups |= {int(group)} if state != "Z" else set()
    return groups


def _times(command: list[str]) -> tuple[float, float]:
    """Return the times from the start of a run to its first and to its last result [s]."""
    _remove_results()
    begun = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=environment())
    _await_result(process)
    first = time.monotonic() - begun
    process.wait()
    return first, time.monotonic() - begun


def _await_result(process: subprocess.Popen[bytes]) -> None:
    while process.poll() is None and not next(Path().glob("results/*.h5"), None):
        time.sleep(0.005)


def _remove_results() -> None:
    shutil.rmtree("results", ignore_errors=True)
    Path(".metrocli-seen").unlink(missing_ok=True)


def _results() -> list[Path]:
    return [Path(f"results/j{n}.h5") for n in range(JOBS)]


def _unexpected() -> list[str]:
    """Return all files and folders below the working folder that neither the user nor a finished run leaves."""
    named = {*map(str, _results()), "metrocli.yaml", ".metrocli-seen", *(f"jobs/j{n}.yaml" for n in range(JOBS))}
    return sorted({str(path) for path in Path().rglob("*")} - named - {"jobs", "results"})


def _sound(path: Path) -> bool:
    try:
        hdf5.read(path)
    except InputError:
        return False
    return True


def edges() -> Iterator[tuple[str, str]]:
    """Yield each hard edge with what went wrong there, empty for nothing."""
    for kilobytes in (1, 4, 16):
        yield f"files of at most {kilobytes} kB", _fresh(lambda kb=kilobytes: _limited(kb))
    for name, full in (("a full disk", True), ("a read-only disk", False)):
        yield name, _fresh(lambda full=full: _on_a_disk(full))
    yield "two runs at once", _fresh(_two_at_once)
    yield "a result open elsewhere", _fresh(_open_elsewhere)


def _fresh(work: Callable[[], str]) -> str:
    """Return what work finds in a new project whose jobs have changed since its results were made."""
    for path in Path().iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    write(JOBS)
    subprocess.run(RUN, check=True, capture_output=True, env=environment())
    for path in Path("jobs").iterdir():
        path.write_text(path.read_text().replace("std: 1 um", "std: 2 um"))
    return work()


def _fails_clearly(ran: subprocess.CompletedProcess[bytes], before: dict[Path, bytes]) -> str:
    """Return what is wrong with a run that could not write; results may be old or new, but not damaged or gone."""
    text = ran.stderr.decode()
    if ran.returncode != 3 or "Traceback" in text or "cannot be written" not in text:
        return f"exit code {ran.returncode}: {text[-300:]}"
    if any(path.read_bytes() != data and not _sound(path) for path, data in before.items()):
        return "a result is damaged"
    return f"left over: {left}" if (left := _unexpected()) else ""


def _limited(kilobytes: int) -> str:
    before = {path: path.read_bytes() for path in _results()}

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1024 * kilobytes, 1024 * kilobytes))

    ran = subprocess.run(RUN, capture_output=True, check=False, env=environment(), preexec_fn=limit)
    return _fails_clearly(ran, before)


def _on_a_disk(full: bool) -> str:
    """Run with three results on a disk in memory, full or read-only, which only root can mount."""
    kept = sorted(Path("results").rename("kept").iterdir())[:3]
    room = sum(path.stat().st_size for path in kept) + (16_000 if full else 10_000_000)
    Path("results").mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={room}", "tmpfs", "results"]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        return f"{NOT_TRIED}: no right to mount a disk"
    try:
        for path in kept:
            shutil.copy(path, "results")
        shutil.rmtree("kept")
        if not full:
            subprocess.run(["mount", "-o", "remount,ro", "results"], check=True)
        before = {path: path.read_bytes() for path in Path("results").iterdir()}
        ran = subprocess.run(RUN, capture_output=True, check=False, env=environment())
        return _fails_clearly(ran, before)
    finally:
        subprocess.run(["umount", "results"], check=True)


def _two_at_once() -> str:
    begun = [subprocess.Popen(RUN, stdout=-1, stderr=-1, env=environment()) for _ in range(2)]
    begun.append(subprocess.Popen([*RUN, "--wait"], stdout=-1, stderr=-1, env=environment()))
    texts = [process.communicate()[1].decode() for process in begun]
    for process, text in zip(begun, texts, strict=True):
        refused = process.returncode == 3 and "another run works on this project" in text
        if process.returncode and not refused:
            return f"exit code {process.returncode}: {text[-300:]}"
    if begun[-1].returncode or not all(_sound(path) for path in _results()) or _unexpected():
        return "the run that waits did not end well"
    return ""


def _open_elsewhere() -> str:
    path = _results()[0]
    with h5py.File(path) as file:
        before = file["parameters"][0]["std"]
        ran = subprocess.run(RUN, capture_output=True, check=False, env=environment())
        if ran.returncode or file["parameters"][0]["std"] != before:
            return f"exit code {ran.returncode}, or the open file changed: {ran.stderr.decode()[-300:]}"
    return "" if hdf5.read(path)[0].estimates[0].std != before else "the result was not replaced"
