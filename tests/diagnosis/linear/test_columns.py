"""Columns stored at the rows that they change give the products of dense projected ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from metrocli.diagnosis.linear import column_parts
from metrocli.diagnosis.linear.basis import Basis
from metrocli.diagnosis.linear.column_parts import Course, OwnColumns, StepColumns
from metrocli.diagnosis.linear.columns import CandidateColumns, gathered, joined

ROWS, MEMBERS = 60, 12


def basis(rng: np.random.Generator, repeats: bool) -> Basis:
    """Return an orthonormal basis of one local column a member, and three shared columns."""
    member = np.arange(ROWS) % MEMBERS if repeats else np.where(np.arange(ROWS) < MEMBERS, np.arange(ROWS), -1)
    local = rng.normal(size=(ROWS, 1)) * (member >= 0)[:, None]
    for one in range(MEMBERS):
        local[member == one] /= np.linalg.norm(local[member == one])
    whole = np.zeros((ROWS, MEMBERS))
    whole[np.arange(ROWS)[member >= 0], member[member >= 0]] = local[member >= 0, 0]
    shared = rng.normal(size=(ROWS, 3))
    shared -= whole @ (whole.T @ shared)
    return Basis(local, member, MEMBERS, np.linalg.qr(shared)[0])


def some(rng: np.random.Generator) -> tuple[CandidateColumns, np.ndarray]:
    """Return five alternatives of two parameters that change different rows, and the same as a dense array."""
    dense = np.zeros((ROWS, 5, 2))
    items = []
    for number, (first, last) in enumerate([(0, 20), (10, 20), (20, 55), (0, 60), (30, 31)]):
        rows = np.arange(first, last)
        dense[rows, number] = rng.normal(size=(len(rows), 2))
        items.append((number // 2, OwnColumns(rows, dense[rows, number])))
    return gathered(items), dense


def steps(rng: np.random.Generator) -> tuple[CandidateColumns, np.ndarray]:
    """Return five alternatives of two parameters: a course of all rows, one of some, and the same dense."""
    courses = [
        Course(rng.permutation(ROWS), rng.normal(size=(ROWS, 2))),
        Course(rng.permutation(np.arange(20, ROWS)), rng.normal(size=(40, 2))),
    ]
    several = [
        StepColumns(courses[0], 7),
        StepColumns(courses[1], 3),
        StepColumns(courses[0], 0),
        StepColumns(courses[1], 39),
        StepColumns(courses[0], 7),
    ]
    dense = np.zeros((ROWS, 5, 2))
    for number, one in enumerate(several):
        dense[one.rows, number] = one.values
    return gathered(("", one) for one in several), dense


@pytest.mark.parametrize("made", [some, steps], ids=["columns of their own", "steps"])
@pytest.mark.parametrize("small", [0, 100_000], ids=["stretch by stretch", "at once"])
@pytest.mark.parametrize("repeats", [True, False], ids=["members read five times", "members read once"])
def test_products_and_squares_are_those_of_the_projected_columns(
    repeats: bool,
    small: int,
    made: Callable[[np.random.Generator], tuple[CandidateColumns, np.ndarray]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(column_parts, "_SMALL", small)
    rng = np.random.default_rng(3)
    columns, dense = made(rng)
    own = basis(rng, repeats)
    b = own.rows(np.arange(ROWS))
    project = np.eye(ROWS) - b @ b.T
    shown = np.einsum("rs,skq->rkq", project, dense)
    seen = project @ rng.normal(size=(ROWS, 4))
    assert np.allclose(columns.products(seen), np.einsum("rkq,rm->kqm", shown, seen), atol=1e-12)
    assert np.allclose(columns.products(seen, [3, 0]), np.einsum("rkq,rm->kqm", shown[:, [3, 0]], seen), atol=1e-12)
    assert np.allclose(columns.grams(own), np.einsum("rkp,rkq->kpq", shown, shown), atol=1e-12)
    assert np.allclose(columns.whole([4, 1], ROWS), dense[:, [4, 1]])


@pytest.mark.parametrize("made", [some, steps], ids=["columns of their own", "steps"])
def test_rows_left_out_and_alternatives_added_are_those_of_the_dense_array(
    made: Callable[[np.random.Generator], tuple[CandidateColumns, np.ndarray]],
) -> None:
    rng = np.random.default_rng(4)
    columns, dense = made(rng)
    kept = rng.uniform(size=ROWS) < 0.5
    kept[30] = False
    cut = columns.at(kept).whole(range(5), ROWS)
    assert np.allclose(cut, np.where(kept[:, None, None], dense, 0.0))
    nothing = Basis(np.zeros((ROWS, 1)), np.full(ROWS, -1), 0, np.zeros((ROWS, 0)))
    assert np.allclose(columns.at(kept).grams(nothing), np.einsum("rkp,rkq->kpq", cut, cut))
    factor = rng.uniform(size=ROWS)
    left = columns.weighted(factor)
    assert np.allclose(left.whole(range(5), ROWS), factor[:, None, None] * dense)
    assert np.allclose(left.norms(), np.linalg.norm(factor[:, None, None] * dense, axis=0))
    more = rng.normal(size=(ROWS, 2))
    assert np.allclose(columns.followed_by(more).whole([5, 2], ROWS), np.stack([more, dense[:, 2]], axis=1))
    both = joined([columns, columns]).weighted(factor)
    assert np.allclose(both.whole([1, 6], ROWS)[:, 1], factor[:, None] * dense[:, 1])


def test_a_course_of_all_rows_is_in_the_order_of_time() -> None:
    """As many rows as a measurement has, and in another order: each product takes the values of its own row."""
    rng = np.random.default_rng(17)
    course = Course(rng.permutation(ROWS), rng.normal(size=(ROWS, 2)))
    columns = gathered((None, StepColumns(course, begin)) for begin in (0, 25))
    vectors = rng.normal(size=(ROWS, 3))
    expected = np.einsum("raq,rm->aqm", columns.whole([0, 1], ROWS), vectors)
    assert np.abs(columns.products(vectors) - expected).max() < 1e-12


def test_many_small_parts_give_the_products_of_each() -> None:
    """As one sparse matrix, with rows of a vector that lie behind the last of any part; and without vectors."""
    rng = np.random.default_rng(18)
    items = [
        (number, OwnColumns(np.sort(rng.choice(ROWS, 9, replace=False)), rng.normal(size=(9, 2))))
        for number in range(15)
    ]
    items[3] = (2, items[3][1])
    course = Course(rng.permutation(ROWS), rng.normal(size=(ROWS, 2)))
    columns = gathered([*items, (None, StepColumns(course, 4))])
    vectors = rng.normal(size=(ROWS + 5, 3))
    expected = np.einsum("raq,rm->aqm", columns.whole(range(columns.count), ROWS), vectors[:ROWS])
    assert np.abs(columns.products(vectors) - expected).max() < 1e-12
    assert columns.products(vectors[:, :0]).shape == (columns.count, 2, 0)
    kept = rng.random(ROWS) < 0.7
    there = np.where(np.append(kept, np.ones(5, dtype=bool))[:, None], vectors, 0.0)
    assert np.abs(columns.products(there) - columns.at(kept).products(there)).max() < 1e-12


def test_members_without_rows_are_not_taken_for_members_of_one_row() -> None:
    """As many rows as members, but one has two of them and another none."""
    rng = np.random.default_rng(8)
    local = rng.normal(size=(3, 1))
    local[:2] /= np.linalg.norm(local[:2])
    local[2] /= abs(local[2])
    own = Basis(local, np.array([0, 0, 1]), 3, np.zeros((3, 0)))
    values = rng.normal(size=(3, 4, 2))
    along = np.einsum("rb,rkq->kbq", own.rows(np.arange(3)), values)
    assert np.allclose(own.grams(values), np.swapaxes(along, 1, 2) @ along, atol=1e-12)
