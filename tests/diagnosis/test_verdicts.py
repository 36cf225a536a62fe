"""One verdict of each sort for each kind of job: nothing hidden, a known effect, one outside the catalogue.

Rates over many cases: python -m benchmarks hidden_effects
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count, islice

import pytest

from benchmarks.hidden import rates
from benchmarks.hidden.case import Case
from benchmarks.hidden_effects import KINDS
from metrocli.diagnosis.findings import Verdict

LONG = {"calibrate-machine", "six-dof"}
EACH_KIND = [pytest.param(kind, marks=pytest.mark.slow if kind in LONG else ()) for kind in KINDS]


def cases(kind: str, scenario: str) -> Iterator[Case]:
    return KINDS[kind].cases(count(), scenario, small=True)


@pytest.mark.alike
@pytest.mark.parametrize("kind", EACH_KIND)
def test_where_nothing_is_hidden_the_verdict_is_clean(kind: str) -> None:
    found = rates.found(next(cases(kind, "nothing")))
    assert found.diagnosis.verdict == Verdict.CLEAN and not found.diagnosis.findings


@pytest.mark.alike
@pytest.mark.parametrize("kind", EACH_KIND)
def test_a_known_effect_is_named(kind: str) -> None:
    distinct = (case for case in cases(kind, "an effect of 3x") if case.hidden[0].distinct)
    found = [rates.found(case) for case in islice(distinct, 3)]
    assert all(one.diagnosis.verdict != Verdict.CLEAN and len(one.diagnosis.findings) == 1 for one in found)
    # noise of its image may explain one as well
    assert sum(rates.sole(one) for one in found) >= 2


@pytest.mark.parametrize("kind", ["multilaterate", pytest.param("selfcal-grid", marks=pytest.mark.slow)])
def test_an_effect_outside_the_catalogue_is_called_unknown(kind: str) -> None:
    case = next(case for case in cases(kind, "outside*") if case.hidden[0].distinct)
    assert rates.found(case).diagnosis.verdict == Verdict.UNEXPLAINED
