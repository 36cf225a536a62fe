"""Errors of no catalogue, drawn at random: is a law found for them, with the right variables, and none in noise?

Networks of tracers and machines at standstill by plain formulas (benchmarks/hidden/lengths.py, machine.py). In the
length of a tracer, or in a component of the error motion, acts a wave, a saturation, a product, a direction of approach
or a step. Their variable, period, place and sign are drawn; what of them the unknowns leave has a norm of 12 to 24
standard deviations, twice what is just found and more.

    python -m benchmarks random_laws [KIND] [COUNT | FIRST-LAST] [nothing]
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from benchmarks.hidden import lengths, machine
from benchmarks.hidden.rates import Rate
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.findings import Verdict
from metrocli.diagnosis.laws.definition import written
from metrocli.tasks import KINDS

Array = npt.NDArray[np.float64]
COUNT = 40
_STRENGTH = (12.0, 24.0)
_POINTS = 60
_NONE = "nothing"


@dataclass(frozen=True)
class Planted:
    """A measurement with an error of no catalogue, or with none."""

    job: AdjustedJob
    form: str
    variables: frozenset[str]
    where: tuple[tuple[str, str], ...]
    strength: float


def _form(
    rng: np.random.Generator, form: str, variables: dict[str, Array], own: str = ""
) -> tuple[Array, frozenset[str]]:
    """Return values of a form (n,) in variables drawn at random, and the names of these.

    `own` is the axis along which they act: products with it (thermal growth), and the side from which it came
    (backlash), are known effects.
    """
    places = [name for name in variables if name in "XYZ" and (form != "product" or name != own)]
    name = str(rng.choice(places))
    v, t = variables[name], variables["t"]
    if form == "wave":
        turn = 2 * np.pi * v / (np.ptp(v) / rng.uniform(1.5, 8))
        return np.sin(turn + rng.uniform(0, 6)), frozenset([name])
    if form == "saturation":
        return 1 - np.exp(-t / (np.ptp(t) * rng.uniform(0.04, 0.2))), frozenset(["t"])
    if form == "step":
        return (t > np.quantile(t, rng.uniform(0.15, 0.85))).astype(float), frozenset(["t"])
    if form == "direction":
        sides = [one for one in variables if one.startswith("from_") and one != f"from_{own.lower()}"]
        side = str(rng.choice(sides))
        return variables[side], frozenset([side])
    first = "T" if "T" in variables else "t"
    return variables[first] * v, frozenset([first, name])


def _network(rng: np.random.Generator, form: str) -> Planted:
    """Return a network in which the length of one tracer has an error."""
    m = lengths.measurement(rng, _POINTS)
    places = KINDS["multilaterate"].task().places
    if form == _NONE:
        return Planted(replace(m.adjusted(), places=places), form, frozenset(), (), 0.0)
    at = int(rng.integers(len(m.tracers)))
    known = dict(zip("XYZ", m.points[m.point].T, strict=True))
    known |= {"t": m.t - m.t.min(), "T": m.temp - m.temp[np.argmin(m.t)]}
    values, names = _form(rng, form, known)
    values = values * (m.tracer == at)
    strength, taken = rng.uniform(*_STRENGTH), lengths.absorbed_by(m)
    size = strength / float(np.linalg.norm(lengths.visible(m, taken, values[:, None]))) * rng.choice([-1, 1])
    job = replace(replace(m, length=m.length + size * values).adjusted(), places=places)
    return Planted(job, form, names, (("tracer", f"T{at}"),), strength)


def _machine(rng: np.random.Generator, form: str) -> Planted:
    """Return a machine in which a component of the error motion has an error."""
    m = machine.measurement(rng)
    places = KINDS["calibrate-machine"].task().places
    if form == _NONE:
        return Planted(replace(m.adjusted(), places=places), form, frozenset(), (), 0.0)
    known = dict(zip("XYZ", m.at.T, strict=True)) | {"t": m.t - m.t.min()}
    component = int(rng.integers(3))
    known |= {f"from_{axis}": side for axis, side in zip("xyz", m.came.T, strict=True)}
    values, names = _form(rng, form, known, "XYZ"[component])
    moved = np.zeros((len(m.at), 3))
    moved[:, component] = values
    change, strength = moved @ m.turn, rng.uniform(*_STRENGTH)
    change *= strength / float(np.linalg.norm(m.visible(change))) * rng.choice([-1, 1])
    job = replace(replace(m, read=m.read + change).adjusted(), places=places)
    return Planted(job, form, names, (), strength)


SIMULATED: dict[str, tuple[Callable[[np.random.Generator, str], Planted], tuple[str, ...]]] = {
    "multilaterate": (_network, ("wave", "saturation", "product")),
    "calibrate-machine": (_machine, ("wave", "saturation", "product", "direction", "step")),
}
"""Measurements of each kind, and the forms of errors that are no known effect there"""


def planted(kind: str, number: int, nothing: bool = False) -> Planted:
    """Return one seeded measurement of a kind."""
    simulated, forms = SIMULATED[kind]
    rng = np.random.default_rng([90, list(SIMULATED).index(kind), int(nothing), number])
    return simulated(rng, _NONE if nothing else forms[number % len(forms)])


@dataclass(frozen=True)
class Outcome:
    """What a diagnosis makes of a measurement."""

    law: str
    explains: bool
    """Whether a law explains at least 90 % of the structure"""
    right: bool
    """Whether its variables are those of the error"""
    there: bool
    """Whether it acts at its place"""
    noticed: bool
    """Whether the verdict is not clean"""


def outcome(one: Planted) -> Outcome:
    """Return what the diagnosis of a measurement concludes."""
    diagnosis = diagnose(one.job)
    law, noticed = diagnosis.law, diagnosis.verdict is not Verdict.CLEAN
    names = ", ".join(str(finding.effect.alternative) for finding in diagnosis.findings)
    if law is None:
        return Outcome(f"- [{names}]" if names else "-", False, False, False, noticed)
    used = frozenset(name for term in law.terms for name in term.form.variables)
    text = f"{law.terms[0].spot.acting.name} {'; '.join(f'{a}: {b}' for a, b in written(law).adds.items())}"
    text += f" {law.part_of_structure:.0%}" + (f" [{names}]" if names else "")
    there = law.terms[0].spot.where == one.where
    return Outcome(text, law.part_of_structure >= 0.9, used == one.variables, there, noticed)


def rates(found: list[Outcome]) -> Iterator[Rate]:
    """Yield the rates of measurements with an error."""
    explained = [one for one in found if one.explains]
    yield Rate("a law explains 90 % of the structure", len(explained), len(found), 0.85, 1.0)
    if explained:
        yield Rate("  with the right variables", sum(one.right for one in explained), len(explained), 0.9, 1.0)
        yield Rate("  at the right place", sum(one.there for one in explained), len(explained))
    yield Rate("not called clean", sum(one.noticed for one in found), len(found))


def main(arguments: list[str]) -> int:
    """Print a line for each measurement and the rates of each kind; return 1 where a bar is missed."""
    numbers, nothing = range(COUNT), _NONE in arguments
    for argument in arguments:
        span = re.fullmatch(r"(?:(\d+)-)?(\d+)", argument)
        if span is not None:
            numbers = range(int(span[2])) if span[1] is None else range(int(span[1]), int(span[2]) + 1)
    met = True
    for kind in [one for one in arguments if one in SIMULATED] or list(SIMULATED):
        before, found = time.process_time(), []
        for number in numbers:
            one = planted(kind, number, nothing)
            found.append(outcome(one))
            wanted = f"{one.form} of {' '.join(sorted(one.variables))}" if one.variables else _NONE
            print(f"{kind} {number} {wanted} ({one.strength:.0f}): {found[-1].law}", flush=True)
        seconds = (time.process_time() - before) / len(found)
        print(f"-- {kind}, {len(found)} measurements, {seconds:.1f} s of CPU time each")
        laws = sum(one.law[0] != "-" for one in found)
        for rate in [Rate("a law", laws, len(found), 0.0, 0.02)] if nothing else rates(found):
            print(rate, flush=True)
            met &= rate.met
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
