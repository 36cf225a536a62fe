"""Mutated jobs, tables, results and images: whatever is in a file, a command ends in words, in time and in memory.

python -m benchmarks fuzz [SECONDS [SEED]]; without, ten minutes. A finding is printed with the number by which
`python -m benchmarks fuzz case NUMBER [SEED]` repeats it in ./fuzz-NUMBER.
"""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.projects.mutations import mutated, renamed_images
from metrocli import tasks
from metrocli.cli.commands import run as metrocli

SAMPLES = Path(__file__).parents[1] / "sample_projects"
PROJECTS = tuple(sorted(path.parent.name for path in SAMPLES.glob("*/metrocli.yaml")))
MOST_BYTES, MOST_SECONDS = 2_000_000_000, 20
MOST_IMAGES = 40
"""In a folder, so that a case does not spend its time on 200 unharmed images"""
QUICK = (("trials: 200000", "trials: 2000"), ("trials: 1000000", "trials: 2000"))
COMMANDS: dict[str, tuple[tuple[str, ...], ...]] = {
    ".yaml": (("run", "."), ("run", "."), ("check", "."), ("status", "."), ("simulate", "JOB", "--out", "simulated"),
              ("gather", "--out", "table.csv"), ("plan", "JOB"), ("diagnose", "JOB", "--limit", "5")),
    ".csv": (("run", "."), ("run", "."), ("check", "."), ("diagnose", "JOB", "--limit", "5")),
    ".h5": (("run", "."), ("status", "."), ("show", "FILE"), ("export", "FILE", "--to", "csv", "--out", "exported"),
            ("lineage", "FILE"), ("diff", "FILE", "FILE"), ("rerun", "FILE"), ("show", "FILE", "--json"),
            ("report", "FILE"), ("compare", "FILE", "FILE"), ("plot", "FILE")),
    ".png": (("run", "."), ("check", ".")),
}  # fmt: skip
"""What is done with a project by the ending of the file that was mutated"""


@dataclass(frozen=True)
class Outcome:
    """What became of one mutated project."""

    command: str
    file: str
    code: int
    """Exit code, or minus the number of the signal that ended it"""
    seconds: float
    bytes: int
    text: str

    @property
    def fault(self) -> str:
        """What must not happen, if it did."""
        if self.code in (0, 2, 3, 4, 5, 6) and "Traceback" not in self.text:
            return "" if self.bytes <= MOST_BYTES else f"{self.bytes / 1e9:.1f} GB"
        return "more than 20 s" if self.code == -signal.SIGXCPU else f"exit code {self.code}"


def prepared(folder: Path, names: Sequence[str] = PROJECTS) -> list[Path]:
    """Return copies of sample projects in a folder, with their results, quick enough to run often."""
    projects = []
    for name in names:
        project = folder / name
        shutil.copytree(SAMPLES / name, project, ignore=shutil.ignore_patterns("results"))
        for path in (project / "jobs").glob("*.yaml"):
            text = path.read_text()
            for slow, quick in QUICK:
                text = text.replace(slow, quick)
            path.write_text(text)
        for images in project.rglob("images"):
            pictures = sorted(images.glob("*.png"))
            for path in set(pictures) - set(pictures[:: -(-len(pictures) // MOST_IMAGES)]):
                path.unlink()
        _in_child(lambda place=project: metrocli(["run", str(place), "-q"]), os.devnull)
        projects.append(project)
    return projects


def case(number: int, seed: int, projects: list[Path], folder: Path) -> Outcome:
    """Mutate a copy of one of the projects, and carry out a command on it in a process of its own."""
    chance = random.Random(seed * 1_000_003 + number)
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(chance.choice(projects), folder)
    files = sorted(path for path in folder.rglob("*") if path.suffix in COMMANDS)
    ending = chance.choice(sorted({path.suffix for path in files}))
    file = chance.choice([path for path in files if path.suffix == ending])
    for _ in range(chance.choice((1, 1, 2, 4))):
        file.write_bytes(mutated(file, chance))
    if ending == ".png" and chance.random() < 0.3:
        renamed_images(folder, chance)
    jobs = sorted((folder / "jobs").glob("*.yaml"))
    job = file if file in jobs else chance.choice(jobs)
    names = {"FILE": str(file.relative_to(folder)), "JOB": str(job.relative_to(folder))}
    words = [names.get(word, word) for word in chance.choice(COMMANDS[ending])]
    said = folder.with_suffix(".txt")
    code, seconds, used = _in_child(lambda: _within(folder, words), str(said))
    return Outcome(" ".join(words), names["FILE"], code, seconds, used, said.read_text(errors="replace"))


def _within(folder: Path, words: list[str]) -> int:
    os.chdir(folder)
    return metrocli(words)


def _in_child(work: Callable[[], int], output: str) -> tuple[int, float, int]:
    """Return exit code, CPU time [s] and largest memory [bytes] of work in a copy of this process."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        handle = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        sys.stdout, sys.stderr = (os.fdopen(number, "w", closefd=False) for number in (1, 2))
        resource.setrlimit(resource.RLIMIT_CPU, (MOST_SECONDS, MOST_SECONDS + 2))
        resource.setrlimit(resource.RLIMIT_AS, (4 * MOST_BYTES, 4 * MOST_BYTES))
        try:
            code = work()
        except BaseException:
            import traceback

            traceback.print_exc()
            code = 1
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    _, status, used = os.wait4(child, 0)
    return os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, used.ru_maxrss * 1024


def campaign(seconds: float, seed: int = 0, most: int = 1_000_000, names: Sequence[str] = PROJECTS) -> list[str]:
    """Return the findings of at most so many cases in so many seconds, and print each, and how many were tried."""
    found: list[str] = []
    codes: dict[int, int] = {}
    slowest, largest = (0.0, 0), 0
    _warm()
    with tempfile.TemporaryDirectory() as place:
        home = Path(place)
        projects = prepared(home, names)
        end, number = time.monotonic() + seconds, 0
        while number < most and time.monotonic() < end:
            one = case(number, seed, projects, home / "mutated")
            codes[one.code] = codes.get(one.code, 0) + 1
            slowest, largest = max(slowest, (one.seconds, number)), max(largest, one.bytes)
            if one.fault:
                last = (one.text.strip().splitlines() or [""])[-4:]
                found.append(f"case {number}: {one.fault}: {one.command} with {one.file}: {' | '.join(last)[:600]}")
                print(found[-1], flush=True)
            number += 1
    counts = ", ".join(f"{count} with exit code {code}" for code, count in sorted(codes.items()))
    most_used = f"{slowest[0]:.1f} s CPU (case {slowest[1]}) and {largest / 1e9:.2f} GB at most"
    print(f"{number} cases: {counts}; {most_used}; {len(found)} findings")
    return found


def _warm() -> None:
    """Import in this process what all its copies need."""
    import cv2  # noqa: F401

    import metrocli.formats.hdf5_reading
    import metrocli.project.pipeline  # noqa: F401

    for kind in tasks.KINDS.values():
        kind.task()
        kind.settings()


def main(words: list[str]) -> int:
    """Run a campaign, or repeat a case; return 1 if anything was found."""
    if words[:1] == ["case"]:
        number, seed = int(words[1]), int(words[2]) if len(words) > 2 else 0
        with tempfile.TemporaryDirectory() as place:
            one = case(number, seed, prepared(Path(place)), Path(f"fuzz-{number}").absolute())
        print(one.text, f"{one.command} with {one.file}: exit code {one.code}, {one.seconds:.1f} s", sep="\n")
        return int(bool(one.fault))
    seconds, seed = float(words[0]) if words else 600.0, int(words[1]) if len(words) > 1 else 0
    return int(bool(campaign(seconds, seed)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
