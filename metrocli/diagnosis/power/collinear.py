"""Candidates whose visible signatures are collinear, and what to measure to distinguish two of them.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.basis import thin_together
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.linear.projection import Linearised
from metrocli.diagnosis.power.average_power import DetectableCandidate, size_separated
from metrocli.frozen import dataclass

_COLLINEAR = 0.9
"""Correlation above which two candidates are reported as collinear"""
_SAME = 0.999
"""Correlation above which two candidates cannot be distinguished at all"""
_DEPENDENT = 1e-8
"""Eigenvalue of the Gram matrix of unit columns below which a direction depends on the others"""
_OFFERED = 2
"""Largest number of further measurements that are reported"""
_HELPS = 0.98
"""Correlation above which a further measurement does not help enough to be reported"""
_SEPARATED = 0.95
"""Probability with which the right one of two names is chosen, over all directions of its parameters"""


@dataclass(frozen=True)
class Pair:
    """Two candidates with similar signatures."""

    one: str
    other: str
    correlation: float
    separable: float
    """Size of the first from which it is distinguished from the other in 95 of 100 cases"""
    unit: str
    dimension: str

    @property
    def alias(self) -> bool:
        """Whether no measurement of this design can distinguish them."""
        return self.correlation > _SAME


def pairs_of(state: State, candidates: Sequence[DetectableCandidate], noise: float) -> Iterable[Pair]:
    """Yield the pairs of testable candidates of different causes or places that correlate by more than 0.9."""
    testable = [candidate for candidate in candidates if candidate.testable]
    ends = np.cumsum([0, *(state.measurement.families[candidate.family].columns.parameters for candidate in testable)])
    own = [slice(int(first), int(last)) for first, last in itertools.pairwise(ends)]
    gram = _visible_products(state, testable)
    turns = [_unit(gram[its, its]) for its in own]
    for i, other in enumerate(testable):
        for j in range(i):
            confounded = turns[j].T @ gram[own[j], own[i]]
            product = confounded @ turns[i]
            # the largest singular value cannot exceed the root of the sum of squares, so most pairs need no SVD
            apart = other.alternative.spot != testable[j].alternative.spot and (product**2).sum() > _COLLINEAR**2
            rho = float(np.linalg.norm(product, 2)) if apart else 0.0
            if rho > _COLLINEAR:
                size = noise * size_separated(gram[own[i], own[i]], confounded, _SEPARATED)
                yield Pair(other.name, testable[j].name, min(rho, 1.0), size, other.unit, other.dimension)


def _visible_products(state: State, candidates: Sequence[DetectableCandidate]) -> Array:
    """Return the products of the visible columns of candidates, each at its own place."""
    m = state.measurement
    keys = tuple((candidate.family, candidate.number) for candidate in candidates)
    gram = state.gram(("candidates", keys), thin_together((m.whole(*key) for key in keys), m.system.rows))
    # a column that is not visible is a rounding error where it is not projected
    gram[np.diag(gram) == 0] = 0.0
    return gram


def _unit(gram: Array) -> Array:
    """Return the turn (q, k) that makes columns of a Gram matrix (q, q) orthonormal, without those that depend."""
    norms = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(norms, norms))
    kept = values > _DEPENDENT
    return np.asarray(vectors[:, kept] / np.sqrt(values[kept]) / norms[:, None])


def separations(job: AdjustedJob, pairs: Sequence[tuple[Candidate, Candidate]]) -> tuple[str, ...]:
    """Return, in words, what to measure to distinguish the effects of each pair.

    These are the first offers that bring their cosine below 0.9, or else the offer with the lowest cosine; if the job
    has no offers, the advice of the effects themselves.
    """
    advice: list[list[tuple[float, str]]] = [[] for _ in pairs]
    for words, model in job.offers(job.model) if pairs else ():
        # an offer takes a linearisation: pairs with enough advice take no part, and without any the rest is left out
        unsettled = [at for at, its in enumerate(advice) if sum(rho < _COLLINEAR for rho, _ in its) < _OFFERED]
        if not unsettled:
            break
        system = linearised(model)
        for at in unsettled:
            advice[at].append((_cosine(system, *pairs[at]), words))
    return tuple(dict.fromkeys(words for its, pair in zip(advice, pairs, strict=True) for words in _advice(its, pair)))


def _cosine(system: Linearised, candidate: Candidate, other: Candidate) -> float:
    """Return the largest cosine between the visible columns of two candidates."""
    columns = [system.seen(each.signature(system)) for each in (candidate, other)]
    turns = [_unit(its.T @ its) for its in columns]
    return float(np.linalg.norm(turns[0].T @ (columns[0].T @ columns[1]) @ turns[1], 2))


def _advice(rows: Sequence[tuple[float, str]], pair: tuple[Candidate, Candidate]) -> list[str]:
    """Return the offers that help to distinguish a pair, of those with the cosine that each leaves."""
    enough = [f"{words} (their correlation falls to {rho:.2f})" for rho, words in rows if rho < _COLLINEAR]
    if enough:
        return enough
    helping = [
        f"{words} (their correlation falls to {rho:.2f} only)" for rho, words in sorted(rows)[:1] if rho < _HELPS
    ]
    return helping + [words for words in dict.fromkeys(candidate.effect.reveal for candidate in pair) if words]
