"""What the points of a result share with each other, and what its estimates owe to inputs with a covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import sha256
from typing import Any

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.schur.covariance import Covariance
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.table import Table
from metrocli.tasks.shared.part import Part
from metrocli.uncertainty.comparison import OWED, SHARED
from metrocli.uncertainty.predicted import COMMON, CORE

_LARGEST = 4_000_000
"""Largest size of the factors, in numbers; results of larger networks do not hold them"""


def factors(covariance: Covariance, block: str, chosen: Mask) -> dict[str, Array]:
    """Return the factors C (points, 3, k) and K (k, k) of the chosen points; an empty mapping if they are too large.

    `block` is the name of the block of points. If the points are eliminated, their shared covariance is `W Q_r W'`; a
    datum on the points adds `-E S' - S E'`.
    """
    if covariance.layout.eliminated == block:
        points = covariance.eliminated
        core, gauge = covariance.reduced, points.gauge
        if gauge is not None:
            k = gauge.reduced.shape[1]
            # `-E S' - S E'` as a quadratic form of (E, S), whose core swaps the two
            exchange = -np.kron([[0.0, 1.0], [1.0, 0.0]], np.eye(k))
            core = np.block([[core, np.zeros((len(core), 2 * k))], [np.zeros((2 * k, len(core))), exchange]])
        if 3 * int(chosen.sum()) * len(core) > _LARGEST:
            return {}
        parts = [points.weights] + ([] if gauge is None else [gauge.moves, points.share])
        common: Array | None = np.concatenate([part[chosen] for part in parts], axis=2)
    else:
        size = 3 * int(chosen.sum())
        core = covariance.of(block)[np.ix_(*[np.repeat(chosen, 3)] * 2)] if size**2 <= _LARGEST else np.zeros((0, 0))
        common = np.eye(size).reshape(-1, 3, size) if size**2 <= _LARGEST else None
    return {} if common is None else {COMMON: common, CORE: covariance.factor * core}


def factors_less(found: Mapping[str, Array], at: Array, by: Array, own: Array) -> dict[str, Array]:
    """Return the factors of points from some of which errors are taken off; of an empty mapping an empty one.

    `at` (3 points, k) selects the coordinates that the errors shift, `by` is the covariance of all coordinates with the
    errors, and `own` (k, k) that of the errors: `-by at' - at by' + at own at'` is added.
    """
    if not found:
        return {}
    common, core = found[COMMON], found[CORE]
    k, size = len(own), len(core)
    more = np.zeros((size + 2 * k, size + 2 * k))
    more[:size, :size] = core
    more[size:, size:] = np.block([[np.zeros((k, k)), -np.eye(k)], [-np.eye(k), own]])
    parts = [common, *(each.reshape(-1, 3, k) for each in (by, at))]
    return {COMMON: np.concatenate(parts, axis=2), CORE: more}


@dataclass(frozen=True)
class JointInput:
    """An input whose errors are unknowns `z = K e` of a block, e ~ N(0, I): e is the same for all that use it."""

    block: str
    turn: Array
    """K (unknowns, errors), with `K K' = I`"""
    digest: str
    """Of its values and their covariance"""


def owed(
    solution: Solution,
    delivered: Sequence[str],
    change: Array,
    inputs: Mapping[str, Group],
    sources: Mapping[str, JointInput] | None,
) -> tuple[dict[str, Table], dict[str, Array]]:
    """Return the table of the inputs and, for each, the factor F of what it adds to the covariance of the estimates.

    `inputs` are correlated observations of parameters, by the name of their input. With the covariance Q of all
    unknowns, the derivatives J of such an observation and its covariance K = L L', `F = Q J' L^-T` and it adds `F F'`.
    So the estimates of two results share `F_1 F_2'`. `change` turns the delivered entries into the estimates (m, m).
    For an input whose errors are unknowns, `F = Q_dz K`.
    """
    known = solution.covariance_or_raise()
    names, digests, factors = [], [], {}
    free = [np.flatnonzero(solution.blocks[name].free.ravel()) for name in delivered]
    for name, group in inputs.items():
        factor = np.zeros((sum(map(len, free)), group.observations.readings.shape[0]))
        for touch in group.linear(solution.blocks, frozenset(solution.blocks)).touches:
            size = touch.jacobian.shape[1]
            columns = int(np.ravel(touch.index)[0]) * size + np.arange(size)
            rows = [
                known.between(block, touch.block)[np.ix_(at, columns)]
                for block, at in zip(delivered, free, strict=True)
            ]
            factor += np.concatenate(rows) @ touch.jacobian[:, :, 0].T
        scale = np.concatenate([solution.by_step(block).ravel()[at] for block, at in zip(delivered, free, strict=True)])
        # `between` has the factor sigma0^2, which F F' is to have once
        factors[OWED + name] = change @ (factor * scale[:, None]) / np.sqrt(known.factor)
        names.append(name)
        digests.append(_digest(group))
    for name, source in (sources or {}).items():
        parts = [known.between(block, source.block)[at] for block, at in zip(delivered, free, strict=True)]
        scale = np.concatenate([solution.by_step(block).ravel()[at] for block, at in zip(delivered, free, strict=True)])
        moved = np.concatenate(parts) * scale[:, None] @ source.turn
        factors[OWED + name] = change @ moved / np.sqrt(known.factor)
        names.append(name)
        digests.append(source.digest)
    table = Table.of({"input [text]": names, "digest [text]": digests})
    return ({SHARED: table}, factors) if names else ({}, {})


def _digest(group: Group) -> str:
    """Return a digest of what is observed, by its values and their covariance: equal for the same input alone."""
    parts: list[Any] = [part for link in group.chain.links for part in getattr(link, "parts", (link,))]
    observed = [*(part.reference for part in parts), group.observations.covariance]
    return sha256(b"".join(np.ascontiguousarray(values).tobytes() for values in observed)).hexdigest()


@dataclass(frozen=True)
class JointCovariance:
    """Covariance of corrected points: `C_a K C_b'`, plus P for points of one replay, plus `o_a I` for each point.

    K is the covariance of what all points share, such as the tracers, the datum and the tips; C are the derivatives by
    it. A replay is the reflector's stop at the place of a probed point: points that were probed there share its error.
    """

    common: Array
    """C, (n, 3, k)"""
    core: Array
    """K, (k, k)"""
    replay: Index
    """Row of the replay of each point (n,)"""
    of_replay: Array
    """P of each replay, (replays, 3, 3)"""
    own_variance: Array
    """o, variance of each coordinate of each point (n,)"""

    def of_points(self) -> Array:
        """Return the covariance of each point, (n, 3, 3)."""
        shared = self.common @ self.core @ np.swapaxes(self.common, 1, 2)
        return np.asarray(shared + self.of_replay[self.replay] + self.own_variance[:, None, None] * np.eye(3))

    def at_reference(self, part: Part, points: Array) -> JointCovariance:
        """Return the covariance of the points (n, 3) of a part at 20 degC; they share the error of its growth."""
        common, core = part.of_factors(points, self.common, self.core)
        shrunk = part.shrinkage**2
        return JointCovariance(common, core, self.replay, self.of_replay * shrunk, self.own_variance * shrunk)

    def propagated(self, derivative: Any) -> Array:
        """Return `D Q D'` for a sparse derivative D (m, 3n) by the coordinates of all points; Q is never formed."""
        from scipy.sparse import block_diag, csr_array

        by_shared = derivative @ self.common.reshape(3 * len(self.replay), -1)
        # 1 from each coordinate of a point to that of its replay: D times this sums over the points of each replay
        at_replay = (3 * self.replay[:, None] + np.arange(3)).ravel()
        entries = np.ones(len(at_replay)), (np.arange(len(at_replay)), at_replay)
        by_replay = derivative @ csr_array(entries, shape=(len(at_replay), 3 * len(self.of_replay)))
        replays = block_diag(list(self.of_replay), format="csr")
        weighted = derivative.multiply(np.repeat(self.own_variance, 3)[None, :])
        independent = by_replay @ replays @ by_replay.T + weighted @ derivative.T
        return np.asarray(by_shared @ self.core @ by_shared.T + independent.toarray())
