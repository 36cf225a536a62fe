"""Values of quantities and the sources that they come from."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import combinations
from typing import Any

from metrocli.errors import Fault
from metrocli.expressions.written import AnyQuantity
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.result import Result
from metrocli.settings import BAD, Number, Schema
from metrocli.settings.values import OfText


def identity(result: Result) -> str:
    """Return a hash of the content of a result's file, equal for results of the same file."""
    return result.made_from[0].sha256 if result.made_from else str(id(result))


def contributors(result: Result) -> set[str]:
    """Return the names in the budget of a result of report-uncertainty."""
    budget = result.tables.get("budget")
    return set() if budget is None else set(budget.texts("contributor")) | set(_included(result))


def _included(result: Result) -> Iterable[str]:
    sources = result.tables.get("sources")
    return [] if sources is None else sources.texts("source")


def shared(results: Mapping[str, Result], named: Iterable[str] = ()) -> list[str]:
    """Return warnings of common sources of results, and of contributors that this job names too (`named`)."""
    lines = []
    for (a, first), (b, second) in combinations(results.items(), 2):
        if identity(first) == identity(second):
            continue
        lines += _between(a, first, b, second)
    for name, result in results.items():
        twice = sorted(contributors(result) & set(named))
        lines += [f"'{item}' is counted twice: it is in the budget of {name} and in this job" for item in twice]
    return lines


def unvalidated(name: str, result: Result, estimate: str) -> list[str]:
    """Return the warning that Monte Carlo does not validate an estimate of a result; nothing without trials."""
    valid = result.details.get(estimate, {}).get("gum_valid")
    if valid is None or math.isnan(float(valid)) or valid:
        return []
    taken = "this job takes its value and uncertainty for those of a normal distribution"
    return [
        f"{name}: Monte Carlo does not validate its uncertainty; {taken}: put its model and quantities into this job"
    ]


def _between(a: str, first: Result, b: str, second: Result) -> list[str]:
    # compared by content, since a comment that was added between the two results changes no reading
    files = {key: item.path for item in first.made_from for key in (item.sha256, item.content) if key}
    common = [files[key] for item in second.made_from for key in (item.sha256, item.content) if key in files]
    lines = []
    if common:
        lines.append(
            f"{a} and {b} have a common source, {', '.join(dict.fromkeys(common))}. Their errors are correlated, but "
            "neither result states the correlation; this job treats them as independent"
        )
    twice = sorted(contributors(first) & contributors(second))
    return lines + [f"'{item}' is counted twice: it is in the budgets of {a} and of {b}" for item in twice]


INFINITE = ("inf", ".inf", "infinite")
FEWEST = 0.5
"""Least degrees of freedom"""


def _refused(node: Node, faults: list[Fault], message: str, hint: str) -> Any:
    faults.append(node.fault(f"{node.path}: {message}", hint))
    return BAD


@dataclass(frozen=True)
class Limit:
    """One end of a tolerance; `none` where there is no limit on that side."""

    expects = "a limit such as '50.001 mm', or none"

    def fits(self, node: Node) -> bool:
        return node.kind == "scalar"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if node.empty or node.text == "none":
            return None
        return AnyQuantity().read(node, faults)

    def schema(self) -> Schema:
        return {"anyOf": [{"type": "null"}, {"const": "none"}, AnyQuantity().schema()]}


@dataclass(frozen=True)
class Probability(OfText):
    """A number above 0 and below 1, or from `minimum` on."""

    minimum: float = 0.0
    expects = "a probability such as 0.95"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        value = Number().read(node, faults)
        if value is BAD or (0 < value < 1 and value >= self.minimum):
            return value
        hint = f"write {value / 100:g}" if 1 < value < 100 else f"expected {self.expects}"
        if 0 < value < 1:
            hint = f"write {1 - value:.12g} if {node.text} is the probability outside"
        return _refused(node, faults, f"{node.text} is not a probability between {self.minimum:g} and 1", hint)

    def schema(self) -> Schema:
        return {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1}


@dataclass(frozen=True)
class DegreesOfFreedom(OfText):
    """A number, or `inf`; 0.5 are those of an uncertainty that is itself uncertain by 100 % (JCGM 100, G.4.2)."""

    expects = "a number of at least 0.5, or inf"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        return math.inf if node.text in INFINITE else Number(FEWEST).read(node, faults)

    def schema(self) -> Schema:
        return {"anyOf": [Number(FEWEST).schema(), {"enum": list(INFINITE)}]}


@dataclass(frozen=True)
class Trials(OfText):
    """A number of trials, or `adaptive`."""

    expects = "a number of trials from 1000 to 1000000000, or adaptive, or 0 for none"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if node.text == "adaptive":
            return None
        value = Number().read(node, [])
        if value is BAD or value != int(value) or not (value == 0 or 1000 <= value <= 1e9):
            return _refused(node, faults, f"'{node.text}' is not a number of trials", f"expected {self.expects}")
        return int(value)

    def schema(self) -> Schema:
        return {"anyOf": [{"const": "adaptive"}, {"type": "number", "minimum": 0, "maximum": 1e9}]}
