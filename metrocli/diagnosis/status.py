"""The status of each candidate: what a diagnosis concludes on it, and how far its usual sizes are seen."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import Literal

from metrocli import units
from metrocli.diagnosis.detectability import Candidate
from metrocli.diagnosis.selection.confidence_set import NamedEffect
from metrocli.effects.effect import Effect


class Status(StrEnum):
    """What a diagnosis concludes on a candidate effect."""

    NAMED = "named"
    EXCLUDED = "excluded"
    """Not found, although one of the largest usual size would have been (power at least 80 %)"""
    CANNOT_SEE = "cannot-see"
    """Its smallest detectable size is larger than usual, or its scan too coarse for the readings"""
    NOT_TESTABLE = "not-testable"
    """The unknowns of the job absorb it"""
    NOT_TESTED = "not-tested"
    """A column is missing"""


UNCHECKED = "no reading is checked by the others"
_SMALLEST = 0.01
"""Smallest number to which a usual size with a unit of its own is converted"""


def status(candidate: Candidate, named: Iterable[NamedEffect]) -> str:
    """Return the status of a candidate; one in the confidence set of a named effect counts as named."""
    if any(candidate.alternative.spot in spots(name) for name in named):
        return Status.NAMED
    if not candidate.testable:
        return Status.NOT_TESTABLE
    seen = candidate.detectable <= candidate.plausible and not candidate.missed
    return Status.EXCLUDED if seen else Status.CANNOT_SEE


def spots(name: NamedEffect) -> set[tuple[str, tuple[str, ...]]]:
    """Return cause and place of a named effect and of all its rivals."""
    return {name.alternative.spot, *(rival.alternative.spot for rival in name.rivals)}


def usual_seen(candidate: Candidate) -> bool | Literal["part"] | None:
    """Return whether effects of usual sizes are detected; None if the usual sizes are not known."""
    usual = candidate.alternative.effect.usual_sizes
    if usual is None:
        return None
    if candidate.detectable <= usual[0]:
        return True
    return "part" if candidate.detectable <= usual[1] else False


def reason(candidate: Candidate, word: str) -> str:
    """Return the reason for a candidate's status, in words."""
    effect = candidate.alternative.effect
    parameter = effect.parameters[0]
    plausible, at = parameter.readable(candidate.plausible)
    if word == Status.NOT_TESTABLE:
        return f"absorbed by {', '.join(candidate.absorbed_by)}; `hides` is for {plausible:.3g} {at}".rstrip()
    size, unit = parameter.readable(candidate.detectable)
    if word == Status.CANNOT_SEE and candidate.missed:
        name = effect.scanned[0].name
        return f"missed between values of {name}, which are further apart than the readings tell: scan a smaller range"
    if word == Status.CANNOT_SEE:
        hides = f"`hides` is for {parameter.sized(candidate.assumed)}"
        return f"detected from {f'{size:.3g} {unit}'.strip()} on; {seen_in_words(candidate)}; {hides}"
    return "" if word == Status.NAMED else f"excluded above {f'{size:.3g} {unit}'.strip()}; {seen_in_words(candidate)}"


def seen_in_words(candidate: Candidate) -> str:
    """Return in words how far the usual sizes of a candidate are detected."""
    usual = candidate.alternative.effect.usual
    if not usual:
        size, unit = candidate.alternative.effect.parameters[0].readable(candidate.plausible)
        return f"larger than {f'{size:.3g} {unit}'.strip()} is not plausible"
    found = {True: "are", "part": "are in part", False: "are not"}[usual_seen(candidate) or False]
    least = candidate.detectable if candidate.testable else candidate.plausible
    return f"usual sizes ({usual_beside(candidate.alternative.effect, least)}) {found} seen"


def usual_beside(effect: Effect, size: float) -> str:
    """Return the usual sizes of an effect in the unit in which a size of it is shown, so that both can be compared.

    They are as its page states them where that has two units, and the lower end would be tiny in the unit of the size.
    """
    if effect.usual_sizes is None:
        return ""
    dimension, unit = effect.parameters[0].dimension, effect.parameters[0].readable(size)[1]
    low, high = (units.find_unit(unit, dimension).outside(one) if dimension else one for one in effect.usual_sizes)
    if low < _SMALLEST and " " in effect.usual.partition(" to ")[0]:
        return effect.usual
    return f"{units.two_digits(low)} to {units.two_digits(high)} {'' if unit == '1' else unit}".strip()
