"""The status of each candidate: what a diagnosis concludes on it, in words, and as plain data for `--json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Any, Literal

from metrocli import units
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.detectability import Detectability, WrongReading
from metrocli.diagnosis.evidence.identified import IdentifiedEffect
from metrocli.diagnosis.evidence.prices import LITTLE
from metrocli.diagnosis.hidden_change import POWER, UndetectedBias
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.diagnosis.power.average_power import DetectableCandidate, ScatterCandidate
from metrocli.effects.effect import Effect
from metrocli.frozen import dataclass


class Status(StrEnum):
    """What a diagnosis concludes on a candidate effect."""

    NAMED = "named"
    EXCLUDED = "excluded"
    """Not found, although one of the largest usual size would have been (power at least 80 %); its bound is below it"""
    CANNOT_SEE = "cannot-see"
    """Its smallest detectable size is larger than usual, its scan too coarse, or its change not linear in its size"""
    NOT_TESTABLE = "not-testable"
    """The unknowns of the job absorb it"""
    NOT_TESTED = "not-tested"
    """A column is missing"""
    NOT_DECIDED = "not-decided"
    """The search ended before it was compared with all else, held-out readings contradict its evidence, or a law
    stands for it"""


UNCHECKED = "no reading is checked by the others"
ENDED = "the search ended before this was decided"
BY_LAW = "the law that was found stands for it"
UNCONFIRMED = "its evidence would name it, but held-out readings do not confirm it or what stands for it"
_SMALLEST = 0.01
"""Smallest number to which a usual size with a unit of its own is converted"""


@dataclass(frozen=True)
class Conclusions:
    """What a diagnosis found, by which it concludes on each candidate."""

    named: tuple[IdentifiedEffect, ...] = ()
    scattered: tuple[str, ...] = ()
    """Names of the effects that act at all their places"""
    decided: bool = True
    """Whether the search came to its end"""


NOTHING = Conclusions()


def status(candidate: DetectableCandidate | ScatterCandidate, found: Conclusions = NOTHING) -> str:
    """Return the status of a candidate; one in the confidence set of an identified effect counts as named.

    So does another form of a named cause only if it explains the readings as well.
    """
    if isinstance(candidate, ScatterCandidate):
        named, is_open = candidate.effect.name in found.scattered, candidate.required
        excluded = excluded_above(candidate) <= candidate.effect.plausible
    else:
        named = any(_claims(name, candidate.alternative) for name in found.named)
        is_open = candidate.required or candidate.by_law
        unseen = candidate.missed or candidate.nonlinear or is_swallowed(candidate)
        excluded = excluded_above(candidate) <= candidate.plausible and not unseen
    if named:
        return Status.NAMED
    if not candidate.testable:
        return Status.NOT_TESTABLE
    if is_open or not found.decided:
        return Status.NOT_DECIDED
    return Status.EXCLUDED if excluded else Status.CANNOT_SEE


def excluded_above(candidate: DetectableCandidate | ScatterCandidate) -> float:
    """Return the size above which an effect is excluded: the larger of that detected and its upper bound."""
    return max(candidate.detectable, candidate.upper)


def is_swallowed(candidate: DetectableCandidate) -> bool:
    """Whether what was found besides the unknowns leaves too little of a signature to tell it apart."""
    return candidate.share < LITTLE


def spots(name: IdentifiedEffect) -> set[tuple[str, tuple[str, ...]]]:
    """Return cause and place of a named effect and of all its rivals."""
    return {name.alternative.spot, *(rival.alternative.spot for rival in name.rivals)}


def reason_of_scatter(candidate: ScatterCandidate, word: str) -> str:
    """Return the reason for the status of an effect that is sought at all its places at once, in words."""
    if word == Status.NAMED:
        return ""
    if word == Status.NOT_TESTABLE:
        return candidate.reason
    if word == Status.NOT_DECIDED:
        return UNCONFIRMED if candidate.required else ENDED
    least = candidate.effect.parameters[0].sized(excluded_above(candidate))
    message = "excluded above" if word == Status.EXCLUDED else "detected from"
    return f"{message} a standard deviation of {least}"


def _claims(name: IdentifiedEffect, alternative: Candidate) -> bool:
    own = {name.alternative.form, *(other.alternative.form for other in name.forms)}
    return alternative.form in own or alternative.spot in spots(name) - {name.alternative.spot}


def usual_seen(candidate: DetectableCandidate) -> bool | Literal["part"] | None:
    """Return whether effects of usual sizes are detected; None if the usual sizes are not known."""
    usual = candidate.alternative.effect.usual_sizes
    if usual is None:
        return None
    if candidate.detectable <= usual[0]:
        return True
    return "part" if candidate.detectable <= usual[1] else False


def reason(candidate: DetectableCandidate, word: str, structure: Sequence[str] = ()) -> str:
    """Return the reason for a candidate's status, in words; `structure` are the covariates of correlated errors."""
    effect = candidate.alternative.effect
    parameter = effect.parameters[0]
    plausible, at = parameter.readable(candidate.plausible)
    if word == Status.NOT_TESTABLE:
        return f"absorbed by {candidate.absorbers}; what it hides is for {plausible:.3g} {at}".rstrip()
    if word == Status.NOT_DECIDED:
        return UNCONFIRMED if candidate.required else BY_LAW if candidate.by_law else ENDED
    size, unit = parameter.readable(excluded_above(candidate))
    shown = f"{size:.3g} {unit}".strip()
    if word == Status.CANNOT_SEE and is_swallowed(candidate):
        what = f"structure in {' and '.join(structure)}" if structure else "what was found"
        return f"cannot be separated from {what}: sizes up to {shown} are possible"
    if word == Status.CANNOT_SEE and candidate.missed:
        name = effect.scanned[0].name
        return f"missed between values of {name}, which are further apart than the readings tell: scan a smaller range"
    if word == Status.CANNOT_SEE and candidate.nonlinear:
        return f"not linear at sizes such as {shown}: estimate it (`effects:`) to decide"
    if word == Status.CANNOT_SEE:
        hides = f"what it hides is for {parameter.sized(candidate.assumed)}"
        return f"detected from {shown} on; {seen_in_words(candidate)}; {hides}"
    return "" if word == Status.NAMED else f"excluded above {shown}; {seen_in_words(candidate)}"


def seen_in_words(candidate: DetectableCandidate) -> str:
    """Return in words how far the usual sizes of a candidate are detected."""
    usual = candidate.alternative.effect.usual
    if not usual:
        size, unit = candidate.alternative.effect.parameters[0].readable(candidate.plausible)
        return f"larger than {f'{size:.3g} {unit}'.strip()} is not plausible"
    verb = {True: "are", "part": "are in part", False: "are not"}[usual_seen(candidate) or False]
    least = candidate.detectable if candidate.testable else candidate.plausible
    return f"usual sizes ({usual_beside(candidate.alternative.effect, least)}) {verb} seen"


def usual_beside(effect: Effect, size: float) -> str:
    """Return the usual sizes of an effect in the unit in which a size of it is shown, so that both can be compared.

    They are as its page states them where that has two units, and the lower end would be tiny in the unit of the size.
    """
    if effect.usual_sizes is None:
        return ""
    dimension, unit = effect.parameters[0].dimension, effect.parameters[0].readable(size)[1]
    low, high = (
        units.find_unit(unit, dimension).outside(usual) if dimension else usual for usual in effect.usual_sizes
    )
    if low < _SMALLEST and " " in effect.usual.partition(" to ")[0]:
        return effect.usual
    return f"{units.two_digits(low)} to {units.two_digits(high)} {'' if unit == '1' else unit}".strip()


def _hides(job: AdjustedJob, hidden: UndetectedBias) -> dict[str, Any]:
    return delivered(job, hidden.size) | {"where": hidden.member, "power": POWER}


def delivered(job: AdjustedJob, value: float) -> dict[str, Any]:
    """Return a change of the delivered result with its unit, as plain data."""
    unit = units.find_unit(job.delivered.unit, job.delivered.dimension)
    return {"what": job.delivered.what, "value": unit.outside(value), "unit": unit.symbol}


def candidates(job: AdjustedJob, design: Detectability, found: Conclusions = NOTHING) -> list[dict[str, Any]]:
    """Return all candidates as plain data, tested or not."""
    words = ((candidate, status(candidate, found)) for candidate in design.candidates)
    tested = [_candidate(job, candidate, word, design.structure) for candidate, word in words]
    readings = [_wrong_reading(job, reading, found.decided) for reading in design.readings]
    missing = [
        _open(untested.effect, untested.where, Status.NOT_TESTED, untested.reason) for untested in design.not_tested
    ]
    throughout = [_throughout(job, scatter, status(scatter, found)) for scatter in design.scatters]
    return tested + throughout + readings + missing


def _throughout(job: AdjustedJob, scatter: ScatterCandidate, word: str) -> dict[str, Any]:
    entry = _open(scatter.effect, {}, word, reason_of_scatter(scatter, word))
    if not scatter.testable:
        return entry
    unit = scatter.effect.parameters[0].unit
    return entry | {
        "minimal_detectable": {"value": scatter.detectable, "unit": unit},
        "above": {"value": excluded_above(scatter), "unit": unit},
        "hides": None if word == Status.NAMED else _hides(job, scatter.undetected),
    }


def _wrong_reading(job: AdjustedJob, reading: WrongReading, decided: bool) -> dict[str, Any]:
    unchecked = f"; {reading.unchecked} readings cannot be checked" if reading.unchecked else ""
    if not reading.testable:
        return _open(reading.effect, {}, Status.NOT_TESTABLE, UNCHECKED)
    words = (
        "wrong readings are listed as outliers; minimal_detectable is that of the median reading, above that of the "
    )
    words += f"one that is checked least{unchecked}"
    if not decided:
        words = ENDED
    return _open(reading.effect, {}, Status.EXCLUDED if decided else Status.NOT_DECIDED, words) | {
        "minimal_detectable": {"value": reading.detectable, "unit": reading.effect.parameters[0].unit},
        "above": {"value": reading.between[1], "unit": reading.effect.parameters[0].unit},
        "hides": _hides(job, reading.undetected),
    }


def _candidate(job: AdjustedJob, candidate: DetectableCandidate, word: str, structure: Sequence[str]) -> dict[str, Any]:
    own = candidate.alternative
    return _open(own.effect, own.where, word, reason(candidate, word, structure)) | {
        "visible_share": candidate.visible,
        **_sizes(candidate),
        # what is in the model changes no result unseen
        "hides": None if word == Status.NAMED else _hides(job, candidate.undetected),
    }


def _sizes(candidate: DetectableCandidate) -> dict[str, Any]:
    """Return the size from which a candidate is excluded, and its usual sizes."""
    least = {"value": candidate.detectable, "unit": candidate.unit} if candidate.testable else None
    above = {"value": excluded_above(candidate), "unit": candidate.unit} if candidate.testable else None
    usual = candidate.alternative.effect.usual_sizes
    return {
        "minimal_detectable": least,
        "above": above,
        "usual": None if usual is None else {"from": usual[0], "to": usual[1], "unit": candidate.unit},
        "usual_seen": usual_seen(candidate),
    }


def _open(effect: Effect, where: Mapping[str, str], word: str, reason: str) -> dict[str, Any]:
    return {
        "name": effect.name,
        "where": dict(where),
        "by": effect.by or None,
        "status": word,
        "minimal_detectable": None,
        "hides": None,
        "reason": reason,
    }
