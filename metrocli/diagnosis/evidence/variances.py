"""Quick scores of random parts that a state lacks: correlated errors, effects at all places, noise of variance groups.

A score is the likelihood of one more variance, the others held. The best few are then tried with all sizes estimated
anew. Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.evidence.measurement import LENGTHS, Measurement
from metrocli.diagnosis.evidence.parts import CORRELATED, LARGEST, SCATTER, Random
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.basis import thin, without_gathering
from metrocli.diagnosis.linear.projection import MOST_OF_STATE
from metrocli.diagnosis.noise import DECLARED_SIGMA
from metrocli.frozen import dataclass

_NOTICED = 1.0
"""Least score of a variance, in its standard deviations, at which its likelihood is computed"""
_GRID, _ROUNDS = 60, 3
_MOST_GIVEN = 600
"""Largest number of given values whose noise is computed exactly"""
FEWEST = 10
"""Fewest freedoms beside all sizes of an effect at all its places: of fewer it looks like larger noise"""


def gain_of_variance(
    eigenvalues: Array, squares: Array, rest: float, dof: float, most: float = np.inf
) -> tuple[float, float]:
    """Return the largest gain of the likelihood by one variance, and ln of that.

    `squares` are those of the residual along directions of some eigenvalues, `rest` all squares.
    """
    seen = eigenvalues > 1e-6 * max(float(eigenvalues.max(initial=0.0)), 1e-300)
    d, y2 = eigenvalues[seen], squares[seen]
    if not len(d):
        return 0.0, -30.0
    left = max(rest - float(y2.sum()), 1e-300)
    # from a variance that changes nothing (1e-4 of the noise) to one of a million times the noise
    grid = np.minimum(np.linspace(-9, 14, _GRID) - np.log(np.median(d)), most)
    best, at = np.zeros(0), 0
    for _ in range(_ROUNDS):
        grown = 1 + np.exp(grid)[:, None] * d
        # ties go to the first, so that a variance which changes nothing stays nothing
        best = -(dof * np.log((y2 / grown).sum(axis=1) + left) + np.log(grown).sum(axis=1)) / 2
        at = int(np.argmax(best))
        low, high = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
        # finer between the neighbours of the best: three rounds end at 1/16 of a step of the first grid
        kept, grid = float(grid[at]), np.linspace(low, high, 9)
    return float(best[at] + dof * np.log(rest) / 2), kept


@dataclass(frozen=True)
class Found:
    """A random part that may enter, with its quick net gain."""

    net: float
    kind: str
    key: tuple[int, int, int]
    log: float

    def part(self, m: Measurement) -> Random:
        """Return its columns."""
        return m.random(self.kind, self.key)


@dataclass(frozen=True)
class _Blocks:
    """Products of the functions of a covariate with each other and with the residual, beside a state."""

    gram: Array
    """Those of each unit, or of all units at once, (units, components*knots, components*knots)"""
    right: Array
    """(units, components*knots)"""

    def turned(self, turn: Array) -> tuple[Array, Array]:
        """Return them for a turn of the knots (knots, k)."""
        units, size, _ = self.gram.shape
        knots, k = turn.shape
        c = size // knots
        half = self.gram.reshape(units, size, c, knots) @ turn
        whole = turn.T @ half.reshape(units, c, knots, c * k)
        right = (self.right.reshape(units, c, knots) @ turn).reshape(units, c * k)
        return whole.reshape(units, c * k, c * k), right


def _blocks(state: State, number: int) -> _Blocks:
    """Return the products of the functions of a covariate beside a state, unit by unit."""
    m, own = state.measurement, state.measurement.knots[number]
    knots, count = len(own.distances), own.count
    if m.local[number]:
        return _Blocks(*_of_units(state, number))
    gram = state.gram(("functions", number), own.columns)
    along = np.asarray(own.columns.T @ state.residual)
    # from component, unit, knot to unit, component, knot
    each = own.components
    gram = gram.reshape(each, count, knots, each, count, knots).transpose(1, 0, 2, 4, 3, 5)
    size = each * knots
    right = along.reshape(each, count, knots).transpose(1, 0, 2).reshape(count, size)
    return _Blocks(gram.reshape(count * size, count * size)[None], right.reshape(1, -1))


def _of_units(state: State, number: int) -> tuple[Array, Array]:
    """Return the products of the functions of each unit, which has a local member, with each other and the residual."""
    m, own = state.measurement, state.measurement.knots[number]
    if ("compact", number) not in m.cache:
        m.cache["compact", number] = own.compact(np.eye(len(own.distances)))
    columns, size = m.cache["compact", number], m.cache["compact", number].shape[1]
    # what the unknowns leave is computed once, unless errors of members are taken with them
    cache, key = m.cache if state.members_are_free else {}, ("visible of units", number)
    others = [state.own.local, *([m.system.basis.shared] if state.members_are_free else [])] if key not in cache else []
    visible, taken = np.zeros((2, own.count, size, size))
    right = np.zeros((own.count, size))
    for every in m.rows_of_members:
        some = every[own.component[every] >= 0]
        if len(some):
            rows = without_gathering(some)
            c, unit = columns[rows], own.unit[some[0]]
            inside = state.entered[rows].T @ c
            taken[unit] += inside.T @ inside
            right[unit] += c.T @ state.residual[rows]
            if others:
                inside = np.concatenate([part[rows] for part in others], axis=1).T @ c
                visible[unit] += c.T @ c - inside.T @ inside
    if others:
        cache[key] = visible
    return cache[key] - taken, right


def correlated_errors(state: State, quiet: set[int], most: int = 3) -> list[Found]:
    """Return the correlated errors with the largest quick net gains, the best first.

    Covariates that show nothing are added to `quiet`, and those that are there are not looked at again. Errors whose
    columns would need too much memory beside those of the state are not among them: of many readings, short ones.
    """
    m, scale = state.measurement, state.fit.dof / state.fit.squares
    taken = [*(part.columns.shape[1] for part in state.random), *(part.rank for part in state.fixed)]
    room = MOST_OF_STATE // m.system.rows - sum(taken)
    present = {part.key for part in state.random if part.kind == CORRELATED}
    scored: list[tuple[float, tuple[int, int, int], Array, Array]] = []
    for number, own in enumerate(m.knots):
        if number in quiet:
            continue
        blocks, before = _blocks(state, number), len(scored)
        for length in m.lengths(number):
            at, turn = LENGTHS.index(length), m.kernel(number, length)
            of_a_unit, units = own.components * turn.shape[1], own.count
            if of_a_unit > room:
                continue
            gram, right = blocks.turned(turn)
            # score test of a variance at 0: what is found less what is expected,
            # over its standard deviation for white noise
            z = float((right**2).sum()) * scale - float(np.einsum("ukk->", gram))
            z /= np.sqrt(2 * float((gram**2).sum()) + 1e-300)
            if m.local[number] or of_a_unit * units <= room:
                scored.append((z, (number, at, -1), gram, right))
            if units > 1:
                scored += _singles(gram, right, scale, (number, at), units)
        if max((process[0] for process in scored[before:]), default=0.0) < _NOTICED:
            quiet.add(number)
    scored = [process for process in scored if process[0] > _NOTICED and process[1] not in present]
    several = sorted((process for process in scored if process[1][2] < 0), key=lambda process: -process[0])[: 2 * most]
    single = sorted((process for process in scored if process[1][2] >= 0), key=lambda process: -process[0])[:most]
    errors = []
    for _, key, gram, right in (*several, *single):
        d, vectors = np.linalg.eigh(gram)
        along = np.einsum("ukd,uk->ud", vectors, right) ** 2 / np.maximum(d, 1e-300)
        gain, log = gain_of_variance(d.ravel(), along.ravel(), state.fit.squares, state.fit.dof, LARGEST)
        errors.append(Found(gain - m.price_of_correlated(key[0], key[2]), CORRELATED, key, log))
    return sorted(errors, key=lambda process: -process.net)[:most]


def _singles(
    gram: Array, right: Array, scale: float, key: tuple[int, int], count: int
) -> Iterator[tuple[float, tuple[int, int, int], Array, Array]]:
    """Yield the unit whose own variance scores most, with its products."""
    if len(gram) == 1:
        size = gram.shape[1] // count
        every = np.arange(count)
        gram = gram[0].reshape(count, size, count, size)[every, :, every]
        right = right.reshape(count, size)
    z = (right**2).sum(axis=1) * scale - np.einsum("ukk->u", gram)
    z /= np.sqrt(2 * (gram**2).sum(axis=(1, 2)) + 1e-300)
    at = int(np.argmax(z))
    yield float(z[at]), (*key, at), gram[[at]], right[[at]]


def scattered_effects(state: State) -> list[Found]:
    """Return the effects at all their places with their quick net gains, the best first."""
    m = state.measurement
    present, effects = {part.key[0] for part in state.random if part.kind == SCATTER}, list[Found]()
    for number in range(len(m.scatters)):
        if number in present:
            continue
        if (SCATTER, number) not in m.cache:
            m.cache[SCATTER, number] = thin(m.scatter(number).columns)
        columns = m.cache[SCATTER, number]
        d, vectors = np.linalg.eigh(state.gram((SCATTER, number), columns))
        along = (vectors.T @ (columns.T @ state.residual)) ** 2 / np.maximum(d, 1e-300)
        kept = d > 1e-4 * max(float(d[-1]), 1e-300)
        if state.freedoms - 2 - kept.sum() >= FEWEST:
            gain, log = gain_of_variance(d[kept], along[kept], state.fit.squares, state.fit.dof)
            effects.append(Found(gain - m.price_of_scatter, SCATTER, (number, 0, -1), log))
    return sorted(effects, key=lambda effect: -effect.net)


def noisier_groups(state: State) -> list[tuple[float, int, float]]:
    """Return the variance groups with quick net gains of a variance of their own: net, number, ratio of deviations.

    Values that are given (priors) have few freedoms, which their weight changes: theirs is that of one more variance.
    """
    m, noisier = state.measurement, []
    if len(m.units) < 2:
        return []
    taken, r = state.absorbed, state.residual
    for number, (kind, _, rows) in enumerate(m.units):
        own = float(rows.sum()) - float(taken[rows].sum())
        # the noise of all that shows any is that of the job: exact readings beside it have none to compare it with
        if state.noise_freedoms - own < 1:
            continue
        # a group that has its own noise already costs nothing more
        price = 0.0 if number in m.noise else m.price_of_noise
        if kind == DECLARED_SIGMA and rows.sum() <= _MOST_GIVEN:
            gain, ratio = _noise_of_given(state, rows)
            if gain > price:
                noisier.append((gain - price, number, ratio))
                continue
        s = float(r[rows] @ r[rows])
        ratio, gain = state.own_noise(own, s)
        if gain:
            noisier.append((gain - price, number, ratio))
    return sorted(noisier, reverse=True)


def _noise_of_given(state: State, rows: Mask) -> tuple[float, float]:
    """Return the gain of larger noise of some rows, `V = I + g E E'`, and the ratio of their deviations."""
    at = np.flatnonzero(rows)
    d, vectors = np.linalg.eigh(state.of_rows(at[None])[0])
    along = (vectors.T @ state.residual[at]) ** 2 / np.maximum(d, 1e-300)
    gain, log = gain_of_variance(d, along, state.fit.squares, state.fit.dof)
    return gain, float(np.sqrt(1 + np.exp(log)))
