"""The decomposition of a matrix at which LAPACK's divide and conquer gives up."""

from __future__ import annotations

from typing import NoReturn

import numpy as np
import pytest

from metrocli.adjust.decompositions import thin_svd


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
