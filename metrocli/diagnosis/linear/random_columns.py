"""Columns whose sizes scatter about 0 with a known variance: they belong to the noise, and all tests hold beside them.

A covariance `I + Z Z'` of the readings is that of further unknowns c with columns Z and, for each of them, a further
row c = 0 of unit weight. So the measurement stays one linear system with white noise. Score tests, levels, folds and
least detectable sizes need nothing else. Method: docs/algorithms/selection-and-levels.md (smooth processes).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.linear.basis import Basis
from metrocli.diagnosis.linear.counted_tests import score_tests_of
from metrocli.diagnosis.linear.projection import System
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.linear.solver import Solver


def with_random_columns(system: System, columns: Array) -> System:
    """Return the system with further unknowns of columns (rows, k), each held at 0 with unit weight by a further row.

    The new columns are `[M Z; I]`, orthonormal after a turn by the eigenvectors of `Z'MZ + I`.
    """
    k = columns.shape[1]
    inside = system.basis.coordinates(columns)
    left = columns - system.basis.combined(inside)
    values, vectors = np.linalg.eigh(left.T @ left)
    turn = vectors / np.sqrt(np.maximum(values, 0.0) + 1)
    basis = _longer(system.basis, k).with_shared(np.concatenate([left @ turn, turn]))
    longer = np.concatenate([system.residual, np.zeros(k)])
    found = replace(
        system,
        basis=basis,
        solver=_with_absorbed(system.solver, system.solver.change(inside) @ turn),
        scale=np.concatenate([system.scale, np.ones(k)]),
        residual=longer,
    )
    return replace(found, residual=found.seen(longer))


def _longer(basis: Basis, k: int) -> Basis:
    """Return a basis with k further rows that no unknown of it changes."""
    return replace(
        basis,
        local=np.pad(basis.local, ((0, k), (0, 0))),
        member=np.concatenate([basis.member, np.full(k, -1, dtype=np.intp)]),
        shared=np.pad(basis.shared, ((0, k), (0, 0))),
    )


def _with_absorbed(solver: Solver, change: Array) -> Solver:
    """Return a solver that knows by how much the unknowns change with the new coordinates: by `-change`."""
    return replace(solver, random=np.concatenate([solver.random, -change], axis=1))


def beside_random_columns(test_set: ScoreTests, columns: Array, rng: np.random.Generator, apart: bool) -> ScoreTests:
    """Return score tests for readings with the covariance `I + Z Z'`, Z being columns (rows, k).

    `apart` tests each component of a reading on its own. The effective numbers of tests are those of white noise.
    """
    system = with_random_columns(test_set.system, columns)
    families, throughout = (
        [replace(one, gram=one.columns.grams(system.basis)) for one in every]
        for every in (test_set.families, test_set.throughout)
    )
    found = score_tests_of(system, families, rng, apart, test_set)
    return replace(found, adjusted=test_set.adjusted, budget=test_set.budget, throughout=tuple(throughout))
