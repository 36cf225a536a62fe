"""Rates over many diagnoses: what the promises speak of, and what stands beside it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from benchmarks.bars import Number, Rate
from benchmarks.hidden.case import Case, Found, Hidden
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.findings import Diagnosis, Finding
from metrocli.diagnosis.status import spots


def found(case: Case) -> Found:
    """Return the diagnosis of a case."""
    before = time.process_time()
    diagnosis = diagnose(case.adjusted())
    seconds = time.process_time() - before
    covered = tuple(
        _covers(finding, hidden, diagnosis)
        for hidden in case.hidden
        for finding in diagnosis.findings
        if _is(finding, hidden)
        and hidden.form in ("", finding.effect.alternative.effect.by)
        and finding.effect.apart.all()
        and set(finding.effect.alternative.parameters) <= set(hidden.values)
    )
    return Found(case, diagnosis, seconds, covered)


def _is(finding: Finding, hidden: Hidden) -> bool:
    alternative = finding.effect.alternative
    return (alternative.effect.name, alternative.where) == (hidden.name, dict(hidden.where))


def _in_set(finding: Finding, hidden: Hidden) -> bool:
    place = tuple(name for key, name in hidden.where.items() if key != "by")
    return (hidden.name, place) in spots(finding.effect)


def _covers(finding: Finding, hidden: Hidden, diagnosis: Diagnosis) -> bool:
    """Whether the 95 % region of the parameters holds the truth: the F distribution of the noise that was found."""
    from scipy.special import fdtri

    name = finding.effect
    off = name.values - np.array([hidden.values[key] for key in name.alternative.parameters])
    size = np.sqrt(np.diag(name.covariance))
    scaled = name.covariance / size / size[:, None]
    distance = float((off / size) @ np.linalg.solve(scaled, off / size))
    return bool(distance / len(off) <= fdtri(len(off), diagnosis.noise.dof, 0.95))


Test = Callable[[Found], bool]


def _rate(what: str, cases: Iterable[Found], test: Test, least: float = 0.0, most: float = 1.0) -> Rate:
    listed = list(cases)
    return Rate(what, sum(test(one) for one in listed), len(listed), least, most)


def _named(one: Found) -> bool:
    return bool(one.diagnosis.findings or one.diagnosis.scatters)


def _detected(one: Found) -> bool:
    """Whether the verdict is not `clean`, or what is hidden stands beside a wrong reading as an explanation of it."""
    hidden = {(each.name, *each.where.values()) for each in one.case.hidden}
    beside = {(other.effect.name, *other.instance) for wrong in one.diagnosis.outliers for other in wrong.effects}
    return one.diagnosis.verdict != "clean" or bool(hidden & beside)


def each_in_sets(one: Found) -> bool:
    return all(any(_in_set(finding, hidden) for finding in one.diagnosis.findings) for hidden in one.case.hidden)


def sole(one: Found) -> bool:
    findings = one.diagnosis.findings
    return len(findings) == 1 and _is(findings[0], one.case.hidden[0]) and not findings[0].instead


def _told_apart(one: Found) -> bool:
    """Whether an outside effect has a wrong name, although the report excludes such a difference."""
    hidden = one.case.hidden[0]
    share = float(np.sqrt(1 - hidden.near**2))
    wrong = [each for each in one.diagnosis.findings if each.effect.alternative.effect.name not in hidden.within]
    return one.diagnosis.verdict in ("explained", "indistinct") and any(each.other_shape_from < share for each in wrong)


def _names(one: Found) -> frozenset[str]:
    findings = [finding.effect.alternative.effect.name for finding in one.diagnosis.findings]
    return frozenset([*findings, *(scatter.effect.name for scatter in one.diagnosis.scatters)])


def _false_outliers(one: Found) -> int:
    return sum(tuple(outlier.keys.values()) not in one.case.outliers for outlier in one.diagnosis.outliers)


def rates(results: Sequence[Found]) -> Iterator[Rate]:
    """Yield the rates that the promises speak of, and those beside them."""
    groups: dict[str, list[Found]] = {}
    for one in results:
        groups.setdefault(one.case.scenario, []).append(one)
    nulls = [one for one in results if not one.case.hidden]
    yield _rate("false name, all without an effect", nulls, _named, most=0.05)
    shown: Test = lambda one: any(f.gain.shown for f in (*one.diagnosis.findings, *one.diagnosis.scatters))  # noqa: E731
    yield _rate("false name with a gain that is shown", nulls, shown, most=0.01)
    for scenario, cases in groups.items():
        if not cases[0].case.hidden:
            yield _rate(f"  false name: {scenario}", cases, _named)
    yield _rate("structure called unexplained without an effect", nulls, lambda one: one.diagnosis.left is not None)
    single = [one for one in results if len(one.case.hidden) == 1 and one.case.hidden[0].name[0] != "_"]
    for scenario, cases in groups.items():
        if cases[0] in single:
            bar = {"1x": 0.75, "1.5x": 0.97, "2x": 0.97, "3x": 0.97}.get(scenario.split()[-1], 0.0)
            yield _rate(f"detected: {scenario}", cases, _detected, least=bar)
    named = [one for one in single if _named(one)]
    yield _rate("truth in the set of names, where one was named", named, each_in_sets, least=0.95)
    large = [one for one in single if one.case.scenario.split()[-1] in ("2x", "3x") and one.case.hidden[0].distinct]
    yield _rate("the sole exact name, from 2x, no near alias", large, sole, least=0.90)
    yield _rate("a known effect called unexplained", single, lambda one: one.diagnosis.left is not None)
    two = [one for one in results if len(one.case.hidden) == 2]
    yield _rate("both of two effects", two, each_in_sets, least=0.85)
    covered = [hit for one in results for hit in one.covered]
    yield Rate("95 % regions that hold the truth", sum(covered), len(covered), 0.92, 0.98)
    outside = [one for one in results if one.case.hidden and one.case.hidden[0].name[0] == "_"]
    clean: Test = lambda one: one.diagnosis.verdict in ("explained", "indistinct")  # noqa: E731
    wrong: Test = lambda one: clean(one) and not _names(one) <= one.case.hidden[0].within  # noqa: E731
    apart = [one for one in outside if one.case.hidden[0].distinct]
    yield _rate("wrong name with a clean bill, outside effect, no near alias", apart, wrong, most=0.10)
    yield _rate("  the same, near aliases of a known effect included", outside, wrong, most=0.10)
    yield _rate("  any name with a clean bill, outside effect", outside, clean)
    yield _rate("  whose difference, by the report, would have shown", outside, _told_apart, most=0.10)
    yield _rate("outside effect not noticed", outside, lambda one: one.diagnosis.verdict == "clean")
    true = [key for one in results for key in one.case.outliers]
    told = [
        key
        for one in results
        for key in (tuple(outlier.keys.values()) for outlier in one.diagnosis.outliers)
        if key in one.case.outliers
    ]
    yield Rate("outliers found", len(told), len(true))
    yield Rate("false outliers, in all cases", sum(map(_false_outliers, results)), len(results))


def print_rates(results: Sequence[Found], longest: float) -> bool:
    """Print the rates and the times; return whether all that are promised are met."""
    listed = [rate for rate in rates(results) if rate.of]
    for rate in listed:
        print(rate)
    times = np.array([one.seconds for one in results])
    print(Number("CPU time of the longest diagnosis", f"{len(times)} cases", times.max(), most=longest, unit="s"))
    return bool(times.max() <= longest) and all(rate.met for rate in listed)
