"""Projects that never lie: random changes, damaged bits, kills, and the cost of having nothing to do.

python -m benchmarks pipeline [changes N | damages N | kills N | idle N ...]
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from straight_line import KIND  # noqa: E402

from metrocli import tasks  # noqa: E402
from metrocli.cli.commands import run as metrocli  # noqa: E402
from metrocli.formats import hdf5  # noqa: E402
from metrocli.project import meaning, runner  # noqa: E402
from metrocli.project.running import memo  # noqa: E402

NAMES = ("a", "b", "c", "d", "e", "f")
USES = {"b": "a", "c": "b", "e": "d"}
"""Jobs that use the result of another one; f stands alone, and a and f also read known.yaml"""
FULL = {"changes": 1000, "damages": 2000, "kills": 200, "idle": 50}


@dataclass
class Truth:
    """What the files of the project mean, kept beside them by whoever changes them."""

    noise: dict[str, int] = field(default_factory=lambda: dict.fromkeys(NAMES, 100))
    title: dict[str, str] = field(default_factory=lambda: dict.fromkeys(NAMES, "t"))
    iterations: dict[str, int] = field(default_factory=lambda: dict.fromkeys(NAMES, 10))
    cells: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("one", "two"), 3900))
    slope: int = 1
    version: str = "0.1.0"
    made: dict[str, Any] = field(default_factory=dict)
    """For each whole result: what it was made from, and its content"""

    def sources(self, name: str) -> Any:
        """What a result is made from: settings, and the content of each input."""
        below = self.made.get(USES.get(name, ""), (None, None))[1]
        known = self.slope if name in "af" else below
        settings = (self.noise[name], self.title[name], self.iterations[name], self.version.rpartition(".")[0])
        return settings, self.cells[table_of(name)], known

    def content(self, name: str) -> Any:
        """What the result of a job holds: the number of iterations and the version do not change it."""
        settings, *inputs = self.sources(name)
        return (name, settings[:2], *inputs)

    def run(self) -> set[str]:
        """Return the jobs that have to run, and take it that they did."""
        ran = set()
        for name in NAMES:
            if self.made.get(name, (None, None))[0] != self.sources(name):
                self.made[name] = (self.sources(name), self.content(name))
                ran.add(name)
        return ran


def table_of(name: str) -> str:
    return "one" if name in "abc" else "two"


class Project:
    """Six jobs of the tests' kind in the working folder."""

    def __init__(self, seed: int) -> None:
        self.truth, self.chance = Truth(), random.Random(seed)
        Path("jobs").mkdir()
        Path("metrocli.yaml").write_text(f"jobs: [{', '.join(f'jobs/{name}.yaml' for name in reversed(NAMES))}]\n")
        for name in NAMES:
            self.write_job(name)
        for table in ("one", "two"):
            self.write_table(table)
        self.write_known()

    def write_job(self, name: str) -> None:
        """Write a job in one of many notations."""
        noise = self.truth.noise[name]
        used = f"../results/{USES[name]}.h5" if name in USES else "../known.yaml" if name in "af" else ""
        known = f", known: {used}" if used else ""
        lines = [
            "metrocli: 1", "job: straight-line", f"title: {self.truth.title[name]}",
            f"noise: {self.chance.choice([f'{noise} um', f'{noise}.0 um', f'{noise}um'])}",
            f"inputs: {{readings: ../{table_of(name)}.csv{known}}}", f"output: ../results/{name}.h5",
        ]  # fmt: skip
        if self.truth.iterations[name] != 10 or self.chance.random() < 0.5:
            lines.append(f"iterations: {self.truth.iterations[name]}")
        self.chance.shuffle(lines)
        lines.insert(self.chance.randrange(len(lines)), self.chance.choice(["", "# a comment", "# another"]))
        Path(f"jobs/{name}.yaml").write_text("\n".join(lines) + "\n")

    def write_table(self, name: str) -> None:
        text = f"point,x_mm,y_um\na,0,1000\nb,1000,2000\nc,2000,3100\nd,3000,{self.truth.cells[name]}\n"
        text = text.replace(",", self.chance.choice([",", ";", ", "]))
        Path(f"{name}.csv").write_text(self.chance.choice(["", "# measured by night\n", "\n"]) + text)

    def write_known(self) -> None:
        note = self.chance.choice(["", "# by hand\n"])
        Path("known.yaml").write_text(f"{note}slope: {self.truth.slope}{self.chance.choice(['', '.0'])} mm/m\n")

    def change(self) -> str:
        """Make one random change and return its name."""
        name, table = self.chance.choice(NAMES), self.chance.choice(["one", "two"])
        output = Path(f"results/{name}.h5")
        kind = self.chance.choice(CHANGES)
        if name not in self.truth.made:
            kind = "rewritten"  # another change has just taken or damaged its result
        if kind == "touch":
            self.chance.choice([output, Path(f"{table}.csv"), Path(f"jobs/{name}.yaml")]).touch()
        elif kind == "rewritten":
            self.write_job(name), self.write_table(table), self.write_known()
        elif kind in ("noise", "title", "iterations"):
            values: dict[str, Any] = getattr(self.truth, kind)
            values[name] = self.chance.choice({"noise": [100, 200], "title": ["t", "u"], "iterations": [10, 20]}[kind])
            self.write_job(name)
        elif kind == "cell":
            self.truth.cells[table] = self.chance.choice([3900, 3950])
            self.write_table(table)
        elif kind == "known":
            self.truth.slope = self.chance.choice([1, 2])
            self.write_known()
        elif kind == "version":
            self.truth.version = self.chance.choice(["0.1.0", "0.1.1", "0.2.0"])
        elif kind == "old copy":
            before = self.truth.made[name]
            shutil.copy(output, "copy.h5")
            self.truth.noise[name] = 300 - self.truth.noise[name]
            self.write_job(name)
            call("run")
            self.truth.run()
            shutil.copy("copy.h5", output)
            self.truth.made[name] = before
        else:
            data = output.read_bytes()
            if kind == "deleted":
                output.unlink()
            elif kind == "truncated":
                output.write_bytes(data[: self.chance.randrange(len(data))])
            else:
                at = self.chance.randrange(len(data))
                output.write_bytes(data[:at] + bytes([data[at] ^ (1 << self.chance.randrange(8))]) + data[at + 1 :])
            self.truth.made.pop(name, None)
        set_version(self.truth.version)
        return kind


CHANGES = (
    "touch", "rewritten", "noise", "title", "iterations", "cell", "known", "version", "old copy", "deleted",
    "truncated", "edited",
)  # fmt: skip


def set_version(version: str) -> None:
    """Make this process a metrocli of another version."""
    for module in (meaning, runner):
        module.__version__ = version  # type: ignore[attr-defined]


def call(*arguments: str) -> list[dict[str, Any]]:
    """Return the jobs of the summary of a command in this process; raise if it fails."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = metrocli([*arguments, "--json"])
    if code:
        raise RuntimeError(f"exit code {code}: {err.getvalue()}")
    found: list[dict[str, Any]] = json.loads(out.getvalue())["jobs"]
    return found


def short(job: dict[str, Any]) -> str:
    return Path(job["job"]).stem


def changes(count: int, seed: int = 0) -> tuple[int, int, int]:
    """Return how often a result was wrongly up to date, a job ran without need, and a dry run was not the run."""
    tasks.KINDS[KIND.name] = KIND
    settled, memo._SETTLED_NS = memo._SETTLED_NS, 20_000_000
    before = meaning.__version__  # type: ignore[attr-defined]
    wrong = needless = other = 0
    try:
        project = Project(seed)
        call("run")
        project.truth.run()
        for _ in range(count):
            for _ in range(project.chance.choice([1, 1, 2])):
                project.change()
            dry = call("run", "--dry-run")
            ran = {short(job) for job in call("run") if job["action"] == "ran"}
            needed = project.truth.run()
            wrong += bool(needed - ran)
            needless += bool(ran - needed)
            certain = {short(job) for job in dry if job["would"] == "runs"}
            perhaps = {short(job) for job in dry if job["would"] == "depends"}
            other += not certain <= ran <= certain | perhaps
    finally:
        memo._SETTLED_NS = settled
        set_version(before)
    return wrong, needless, other


def damages(count: int, seed: int = 0) -> tuple[int, int, float]:
    """Return how many single-bit damages were believed and not healed, and the longest time of a status [s CPU]."""
    tasks.KINDS[KIND.name] = KIND
    project = Project(seed)
    call("run")
    contents = {name: hdf5.read_label(Path(f"results/{name}.h5")).content for name in NAMES}
    believed = not_healed = 0
    longest = 0.0
    for _ in range(count):
        name = project.chance.choice(NAMES)
        path = Path(f"results/{name}.h5")
        data = bytearray(path.read_bytes())
        # every other one in the first lines, which are a small part of the file
        at = project.chance.randrange(8 * (len(data) if project.chance.random() < 0.5 else 1024))
        data[at // 8] ^= 1 << at % 8
        path.write_bytes(data)
        begun = time.process_time()
        believed += next(job for job in call("status") if short(job) == name)["up_to_date"]
        longest = max(longest, time.process_time() - begun)
        call("run")
        not_healed += hdf5.read_label(path).content != contents[name]
    return believed, not_healed, longest


def kills(count: int, seed: int = 0) -> tuple[int, int, int]:
    """Return after how many SIGKILLs a result was unreadable, a finished one lost, and a file or a lock left over."""
    chance = random.Random(seed)
    idle_files(8)
    unreadable = lost = left = 0
    for number in range(count):
        shutil.rmtree("results", ignore_errors=True)
        command = [sys.executable, "-m", "metrocli", "run", "--jobs", str(4 if number % 2 else 1)]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True, env=environment()
        )
        time.sleep(chance.uniform(0.3, 2.5))
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        finished = [line.rpartition(" -> ")[2] for line in process.communicate()[0].decode().splitlines()]
        for path in Path().glob("results/*.h5"):
            try:
                hdf5.read(path)
            except Exception:
                unreadable += 1
        lost += any(not Path(path).exists() for path in finished)
        after = subprocess.run(command, capture_output=True, check=False, env=environment())
        names = sorted(path.name for path in Path("results").iterdir())
        left += after.returncode != 0 or names != sorted(f"j{n}.h5" for n in range(8))
    return unreadable, lost, left


def idle_files(count: int) -> None:
    """Write a project of many independent jobs."""
    Path("jobs").mkdir()
    for n in range(count):
        Path(f"jobs/j{n}.yaml").write_text(
            f"metrocli: 1\njob: report-uncertainty\nquantities: {{a: {{value: {n} mm, std: 1 um}}}}\n"
            f"measurands: {{l: {{model: 2*a, unit: mm}}}}\nmonte_carlo: {{trials: 1000}}\noutput: ../results/j{n}.h5\n"
        )
    Path("metrocli.yaml").write_text("jobs:\n" + "".join(f"- jobs/j{n}.yaml\n" for n in range(count)))


def idle(count: int) -> tuple[float, float]:
    """Return the CPU time [ms] of the first and of a later run with nothing to do."""
    from metrocli.project.job import load

    idle_files(count)
    result, record = runner.compute(load(Path("jobs/j0.yaml")))
    from dataclasses import replace

    for n in range(count):
        job = load(Path(f"jobs/j{n}.yaml"))
        hdf5.write(job.output, result, replace(record, job_text=job.text, meaning=meaning.of_job(job)))
    time.sleep(3)  # younger files are not remembered
    return tuple(cpu_of([sys.executable, "-m", "metrocli", "run", "--quiet"]) for _ in range(2))  # type: ignore[return-value]


def cpu_of(command: list[str]) -> float:
    """Return the CPU time of a command in ms; raises if it fails."""
    before = os.times()
    subprocess.run(command, check=True, env=environment())
    after = os.times()
    return 1e3 * (after.children_user + after.children_system - before.children_user - before.children_system)


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def within_folder(work: Callable[..., Any], *arguments: int) -> Any:
    """Return the outcome of a piece of work in a new working folder."""
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            return work(*arguments)
        finally:
            os.chdir(here)


def main(wanted: list[str]) -> int:
    """Print one line a campaign; return 1 if anything lied."""
    pairs = list(zip(wanted[::2], map(int, wanted[1::2]), strict=True)) or list(FULL.items())
    failed = False
    for name, count in pairs:
        if name == "changes":
            wrong, needless, other = within_folder(changes, count)
            print(f"{count} changes: {wrong} wrongly up to date, {needless} needless, {other} dry runs unlike the run")
            failed |= bool(wrong or needless or other)
        elif name == "damages":
            believed, not_healed, longest = within_folder(damages, count)
            print(f"{count} damaged bits: {believed} believed, {not_healed} not healed, {longest:.2f} s CPU at most")
            failed |= bool(believed or not_healed)
        elif name == "kills":
            unreadable, lost, left = within_folder(kills, count)
            print(f"{count} kills: {unreadable} unreadable, {lost} finished results lost, {left} with leftovers")
            failed |= bool(unreadable or lost or left)
        else:
            first, later = within_folder(idle, count)
            print(f"{count} jobs, nothing to do: {first:.0f} ms CPU the first time, {later:.0f} ms later", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
