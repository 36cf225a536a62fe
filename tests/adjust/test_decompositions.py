"""The decomposition of a matrix at which LAPACK's divide and conquer gives up."""

from __future__ import annotations

from typing import NoReturn

import numpy as np
import pytest
import scipy.linalg

from metrocli.adjust.decompositions import pivoted_qr, thin_svd


def given_up(*_: object, **__: object) -> NoReturn:
    raise np.linalg.LinAlgError("SVD did not converge")


@pytest.mark.parametrize("shape", [(30, 12), (12, 30)])
def test_it_is_decomposed_otherwise(shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    matrix = np.random.default_rng(5).normal(size=shape)
    usual = thin_svd(matrix)
    monkeypatch.setattr(np.linalg, "svd", given_up)
    u, values, vt = thin_svd(matrix)
    assert (u.shape, vt.shape) == ((shape[0], 12), (12, shape[1]))
    assert (u * values) @ vt == pytest.approx(matrix, abs=1e-12)
    assert values == pytest.approx(usual[1], rel=1e-12)


def test_a_matrix_with_entries_that_are_no_numbers_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        thin_svd(np.full((3, 3), np.nan))


@pytest.mark.parametrize("shape", [(3, 7), (7, 3), (5, 5), (1, 4), (4, 1), (2, 60)])
def test_pivots_and_signs_are_those_of_lapack(shape: tuple[int, int]) -> None:
    matrix = np.random.default_rng(8).normal(size=shape)
    q, r, order = pivoted_qr(matrix)
    expected_q, expected_r, expected_order = scipy.linalg.qr(matrix, pivoting=True)
    assert (order == expected_order).all()
    assert q == pytest.approx(expected_q, abs=1e-13) and r == pytest.approx(expected_r, abs=1e-13)


def test_of_dependent_columns_the_diagonal_ends_with_zeros() -> None:
    rng = np.random.default_rng(9)
    matrix = rng.normal(size=(6, 2)) @ rng.normal(size=(2, 9))
    q, r, order = pivoted_qr(matrix)
    assert q @ r == pytest.approx(matrix[:, order], abs=1e-12)
    assert (np.abs(np.diag(r)) > 1e-12).sum() == 2
