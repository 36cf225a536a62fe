"""The system with local unknowns removed member by member equals the dense one."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.hidden import lengths
from benchmarks.hidden_effects import KINDS
from metrocli.adjust.schur.layout import without_elimination
from metrocli.diagnosis.evidence.functions import process_bases
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


def test_displacements_and_angles_of_one_reading_are_of_two_units() -> None:
    """A laser for six degrees of freedom: errors in um are those of displacements, not mixed with 1e-6 rad as mm."""
    job = KINDS["six-dof"].case(0, True).adjusted()
    (group,) = job.model.readings
    system = linearised(job.model)
    angle = np.tile([False] * 3 + [True] * 3, group.observations.count)
    assert job.reading == ("um", "length")
    assert (system.in_reported_unit[system.rows_of(group)] == ~angle).all() and not system.in_reported_unit[
        ~system.rows_of(group)
    ].any()
    functions = next(process_bases(job, system))
    scale = system.scale[system.rows_of(group)]
    expected = {"mm": np.median(scale[~angle]), "rad": np.median(scale[angle])}
    assert functions.sigmas == pytest.approx(expected)
