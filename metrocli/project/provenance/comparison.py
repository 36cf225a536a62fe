"""Results compared, gathered in one table, and made again."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from metrocli import units
from metrocli.errors import Fault, InputError
from metrocli.formats import hdf5
from metrocli.frozen import dataclass
from metrocli.progress import SILENT, Progress
from metrocli.project import fingerprint, yaml_text
from metrocli.project.campaign import KEY
from metrocli.project.inputs import content_now, input_files
from metrocli.project.job import JobFile, JobOptions, load
from metrocli.project.provenance.lineage import Origin, files_of, trace
from metrocli.project.runner import HERE, compute
from metrocli.project.staleness import Staleness
from metrocli.record import Record
from metrocli.result import Estimate, Result
from metrocli.table import Table
from metrocli.uncertainty.workers import Workers


def with_standards(result: Path, record: Record) -> Record:
    """Return the record of a result with the certificates that the jobs of the results below it state.

    Files are named as the job of this result would name them. What the job itself states stays as it is.
    """
    origin, *below = files_of(trace(result))
    home = origin.job.parent if origin.job else result.parent
    own = {name for name, _ in record.references()}
    standards = dict(pair for entry in below if entry.label is not None for pair in _stated(entry, home))
    return replace(record, below=tuple((name, number) for name, number in standards.items() if name not in own))


def _stated(origin: Origin, home: Path) -> Iterator[tuple[str, str]]:
    record = hdf5.read_record(origin.path)[1]
    files = {file.path for file in record.inputs}
    folder = origin.job.parent if origin.job else origin.path.parent
    for name, number in record.references():
        if number:
            yield Path(os.path.relpath(folder / name, home)).as_posix() if name in files else name, number


@dataclass(frozen=True)
class Moved:
    """An estimate that two results give differently."""

    name: str
    before: float
    after: float
    unit: str
    std: float
    """Standard uncertainty of the first result"""
    stds: float
    """The difference in standard uncertainties of the first result"""


@dataclass(frozen=True)
class Difference:
    """What differs between two results; all empty if nothing does."""

    moved: tuple[Moved, ...]
    """Estimates of both, the largest difference in standard uncertainties first"""
    only: tuple[str, ...]
    """Estimates, statistics and states that only one of them has or that differ otherwise, in words"""
    settings: tuple[str, ...]
    inputs: tuple[str, ...]
    same: bool
    """Whether values, tables and all else of the results are the same bit for bit"""


def between(first: Path, second: Path) -> Difference:
    """Return what differs between two result files; raises InputError if one cannot be believed."""
    (a, of_a), (b, of_b) = hdf5.read(first), hdf5.read(second)
    known, present = ({estimate.name: estimate for estimate in result.estimates} for result in (a, b))
    moved = [
        _moved(known[name], estimate)
        for name, estimate in present.items()
        if name in known and (known[name].value, known[name].std) != (estimate.value, estimate.std)
    ]
    moved.sort(key=lambda change: -change.stds)
    only = [f"{name} is in the second only" for name in present if name not in known]
    only += [f"{name} is in the first only" for name in known if name not in present]
    for what, before, after in (
        ("kind", a.kind, b.kind),
        ("status", of_a.status, of_b.status),
        ("version", of_a.metrocli_version, of_b.metrocli_version),
        ("sigma0", a.statistics.get("sigma0"), b.statistics.get("sigma0")),
        ("observations", a.statistics.get("observations"), b.statistics.get("observations")),
    ):
        if before != after and before == before:  # nan equals nan
            only.append(f"{what}: {before} -> {after}")
    return Difference(
        tuple(moved), tuple(only), tuple(_settings(of_a, of_b, first, second)), tuple(_inputs(of_a, of_b)),
        fingerprint.of_result(a, of_a) == fingerprint.of_result(b, of_b),
    )  # fmt: skip


def _moved(a: Estimate, b: Estimate) -> Moved:
    known = 0 < a.std < math.inf
    stds = abs(b.value - a.value) / a.std if known else 0.0 if a.value == b.value else math.inf
    return Moved(a.name, a.value, b.value, a.unit, a.std, stds)


def _settings(a: Record, b: Record, first: Path, second: Path) -> list[str]:
    nodes = [
        yaml_text.parse(record.job_text, f"{path} (its job)", Path())
        for record, path in ((a, first), (b, second))
    ]  # fmt: skip
    return fingerprint.changed_settings(*nodes)


def _inputs(a: Record, b: Record) -> list[str]:
    contents: Mapping[str, str] = {file.path: file.content for file in b.inputs}
    return fingerprint.changed_inputs(a.inputs, b.inputs, contents.__getitem__)


_OWN = ("job", "status", "up_to_date", "sigma0")


def table_of(states: Iterable[Staleness]) -> Table:
    """Return a row for each job that has a result which can be believed.

    Columns: job, the columns of its list of parts, status, conformity of jobs with tolerances, up_to_date (yes or no),
    sigma0. For each estimate follow NAME, NAME.std and NAME.U, and the limits NAME.low and NAME.high of its tolerance.
    A cell is empty where a result has no such estimate. Where names meet, columns of the list are called for.NAME,
    estimates estimates.NAME. Raises InputError if there is no result.
    """
    rows: list[dict[str, str | float]] = []
    parts: list[Mapping[str, str]] = []
    known: dict[str, str] = {}
    for state in states:
        if state.label is None:
            continue
        result, record = hdf5.read(state.step.job.output)
        part = state.step.job.options.part
        parts.append(part.values if part else {})
        sigma0 = result.statistics.get("sigma0")
        row: dict[str, str | float] = {"job": state.step.name, "status": record.status}
        row |= {"conformity": record.conformity} if record.conformity else {}
        row |= {"up_to_date": "no" if state.reason else "yes"}
        row |= {"sigma0": float(sigma0)} if isinstance(sigma0, float | int) else {}
        for estimate in result.estimates:
            named = _named(estimate)
            row |= {named: estimate.value, f"{named}.std": estimate.std, f"{named}.U": result.expanded(estimate)[0]}
            known |= dict.fromkeys((named, f"{named}.std", f"{named}.U"), estimate.unit)
            limits = result.details.get(estimate.name, {}).get("tolerance", {}).get("limits", ())
            for end, limit in zip(("low", "high"), limits, strict=False):
                row[f"{named}.{end}"], known[f"{named}.{end}"] = float(limit), estimate.unit
        rows.append(row)
    if not rows:
        raise InputError("the project has no results yet; run it first")
    names = dict.fromkeys(name for row in rows for name in row)
    taken = {*names, *(f"{name}_{units.suffix_of(known.get(name, ''))}" for name in names)}
    listed = {name: f"{KEY}.{name}" if name in taken else name for part in parts for name in part}
    columns = {"job": _column([row["job"] for row in rows])}
    columns |= {shown: _column([part.get(name) for part in parts]) for name, shown in listed.items()}
    columns |= {name: _column([row.get(name) for row in rows]) for name in names}
    return Table(columns, known)


def _named(estimate: Estimate) -> str:
    """Return the name of the column of an estimate, with its unit where a CSV has no ending for it."""
    name = (
        estimate.name
        if estimate.unit in ("", "1") or units.suffix_of(estimate.unit)
        else f"{estimate.name} [{estimate.unit}]"
    )
    return f"estimates.{name}" if name in _OWN else name


def _column(cells: Sequence[str | float | None]) -> np.ndarray:
    if any(isinstance(cell, str) for cell in cells):
        return np.array(["" if cell is None else str(cell) for cell in cells])
    return np.array([np.nan if cell is None else cell for cell in cells], dtype=float)


def rerun(
    path: Path, accept_doubtful: bool = False, progress: Progress = SILENT, workers: Workers = HERE
) -> tuple[Result, Record, bool]:
    """Return the result of a file made again with its record, and whether it is the same bit for bit.

    The job is the text in the result, not its file. Raises InputError with each input that is not what it was.
    """
    result, record = hdf5.read(path)
    job = _job_of(path, record, accept_doubtful)
    changed = fingerprint.changed_inputs(record.inputs, input_files(job), lambda name: content_now(job, name))
    if changed:
        hint = "restore it from where the record has its sha256 (metrocli lineage), or run the job as it is now"
        raise InputError([Fault(line, str(path), hint=hint) for line in changed])
    strict = bool(result.warnings) and set(result.warnings) <= set(record.doubts)
    again, new = compute(job, progress, workers, strict)
    return again, new, new.content == record.content


def _job_of(path: Path, record: Record, accept_doubtful: bool) -> JobFile:
    if not record.job_file:
        raise InputError([Fault("the result does not name its job file", str(path))])
    file = Path(os.path.normpath(path.parent / record.job_file))
    return load(file, JobOptions(output=path, accept_doubtful=accept_doubtful, text=record.job_text))
