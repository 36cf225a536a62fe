"""One round of the hidden-effect campaign on small measurements: the promised rates, as far as so few cases can show them.

The whole campaign, with times: python -m benchmarks hidden_effects
"""

from __future__ import annotations

from functools import cache

import pytest
from scipy.stats import binom

from benchmarks.hidden import rates
from benchmarks.hidden.case import Found
from benchmarks.hidden_effects import KINDS, results

COUNT = 20
"""One of each scenario"""


@cache
def found(kind: str) -> tuple[Found, ...]:
    return tuple(results(kind, range(COUNT), small=True))


@pytest.fixture(params=KINDS)
def cases(request: pytest.FixtureRequest) -> tuple[Found, ...]:
    return found(request.param)


def hidden(cases: tuple[Found, ...], known: bool) -> list[Found]:
    return [one for one in cases if one.case.hidden and (one.case.hidden[0].name[0] != "_") is known]


def test_where_nothing_is_hidden_nothing_is_named(cases: tuple[Found, ...]) -> None:
    nothing = [one for one in cases if not one.case.hidden]
    assert len(nothing) >= len(cases) // 3
    assert sum(bool(one.diagnosis.findings) for one in nothing) <= 1
    assert not any(finding.gain.shown for one in nothing for finding in one.diagnosis.findings)
    # one of seven, where one round has no more, is within the 5 % that the levels allow (probability 0.3)
    assert sum(one.diagnosis.verdict != "clean" for one in nothing) <= max(1, len(nothing) // 10)


def test_what_is_hidden_is_found_and_named(cases: tuple[Found, ...]) -> None:
    known = hidden(cases, known=True)
    assert len(known) >= 0.4 * len(cases)
    large = [one for one in known if not one.case.scenario.endswith(" 1x")]
    assert all(one.diagnosis.verdict != "clean" for one in large)
    named = [one for one in known if one.diagnosis.findings]
    assert sum(map(rates.each_in_sets, named)) >= 0.95 * len(named)


def test_a_name_stands_alone_where_no_other_is_alike(cases: tuple[Found, ...]) -> None:
    known = [one for one in hidden(cases, known=True) if len(one.case.hidden) == 1 and one.case.hidden[0].distinct]
    large = [one for one in known if one.case.scenario.split()[-1] in ("2x", "3x")]
    assert len(large) >= len(cases) // 8
    assert sum(map(rates.sole, large)) >= 0.9 * len(large)


def test_an_effect_of_no_table_is_called_unknown(cases: tuple[Found, ...]) -> None:
    """With 15 to 40 poses some show in too few readings: of 23 in the campaign 6 were not noticed, 1 misnamed.

    Of 30 in images of a part 10 were not: seen as noise 1.3 times larger, ripples along the radius most of all.
    """
    outside = [one for one in hidden(cases, known=False) if one.case.hidden[0].distinct]
    assert len(outside) >= len(cases) // 20
    unexplained = [one for one in outside if one.diagnosis.verdict == "unexplained"]
    few = cases[0].diagnosis.job.kind in ("align-part", "calibrate-camera")
    few |= "outside the table, few poses" in {one.case.scenario for one in outside}
    assert len(unexplained) >= (0.4 if few else 1.0) * len(outside)
    assert sum(bool(one.diagnosis.findings) and one not in unexplained for one in outside) <= (1 if few else 0)
    assert all(one.diagnosis.left is not None and one.diagnosis.left.depends_on for one in unexplained)


def test_a_name_is_told_from_what_it_is_not_by_its_region(cases: tuple[Found, ...]) -> None:
    covered = [hit for one in cases for hit in one.covered]
    assert len(covered) >= len(cases) // 4
    # of so many regions of 95 % fewer hold the truth once in a hundred times
    assert sum(covered) >= binom.ppf(0.01, len(covered), 0.95)


def test_the_noise_is_found(cases: tuple[Found, ...]) -> None:
    ratios = [one.diagnosis.noise for one in cases if not one.case.hidden and "noisier" not in one.case.scenario]
    truths = [one.case.noise for one in cases if not one.case.hidden and "noisier" not in one.case.scenario]
    inside = [noise.low <= truth <= noise.high for noise, truth in zip(ratios, truths, strict=True)]
    assert sum(inside) >= 0.85 * len(inside)
