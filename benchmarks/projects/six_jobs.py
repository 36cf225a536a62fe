"""A six-job project that is changed and damaged at random, beside an independent account of what has to run."""

from __future__ import annotations

import contextlib
import io
import json
import random
import shutil
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))

import straight_line.task  # noqa: E402
from straight_line import KIND  # noqa: E402

from metrocli import tasks  # noqa: E402
from metrocli.cli.commands import run as metrocli  # noqa: E402
from metrocli.effects.effect import Effect, Parameter  # noqa: E402
from metrocli.formats import hdf5  # noqa: E402
from metrocli.project import fingerprint, runner  # noqa: E402
from metrocli.project.running import memo  # noqa: E402

NAMES = ("a", "b", "c", "d", "e", "f")
USES = {"b": "a", "c": "b", "e": "d"}
"""Jobs that use the result of another one; f stands alone, and a and f also read known.yaml"""
OF_LAB = ("c", "f")
"""Jobs that name the file with effects of the laboratory"""
BOW = Effect("bow", "the line is bent", (Parameter("size", "length"),))


@dataclass
class Truth:
    """What the files of the project mean, kept beside them by whoever changes them."""

    noise: dict[str, int] = field(default_factory=lambda: dict.fromkeys(NAMES, 100))
    title: dict[str, str] = field(default_factory=lambda: dict.fromkeys(NAMES, "t"))
    iterations: dict[str, int] = field(default_factory=lambda: dict.fromkeys(NAMES, 10))
    cells: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("one", "two"), 3900))
    file: dict[str, str] = field(default_factory=lambda: dict.fromkeys(NAMES, ""))
    """For each job, the ending of the name of its table, of which there are two copies"""
    bow: dict[str, int] = field(default_factory=lambda: dict.fromkeys(NAMES, 0))
    """For each job, the size of the effect that it applies; 0 for none"""
    lab: int = 50
    slope: int = 1
    version: str = "0.1.0"
    made: dict[str, Any] = field(default_factory=dict)
    """For each whole result: what it was made from, and its content"""

    def sources(self, name: str) -> Any:
        """What a result is made from: settings, and the content of each input."""
        below = self.made.get(USES.get(name, ""), (None, None))[1]
        known = self.slope if name in "af" else below
        unseen = (self.iterations[name], self.file[name], self.bow[name], self.version.rpartition(".")[0])
        settings = (self.noise[name], self.title[name], unseen)
        return settings, self.cells[table_of(name)], known, self.lab if name in OF_LAB else None

    def content(self, name: str) -> Any:
        """What the result of a job holds: iterations, names of inputs, the effect and the version do not change it."""
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
        self.write_lab()

    def write_job(self, name: str) -> None:
        """Write a job in one of many notations."""
        noise = self.truth.noise[name]
        used = f"../results/{USES[name]}.h5" if name in USES else "../known.yaml" if name in "af" else ""
        known = f", known: {used}" if used else ""
        lines = [
            "metrocli: 1", f"job: {KIND.name}", f"title: {self.truth.title[name]}",
            f"noise: {self.chance.choice([f'{noise} um', f'{noise}.0 um', f'{noise}um'])}",
            f"inputs: {{readings: ../{table_of(name)}{self.truth.file[name]}.csv{known}}}",
            f"output: ../results/{name}.h5",
        ]  # fmt: skip
        if self.truth.bow[name]:
            lines.append(f"effects: [{{name: bow, size: {self.truth.bow[name]} um}}]")
        if name in OF_LAB:
            lines.append("effects_from: ../lab.yaml")
        if self.truth.iterations[name] != 10 or self.chance.random() < 0.5:
            lines.append(f"iterations: {self.truth.iterations[name]}")
        self.chance.shuffle(lines)
        lines.insert(self.chance.randrange(len(lines)), self.chance.choice(["", "# a comment", "# another"]))
        Path(f"jobs/{name}.yaml").write_text("\n".join(lines) + "\n")

    def write_table(self, name: str) -> None:
        text = f"point,x_mm,y_um\na,0,1000\nb,1000,2000\nc,2000,3100\nd,3000,{self.truth.cells[name]}\n"
        text = text.replace(",", self.chance.choice([",", ";", ", "]))
        for path in (f"{name}.csv", f"{name}-copy.csv"):
            Path(path).write_text(self.chance.choice(["", "# measured by night\n", "\n"]) + text)

    def write_known(self) -> None:
        note = self.chance.choice(["", "# by hand\n"])
        Path("known.yaml").write_text(f"{note}slope: {self.truth.slope}{self.chance.choice(['', '.0'])} mm/m\n")

    def write_lab(self) -> None:
        """Write the effects of the laboratory, for jobs of another kind, so that results do not depend on them."""
        note = self.chance.choice(["", "# procedure 17\n"])
        Path("lab.yaml").write_text(
            f"{note}define:\n- {{name: fork-sag, cause: the fork bends, acts_on: length, adds: sag*elevation**2, "
            f"where: [tracer], parameters: {{sag: {{unit: um, plausible: {self.truth.lab} um}}}}}}\n"
        )

    def change(self) -> str:
        """Make one random change and return its name."""
        name, table = self.chance.choice(NAMES), self.chance.choice(["one", "two"])
        output = Path(f"results/{name}.h5")
        kind = self.chance.choice(CHANGES)
        if name not in self.truth.made:
            kind = "rewritten"  # another change has just taken or damaged its result
        if kind == "touch":
            self.chance.choice([output, Path(f"{table}.csv"), Path(f"jobs/{name}.yaml"), Path("lab.yaml")]).touch()
        elif kind == "rewritten":
            self.write_job(name), self.write_table(table), self.write_known(), self.write_lab()
        elif kind in SETTINGS:
            values: dict[str, Any] = getattr(self.truth, kind)
            values[name] = self.chance.choice(SETTINGS[kind])
            self.write_job(name)
        elif kind == "lab":
            self.truth.lab = self.chance.choice([50, 60])
            self.write_lab()
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
            elif kind == "renamed":
                output.rename(f"results/{name}-old.h5")
            elif kind == "edited by hand":
                with h5py.File(output, "r+") as file:
                    file["parameters"][0] = file["parameters"][1]
            elif kind == "truncated":
                output.write_bytes(data[: self.chance.randrange(len(data))])
            else:
                at = self.chance.randrange(len(data))
                output.write_bytes(data[:at] + bytes([data[at] ^ (1 << self.chance.randrange(8))]) + data[at + 1 :])
            self.truth.made.pop(name, None)
        set_version(self.truth.version)
        return kind


SETTINGS = {"noise": [100, 200], "title": ["t", "u"], "iterations": [10, 20], "file": ["", "-copy"], "bow": [0, 5, 6]}
"""Values that change a job; its title and its noise also change its result"""
CHANGES = (
    "touch", "rewritten", *SETTINGS, "lab", "cell", "known", "version", "old copy", "deleted", "renamed", "truncated",
    "one bit", "edited by hand",
)  # fmt: skip


def set_version(version: str) -> None:
    """Make this process a metrocli of another version."""
    for module in (fingerprint, runner, memo):
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
    task = straight_line.task.TASK
    straight_line.task.TASK = replace(task, effects=(BOW,))
    settled, memo._SETTLED_NS = memo._SETTLED_NS, 20_000_000
    before = fingerprint.__version__  # type: ignore[attr-defined]
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
        straight_line.task.TASK = task
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
