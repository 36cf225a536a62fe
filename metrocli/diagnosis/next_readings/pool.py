"""What the readings know about the sizes of effects, and how much more they would know with any of the proposals.

Let J be the whitened derivatives of the readings by all unknowns, G the whitened columns of effects, r the residuals.
The readings have the information `G'MG` on the sizes of the effects, with `M = I - J (J'J)^- J'`, and the products
`G'Mr`. New readings with derivatives K and columns H add the information `E' (I + C)^-1 E`, with what the unknowns
cannot absorb of them, `E = H - K (J'J)^- J'G`, and `C = K (J'J)^- K'`: recursive least squares. All follow from one
linear system in which the proposals have a very small weight.

Method: docs/algorithms/next-readings.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.linear.projection import Linearised
from metrocli.diagnosis.linear.quadratics import roots
from metrocli.diagnosis.next_readings.proposals import Proposal, with_proposals
from metrocli.diagnosis.noise import VarianceGroup, weights_of
from metrocli.effects.extension import with_effect
from metrocli.frozen import dataclass

_WEIGHT = 1e-4
"""Factor on the whitened rows of proposals, and of wrong readings; their own part in the unknowns is its square"""


@dataclass(frozen=True)
class KnownErrors:
    """What is known of the readings so far."""

    noise: float = 1.0
    """The true noise relative to what is declared"""
    units: tuple[VarianceGroup, ...] = ()
    """Noisier units"""
    wrong: tuple[Mapping[str, str], ...] = ()
    """Keys of wrong readings, which count nothing"""

    @staticmethod
    def from_diagnosis(diagnosis: Diagnosis) -> KnownErrors:
        """Return what a diagnosis found out about the readings."""
        wrong = tuple(outlier.keys for outlier in diagnosis.outliers)
        return KnownErrors(diagnosis.noise.ratio, diagnosis.variance_groups, wrong)


@dataclass(frozen=True)
class Pool:
    """The information on the sizes of effects in the readings, and what proposals not made yet would add to it.

    All is in units of the noise. The effects have q columns together.
    """

    gram: Array
    """Information G'MG, (q, q)"""
    right: Array
    """Products G'Mr with the residuals of the readings so far, (q,)"""
    squares: float
    """Sum of squares of these residuals"""
    dof: int
    raw: Array
    """Norms of the whole columns G, (q,)"""
    left: Array
    """Part E of each proposed row that the unknowns cannot absorb, (rows, q)"""
    covariance: Array
    """Covariance C of the predictions of all proposed rows, (rows, rows)"""
    rows: tuple[Index, ...]
    """Rows of each proposal"""
    made: Array
    """Rows of the readings that were made, uncorrelated: these add made'made to the information, (m, q)"""

    def gains(self) -> Array:
        """Return what each proposal would add to the information, (proposals, q, q)."""
        q = len(self.gram)
        information = np.zeros((len(self.rows), q, q))
        for size in {len(rows) for rows in self.rows}:
            alike = [number for number, rows in enumerate(self.rows) if len(rows) == size]
            at = np.stack([self.rows[number] for number in alike])
            inner = np.eye(size) + self.covariance[at[:, :, None], at[:, None, :]]
            e = self.left[at]
            information[alike] = np.swapaxes(e, 1, 2) @ np.linalg.solve(inner, e)
        return information

    def with_proposal(self, number: int) -> Pool:
        """Return the pool after a proposal is carried out; it can be carried out once more."""
        rows = self.rows[number]
        lower = np.linalg.cholesky(np.eye(len(rows)) + self.covariance[np.ix_(rows, rows)])
        across = np.linalg.solve(lower, self.covariance[rows])
        own = np.linalg.solve(lower, self.left[rows])
        return replace(
            self,
            gram=self.gram + own.T @ own,
            dof=self.dof + len(rows),
            left=self.left - across.T @ own,
            covariance=self.covariance - across.T @ across,
            made=np.concatenate([self.made, own]),
        )

    def noncentrality(self, gram: Array, sizes: Array) -> Array:
        """Return `|M g|^2` of the first effect of sizes (n,) beside the columns of the others, (k,).

        `gram` are amounts of information, (k, q, q).
        """
        n = len(sizes)
        root = roots(gram[:, n:, n:], np.broadcast_to(self.raw[n:], (len(gram), len(self.raw) - n)))
        own, across = gram[:, :n, :n] @ sizes @ sizes, np.einsum("q,kqr,krv->kv", sizes, gram[:, :n, n:], root)
        return np.asarray(np.maximum(own - (across**2).sum(axis=1), 0.0))


def pool_of(
    job: AdjustedJob,
    proposed: Sequence[Proposal],
    effects: Sequence[Candidate],
    beside: Sequence[Candidate] = (),
    known: KnownErrors | None = None,
) -> Pool:
    """Return the pool of proposals for effects beside the unknowns of a job and the effects `beside`."""
    known = KnownErrors() if known is None else known
    whole = with_proposals(job.model, proposed)
    for candidate in beside:
        whole = with_effect(whole, candidate.effect, [candidate.instance], dict(candidate.scanned))
    old = {group.name: group.observations.count for group in job.model.groups}
    system = linearised(whole, _weights(job, proposed, known, old))
    rows, numbers = _rows_of(system, old, proposed)
    full = np.concatenate([effect.signature(system) for effect in effects], axis=1) / known.noise
    first = full.copy()
    first[rows] = 0.0
    shown, inside = system.split(first)
    left = (full[rows] - system.basis.combined(inside)[rows]) / _WEIGHT
    basis = system.basis.rows(rows) / _WEIGHT
    residual = system.residual / known.noise
    shown[rows], residual[rows] = 0.0, 0.0
    return Pool(
        shown.T @ shown,
        shown.T @ residual,
        float(residual @ residual),
        system.dof - len(rows),
        np.linalg.norm(first, axis=0),
        left,
        basis @ basis.T,
        numbers,
        np.zeros((0, full.shape[1])),
    )


def _weights(
    job: AdjustedJob, proposed: Sequence[Proposal], known: KnownErrors, old: Mapping[str, int]
) -> Mapping[str, Array]:
    """Return factors on the whitened readings of each group: of noisier units, of wrong readings, and of proposals."""
    whole = replace(job, model=with_proposals(job.model, proposed))
    weights = weights_of(whole, known.units)
    for group in whole.model.readings:
        keys, count = group.observations.keys, group.observations.count
        factor = weights[group.name]
        factor[old[group.name] :] *= _WEIGHT
        for wrong in known.wrong:
            names = {key: name for key, name in wrong.items() if key != "component"}
            # readings of another group, such as distances beside images, have other keys
            if names.keys() <= keys.keys():
                same = [np.asarray(keys[key]) == name for key, name in names.items()]
                factor[np.all(same, axis=0) & (np.arange(count) < old[group.name])] *= _WEIGHT
    return weights


def _rows_of(
    system: Linearised, old: Mapping[str, int], proposed: Sequence[Proposal]
) -> tuple[Index, tuple[Index, ...]]:
    """Return the rows of all proposals in the system, and for each proposal the numbers of its own among these."""
    place = dict(old)
    rows: list[Index] = []
    numbers: list[Index] = []
    count = 0
    for proposal in proposed:
        own = []
        for name, added in proposal.added.items():
            d, n = added.readings.shape
            own.append(system.first[name] + d * place[name] + np.arange(d * n))
            place[name] += n
        rows += own
        size = sum(map(len, own))
        numbers.append(np.arange(count, count + size))
        count += size
    return np.concatenate(rows), tuple(numbers)
