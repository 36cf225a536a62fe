"""A named effect against each candidate, held against F tests of whole columns."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from benchmarks.hidden import lengths
from metrocli.diagnosis.extended_fit import score_tests_of_job
from metrocli.diagnosis.linear.fitted_columns import nothing_fitted
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.selection.rival_tests import Named, against


@pytest.fixture(scope="module")
def tests() -> ScoreTests:
    rng = np.random.default_rng(61)
    planted, _ = lengths.planted(lengths.measurement(rng, 14), rng, "tracer-drift", 4.0)
    return score_tests_of_job(planted.adjusted(), {}, rng)[0]


def squares(columns: np.ndarray, readings: np.ndarray) -> float:
    """The least sum of squares of readings fitted by columns of unit length."""
    unit = columns / np.linalg.norm(columns, axis=0)
    return float(((readings - unit @ np.linalg.lstsq(unit, readings, rcond=1e-9)[0]) ** 2).sum())


def test_cosines_and_levels_are_those_of_whole_columns(tests: ScoreTests) -> None:
    system, fitted = tests.system, nothing_fitted(tests.system)
    number = next(i for i, one in enumerate(tests.families) if one.name == "tracer-drift")
    own = tests.visible(number, 0)
    explained = own @ np.linalg.lstsq(own, system.residual, rcond=None)[0]
    compared = 0
    for at, family in enumerate(tests.families):
        if family.unknown:
            continue
        cosines, levels = against(tests, at, fitted, Named(own, tests.families[number].raw[0], explained))
        for one in range(0, family.columns.count, 3):
            rival = tests.visible(at, one)
            rival = rival[:, np.linalg.norm(rival, axis=0) > 1e-4 * family.raw[one]]
            both = np.concatenate([rival, own], axis=1)
            q = np.linalg.matrix_rank(both / np.linalg.norm(both, axis=0), tol=1e-3) - rival.shape[1]
            if not rival.shape[1] or q < own.shape[1]:
                continue
            inside = np.linalg.norm(explained) ** 2 - squares(rival, explained)
            assert cosines[one] == pytest.approx(np.sqrt(inside) / np.linalg.norm(explained), abs=1e-6)
            beside = squares(rival, system.residual) + fitted.prior
            left = squares(both, system.residual) + fitted.prior
            rest = fitted.dof - both.shape[1]
            expected = stats.f.logsf((beside - left) / q / (left / rest), q, rest)
            assert levels[one] == pytest.approx(expected, rel=1e-5, abs=1e-6)
            compared += 1
    assert compared > 20
