"""Acceptance criteria of a job, `require: {sigma0: "< 1.5", x.std: "< 10 um"}`, and decisions on its tolerances."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

from metrocli import tasks, units
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import Fault
from metrocli.expressions.dimensions import converted
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.record import FAIL, GUARD_BAND, PASS, CriterionVerdict
from metrocli.result import Result
from metrocli.settings import BAD, Schema
from metrocli.tasks.shared.figures import of_effects
from metrocli.words import nearest, suggestion

_COMPARISONS: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le, ">=": operator.ge, "==": operator.eq, "<": operator.lt, ">": operator.gt,
}  # fmt: skip
_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_BRACES = re.compile(r"\{[a-z]+\}")
_CONDITION = re.compile(rf"\s*(<=|>=|==|<|>)\s*({_NUMBER})\s*(\S*)\s*")


@dataclass(frozen=True)
class Requirement:
    """One comparison of a value of the result with a limit."""

    name: str
    """An estimate (`f`), its standard uncertainty (`f.std`) or a statistic (`sigma0`, `rms.px`)."""
    comparison: str
    limit: float
    unit: str
    node: Node

    def verdict(self, result: Result, faults: list[Fault]) -> CriterionVerdict | None:
        """Compare the value with the limit.

        Adds a fault and returns None if the result has no such value, or one of another unit.
        """
        known = values_of(result)
        limit = self.limit_among({name: unit for name, (_, unit) in known.items()}, faults)
        if limit is None:
            return None
        value, unit = known[self.figure]
        return CriterionVerdict(
            self.name, self.node.text, value, unit, bool(_COMPARISONS[self.comparison](value, limit))
        )

    @property
    def figure(self) -> str:
        """The name of the value in the result."""
        return self.name.removeprefix("statistics.")

    def limit_among(self, known: Mapping[str, str], faults: list[Fault]) -> float | None:
        """Return the limit in the internal unit of the value that it is for; `known` has the unit of each by name.

        In the names braces stand for any text (`{tracer}.x`). Adds a fault and returns None if the value is not
        known, or the limit has another unit.
        """
        possible = units_among(self.figure, known)
        if not possible:
            message = f"require: the result has no value '{self.name}'"
            faults.append(self.node.fault(message, _allowed(self.figure, known)))
        wrong: list[units.QuantityError] = []
        for unit in possible:
            try:
                return self._limit_in(unit)
            except units.QuantityError as error:
                wrong.append(error)
        faults.extend(self.node.fault(f"{self.node.path}: {fault.message}", fault.hint) for fault in wrong[:1])
        return None

    def _limit_in(self, unit: str) -> float:
        if not self.unit and unit in ("", "1"):
            return self.limit
        if not self.unit:
            example = f"write e.g. '{self.comparison} {self.limit:g} {unit}'"
            raise units.QuantityError(f"{self.limit:g} has no unit", example)
        dimension = next((name for name in units.DIMENSIONS if units.internal_unit(name) == unit), None)
        if dimension is None:
            try:
                return converted(self.limit, self.unit, unit)
            except units.QuantityError as error:
                hint = "write the limit without a unit" if unit in ("", "1") else error.hint
                raise units.QuantityError(f"{self.name} has the unit '{unit}', not '{self.unit}'", hint) from error
        return units.find_unit(self.unit, dimension).inside(self.limit)


def figures_of(kind: str, settings: Any, requests: tuple[RequestedEffect, ...]) -> dict[str, str]:
    """Return the units of all figures, by name, that the result of a job can have and a requirement can name."""
    return tasks.KINDS[kind].figures(settings) | of_effects(requests)


def by_names(known: Mapping[str, str], names: Mapping[str, Collection[str]]) -> dict[str, str]:
    """Return known figures with the names that stand for their braces, those of `tracer` for `{tracer}.x`.

    A figure whose braces stand for something else stays as it is.
    """
    conditions: dict[str, str] = {}
    for figure, unit in known.items():
        braces = _BRACES.findall(figure)
        key = braces[0][1:-1] if len(braces) == 1 else ""
        conditions |= {figure.replace(braces[0], name): unit for name in names[key]} if key in names else {figure: unit}
    return conditions


def units_among(name: str, known: Mapping[str, str]) -> list[str]:
    """Return the unit of a known name, or those of the known names with braces that it fits."""
    if name in known:
        return [known[name]]
    patterns = {
        ".+".join(map(re.escape, _BRACES.split(quantity))): unit for quantity, unit in known.items() if "{" in quantity
    }
    return [unit for pattern, unit in patterns.items() if re.fullmatch(pattern, name)]


def _allowed(name: str, known: Mapping[str, str]) -> str:
    """Return the known name that is meant, or all of them; standard uncertainties once only."""
    if nearest(name, known) is not None:
        return suggestion(name, known)
    brief = [candidate for candidate in known if not candidate.endswith((".std", ".dof"))]
    more = ", and the standard uncertainty of an estimate as NAME.std" if len(brief) < len(known) else ""
    return f"{suggestion(name, brief)}{more}"


def values_of(result: Result) -> dict[str, tuple[float, str]]:
    """Return all values that a requirement can name, each with its unit."""
    values: dict[str, tuple[float, str]] = {}
    for name, value in result.statistics.items():
        if isinstance(value, Mapping):
            values |= {f"{name}.{part}": (float(number), "") for part, number in value.items()}
        elif isinstance(value, int | float):
            values[name] = (float(value), "")
    for estimate in result.estimates:
        values[f"{estimate.name}.std"] = (estimate.std, estimate.unit)
        values[estimate.name] = (estimate.value, estimate.unit)
        for path, value in _numbers(estimate.name, result.details.get(estimate.name, {})):
            plain = path.rpartition(".")[2] in result.plain
            values[path] = (value, "" if plain else estimate.unit)
    return values


def _numbers(path: str, values: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield the numbers of nested details under their paths, such as `l.mc.std`."""
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _numbers(f"{path}.{name}", value)
        elif isinstance(value, int | float):
            yield f"{path}.{name}", float(value)


@dataclass(frozen=True)
class Requirements:
    """The value of `require:`: a mapping from names to comparisons or lists of comparisons."""

    expects = "names with comparisons such as {sigma0: '< 1.5'}"

    def fits(self, node: Node) -> bool:
        return node.kind == "mapping"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            faults.append(node.fault(f"{node.path}: this is not a mapping", f"expected {self.expects}"))
            return BAD
        parts = [(key.text, part) for key, value in node.entries for part in (value.items or (value,))]
        requirements = [_requirement(name, part, faults) for name, part in parts]
        # those that can be read are checked against the figures of the job, beside the faults of the others
        return tuple(requirement for requirement in requirements if requirement is not None)

    def schema(self) -> Schema:
        shape: Schema = {"type": "string", "pattern": rf"^\s*(<=|>=|==|<|>)\s*{_NUMBER}\s*(\S*)\s*$"}
        return {"type": "object", "additionalProperties": {"anyOf": [shape, {"type": "array", "items": shape}]}}


def _requirement(name: str, node: Node, faults: list[Fault]) -> Requirement | None:
    match = _CONDITION.fullmatch(node.text) if node.kind == "scalar" else None
    if match is None:
        faults.append(node.fault(f"{node.path}: '{node.text}' is not a comparison", "write e.g. '< 1.5' or '<= 5 um'"))
        return None
    return Requirement(name, match[1], float(match[2]), match[3], node)


_DECISIONS = {"conforming": PASS, "non-conforming": FAIL}
"""By the zone of ISO 14253-1; in any other zone nothing is shown"""
OVER_LIMIT = "length_error_over_limit"
"""Statistic: the largest error of a calibrated length over its limit (VDI/VDE 2634, acceptance)"""


def decisions(result: Result, reported: bool) -> Iterator[CriterionVerdict]:
    """Yield the decision on each tolerance of a result; where it is only `reported`, each counts as met."""
    for estimate in result.estimates:
        tolerance: Mapping[str, Any] = result.details.get(estimate.name, {}).get("tolerance", {})
        if "zone" in tolerance:
            decided = _DECISIONS.get(tolerance["zone"], GUARD_BAND)
            low, high = tolerance["limits"]
            ends = [f"{end:.10g}" if math.isfinite(end) else "no limit" for end in (low, high)]
            within = f"{' to '.join(ends)} {estimate.unit}".strip()
            yield CriterionVerdict(
                estimate.name, within, estimate.value, estimate.unit, reported or decided != FAIL, decided
            )
    over = result.statistics.get(OVER_LIMIT)
    if isinstance(over, float):
        met, what = over <= 1, "largest over its limit, <= 1"
        yield CriterionVerdict("length measuring errors", what, over, "1", reported or met, PASS if met else FAIL)
