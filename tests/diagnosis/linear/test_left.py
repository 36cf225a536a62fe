"""What a fit leaves of the candidates, from the products of its parts, against dense algebra on all rows."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from benchmarks.hidden import lengths
from metrocli.diagnosis.extended_fit import score_tests_of_job
from metrocli.diagnosis.linear.fitted_columns import FittedColumns, FittedParts, nothing_fitted
from metrocli.diagnosis.linear.score_tests import ScoreTests


@cache
def network() -> ScoreTests:
    job = lengths.measurement(np.random.default_rng(21), 20).adjusted()
    return score_tests_of_job(job, {}, np.random.default_rng(3))[0]


def candidates() -> list[tuple[int, int]]:
    """Return effects and smooth functions of different places, and one that is nearly another."""
    tests = network()
    return [(number, family.columns.count // 2) for number, family in enumerate(tests.families)][::4]


def of(*numbers: int) -> FittedParts:
    tests, parts = network(), FittedParts(nothing_fitted(network().system))
    for number in numbers:
        parts = parts.with_part(tests.visible(*candidates()[number]))
        tests.scores(parts.fitted)
    return parts


def asked_late() -> FittedColumns:
    """Return a fit of which nothing was asked before two parts were added and one was taken out."""
    tests, start = network(), of(0)
    parts = start.with_part(tests.visible(*candidates()[1])).with_part(tests.visible(*candidates()[2]))
    return parts.only([0, 2]).with_part(tests.visible(*candidates()[3])).fitted


FITS: dict[str, Callable[[], FittedColumns]] = {
    "nothing": lambda: of().fitted,
    "several": lambda: of(0, 1, 2).fitted,
    "without one": lambda: of(0, 1, 2).without([1]),
    "only two": lambda: of(0, 1, 2).only([0, 2]).fitted,
    "a swap": lambda: of(0, 1, 2).only([1, 2]).with_part(network().visible(*candidates()[3])).fitted,
    "without one of a swap": lambda: of(0, 1).only([1]).with_part(network().visible(*candidates()[2])).without([0]),
    "asked late": asked_late,
    "beside": lambda: of(0, 1).without([0]).with_columns(network().of_reading(7)),
}


@pytest.mark.parametrize("name", FITS)
def test_what_is_left_is_that_of_all_rows(name: str) -> None:
    tests, fitted = network(), FITS[name]()
    system = tests.system
    basis, _ = np.linalg.qr(np.concatenate([fitted.basis, np.zeros((system.rows, 1))], axis=1))
    basis = basis[:, : fitted.basis.shape[1]]
    assert np.abs(fitted.basis.T @ fitted.basis - np.eye(basis.shape[1])).max(initial=0.0) < 1e-12
    residual = system.residual - basis @ (basis.T @ system.residual)
    assert np.abs(fitted.residual - residual).max() < 1e-10
    assert fitted.squares == pytest.approx(float(residual @ residual) + fitted.prior, rel=1e-10)
    for number, family in enumerate(tests.families):
        whole = system.seen(family.columns.whole(range(family.columns.count), system.rows))
        beside = whole - np.tensordot(basis, np.tensordot(basis.T, whole, 1), 1)
        gram, right = np.einsum("raq,rap->aqp", beside, beside), np.einsum("raq,r->aq", beside, residual)
        left = tests.left(number, fitted)
        scale = np.maximum(family.raw, 1e-300)
        assert np.abs((left.gram - gram) / scale[:, :, None] / scale[:, None, :]).max() < 1e-9
        assert np.abs((left.right - right) / scale).max() < 1e-8 * np.linalg.norm(residual)
        some = [family.columns.count - 1, 0]
        assert np.allclose(tests.left(number, fitted.alone(), some).right, left.right[some], atol=1e-8 * scale.max())


def test_readings_beside_a_fit_are_those_of_all_rows() -> None:
    tests = network()
    for fitted in (of(0, 1, 2).fitted, of(0, 1, 2).without([1])):
        gains, _ = tests.gains_of_readings(fitted)
        for reading in (0, 11, 60):
            column = fitted.beside(tests.of_reading(reading))[:, 0]
            assert gains[reading] == pytest.approx(
                float(column @ fitted.residual) ** 2 / float(column @ column), rel=1e-6
            )


def test_what_is_remembered_does_not_travel() -> None:
    import pickle

    tests = network()
    tests.visible(*candidates()[0])
    assert tests.remembered.visible
    assert not pickle.loads(pickle.dumps(tests.remembered)).visible
