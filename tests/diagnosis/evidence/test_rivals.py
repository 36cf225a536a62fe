"""The odds of a rival are those of the score: of the state with it in the place of the identified effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hidden import launch, lengths
from metrocli.cli.diagnosis_report import findings as diagnosis_report
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.evidence.identified import identified
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.verdict import as_data


def test_the_odds_of_a_rival_are_the_difference_of_scores() -> None:
    rng = np.random.default_rng(12)
    wrong, _ = lengths.planted(lengths.measurement(rng, 40), rng, "refraction-drift", 2.0)
    m = measurement_of(wrong.adjusted())
    bare = State.of(m)
    ranks = set()
    for number in range(len(m.families)):
        net = np.subtract(*bare.gains_of_family(number)[:2])
        state = bare.plus([m.effect(number, int(np.argmax(net)))])
        for rival in identified(state, state.fixed[0]).rivals:
            key = next(
                (i, j)
                for i, family in enumerate(m.families)
                for j, other in enumerate(family.alternatives)
                if other is rival.alternative
            )
            instead = bare.plus([m.effect(*key)])
            assert np.log(rival.odds) == pytest.approx(instead.score - state.score, abs=1e-6)
            ranks.add((state.fixed[0].rank, instead.fixed[0].rank))
    # prices differ by rank: an effect of two parameters stands beside one of one
    assert len({one == other for one, other in ranks}) == 2


def test_effects_that_explain_as_well_together_are_rivals() -> None:
    """Beside seven readings of an encoder a second harmonic is nearly an offset with an eccentricity."""
    adjusted = launch.case(700003).adjusted()
    found = diagnose(adjusted)
    m = measurement_of(adjusted)
    keys = {str(one): (f, k) for f, family in enumerate(m.families) for k, one in enumerate(family.alternatives)}
    named, *instead = "encoder-harmonic phi3", "encoder-offset phi3", "encoder-eccentricity phi3"
    one, together = (State.of(m, [m.effect(*keys[name]) for name in names]).score for names in ([named], instead))
    (finding,) = found.findings
    assert str(finding) == named and found.verdict == "indistinct"
    (joint,) = (rival for rival in finding.effect.rivals if rival.beside)
    assert str(joint) == " with ".join(instead)
    # about the solution with the effect, where that of the test is without one
    assert np.log(joint.odds) == pytest.approx(together - one, abs=0.5)
    assert str(joint) in diagnosis_report.of_diagnosis(found, None)
    listed = as_data(found)["effects"][0]["alternatives"][-1]
    assert (listed["name"], listed["with"][0]["name"]) == ("encoder-offset", "encoder-eccentricity")


def test_scanned_values_are_no_sizes_to_compare_with_usual_ones() -> None:
    """A period of 9 mm is no amplitude, and a parameter that is not determined has no bound."""
    found = diagnose(launch.case(700003).adjusted())
    finding = found.findings[0]
    whole = finding.times_usual
    undetermined = replace(finding.sizes[0], value=1e9, std=None)
    assert replace(finding, sizes=(*finding.sizes, undetermined)).times_usual == whole
    assert replace(finding, sizes=(undetermined,)).times_usual == 0.0
