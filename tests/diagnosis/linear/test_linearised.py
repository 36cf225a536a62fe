"""The system with local unknowns removed member by member equals the dense one."""

from __future__ import annotations

import numpy as np
import pytest
from metrocli.diagnosis.cross_validation import held_out_errors
from metrocli.diagnosis.linear.fitted_columns import FittedParts, nothing_fitted
from metrocli.diagnosis.linear.without_rows import carried, without_rows

from benchmarks.hidden import lengths
from metrocli.adjust.schur.layout import without_elimination
from metrocli.diagnosis.extended_fit import score_tests_of_job
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.linear.projection import scatter
from metrocli.effects.model import Model
from metrocli.instruments import tracer


def models() -> list[Model]:
    """A free network of points and tracers, and the same with a calibrated distance between two points."""
    job = lengths.measurement(np.random.default_rng(41), 14).adjusted()
    return [job.model, list(job.offers(job.model))[-1][1]]


def dense(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """All derivatives of the whitened readings, (rows, unknowns), and the residuals."""
    layout = without_elimination(model.blocks)
    parts, residuals = [], []
    for group in model.groups:
        linear = group.linear(model.blocks, layout.wanted)
        d, n = linear.residual.shape
        full = np.zeros((n, d, layout.width))
        for touch in linear.touches:
            scatter(full, touch.jacobian, layout.columns[touch.block][touch.index])
        parts.append(full.reshape(n * d, -1))
        residuals.append(linear.residual.T.ravel())
    return np.concatenate(parts), np.concatenate(residuals)


@pytest.mark.parametrize("number", [0, 1], ids=["free network", "with a distance"])
def test_projection_and_changes_are_those_of_the_dense_system(number: int) -> None:
    model = models()[number]
    system, (jacobian, residual) = linearised(model), dense(model)
    u, s, _ = np.linalg.svd(jacobian / np.linalg.norm(jacobian, axis=0), full_matrices=False)
    taken = u[:, s > 1e-9]
    assert system.dof == len(jacobian) - taken.shape[1]
    values = np.random.default_rng(42).normal(size=(len(jacobian), 3))
    assert np.allclose(system.seen(values), values - taken @ (taken.T @ values), atol=1e-9)
    assert np.allclose(system.residual, residual - taken @ (taken.T @ residual), atol=1e-9)
    assert np.allclose(system.basis.squares(), (taken**2).sum(axis=1), atol=1e-9)
    # what is absorbed is reproduced by the change of the unknowns, whatever the frame
    assert np.allclose(jacobian @ system.absorbed(values), taken @ (taken.T @ values), atol=1e-6)
    some = np.array([0, 5, 17])
    assert np.allclose(system.basis.products(some, some), (taken @ taken.T)[np.ix_(some, some)], atol=1e-9)


@pytest.mark.parametrize("number", [0, 1], ids=["free network", "with a distance"])
def test_changes_keep_the_datum(number: int) -> None:
    """No common motion of the points: the sum of their changes, and of their moments, is zero."""
    system = linearised(models()[number])
    change = system.absorbed(np.random.default_rng(43).normal(size=system.rows))
    points = system.model.blocks[tracer.POINT].values
    moved = change[system.entries(tracer.POINT)]
    size = np.abs(moved).sum()
    assert np.abs(moved.sum(axis=0)).max() < 1e-7 * size
    assert np.abs(np.cross(points - points.mean(axis=0), moved).sum(axis=0)).max() < 1e-6 * size * np.ptp(points)


def test_own_change_is_the_part_of_the_whole_change() -> None:
    system = linearised(models()[1])
    rows = np.arange(0, 83, 3)
    whole = system.solver.change(system.basis.rows(rows).T)
    own = system.solver.own_change(system.basis, rows)
    places = system.solver.places[0][system.basis.member[rows]]
    for at, (member, numbers) in enumerate(zip(system.basis.member[rows], places, strict=True)):
        if member >= 0 and (numbers >= 0).all():
            assert np.allclose(own[at], whole[numbers, at], rtol=1e-8, atol=1e-10)


def test_rows_left_out_are_as_if_they_had_unknowns_of_their_own() -> None:
    m = lengths.measurement(np.random.default_rng(44), 14)
    tests, _ = score_tests_of_job(m.adjusted(), {}, np.random.default_rng(1))
    out = np.flatnonzero(np.isin(m.point, [2, 5, 11]))
    fewer, start = without_rows(tests, out)
    unit = np.zeros((tests.system.rows, len(out)))
    unit[out, np.arange(len(out))] = 1.0
    freed = nothing_fitted(tests.system).with_columns(tests.system.seen(unit))
    left = nothing_fitted(fewer.system)
    # the products that are known from the start are those of the columns
    for number in range(len(tests.families)):
        known, made = fewer.left(number, start), fewer.left(number, left)
        assert np.allclose(known.right, made.right, atol=1e-9 * tests.families[number].raw.max())
        assert np.allclose(known.gram, made.gram)
    assert np.allclose(left.residual, freed.residual, atol=1e-9)
    assert fewer.system.dof == round(freed.dof - 2)
    for number in range(len(tests.families)):
        one, other = fewer.score(number, left), tests.score(number, freed)
        assert np.allclose(one.gain, other.gain, rtol=1e-6, atol=1e-6)
    kept = np.ones(tests.system.rows, dtype=bool)
    kept[out] = False
    for family in fewer.families:
        columns = family.columns.at(kept).whole(range(family.columns.count), tests.system.rows)
        shown = fewer.system.seen(columns)
        assert np.allclose(family.gram, np.einsum("rkp,rkq->kpq", shown, shown), atol=1e-9 * family.raw.max() ** 2)
        assert not family.gram[~columns.any(axis=(0, 2))].any()


def test_members_of_the_whole_fit_have_the_same_products_in_the_rest() -> None:
    m = lengths.measurement(np.random.default_rng(46), 14)
    tests, _ = score_tests_of_job(m.adjusted(), {}, np.random.default_rng(1))
    names = {family.name: number for number, family in enumerate(tests.families)}
    keys = [(names["tracer-scale"], 1), (names["tracer-drift"], 2)]
    whole = FittedParts(nothing_fitted(tests.system))
    for key in keys:
        whole = whole.with_part(tests.visible(*key))
    out = np.flatnonzero(np.isin(m.point, [0, 3, 12]))
    fewer, start = without_rows(tests, out, carried(tests, whole, enumerate(keys)))
    fit = computed = FittedParts(start)
    for key in keys:
        fit = fit.with_part(fewer.visible(*key), fewer.remembered.products[key])
        full = fewer.families[key[0]].columns.whole([key[1]], tests.system.rows)[:, 0]
        computed = computed.with_part(fewer.system.seen(full))
    for number, family in enumerate(fewer.families):
        known = number, family.columns.count
        assert known in fit.products
        scale = family.raw.max()
        assert np.allclose(
            fit.along(known, family.columns) @ fit.amounts,
            computed.along(known, family.columns) @ computed.amounts,
            atol=1e-9 * scale * np.linalg.norm(tests.system.residual),
        )
        grams = [fewer.left(number, one.fitted).gram for one in (fit, computed)]
        assert np.allclose(*grams, atol=1e-11 * scale**2)


def test_held_out_points_are_predicted_as_by_all_their_rows() -> None:
    """The prediction of whole points uses their shared columns only; that of a dense system all of them."""
    m = lengths.measurement(np.random.default_rng(45), 14)
    tests, _ = score_tests_of_job(m.adjusted(), {}, np.random.default_rng(1))
    fitted, out = nothing_fitted(tests.system), np.flatnonzero(np.isin(m.point, [1, 7]))
    held = held_out_errors(tests, fitted, out)
    projector = np.eye(tests.system.rows) - tests.system.basis.rows(np.arange(tests.system.rows)) @ (
        tests.system.basis.rows(np.arange(tests.system.rows)).T
    )
    values, vectors = np.linalg.eigh(projector[np.ix_(out, out)])
    kept = values > 1e-6
    along = vectors[:, kept].T @ fitted.residual[out]
    errors = vectors[:, kept] @ (along / values[kept]) * tests.system.scale[out]
    assert np.allclose(held.errors, errors, rtol=1e-6, atol=1e-9)
    assert np.isclose(held.directions, kept.sum())
