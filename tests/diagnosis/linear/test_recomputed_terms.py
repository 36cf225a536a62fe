"""Smooth functions whose columns are not held give what their columns give."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.hidden import lengths
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.extended_fit import score_tests_of_job
from metrocli.diagnosis.linear import smooth_terms
from metrocli.diagnosis.linear.column_parts import Part
from metrocli.diagnosis.linear.smooth import recomputed_terms
from metrocli.diagnosis.linear.smooth.recomputed_terms import SmoothFunctions, Terms, polynomials


def terms(rng: np.random.Generator, angle: bool, gaps: bool) -> Terms:
    """Return functions of some of 60 readings of two components, from row 5 on."""
    functions = SmoothFunctions.of(rng.random((1 if angle else 3, 60)) * 4, 3, angle)
    chosen = np.flatnonzero(rng.random(60) < 0.7) if gaps else np.arange(7, 50)
    own = Terms.of(5, chosen, rng.random((60, 2, 2)), functions.between(chosen, 3))
    return own.turned(rng.random((1, own.parameters, own.parameters)))


@pytest.mark.parametrize("angle", [False, True])
@pytest.mark.parametrize("gaps", [False, True])
def test_products_and_grams_are_those_of_the_columns(angle: bool, gaps: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    monkeypatch.setattr(recomputed_terms, "_AT_ONCE", 11)
    own = terms(rng, angle, gaps)
    held = Part(own.rows, own.dense(), own.numbers)
    for several in (3, 0):
        visible = rng.normal(size=(140, several))
        np.testing.assert_allclose(own.products(visible), held.products(visible), atol=1e-9)
    np.testing.assert_allclose(own.norms(None), held.norms(None))
    there = rng.random(len(own.rows)) < 0.4
    cut = own.cut(there)
    np.testing.assert_array_equal(cut.rows, own.rows[there])
    np.testing.assert_allclose(cut.values, held.values[there])
    assert own.cut(np.zeros(len(own.rows), dtype=bool)).values.shape == (0, *held.values.shape[1:])
    unit = own.orthonormal(1e-9).dense()[:, 0]
    np.testing.assert_allclose(unit.T @ unit, np.eye(unit.shape[1]), atol=1e-9)
    np.testing.assert_allclose(unit @ (unit.T @ held.values[:, 0]), held.values[:, 0], atol=1e-8)


@pytest.mark.parametrize(("coordinates", "degree"), [(1, 6), (2, 4), (3, 3)])
def test_polynomials_have_no_mean_and_span_all_degrees(coordinates: int, degree: int) -> None:
    points, weights = np.polynomial.legendre.leggauss(9)
    grid = np.stack([one.ravel() for one in np.meshgrid(*[points] * coordinates)])
    each = np.prod(np.meshgrid(*[weights] * coordinates), axis=0).ravel()
    found = polynomials(grid, degree)
    assert np.abs(found @ each).max() < 1e-12
    assert np.linalg.matrix_rank(np.vstack([found, np.ones(len(each))])) == len(found) + 1
    power = grid[0] ** degree
    left = power - np.linalg.lstsq(np.vstack([found, np.ones(len(each))]).T, power, rcond=None)[0] @ np.vstack(
        [found, np.ones(len(each))]
    )
    assert np.abs(left).max() < 1e-10


def test_a_diagnosis_is_the_same_without_held_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    m = lengths.measurement(np.random.default_rng(9), 60)
    drift, _ = lengths.planted(m, np.random.default_rng(10), "tracer-drift", 4.0)
    held = diagnose(drift.adjusted())
    monkeypatch.setattr(smooth_terms, "_MANY", 0)
    tests, _ = score_tests_of_job(drift.adjusted(), {}, np.random.default_rng(1))
    smooth = [one for family in tests.families if family.unknown for one in family.columns.parts]
    assert smooth
    assert all(isinstance(one, Terms) for one in smooth)
    found = diagnose(drift.adjusted())
    assert [str(one.effect.alternative) for one in found.findings] == [
        str(one.effect.alternative) for one in held.findings
    ]
    assert found.findings
    assert found.after == pytest.approx(held.after, rel=1e-6)
    for one, other in zip(found.findings, held.findings, strict=True):
        assert one.effect.log_level == pytest.approx(other.effect.log_level, rel=1e-6)
        assert one.gain.log_score == pytest.approx(other.gain.log_score, rel=1e-6)
