"""A law as the definition of an effect of one's own, and as plain data.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from fractions import Fraction
from itertools import count
from typing import Any

from metrocli.diagnosis.laws.law import Law
from metrocli.diagnosis.laws.library import Term
from metrocli.expressions.dimensions import Powers, base_unit, compound
from metrocli.frozen import dataclass

_MARGIN = 1.5
"""A scanned value is written with a range of this factor on both sides"""
_NAMED = re.compile(r"[A-Za-z]+|1")
_PLAUSIBLE = 10.0
"""Plausible size of a parameter, as a multiple of its value or its standard uncertainty"""


@dataclass(frozen=True)
class Written:
    """The texts of a law: expressions by component, parameters with value, uncertainty and unit, and scanned values."""

    adds: dict[str, str]
    parameters: dict[str, tuple[float, float, str]]
    scan: dict[str, tuple[float, str]]


def written(law: Law) -> Written:
    """Return the texts of a law."""
    adds: dict[str, list[str]] = {}
    parameters: dict[str, tuple[float, float, str]] = {}
    scan: dict[str, tuple[float, str]] = {}
    used = {name for term in law.terms for name in term.form.variables}
    names, shapes = ((name for name in map(text.format, count(1)) if name not in used) for text in ("a{}", "s{}"))
    for term, sizes, stds in zip(law.terms, law.sizes, law.stds, strict=True):
        form, acting = term.form, term.spot.acting
        known = acting.variables_at({})
        unit = _unit_of(term)
        per_unit = compound(unit).factor
        scanned = next(shapes) if form.scanned is not None else ""
        if form.scanned is not None:
            scan[scanned] = (form.scanned, _text(compound(known[form.variables[0]].unit).powers))
        for factor, size, std in zip(form.factors, sizes.tolist(), stds.tolist(), strict=True):
            name = next(names)
            parameters[name] = (size / per_unit, std / per_unit, unit)
            text = factor.replace("{s}", scanned)
            adds.setdefault(term.spot.component, []).append(name if text == "1" else f"{name}*{text}")
    return Written({key: " + ".join(parts) for key, parts in adds.items()}, parameters, scan)


def _unit_of(term: Term) -> str:
    """Return the unit of the sizes of a term: with units of headings where these are plain names, else base units."""
    known, powers = term.spot.acting.variables_at({}), term.form.powers_of()
    of_component = term.spot.acting.unit_of(term.spot.component)
    # a unit that is a quotient itself, such as mm/m, cannot stand behind another /
    by_column = [known[name].heading_unit or known[name].unit for name in powers for _ in range(powers[name])]
    if any(known[name].of_data for name in powers) and all(_NAMED.fullmatch(unit) for unit in by_column):
        return "/".join([of_component, *(unit for unit in by_column if unit != "1")])
    unit = compound(of_component).powers
    for name, power in powers.items():
        unit = _divided(unit, compound(known[name].unit).powers, power)
    return _text(unit)


def _divided(unit: Powers, by: Powers, power: int) -> Powers:
    powers = {name: Fraction(value) for name, value in unit}
    for name, value in by:
        powers[name] = powers.get(name, Fraction(0)) - power * value
    return tuple((name, value) for name, value in sorted(powers.items()) if value)


def _text(powers: Powers) -> str:
    return base_unit(tuple(sorted(powers, key=lambda power: power[1] < 0)))


def as_define(law: Law, name: str) -> dict[str, Any]:
    """Return the entry of a law under `define:`, with `cause: unknown`."""
    texts = written(law)
    scalar = set(texts.adds) == {""}
    definition: dict[str, Any] = {
        "name": name,
        "cause": "unknown",
        "acts_on": law.terms[0].spot.acting.name,
        "adds": texts.adds[""] if scalar else texts.adds,
        "parameters": {
            key: {"unit": unit, "plausible": f"{_PLAUSIBLE * max(abs(value), std):.3g} {unit}".removesuffix(" 1")}
            for key, (value, std, unit) in texts.parameters.items()
        },
    }
    if law.terms[0].spot.where:
        definition["where"] = [key for key, _ in law.terms[0].spot.where]
    if texts.scan:
        definition["scan"] = {key: dict(_range(value, unit)) for key, (value, unit) in texts.scan.items()}
    return definition


def _range(value: float, unit: str) -> Iterator[tuple[str, str]]:
    yield "from", f"{value / _MARGIN:.10g} {unit}".removesuffix(" 1")
    yield "to", f"{value * _MARGIN:.10g} {unit}".removesuffix(" 1")
    yield "steps", "31"


def as_wanted(law: Law, name: str) -> Mapping[str, str]:
    """Return the entry of a law under `effects:`: its sizes are estimated, its scanned values given."""
    scan = {key: f"{value:.10g} {unit}".removesuffix(" 1") for key, (value, unit) in written(law).scan.items()}
    return {"name": name, **dict(law.terms[0].spot.where), **scan}
