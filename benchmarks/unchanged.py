"""python -m benchmarks.unchanged save FOLDER | compare BEFORE AFTER [SHARE]: has a change of structure moved a number?

`save` runs every job of the samples and of the shared cases, and `diagnose`, `simulate`, `plan` and each export of
them, and keeps what they write. `compare` holds two such folders against each other: numbers bit for bit, keys and
texts of tables letter for letter. Sentences for people (warnings, notes, messages) may differ; they are counted. With
SHARE (such as 1e-6), numbers of results may differ by this share of the largest in their table column or array.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import yaml

from metrocli.exports import FORMATS

HERE = Path(__file__).resolve().parents[1]
SHARED = HERE.parent / "shared" / "cases"
KINDS = (
    "calibrate-camera",
    "align-part",
    "multilaterate",
    "locate-launch-unit",
    "selfcal-grid",
    "calibrate-machine",
)
SENTENCES = {
    "reason", "files", "separate_by", "depends_on", "warnings", "notes", "cause", "text", "hint",
    "mistake", "extended_job",
}  # fmt: skip
"""Keys of JSON whose values are sentences or paths"""
PROSE = ("warnings", "notes", "job")
"""Datasets of a result that are sentences"""
NOT_COMPARED = ("created", "metrocli_version", "shown")


def metrocli(arguments: list[str], log: Path) -> None:
    """Run one command and keep its exit code, output and messages."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "metrocli", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    log.with_suffix(".code").write_text(f"{done.returncode}\n")
    log.with_suffix(".out").write_text(done.stdout)
    log.with_suffix(".err").write_text(done.stderr)


def case(kind: str, source: Path, kept: Path) -> None:
    """Run and diagnose one shared case."""
    with tempfile.TemporaryDirectory() as folder:
        work = shutil.copytree(source, Path(folder) / "case")
        job = work / "job.yaml"
        metrocli([kind, str(job), "--output", str(kept / "result.h5"), "-q"], kept / "run")
        metrocli(["diagnose", str(job), "--json", "--out", str(work / "extended.yaml")], kept / "diagnose")


def sample(source: Path, kept: Path) -> None:
    """Run one sample project, and ask of each of its jobs all that can be asked."""
    with tempfile.TemporaryDirectory() as folder:
        work = shutil.copytree(source, Path(folder) / source.name)
        metrocli(["run", str(work), "--json"], kept / "run")
        for name in yaml.safe_load((work / "metrocli.yaml").read_text())["jobs"]:
            job = work / name
            below = kept / job.stem
            below.mkdir()
            described = yaml.safe_load(job.read_text())
            result = (job.parent / described["output"]).resolve()
            if result.is_file():
                shutil.copy(result, below / "result.h5")
            metrocli(["diagnose", str(job), "--json", "--out", str(below / "extended.yaml")], below / "diagnose")
            metrocli(["plan", str(job), "--json", "--out", str(below / "plan")], below / "plan")
            metrocli(["simulate", str(job), "--seed", "7", "--out", str(below / "simulated")], below / "simulate")
            for form in FORMATS:
                out = below / form
                metrocli(["export", str(result), "--to", form, "--out", str(out)], below / f"export-{form}")


def save(folder: Path) -> int:
    """Run everything, two at a time."""
    tasks: list[Callable[[], None]] = []

    def add(name: str, task: Callable[[Path], None]) -> None:
        kept = folder / name
        if kept.exists():
            shutil.rmtree(kept)
        kept.mkdir(parents=True)
        tasks.append(lambda: task(kept))

    for source in sorted((HERE / "sample_projects").iterdir()):
        if (source / "metrocli.yaml").is_file():
            add(f"samples/{source.name}", lambda kept, source=source: sample(source, kept))
    for kind in KINDS:
        for source in sorted((SHARED / kind).iterdir()) if (SHARED / kind).is_dir() else ():
            add(f"cases/{kind}/{source.name}", lambda kept, kind=kind, source=source: case(kind, source, kept))
    if not SHARED.is_dir():
        print(f"no shared cases at {SHARED}: samples only", file=sys.stderr)
    with ThreadPoolExecutor(2) as pool:
        for number, future in enumerate([pool.submit(task) for task in tasks], 1):
            future.result()
            print(f"\r{number} of {len(tasks)}", end="", file=sys.stderr)
    print(file=sys.stderr)
    return 0


@dataclass
class Findings:
    """What differs between two folders."""

    different: list[str] = field(default_factory=list)
    sentences: list[str] = field(default_factory=list)
    numbers: int = 0
    files: int = 0
    share: float = 0.0
    """Differences of numbers up to this share of the largest of their column are rounding"""


def compare(before: Path, after: Path, share: float = 0.0) -> int:
    """Print what differs; 1 where a number, a key or an exit code does."""
    found = Findings(share=share)
    names = sorted(
        {path.relative_to(root).as_posix() for root in (before, after) for path in root.rglob("*") if path.is_file()}
    )
    for name in names:
        one, two = before / name, after / name
        if not (one.is_file() and two.is_file()):
            found.different.append(f"{name}: only {'before' if one.is_file() else 'after'}")
            continue
        found.files += 1
        _file(name, one, two, found)
    for line in found.different:
        print(line)
    print(f"{found.files} files, {found.numbers} numbers: {len(found.different)} differences", end="")
    print(f"; {len(found.sentences)} sentences in other words")
    return int(bool(found.different) or not found.files)


def _file(name: str, one: Path, two: Path, found: Findings) -> None:
    if one.suffix == ".h5":
        with h5py.File(one) as first, h5py.File(two) as second:
            _same(name, _flat(first), _flat(second), found)
    elif one.suffix == ".err":
        if one.read_text() != two.read_text():
            found.sentences.append(name)
    elif one.suffix in (".out", ".json") and one.read_text().lstrip().startswith(("{", "[")):
        _same(name, _leaves(json.loads(one.read_text())), _leaves(json.loads(two.read_text())), found)
    elif one.suffix == ".out" and "export" not in one.name and "simulate" not in one.name:
        if one.read_text() != two.read_text():
            found.sentences.append(name)
    elif one.suffix == ".out":
        if one.read_text().count("\n") != two.read_text().count("\n"):
            found.different.append(f"{name}: another number of lines")
    elif _data(one) != _data(two) and not (one.suffix == ".csv" and _near_cells(_data(one), _data(two), found.share)):
        found.different.append(name)
    else:
        found.numbers += len(one.read_text(errors="replace").split(","))


def _data(path: Path) -> list[bytes]:
    """Return the lines of a file that are not comments."""
    return [line for line in path.read_bytes().splitlines() if not line.startswith((b"#", b";", b"//"))]


def _flat(file: h5py.File) -> dict[str, Any]:
    """Return every dataset and attribute of a result by its path."""
    flat: dict[str, Any] = {}

    def keep(name: str, item: Any) -> None:
        for key, value in item.attrs.items():
            flat[f"{name}@{key}"] = value
        if isinstance(item, h5py.Dataset):
            flat[name] = item[()]

    keep("", file)
    file.visititems(keep)
    return {key: value for key, value in flat.items() if key.rpartition("@")[2] not in NOT_COMPARED}


def _leaves(value: Any, path: str = "") -> dict[str, Any]:
    """Return the leaves of JSON by their path."""
    if isinstance(value, dict):
        return {key: leaf for name, below in value.items() for key, leaf in _leaves(below, f"{path}/{name}").items()}
    if isinstance(value, list):
        return {key: leaf for n, below in enumerate(value) for key, leaf in _leaves(below, f"{path}/{n}").items()}
    return {path: value}


def _same(name: str, first: dict[str, Any], second: dict[str, Any], found: Findings) -> None:
    for key in sorted(first.keys() | second.keys()):
        place = f"{name}: {key}"
        sentence = bool(SENTENCES & set(key.split("/"))) or key in PROSE or key.endswith("/result")
        if key not in first or key not in second:
            one_sided = f"{place}: only {'before' if key in first else 'after'}"
            (found.sentences if sentence else found.different).append(one_sided)
            continue
        one, two = (np.asarray(side[key]) for side in (first, second))
        if key == "inputs":
            one, two = one["path"], two["path"]
        found.numbers += one.size
        if (
            one.dtype == two.dtype
            and one.shape == two.shape
            and (_bits(one) == _bits(two) or _near(one, two, found.share))
        ):
            continue
        (found.sentences if sentence else found.different).append(f"{place}: {_short(one)} -> {_short(two)}")


def _near(one: np.ndarray, two: np.ndarray, share: float) -> bool:
    """Return whether floats differ by no more than a share of the largest, and all else not at all."""
    if one.dtype.names:
        return all(_near(one[name], two[name], share) for name in one.dtype.names)
    if one.dtype.kind != "f":
        return _bits(one) == _bits(two)
    largest = np.abs(one[np.isfinite(one)]).max(initial=0.0)
    return bool(np.allclose(one, two, rtol=0, atol=share * largest, equal_nan=True))


def _near_cells(one: list[bytes], two: list[bytes], share: float) -> bool:
    """Return whether the lines of two CSV files have equal texts and, but for rounding, equal numbers."""
    rows, others = ([line.decode().split(",") for line in lines] for lines in (one, two))
    if list(map(len, rows)) != list(map(len, others)):
        return False
    for column, other in zip(zip(*rows, strict=False), zip(*others, strict=False), strict=False):
        pairs = [(a, b) for a, b in zip(column, other, strict=True) if a != b]
        numbers = [_number(cell) for cell in column]
        largest = max((abs(number) for number in numbers if np.isfinite(number)), default=0.0)
        if not all(abs(_number(a) - _number(b)) <= share * largest for a, b in pairs):
            return False
    return True


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _bits(values: np.ndarray) -> Any:
    return values.tolist() if values.dtype.hasobject else values.tobytes()


def _short(values: np.ndarray) -> str:
    return f"{values.dtype}{list(values.shape)}" if values.size > 1 else repr(values.tolist())


def main(words: list[str]) -> int:
    """Run a command line."""
    match words:
        case ["save", folder]:
            return save(Path(folder).absolute())
        case ["compare", before, after, *share]:
            return compare(Path(before), Path(after), *map(float, share))
        case _:
            print(__doc__)
            return int(bool(words))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
