"""Least squares done plainly, to hold the engine against: one full Jacobian by differences, one dense inverse."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.optimize

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group

Array = npt.NDArray[np.float64]
Places = dict[str, Array]


def whitened(group: Group, blocks: Mapping[str, Block]) -> Array:
    """Residuals of a group in units of their standard deviations, readings one after the other."""
    observations = group.observations
    residual = (observations.readings - group.chain.predict(blocks, observations)).T
    if observations.covariance is None:
        residual = residual / observations.sigma.T
    else:
        roots = np.linalg.cholesky(np.moveaxis(observations.covariance, -1, 0))
        residual = np.linalg.solve(roots, residual[:, :, None])[:, :, 0]
    weights = np.ones(observations.count) if group.weights is None else group.weights
    return (residual * np.sqrt(weights)[:, None]).ravel()


def entries(blocks: Mapping[str, Block]) -> list[tuple[str, int, int]]:
    """Every free entry as (block, member, column)."""
    return [(block.name, int(i), int(j)) for block in blocks.values() for i, j in np.argwhere(block.free)]


def moved(blocks: Mapping[str, Block], places: Sequence[tuple[str, int, int]], step: Array) -> dict[str, Block]:
    """Blocks after a step of the named entries."""
    steps = {name: np.zeros(block.values.shape) for name, block in blocks.items()}
    for at in np.flatnonzero(step):
        name, i, j = places[at]
        steps[name][i, j] = step[at]
    return {name: block.moved(steps[name]) if steps[name].any() else block for name, block in blocks.items()}


def sizes(blocks: Mapping[str, Block], places: Sequence[tuple[str, int, int]]) -> Array:
    """A step for differences in each entry: small against what the model bends over, large against rounding."""
    return np.array(
        [
            5e-4 * (blocks[n].reach[j] if np.isfinite(blocks[n].reach[j]) else max(abs(blocks[n].values[i, j]), 1.0))
            for n, i, j in places
        ]
    )


def jacobian(
    blocks: Mapping[str, Block], groups: Sequence[Group], places: Sequence[tuple[str, int, int]], *, quick: bool = False
) -> Array:
    """Derivative of the whitened predictions by the entries, by four values each (two if quick)."""

    def residual(step: Array) -> Array:
        at = moved(blocks, places, step)
        return np.concatenate([whitened(group, at) for group in groups])

    columns = []
    for h in np.diag(sizes(blocks, places)):
        if quick:
            columns.append((residual(-h / 5) - residual(h / 5)) * 2.5 / h.sum())
            continue
        near, far = residual(h) - residual(-h), residual(2 * h) - residual(-2 * h)
        columns.append(-(8 * near - far) / (12 * h.sum()))
    return np.stack(columns, axis=1)


@dataclass(frozen=True)
class Dense:
    """A solution and its matrices."""

    blocks: dict[str, Block]
    places: list[tuple[str, int, int]]
    residual: Array
    jacobian: Array

    @property
    def noise(self) -> Array:
        """Covariance from the readings alone."""
        return inverse(self.jacobian.T @ self.jacobian)

    def covariance(self, blocks: Mapping[str, Block]) -> Array:
        """Covariance of all entries of all blocks in their order, zero where fixed."""
        return spread(self.noise, self.places, blocks)

    @property
    def redundancy(self) -> Array:
        """diag(I - J Q J')"""
        return 1 - np.einsum("ia,ab,ib->i", self.jacobian, self.noise, self.jacobian)


def inverse(matrix: Array) -> Array:
    """Inverse of a positive definite matrix, scaled first."""
    scale = 1 / np.sqrt(np.diag(matrix))
    return np.linalg.inv(matrix * scale[:, None] * scale) * scale[:, None] * scale


def spread(joint: Array, places: Sequence[tuple[str, int, int]], blocks: Mapping[str, Block]) -> Array:
    """A covariance of some entries put into that of all entries of all blocks."""
    starts, total = {}, 0
    for name, block in blocks.items():
        starts[name] = total
        total += block.values.size
    at = np.array([starts[n] + i * blocks[n].size + j for n, i, j in places], dtype=int)
    full = np.zeros((total, total))
    full[np.ix_(at, at)] = joint
    return full


def solve(
    blocks: Mapping[str, Block], groups: Sequence[Group], step: Callable[[Array, Array], Array] | None = None
) -> dict[str, Block]:
    """Full Gauss-Newton steps from the blocks' values, each by numpy's least squares."""
    at, places = dict(blocks), entries(blocks)
    matrix, length = np.zeros((0, 0)), np.inf
    for _ in range(60):
        if length > 1e-6:
            matrix = jacobian(at, groups, places, quick=True)
        residual = np.concatenate([whitened(group, at) for group in groups])
        scale = np.linalg.norm(matrix, axis=0)
        change = step(matrix, residual) if step else np.linalg.lstsq(matrix / scale, residual, rcond=None)[0] / scale
        at, length = moved(at, places, change), float(np.linalg.norm(matrix @ change))
        if length < 1e-7:
            return at
    raise AssertionError("the dense solution did not converge")


def at_solution(at: Mapping[str, Block], groups: Sequence[Group]) -> Dense:
    """Matrices at the blocks' values."""
    places = entries(at)
    residual = np.concatenate([whitened(group, at) for group in groups])
    matrix = jacobian(at, groups, places)
    return Dense(dict(at), places, residual, matrix)


def lowest(blocks: Mapping[str, Block], groups: Sequence[Group]) -> float:
    """Lowest sum of squares found by scipy's own method from the blocks' values."""
    places = entries(blocks)

    def residual(step: Array) -> Array:
        at = moved(blocks, places, step)
        return np.concatenate([whitened(group, at) for group in groups])

    found = scipy.optimize.least_squares(
        residual, np.zeros(len(places)), x_scale="jac", method="trf", xtol=1e-14, ftol=1e-14, gtol=None
    )
    return float(2 * found.cost)
