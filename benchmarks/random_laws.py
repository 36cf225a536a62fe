"""Errors of no catalogue, drawn at random: is a law found for them, with the right variables, and none in noise?

Measurements of five kinds by plain formulas (benchmarks/hidden/foreign.py). In the length of a tracer, a component of
a machine's error motion, a coordinate of a ball grid in one view or of all image points acts a wave, a saturation, a
product, a direction of approach or a step. Their variable, period, place and sign are drawn; what of them the unknowns
leave has a norm of 12 to 24 standard deviations, twice what is just found and more. The extended job is adjusted and
diagnosed once more.

    python -m benchmarks random_laws [KIND] [COUNT | FIRST-LAST] [nothing] [column]

With `column` a column of random numbers, which has nothing to do with the readings, is a variable of laws too.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.bars import Rate
from benchmarks.hidden.foreign import NOTHING, SIMULATED, Planted, planted
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.evidence.folds import gain_between
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.findings import Diagnosis, Verdict
from metrocli.diagnosis.job_entries import as_job, scatter_as_job
from metrocli.diagnosis.laws.definition import as_define, as_wanted, written
from metrocli.diagnosis.laws.law import Law
from metrocli.diagnosis.laws.library import Library
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.effects import requested
from metrocli.effects.own import define
from metrocli.errors import MetrocliError
from metrocli.nodes import Node
from metrocli.project.yaml_text import parse
from metrocli.tasks import KINDS

COUNT = 40
_SAME = {"u": "off_u", "v": "off_v", "x": "X", "y": "Y", "z": "Z"}
"""Variables that differ by a constant, or by the errors of points"""
_IN_CAMERA = {"X": "off_u", "Y": "off_v", "x": "off_u", "y": "off_v"}
"""Coordinates in a camera along whose axes the target is carried: over the depth, they are those of the image"""


@dataclass(frozen=True)
class Outcome:
    """What a diagnosis makes of a measurement."""

    law: str
    explains: bool
    """Whether a law explains at least 90 % of the error, in squares of what the unknowns leave of it"""
    right: bool
    """Whether its variables are those of the error"""
    there: bool
    """Whether it acts at its place"""
    noticed: bool
    """Whether the verdict is not clean"""
    clean: bool = False
    """Whether the extended job is"""
    held: float = np.inf
    """Held-out error with the law, relative to that with the error itself in the model"""


def outcome(one: Planted) -> Outcome:
    """Return what the diagnosis of a measurement concludes."""
    diagnosis = diagnose(one.job())
    law, noticed = diagnosis.law, diagnosis.verdict is not Verdict.CLEAN
    found = [str(finding.effect.alternative) for finding in diagnosis.findings]
    names = ", ".join([*found, *(f"{one.effect.name} everywhere" for one in diagnosis.scatters)])
    if law is None:
        return Outcome(f"- [{names}]" if names else "-", False, False, False, noticed)
    in_camera = law.terms[0].spot.acting.name == "point-in-camera" and one.kind == "calibrate-camera"
    same = _SAME | _IN_CAMERA if in_camera else _SAME
    used = frozenset(same.get(name, name) for term in law.terms for name in term.form.variables)
    text = f"{law.terms[0].spot.acting.name} {'; '.join(f'{a}: {b}' for a, b in written(law).adds.items())}"
    text += f" [{names}]" if names else ""
    there, after = law.terms[0].spot.where == one.where, _after(one, diagnosis)
    text += f", extended: {after}"
    part, right = _explained(one, law), used == one.variables
    held = _held(one, law)
    text = f"{part:.0%}, held-out error {held:.2f} times that of the true law, {text}"
    return Outcome(text, part >= 0.9, right, there, noticed, after is Verdict.CLEAN, held)


def _explained(one: Planted, law: Law) -> float:
    """Return the share of a law in what the error does to the residuals, `1 - |e - l|^2 / |e|^2`."""
    system, right = (linearised(read.adjusted().model) for read in (one.measured, one.correct))
    error, library = system.residual - right.residual, Library(one.job(), system)
    by_law = sum(library.columns(term) @ sizes for term, sizes in zip(law.terms, law.sizes, strict=True))
    return 1 - float(((error - system.seen(by_law)) ** 2).sum() / (error**2).sum())


def _held(one: Planted, law: Law) -> float:
    """Return the held-out error with a law, relative to that with the error itself, of which the size is estimated."""
    m, right = measurement_of(one.job()), linearised(one.correct.adjusted().model)
    shape = m.system.seen(m.system.residual - right.residual)[:, None]
    true = State.of(m, [m.term(shape, (0, 0), 0.0)])
    return law.gain.after / gain_between(State.of(m), true).after


def _after(one: Planted, diagnosis: Diagnosis) -> Verdict | str:
    """Return the verdict on the extended job: the law defined, estimated together with all that is named."""
    law, task = diagnosis.law, KINDS[one.kind].task()
    assert law is not None
    named = [*map(scatter_as_job, diagnosis.scatters), *(as_job(found.effect) for found in diagnosis.findings)]
    try:
        own = define.read(_nodes([as_define(law, "law-1")]), task.places, [], [])
        effects = requested.read([*task.effects, *own], _nodes([*named, as_wanted(law, "law-1")]), [])
        return diagnose(one.job(effects, own)).verdict
    except MetrocliError as error:
        return f"{error}".partition("\n")[0]


def _nodes(entries: list[Any]) -> tuple[Node, ...]:
    return parse(yaml.safe_dump({"entries": entries}), "-", Path()).get("entries").items


def rates(found: list[Outcome]) -> Iterator[Rate]:
    """Yield the rates of measurements with an error."""
    explained = [one for one in found if one.explains]
    yield Rate("a law explains 90 % of the error", len(explained), len(found), 0.85, 1.0)
    if explained:
        yield Rate("  with the right variables", sum(one.right for one in explained), len(explained), 0.9, 1.0)
        yield Rate("  at the right place", sum(one.there for one in explained), len(explained))
    laws = [one for one in found if one.law[0] != "-"]
    if laws:
        near = sum(one.held <= 1.1 for one in laws)
        yield Rate("held-out error within 10 % of that with the true law", near, len(laws))
        yield Rate("extended jobs that are clean", sum(one.clean for one in laws), len(laws), 0.8, 1.0)
    yield Rate("not called clean", sum(one.noticed for one in found), len(found))


def main(arguments: list[str]) -> int:
    """Print a line for each measurement and the rates of each kind; return 1 where a bar is missed."""
    numbers, nothing = range(COUNT), NOTHING in arguments
    for argument in arguments:
        span = re.fullmatch(r"(?:(\d+)-)?(\d+)", argument)
        if span is not None:
            numbers = range(int(span[2])) if span[1] is None else range(int(span[1]), int(span[2]) + 1)
    met = True
    for kind in [one for one in arguments if one in SIMULATED] or list(SIMULATED):
        before, found = time.process_time(), []
        for number in numbers:
            one = planted(kind, number, nothing)
            one = replace(one, column=number) if "column" in arguments else one
            found.append(outcome(one))
            wanted = f"{one.form} of {' '.join(sorted(one.variables))}" if one.variables else NOTHING
            print(f"{kind} {number} {wanted} ({one.strength:.0f}): {found[-1].law}", flush=True)
        seconds = (time.process_time() - before) / len(found)
        print(f"-- {kind}, {len(found)} measurements of {seconds:.1f} s of CPU time")
        laws = sum(one.law[0] != "-" for one in found)
        for rate in [Rate("a law", laws, len(found), 0.0, 0.02)] if nothing else rates(found):
            print(rate, flush=True)
            met &= rate.met
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
