"""Sparse Cholesky by fronts: the same as dense algebra, whatever the matrix and the places of its unknowns."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array

from metrocli.adjust.sparse.cholesky import factor
from metrocli.adjust.sparse.nested_dissection import dissect


def lattice(shape: tuple[int, ...], seed: int) -> tuple[csr_array, np.ndarray]:
    """A positive definite matrix that couples neighbours on a lattice, with one long link, and their places."""
    places = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1).reshape(-1, len(shape))
    rng = np.random.default_rng(seed)
    near = np.abs(places[:, None] - places).sum(axis=2) == 1
    near[0, -1] = near[-1, 0] = True
    strength = np.triu(near * rng.normal(size=near.shape), 1)
    matrix = strength + strength.T
    return csr_array(matrix + np.diag(np.abs(matrix).sum(axis=1) + rng.uniform(0.1, 1, len(matrix)))), places.astype(
        float
    )


@pytest.mark.alike
@pytest.mark.parametrize("shape", [(1, 1), (7, 3), (30, 30), (9, 9, 9), (900, 1), (1, 1, 400)])
def test_it_solves_and_inverts(shape: tuple[int, ...]) -> None:
    matrix, places = lattice(shape, 1)
    dense = matrix.toarray()
    cholesky = factor(matrix, dissect(matrix, places))
    right = np.random.default_rng(2).normal(size=(len(dense), 3))
    assert np.allclose(cholesky.solve(right), np.linalg.solve(dense, right), rtol=0, atol=1e-10)
    assert np.allclose(cholesky.solve(right[:, 0]), cholesky.solve(right)[:, 0])
    inverse = cholesky.inverse(matrix)
    wanted = np.where(dense != 0, np.linalg.inv(dense), 0.0)
    assert np.abs(inverse.toarray() - wanted).max() < 1e-12 * np.abs(wanted).max() * 100


def test_every_unknown_is_eliminated_once_and_after_its_children() -> None:
    matrix, places = lattice((12, 12, 4), 3)
    fronts = dissect(matrix, places)
    order = np.concatenate([front.pivots for front in fronts])
    assert sorted(order.tolist()) == list(range(matrix.shape[0]))
    turn = np.empty(len(order), dtype=int)
    for i, front in enumerate(fronts):
        turn[front.pivots] = i
    assert all((turn[front.border] > i).all() for i, front in enumerate(fronts))
    assert all(child < i for i, front in enumerate(fronts) for child in front.children)


def test_a_cut_takes_no_more_unknowns_than_its_couplings_need() -> None:
    """Twenty places in a row with 40 unknowns each, all coupled there; one of a place is with three of the next."""
    places = np.repeat(np.arange(20.0), 40)[:, None]
    dense = np.where(places == places.T, 0.01, 0.0)
    for place in range(19):
        dense[40 * place, 40 * place + 41 : 40 * place + 44] = 0.1
    dense = np.maximum(dense, dense.T) + np.eye(800)
    fronts = dissect(csr_array(dense), places)
    assert len(fronts) > 3
    assert len(fronts[-1].pivots) == 1
    assert max(len(front.border) for front in fronts) <= 2


@pytest.mark.alike
@pytest.mark.parametrize("seed", range(6))
def test_it_inverts_where_places_say_nothing_of_couplings(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(400, 1200))
    links = rng.integers(0, n, (2, n + n // 4))
    dense = np.zeros((n, n))
    dense[links[0], links[1]] = rng.normal(size=links.shape[1])
    dense = dense + dense.T
    dense += np.diag(np.abs(dense).sum(axis=1) + 1)
    matrix = csr_array(dense)
    cholesky = factor(matrix, dissect(matrix, rng.integers(0, 6, (n, 3)).astype(float)))
    wanted = np.where(dense != 0, np.linalg.inv(dense), 0.0)
    assert np.abs(cholesky.inverse(matrix).toarray() - wanted).max() < 1e-13
    right = rng.normal(size=(n, 5))
    assert np.allclose(cholesky.solve(right), np.linalg.solve(dense, right), rtol=0, atol=1e-12)
    half = cholesky.forward(right)
    assert np.allclose(half.T @ half, right.T @ np.linalg.solve(dense, right), rtol=0, atol=1e-10)


def test_many_small_pieces_share_fronts() -> None:
    rng = np.random.default_rng(7)
    roots = rng.normal(size=(500, 3, 3))
    pieces = roots @ roots.swapaxes(1, 2) + np.eye(3)
    at = np.arange(1500).reshape(500, 3)
    pairs = (np.broadcast_to(at[:, :, None], pieces.shape).ravel(), np.broadcast_to(at[:, None], pieces.shape).ravel())
    matrix = csr_array((pieces.ravel(), pairs))
    fronts = dissect(matrix, rng.integers(0, 9, (1500, 2)).astype(float))
    assert len(fronts) < 20
    assert np.allclose(factor(matrix, fronts).inverse(matrix).data, np.linalg.inv(pieces).reshape(-1, 9).ravel())


def test_parts_without_connection_and_shared_places() -> None:
    """Two matrices side by side, all unknowns of one at the same place: a front that cannot be cut."""
    first, places = lattice((20, 20), 4)
    rng = np.random.default_rng(5)
    root = rng.normal(size=(300, 300))
    second = root @ root.T + 300 * np.eye(300)
    matrix = csr_array(np.block([[first.toarray(), np.zeros((400, 300))], [np.zeros((300, 400)), second]]))
    both = np.concatenate([places, np.full((300, 2), 99.0)])
    cholesky = factor(matrix, dissect(matrix, both))
    right = rng.normal(size=700)
    assert np.allclose(matrix @ cholesky.solve(right), right, atol=1e-9)
    assert np.allclose(cholesky.inverse(matrix).toarray()[400:, 400:], np.linalg.inv(second), atol=1e-12)


@pytest.mark.alike
@pytest.mark.parametrize(("shape", "lone"), [((30, 20), 5), ((60, 20), 7), ((40, 25), 9)])
def test_a_part_without_connection_inside_a_side_of_a_cut(shape: tuple[int, int], lone: int) -> None:
    """Cut in the middle first: the lone rows of one side then touch nothing that is eliminated later."""
    matrix, places = lattice(shape, 7)
    apart = places[:, 0] < lone
    dense = matrix.toarray() * (apart[:, None] == apart)
    matrix = csr_array(dense)
    cholesky = factor(matrix, dissect(matrix, places))
    right = np.random.default_rng(8).normal(size=len(places))
    assert np.allclose(dense @ cholesky.solve(right), right, atol=1e-9)
    wanted = np.where(dense != 0, np.linalg.inv(dense), 0.0)
    assert np.abs(cholesky.inverse(matrix).toarray() - wanted).max() < 1e-10 * np.abs(wanted).max()


def test_an_indefinite_matrix_is_refused() -> None:
    matrix, places = lattice((30, 30), 6)
    spoilt = matrix.copy()
    spoilt.setdiag(matrix.diagonal() - 10.0)
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        factor(spoilt, dissect(spoilt, places))
