"""Which numbers of the diagnosis change a verdict, where each is doubled or halved.

python -m benchmarks constants [EVERY] [MODULE ...]    # such as evidence rounds laws

Each number that a module of `metrocli/diagnosis` defines is doubled, then halved. One shared case in EVERY (24 unless
given) of each kind, and a real board as it is, are diagnosed anew, until one has another verdict, other names or
other wrong readings. It prints a line for each number that changes something, and the counts. Data that are absent
leave their cases out.
"""

from __future__ import annotations

import ast
import importlib
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from benchmarks.cases import KINDS, folders
from benchmarks.real.sets import BOARDS, LENS
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose
from metrocli.errors import MetrocliError
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load

ROOT = Path(__file__).parents[1]
EVERY, BOARDS_TAKEN = 24, 1
FACTORS = (2.0, 0.5)
Jobs = dict[str, AdjustedJob]


@dataclass(frozen=True)
class Number:
    """A number that a module defines, alone or as a member of a tuple."""

    module: str
    name: str
    at: int | None
    value: float

    def __str__(self) -> str:
        place = "" if self.at is None else f"[{self.at}]"
        return f"{self.module.removeprefix('metrocli.diagnosis.')}.{self.name}{place} = {self.value:g}"

    def put(self, factor: float) -> None:
        """Change the number wherever the program has it: in its module, and where another imports it."""
        other = type(self.value)(self.value * factor)
        owner = sys.modules[self.module]
        old = getattr(owner, self.name)
        new = other if self.at is None else (*old[: self.at], other, *old[self.at + 1 :])
        for module in _importers(self.module, self.name):
            setattr(module, self.name, new)


def _modules() -> list[str]:
    paths = sorted((ROOT / "metrocli" / "diagnosis").rglob("*.py"))
    names = (".".join(path.relative_to(ROOT).with_suffix("").parts) for path in paths)
    # those of the search first
    return sorted((name.removesuffix(".__init__") for name in names), key=lambda name: ".evidence." not in name)


def _importers(owner: str, name: str) -> Iterator[ModuleType]:
    yield sys.modules[owner]
    for module in [one for key, one in sys.modules.items() if key.startswith("metrocli.") and key != owner]:
        path = getattr(module, "__file__", None)
        if path and name in vars(module):
            tree = ast.parse(Path(path).read_text(encoding="utf-8"))
            froms = (one for one in ast.walk(tree) if isinstance(one, ast.ImportFrom) and one.module == owner)
            if any(alias.name == name for one in froms for alias in one.names):
                yield module


def numbers() -> Iterator[Number]:
    """Yield the numbers that the modules of the diagnosis define; seeds of random draws are none."""
    for module in _modules():
        tree = ast.parse(Path(str(importlib.import_module(module).__file__)).read_text(encoding="utf-8"))
        for statement in tree.body:
            if not isinstance(statement, ast.Assign):
                continue
            targets = statement.targets[0]
            names = [node.id for node in ast.walk(targets) if isinstance(node, ast.Name)]
            for name in (name for name in names if name.isupper() and "SEED" not in name):
                value = getattr(sys.modules[module], name)
                if isinstance(value, int | float):
                    yield Number(module, name, None, value)
                elif isinstance(value, tuple):
                    yield from (Number(module, name, i, v) for i, v in enumerate(value) if isinstance(v, int | float))


def jobs(every: int, folder: Path) -> Jobs:
    """Return what is diagnosed, by its name: adjusted once."""
    files = {f"{kind}/{case.name}": case / "job.yaml" for kind in KINDS for case in folders(kind)[2::every]}
    for board in (board for board in BOARDS[:BOARDS_TAKEN] if board.folder.is_dir()):
        files[board.name] = board.job(folder / board.name, board.read(folder), LENS)
    return {name: adjusted_job_of(load(path)) for name, path in files.items()}


def answer(job: AdjustedJob) -> str:
    """Return what a diagnosis states of the causes, without sizes."""
    try:
        found = diagnose(job)
    except MetrocliError as error:
        return str(error).splitlines()[0]
    causes = sorted(str((one.effect.alternative.effect.name, one.effect.alternative.where)) for one in found.findings)
    scatters = sorted(one.effect.name for one in found.scatters)
    readings = sorted(str(one.keys) for one in found.outliers)
    return f"{found.verdict}: {causes} {scatters} {readings}"


def changed(number: Number, factor: float, all_jobs: Jobs, before: dict[str, str], order: Sequence[str]) -> str:
    """Return the first case that has another answer with a number changed; empty if none has. Another process tries."""
    read, write = os.pipe()
    child = os.fork()
    if not child:
        number.put(factor)
        try:
            different = next((name for name in order if answer(all_jobs[name]) != before[name]), "")
        except Exception as error:
            # a number that makes a diagnosis fail changes it
            different = f"failed: {type(error).__name__}"
        os.write(write, different.encode())
        os._exit(0)
    os.close(write)
    with os.fdopen(read, encoding="utf-8") as pipe:
        different = pipe.read()
    os.waitpid(child, 0)
    return different


def main(arguments: list[str]) -> int:
    """Print which numbers change an answer; the exit code is 0 whatever they are."""
    words = [word for word in arguments if not word.isdecimal()]
    count = max(next((int(word) for word in arguments if word.isdecimal()), EVERY), 1)
    with tempfile.TemporaryDirectory() as folder:
        every = jobs(count, Path(folder))
        start = time.process_time()
        before = {name: answer(job) for name, job in every.items()}
        print(f"{len(before)} diagnoses, {time.process_time() - start:.0f} s", flush=True)
        listed = [number for number in numbers() if not words or any(word in number.module for word in words)]
        changing, hits = list[Number](), dict[str, int]()
        for tried, number in enumerate(listed, 1):
            # an hour of silence: what is tried stands beside the result, not in it
            print(f"{tried} of {len(listed)}: {number}", file=sys.stderr, flush=True)
            for factor in FACTORS:
                # what has changed most often is tried first
                order = sorted(before, key=lambda name: -hits.get(name, 0))
                if different := changed(number, factor, every, before, order):
                    hits[different] = hits.get(different, 0) + 1
                    changing.append(number)
                    print(f"{number} times {factor:g}: {different}", flush=True)
                    break
    print(f"{len(changing)} of {len(listed)} numbers change an answer when doubled or halved")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
