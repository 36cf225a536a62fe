"""Common sources of results: the same file, a shared input, a contributor that is counted twice."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import combinations

from metrocli.result import Result


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


def _between(a: str, first: Result, b: str, second: Result) -> list[str]:
    # by content too: a comment that was added between the two results leaves the readings what they are
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
