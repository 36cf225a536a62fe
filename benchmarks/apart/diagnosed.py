"""Statements of `diagnose`, checked by readings that plain formulas simulate and by how often it notices an effect."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.apart.model import Array, Model
from benchmarks.apart.statement import Rng, Simulated, Statement, of_share
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.findings import Diagnosis, Verdict
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load

_DIAGNOSES = 40
_SMALL = 1e-2


@dataclass(frozen=True)
class Diagnosed:
    """A job with its measurement as a plain function, and how other readings of it are written."""

    kind: str
    place: str
    folder: Path
    job: str
    model: Model
    write: Callable[[Path, Array], None]
    """Writes readings into the folder of a copy"""
    parameters: Mapping[str, tuple[str, ...]]
    change: Callable[[str, Mapping[str, str], Mapping[str, float]], Array]
    """Change of the readings by an effect at a place"""
    moved: Callable[[Array, Array], float]
    """How far what is delivered is from what is delivered of other unknowns"""

    def diagnosis(self, readings: Array) -> Diagnosis:
        """Return the diagnosis of a copy with other readings."""
        with tempfile.TemporaryDirectory() as name:
            copy = Path(name) / "copy"
            shutil.copytree(self.folder, copy, ignore=shutil.ignore_patterns("results"))
            self.write(copy, readings)
            return diagnose(adjusted_job_of(load(copy / self.job)))

    def noticed(self, change: Callable[[], Array], rng: Rng) -> int:
        """Return how many measurements are not called clean; `change` draws what an effect does to the readings."""
        found = [self.diagnosis(change() + self.model.read(rng)) for _ in range(_DIAGNOSES)]
        return sum(one.verdict != Verdict.CLEAN or bool(one.outliers) for one in found)


def _direction(count: int, rng: Rng) -> Array:
    found = rng.normal(size=count)
    return np.asarray(found / np.linalg.norm(found))


def _name(candidate: Mapping[str, Any]) -> str:
    return " ".join([candidate["name"], *candidate["where"].values()])


def excluded(one: Diagnosed, candidates: Iterable[Mapping[str, Any]]) -> Iterable[Statement]:
    """Yield the sizes above which an effect is said to be excluded: just there 80 % are noticed."""

    def check(candidate: Mapping[str, Any]) -> Callable[[Rng], Simulated]:
        def simulated(rng: Rng) -> Simulated:
            names = one.parameters[candidate["name"]]

            def change() -> Array:
                sizes = candidate["above"]["value"] * _direction(len(names), rng)
                return one.change(candidate["name"], candidate["where"], dict(zip(names, sizes.tolist(), strict=True)))

            return of_share(one.noticed(change, rng), _DIAGNOSES, 0.72, 0.88)

        return simulated

    for candidate in candidates:
        above = candidate.get("above")
        if above and candidate["name"] in one.parameters:
            text = f"above {above['value']:.3g} {above['unit']}"
            yield Statement(one.kind, one.place, f"{_name(candidate)} is found with 80 %", text, check(candidate))


def hidden(one: Diagnosed, candidates: Iterable[Mapping[str, Any]]) -> Iterable[Statement]:
    """Yield what effects are said to hide: a change of the result by just so much goes unnoticed in at most 5 %."""

    def check(candidate: Mapping[str, Any], limit: float) -> Callable[[Rng], Simulated]:
        def simulated(rng: Rng) -> Simulated:
            names = one.parameters[candidate["name"]]
            sizes = candidate["above"]["value"] * _SMALL * _direction(len(names), rng)

            def change(times: float) -> Array:
                values = dict(zip(names, (times * sizes).tolist(), strict=True))
                return one.change(candidate["name"], candidate["where"], values)

            start = one.model.predict(one.model.truth)
            moved = one.moved(one.model.adjusted(start + change(1.0))[0], one.model.truth)
            hiding = change(limit / moved)
            missed = _DIAGNOSES - one.noticed(lambda: hiding, rng)
            return of_share(missed, _DIAGNOSES, 0.0, 0.05)

        return simulated

    for candidate in candidates:
        hides = candidate.get("hides")
        if hides and hides["value"] > 0 and candidate.get("above") and candidate["name"] in one.parameters:
            limit = hides["value"] * {"um": 1e-3, "mm": 1.0}[hides["unit"]]
            claim = f"{_name(candidate)} hides more in at most 5 %"
            yield Statement(one.kind, one.place, claim, f"{1e3 * limit:.3g} um", check(candidate, limit))


def chance(one: Diagnosed, p_value: float) -> Statement:
    """Return the chance of the strongest structure: so many measurements with nothing hidden show a stronger one."""

    def check(rng: Rng) -> Simulated:
        found = [one.diagnosis(one.model.read(rng)).before for _ in range(_DIAGNOSES)]
        return of_share(sum(p < p_value for p in found), _DIAGNOSES, p_value, p_value)

    return Statement(one.kind, one.place, "chance of the strongest structure", f"p = {p_value:.2g}", check)
