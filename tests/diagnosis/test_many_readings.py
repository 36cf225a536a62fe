"""What a diagnosis does differently where there are many readings gives what it gives for few."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hidden import lengths
from metrocli.cli.diagnosis_report import findings
from metrocli.diagnosis import diagnose, verdict
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.evidence import moves, products, variances
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.prices import counted
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear import counting, memory
from metrocli.errors import InputError

DRIFT = {"rate": 3e-6}


def job(points: int, drift: bool = False, wrong: float = 0.0) -> AdjustedJob:
    """Return a network of six tracers."""
    rng = np.random.default_rng(5)
    m = lengths.measurement(rng, points)
    if drift:
        m = replace(m, length=m.length + lengths.signature("dead-path-drift", 1, DRIFT)(m))
    return (lengths.spoilt(m, rng, wrong)[0] if wrong else m).adjusted()


def test_effective_numbers_of_tests_are_those_of_part_of_the_points(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = measurement_of(job(300))
    monkeypatch.setattr(counting, "_SAMPLE", 600)
    some, _ = counting.of_some_members(whole.system, whole.families, np.random.default_rng(2))
    assert 590 <= some.rows <= 610
    drawn = counted(whole.system, whole.families, len(whole.places), np.random.default_rng(1))
    assert drawn.dof == whole.prices.dof
    ratios = np.array(drawn.tests) / np.array(whole.prices.tests)
    assert (ratios > 1 / 2).all()
    assert (ratios < 2).all()


def test_part_of_the_points_is_a_measurement_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = measurement_of(job(300))
    monkeypatch.setattr(counting, "_SAMPLE", 600)
    system, families = counting.of_some_members(whole.system, whole.families, np.random.default_rng(2))
    basis = system.basis.rows(np.arange(system.rows))
    np.testing.assert_allclose(basis.T @ basis @ basis.T, basis.T, atol=1e-9)
    for family in families:
        shown = system.seen(family.columns.whole(range(family.columns.count), system.rows))
        np.testing.assert_allclose(
            family.gram, np.einsum("rkp,rkq->kpq", shown, shown), atol=1e-6 * family.raw.max() ** 2
        )


def test_a_diagnosis_that_needs_more_memory_than_there_is_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    network = job(60)
    assert 0 < memory.at_hand() <= 4e9
    monkeypatch.setattr(memory, "at_hand", lambda: 1e9)
    monkeypatch.setattr(memory, "needed", lambda job: 3.5e9)
    with pytest.raises(InputError, match=r"needs about 3\.5 GB for 360 readings(.|\n)*one point or pose in 4"):
        diagnose.diagnose(network)
    with pytest.raises(InputError, match="needs about"):
        diagnose.what_can_be_seen(network)


def test_a_few_readings_are_diagnosed_however_little_memory_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "at_hand", lambda: 1e8)
    network = lengths.measurement(np.random.default_rng(1), 60).adjusted()
    assert memory.as_fits(network) is network


def only(m: lengths.Measurement, points: np.ndarray[tuple[int], np.dtype[np.intp]]) -> lengths.Measurement:
    """Return a measurement of some of its points."""
    kept = np.isin(m.point, points)
    own = {key: getattr(m, key)[kept] for key in ("tracer", "t", "temp", "length")}
    number = np.searchsorted(points, m.point[kept])
    return replace(m, points=m.points[points], nominal=m.nominal[points], point=number, **own)


@pytest.mark.slow
def test_of_a_network_that_is_too_large_a_part_of_the_points_is_diagnosed(monkeypatch: pytest.MonkeyPatch) -> None:
    m = lengths.measurement(np.random.default_rng(5), 700)
    m = replace(m, length=m.length + lengths.signature("dead-path-drift", 1, {"rate": 1e-6})(m))
    whole = m.adjusted()
    monkeypatch.setattr(memory, "at_hand", lambda: 1e9)
    monkeypatch.setattr(memory, "needed", lambda job: 2.1e9 if job is whole else 9e8)
    found = diagnose.diagnose(whole)
    part = found.job.part
    assert part is not None
    assert str(part) == "272 of 700 points"
    names = dict.fromkeys(found.job.model.readings[0].observations.keys["point"])
    alone = diagnose.diagnose(only(m, np.sort([int(name[1:]) for name in names])).adjusted())
    assert alone.job.part is None
    for one in (found, alone):
        assert [str(own.effect.alternative) for own in one.findings] == ["dead-path-drift T1"]
    (first,), (second,) = found.findings, alone.findings
    assert first.sizes[0].value == pytest.approx(second.sizes[0].value, rel=1e-3)
    # by parts left out, which are others where the points are numbered anew
    assert first.sizes[0].std == pytest.approx(second.sizes[0].std, rel=0.1)
    assert first.effect.log_level == pytest.approx(second.effect.log_level, rel=0.02)
    assert first.shift == pytest.approx(second.shift, rel=0.05)
    assert found.noise.ratio == pytest.approx(alone.noise.ratio, rel=1e-3)
    assert found.verdict == alone.verdict
    assert findings.of_diagnosis(found, None).startswith(f"verdict: {found.verdict} in 272 of 700 points\n")
    assert verdict.as_data(found)["part"] == {"kind": "point", "count": 272, "of": 700}
    assert verdict.as_data(alone)["part"] is None


def test_points_are_drawn_evenly_and_held_where_they_are_not_read() -> None:
    whole = job(500)
    part = memory.part_of(whole, 0.5)
    assert part is not None
    kept = np.flatnonzero(part.model.blocks["point"].free.all(axis=1))
    assert len(kept) == 250
    assert (np.diff(kept) <= 3).all()
    observations = part.model.readings[0].observations
    assert (np.unique(observations.index["point"]) == kept).all()
    assert observations.count == 6 * 250
    assert {one.values["lengths"].shape[-1] for one in part.covariates} == {1500}
    assert part.folds["lengths"].shape == (1500,)
    assert part.model.datum is not None
    assert (np.flatnonzero(part.model.datum.members) == kept).all()


def test_files_kept_in_memory_do_not_count_as_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """A container fills its memory with the files that it has read; these give way."""
    texts = {"max": "2000000000\n", "current": "1900000000\n", "stat": "anon 5\ninactive_file 1500000000\n"}
    monkeypatch.setattr(memory, "_text", lambda path: texts.get(path.rpartition(".")[2], ""))
    assert memory.at_hand() == 1.6e9


def test_memory_grows_with_the_readings() -> None:
    few, many = job(30), job(300)
    fixed = memory._FIXED
    assert memory.needed(many) - fixed == pytest.approx(10 * (memory.needed(few) - fixed), rel=0.01)


def test_more_wrong_readings_than_can_be_held_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    network = job(60, wrong=0.03)
    monkeypatch.setattr(moves, "MOST_NUMBERS", 2 * 360)
    with pytest.raises(InputError, match="more than 2 wrong readings(.|\n)*outliers: remove"):
        diagnose.diagnose(network)


def test_columns_that_give_way_to_others_are_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    m = measurement_of(job(60))
    number = next(i for i in range(len(m.knots)) if len(m.lengths(i)) > 1)
    parts = [m.correlated(number, length, -1) for length in m.lengths(number)[:2]]
    states = [State.of(m, random=[part], logs=[0.5]) for part in parts]
    monkeypatch.setattr(products, "MOST_OF_STATE", max(part.columns.size for part in parts))
    m = measurement_of(job(60))
    again = [State.of(m, random=[part], logs=[0.5]) for part in (*parts, *parts)]
    assert [state.score for state in again] == [state.score for state in (*states, *states)]
    assert len(m.columns) == 1


def test_errors_for_whose_columns_there_is_no_room_are_not_sought(monkeypatch: pytest.MonkeyPatch) -> None:
    m = measurement_of(job(60))
    number = next(i for i, knots in enumerate(m.knots) if knots.count == 6)
    t = m.correlated(number, 1 / 4, -1).columns
    rng = np.random.default_rng(3)
    m = replace(m, system=replace(m.system, residual=m.system.seen(9 * t @ rng.normal(size=t.shape[1]))), cache={})
    assert any(error.key[2] < 0 for error in variances.correlated_errors(State.of(m), set()))
    # room for an error of one tracer, not for one of each
    monkeypatch.setattr(variances, "MOST_OF_STATE", t.size // 6)
    errors = variances.correlated_errors(State.of(m), set())
    assert errors and all(error.key[2] >= 0 for error in errors if m.knots[error.key[0]].count > 1)
    monkeypatch.setattr(variances, "MOST_OF_STATE", 0)
    assert not variances.correlated_errors(State.of(m), set())
