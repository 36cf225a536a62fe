"""What changed between two results, and what in their jobs and inputs did."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from metrocli.formats import hdf5
from metrocli.frozen import dataclass
from metrocli.project import meaning, yaml_text
from metrocli.record import Record
from metrocli.result import Estimate


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
    known, found = ({one.name: one for one in result.estimates} for result in (a, b))
    moved = [_moved(known[name], one) for name, one in found.items() if name in known and _differ(known[name], one)]
    moved.sort(key=lambda one: -one.stds)
    only = [f"{name} is in the second only" for name in found if name not in known]
    only += [f"{name} is in the first only" for name in known if name not in found]
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
        meaning.of_result(a, of_a) == meaning.of_result(b, of_b),
    )  # fmt: skip


def _differ(a: Estimate, b: Estimate) -> bool:
    return (a.value, a.std) != (b.value, b.std)


def _moved(a: Estimate, b: Estimate) -> Moved:
    known = 0 < a.std < math.inf
    stds = abs(b.value - a.value) / a.std if known else 0.0 if a.value == b.value else math.inf
    return Moved(a.name, a.value, b.value, a.unit, a.std, stds)


def _settings(a: Record, b: Record, first: Path, second: Path) -> list[str]:
    nodes = [
        yaml_text.parse(record.job_text, f"{path} (its job)", Path())
        for record, path in ((a, first), (b, second))
    ]  # fmt: skip
    return meaning.changed_settings(*nodes)


def _inputs(a: Record, b: Record) -> list[str]:
    contents: Mapping[str, str] = {one.path: one.content for one in b.inputs}
    return meaning.changed_inputs(a.inputs, b.inputs, contents.__getitem__)
