"""Scanned parameters are refined between the values that the scan tried."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.hidden import grids, lengths, machine
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.refined import _Scan, refined
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.evidence.weights import with_noise
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.diagnosis.linear.families import _steps
from metrocli.diagnosis.rounds import searched
from metrocli.tasks.adjust_network.effects import EFFECTS
from tests.diagnosis.evidence.test_dense import number_of_effect, with_residual


def test_forms_of_a_cause_without_the_parameter_are_no_neighbours() -> None:
    """A point moved at a time, or from a station on: both stand in one family of `point-moved`."""
    by_time, by_station = (effect for effect in EFFECTS if effect.name == "point-moved")
    sizes = ("dx", "dy", "dz")
    tried = [Candidate(by_time, ("P1",), (("at", at),), sizes) for at in (100.0, 200.0, 300.0)]
    other = Candidate(by_station, ("P1",), (("from_station", 2.0),), sizes)
    times = np.arange(90.0, 330.0, 20.0)
    readings = SimpleNamespace(observations=SimpleNamespace(conditions={"t": times}))
    m = SimpleNamespace(
        families=[SimpleNamespace(alternatives=(*tried, other))],
        job=SimpleNamespace(model=SimpleNamespace(readings=[readings])),
    )
    scan = _Scan(SimpleNamespace(measurement=m), SimpleNamespace(family=0, number=1), "at")
    found = scan._between(tried[1])
    assert found.min() > 100
    assert found.max() < 300


def test_values_refined_in_two_branches_of_a_search_are_two() -> None:
    """Screws of two axes, each refined beside nothing: the second must not have the products of the first."""
    m = measurement_of(machine.measurement(np.random.default_rng(5), machine.SMALL).adjusted(), quick=True)
    family = number_of_effect(m, "screw-pitch-error")
    at = {}
    for number, one in enumerate(m.families[family].alternatives):
        at.setdefault(one.instance, []).append(number)
    middle = [at[axis,][len(at[axis,]) // 2] for axis in ("x", "y")]
    between = sum(m.whole(family, number)[:, 0] + m.whole(family, number + 1)[:, 0] for number in middle)
    m = with_residual(m, m.system.residual + 3 * between)
    for number in middle:
        state = refined(State.of(m, [m.effect(family, number)]))
        assert state.fixed[0].number != number
        # least squares leave nothing along the columns
        left = state.fixed[0].columns.T @ state.residual
        assert np.abs(left).max() < 1e-6 * np.linalg.norm(m.system.residual)


def test_other_values_that_fit_alike_stay_beside_other_noise() -> None:
    m = measurement_of(lengths.measurement(np.random.default_rng(5), 20).adjusted(), quick=True)
    alias = ("at", 3.0, 0.5)
    state = State.of(m, [replace(m.effect(0, 0), aliases=(alias,)), m.reading(3)])
    assert [part.aliases for part in state.at(with_noise(m, {0: 2.0})).fixed] == [(alias,), ()]


def test_a_term_of_a_law_stays_beside_other_noise_and_has_nothing_to_refine() -> None:
    """Rivals of effects are sought after laws: their terms are of no family, and the search may change the noise."""
    m = measurement_of(lengths.measurement(np.random.default_rng(5), 20).adjusted(), quick=True)
    key = len(m.families), 2
    term = m.term(m.whole(0, 1), key, 1.0)
    state = State.of(m, [m.effect(0, 0), term])
    assert refined(state).fixed[1] is term
    weighted = with_noise(m, {0: 2.0})
    found, expected = (
        state.at(weighted),
        State.of(weighted, [weighted.effect(0, 0), weighted.term(weighted.whole(0, 1), key, 1.0)]),
    )
    assert found.score == pytest.approx(expected.score)
    assert found.fixed[1].key == term.key
    # the sizes are those of the same parameters
    assert found.fixed[1].columns @ np.linalg.pinv(found.fixed[1].turn) == pytest.approx(weighted.whole(0, 1))


@pytest.mark.parametrize("quick", [True, False])
def test_readings_beside_a_large_step_are_not_called_wrong(quick: bool) -> None:
    """A scan tries each fourth time: the readings between the step and the time tried are not wrong ones."""
    m = grids.measurement(np.random.default_rng(21), "1234")
    before, at = np.sort(m.t[m.views.view == 1])[40:42].tolist()
    step = {"view": 1, "at": at, "dx": 0.21, "dy": -0.1, "dz": 0.06}
    m = replace(m, readings=m.readings + grids.change(m, "reseated-artefact", step))
    _, state = searched(m.adjusted(), quick)
    (named,) = (state.measurement.alternative(part.key) for part in state.named)
    assert named.spot == ("reseated-artefact", ("2",)) and not state.readings
    assert before < dict(named.scanned)["at"] < at


class _Even:
    """Random numbers; places of the x axis are multiples of 25 mm."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rng, name)

    def uniform(self, low: Any, high: Any, size: Any = None) -> Any:
        drawn = self.rng.uniform(low, high, size)
        if low is machine.LOW:
            drawn[:, 0] = 25 * np.round(drawn[:, 0] / 25)
        return drawn


def test_all_periods_that_even_places_do_not_distinguish_are_listed() -> None:
    """A wave of period p is at multiples of 25 mm one of frequency k/25 + 1/p or k/25 - 1/p, for each whole k."""
    m = machine.measurement(_Even(31))
    wave = {"amplitude": 0.012, "phase": 0.7, "period": 9.0}
    m = replace(m, read=m.read + machine.change(m, "screw-pitch-error", {"axis": "x"}, wave))
    _, state = searched(m.adjusted(), quick=True)
    (part,) = state.named
    found = [dict(state.measurement.alternative(part.key).scanned)["period"], *(value for _, value, _ in part.aliases)]
    frequencies = np.abs(np.arange(-15, 15)[:, None] / 25 + [1 / 9, -1 / 9]).ravel()
    # well inside the range of the scan, 2 to 50 mm
    for period in (1 / f for f in np.unique(frequencies.round(12)) if 1 / 40 < f < 1 / 2.2):
        assert min(abs(one - period) for one in found) < 0.01 * period, period


def test_a_step_begins_after_the_first_reading_of_its_place() -> None:
    """What acts on all readings of a tracer, or a ball, is no change: it was so from the start."""
    m = lengths.measurement(np.random.default_rng(3), 20)
    kept = (m.tracer != 1) | (m.t > np.sort(np.unique(m.t))[4])
    late = replace(m, **{name: getattr(m, name)[kept] for name in ("point", "tracer", "t", "temp", "length")})
    job = late.adjusted()
    effect = next(one for one in job.effects if one.name == "dead-path-jump")
    tried = [dict(one.scanned)["at"] for one, _ in _steps(job, measurement_of(job).system, effect, [("T1",)])]
    assert tried and min(tried) > late.t[late.tracer == 1].min()
