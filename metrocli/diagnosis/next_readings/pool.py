"""How much of a signature the readings show, and how much more they would show with any of the proposals.

Let J be the whitened derivatives of the readings by all unknowns and g the whitened signature of an effect of a size.
Its non-centrality is `lambda = |M g|^2` with `M = I - J (J'J)^- J'`. New readings with derivatives K and signature h
add `e' (I + C)^-1 e`, with what the unknowns cannot absorb of them, `e = h - K (J'J)^- J'g`, and `C = K (J'J)^- K'`:
recursive least squares. Both follow from one linear system in which the proposals have a very small weight.

Method: docs/algorithms/next-readings.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.linear.candidates import Alternative
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.linear.projection import System
from metrocli.diagnosis.next_readings.proposals import Proposal, with_proposals
from metrocli.effects.extension import with_effect
from metrocli.effects.model import Model

_WEIGHT = 1e-4
"""Factor on the whitened rows of proposals; their own part in the unknowns is its square"""


@dataclass(frozen=True)
class Pool:
    """The non-centrality of a signature in the readings, and what proposals that are not made yet would add to it."""

    noncentrality: float
    left: Array
    """Part e of each proposed row that the unknowns cannot absorb, (rows,)"""
    covariance: Array
    """Covariance C of the predictions of all proposed rows, (rows, rows)"""
    rows: tuple[Index, ...]
    """Rows of each proposal"""
    dof: int

    def gains(self) -> Array:
        """Return what each proposal would add to the non-centrality, (proposals,)."""
        found = np.zeros(len(self.rows))
        for size in {len(rows) for rows in self.rows}:
            alike = [number for number, rows in enumerate(self.rows) if len(rows) == size]
            at = np.stack([self.rows[number] for number in alike])
            inner = np.eye(size) + self.covariance[at[:, :, None], at[:, None, :]]
            e = self.left[at]
            found[alike] = np.einsum("ka,ka->k", e, np.linalg.solve(inner, e[:, :, None])[:, :, 0])
        return found

    def made(self, number: int) -> Pool:
        """Return the pool after a proposal is carried out; it can be carried out once more."""
        rows = self.rows[number]
        inner = np.eye(len(rows)) + self.covariance[np.ix_(rows, rows)]
        across = np.linalg.solve(inner, self.covariance[rows])
        e = self.left[rows]
        return Pool(
            self.noncentrality + float(e @ np.linalg.solve(inner, e)),
            self.left - across.T @ e,
            self.covariance - self.covariance[:, rows] @ across,
            self.rows,
            self.dof + len(rows),
        )


Signature = Callable[[Model, System], Array]
"""Returns the whitened signature of an effect of its size in all rows of a system, (rows,)"""


def pool_of(
    model: Model, proposed: Sequence[Proposal], beside: Sequence[Alternative], signature: Signature, noise: float
) -> Pool:
    """Return the pool of proposals for a signature beside the unknowns of a model and the effects `beside`.

    `noise` is the true noise relative to what is declared.
    """
    whole = with_proposals(model, proposed)
    for one in beside:
        whole = with_effect(whole, one.effect, [one.instance], dict(one.scanned))
    old = {group.name: group.observations.count for group in model.groups}
    weights = {
        group.name: np.where(np.arange(group.observations.count) < old[group.name], 1.0, _WEIGHT)
        for group in whole.readings
    }
    system = linearised(whole, weights)
    rows, numbers = _rows_of(system, old, proposed)
    full = signature(whole, system) / noise
    first = full.copy()
    first[rows] = 0.0
    shown, inside = system.split(first)
    left = (full[rows] - system.basis.combined(inside)[rows]) / _WEIGHT
    basis = system.basis.rows(rows) / _WEIGHT
    shown[rows] = 0.0
    return Pool(float(shown @ shown), left, basis @ basis.T, numbers, system.dof - len(rows))


def _rows_of(system: System, old: dict[str, int], proposed: Sequence[Proposal]) -> tuple[Index, tuple[Index, ...]]:
    """Return the rows of all proposals in the system, and for each proposal the numbers of its own among these."""
    place = dict(old)
    rows: list[Index] = []
    numbers: list[Index] = []
    count = 0
    for one in proposed:
        own = []
        for name, added in one.added.items():
            d, n = added.readings.shape
            own.append(system.first[name] + d * place[name] + np.arange(d * n))
            place[name] += n
        rows += own
        size = sum(map(len, own))
        numbers.append(np.arange(count, count + size))
        count += size
    return np.concatenate(rows), tuple(numbers)
