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

pytestmark = pytest.mark.slow
COUNT = 20
"""One case of each scenario"""
SMALL = ("calibrate-camera", "multilaterate", "selfcal-grid")
"""Kinds whose measurements are smaller here than in the campaign"""
MORE = {"align-part": 40}
"""Kinds of which more cases are needed: in most of them some other cause looks nearly like the hidden one"""
TRIED = [kind for kind in KINDS if kind != "calibrate-machine"]
"""A round of machines takes minutes; single ones are in test_verdicts"""


@cache
def found(kind: str) -> tuple[Found, ...]:
    return tuple(results(kind, range(MORE.get(kind, COUNT)), small=kind in SMALL))


@pytest.fixture(params=TRIED)
def cases(request: pytest.FixtureRequest) -> tuple[Found, ...]:
    return found(request.param)


def hidden(cases: tuple[Found, ...], known: bool) -> list[Found]:
    return [one for one in cases if one.case.hidden and (one.case.hidden[0].name[0] != "_") is known]


def is_likely(hits: int, tries: int, rate: float) -> bool:
    """Whether a promised rate gives at least so few hits in more than one of a hundred rounds."""
    return hits >= binom.ppf(0.01, tries, rate)


def test_where_nothing_is_hidden_nothing_is_named(cases: tuple[Found, ...]) -> None:
    nothing = [one for one in cases if not one.case.hidden]
    assert len(nothing) >= len(cases) // 3
    assert sum(bool(one.diagnosis.findings) for one in nothing) <= 1
    assert not any(finding.gain.shown for one in nothing for finding in one.diagnosis.findings)
    assert is_likely(sum(one.diagnosis.verdict == "clean" for one in nothing), len(nothing), 0.95)


def test_what_is_hidden_is_found_and_named(cases: tuple[Found, ...]) -> None:
    known = hidden(cases, known=True)
    assert len(known) >= 0.4 * len(cases)
    large = [one for one in known if not one.case.scenario.endswith(" 1x")]
    assert all(one.diagnosis.verdict != "clean" for one in large)
    named = [one for one in known if one.diagnosis.findings]
    assert is_likely(sum(map(rates.each_in_sets, named)), len(named), 0.95)


def test_a_name_stands_alone_where_no_other_is_alike(cases: tuple[Found, ...]) -> None:
    known = [one for one in hidden(cases, known=True) if len(one.case.hidden) == 1 and one.case.hidden[0].distinct]
    large = [one for one in known if one.case.scenario.split()[-1] in ("2x", "3x")]
    assert len(large) >= 2
    assert is_likely(sum(map(rates.sole, large)), len(large), 0.9)


def test_an_effect_outside_the_catalogue_is_called_unknown(cases: tuple[Found, ...]) -> None:
    """With 15 to 40 poses some show in too few readings: of 23 in the campaign 6 were not noticed, 1 misnamed.

    Of 30 in images of a part 10 were not: seen as noise 1.3 times larger, ripples along the radius most of all.
    Of those in the small grids here one is misnamed: 27 balls show little of a wave.
    """
    outside = [one for one in hidden(cases, known=False) if one.case.hidden[0].distinct]
    if not outside:
        pytest.skip("in this round no effect outside the catalogue differs from those inside it")
    unexplained = [one for one in outside if one.diagnosis.verdict == "unexplained"]
    few = cases[0].diagnosis.job.kind in ("align-part", "calibrate-camera")
    few |= "outside the table, few poses" in {one.case.scenario for one in outside}
    assert is_likely(len(unexplained), len(outside), 0.6 if few else 0.95)
    misnamed = sum(bool(one.diagnosis.findings) and one not in unexplained for one in outside)
    assert misnamed <= (1 if few or cases[0].diagnosis.job.kind in SMALL else 0)
    assert all(one.diagnosis.left is not None and one.diagnosis.left.depends_on for one in unexplained)


def test_regions_hold_the_planted_sizes(cases: tuple[Found, ...]) -> None:
    covered = [hit for one in cases for hit in one.covered]
    assert len(covered) >= len(cases) // 4
    assert is_likely(sum(covered), len(covered), 0.95)


def test_the_noise_is_found(cases: tuple[Found, ...]) -> None:
    ratios = [one.diagnosis.noise for one in cases if not one.case.hidden and "noisier" not in one.case.scenario]
    truths = [one.case.noise for one in cases if not one.case.hidden and "noisier" not in one.case.scenario]
    inside = [noise.low <= truth <= noise.high for noise, truth in zip(ratios, truths, strict=True)]
    assert is_likely(sum(inside), len(inside), 0.95)
