"""Cross-validation: how much better an effect predicts held-out readings, the selection repeated without them.

Leaving readings g out of a linear adjustment needs no new adjustment. The error of their prediction is
`e = M_gg^- r_g` with covariance `s^2 M_gg^-`, and the model of the others is the one in which the unit vectors of g
are fitted columns. Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index, Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob, Budget, Ordered
from metrocli.diagnosis.linear.basis import Basis
from metrocli.diagnosis.linear.fitted_columns import FittedColumns, nothing_fitted
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.linear.without_rows import Carried, carried, without_rows
from metrocli.diagnosis.selection.confidence_set import NamedEffect
from metrocli.diagnosis.selection.search import search
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.frozen import dataclass

_DETERMINED = 1e-6
"""Eigenvalue of M_gg below which a direction of the held-out readings is not predicted by the others"""


@dataclass(frozen=True)
class Gain:
    """Gain of an effect: how much better held-out readings are predicted with it."""

    before: float
    """Root mean square error of prediction, in the internal unit of the readings"""
    after: float
    median_before: float
    median_after: float
    log_score: float
    log_score_std: float
    folds: tuple[float, ...] = ()
    """Part of each held-out part of the readings in the log score"""

    @property
    def shown(self) -> bool:
        """Whether the gain exceeds twice its standard error."""
        return self.log_score > 2 * self.log_score_std

    @property
    def reduction(self) -> float:
        """Fraction by which the error decreases."""
        return 1 - self.after / self.before if self.before > 0 else 0.0


@dataclass(frozen=True)
class Held:
    """Prediction of one fold."""

    score: float
    errors: Array
    """Errors of prediction of the readings, in the unit in which they are reported"""
    directions: float
    """Number of independent errors that they amount to"""


def cross_validated(
    job: AdjustedJob, selection: Selection, names: Sequence[NamedEffect], limit: float, ordered: Ordered = map
) -> list[Gain]:
    """Return the gain of each named effect, then of all together; `ordered` computes the folds, within a limit [s].

    Each fold is predicted with what its own selection names of the effect, and without it. Smooth terms are in neither
    model, as the extended job has none. If the time of a fold is spent, that of the job is.
    """
    test_set = selection.test_set
    rows = folds_of(job, test_set)
    spared = np.zeros(test_set.system.rows, dtype=bool)
    for one in selection.outliers:
        spared[test_set.places[one.number][test_set.places[one.number] >= 0]] = True
    numbers = sorted({int(fold) for fold in rows[~spared]} - {-1})
    # each part has the same time for its search, so that all are treated alike
    seconds = limit / (rows.max() + 1)
    groups = (*([name] for name in names), *([names] if len(names) > 1 else ()))
    parts = enumerate((one.family, one.number) for one in selection.chosen)
    named = {(one.family, one.number) for one in selection.named}
    # where no unknown is local, a fold is made by further unknowns, not without its rows
    own = [(part, key) for part, key in parts if key in named] if test_set.system.basis.members else []
    members = carried(test_set, selection.fit, own)
    found = [*ordered(_Folds(test_set, rows, spared, groups, members, seconds), numbers)]
    job.budget.ended |= any(ended for _, ended in found)
    gains = [gain_of(pairs) for pairs in zip(*(pairs for pairs, _ in found), strict=True)]
    # one name alone is all of them together
    return gains if len(names) > 1 else [*gains, *gains]


@dataclass(frozen=True)
class _Folds:
    """What is compared in each fold. It travels to other processors, so it has no more than that."""

    test_set: ScoreTests
    rows: Index
    """Fold of each row"""
    spared: Mask
    """Rows that are not predicted, since their readings are wrong"""
    groups: Sequence[Sequence[NamedEffect]]
    members: Sequence[Carried]
    """The named effects"""
    seconds: float
    """Time for the search without a fold [s of CPU time]"""

    def __call__(self, fold: int) -> tuple[list[tuple[Held, Held]], bool]:
        """Return the predictions of a fold without and with each group, and whether its time was spent."""
        budget, out = Budget(self.seconds), self.rows == fold
        trained = _trained(self.test_set, np.flatnonzero(out), self.members, budget)
        start = fitted_without(self.test_set, np.flatnonzero(out & self.spared))
        held = np.flatnonzero(out & ~self.spared)
        return [_compared(self.test_set, start, trained, group, held) for group in self.groups], budget.ended


def gain_of_model(
    job: AdjustedJob, before: tuple[ScoreTests, FittedColumns], after: tuple[ScoreTests, FittedColumns]
) -> Gain:
    """Return the gain of a model with more unknowns: the same readings predicted fold by fold in both.

    Rows of the readings have the same numbers in both; what the second has more are priors after them.
    """
    rows = folds_of(job, before[0])
    folds = (np.flatnonzero(rows == fold) for fold in range(int(rows.max()) + 1))
    return gain_of([(held_out_errors(*before, out), held_out_errors(*after, out)) for out in folds if out.size])


def _trained(test_set: ScoreTests, out: Index, members: Sequence[Carried], budget: Budget) -> Selection:
    """Return the selection without some rows, within a time for its search."""
    fewer, start = without(test_set, out, members)
    return search(replace(fewer, budget=budget), start)


def without(test_set: ScoreTests, out: Index, members: Sequence[Carried] = ()) -> tuple[ScoreTests, FittedColumns]:
    """Return the tests without some rows, and the fit from which a selection without them starts.

    `members` are effects that it may need. Rows that hold only some readings of a local member are taken out by
    unknowns of their own.
    """
    if _by_members(test_set.system.basis, out):
        return without_rows(test_set, out, members)
    return test_set, fitted_without(test_set, out)


def _by_members(basis: Basis, out: Index) -> bool:
    """Return whether some rows hold all rows of their local members, and are more than the shared unknowns."""
    return basis.members > 0 and basis.shared.shape[1] < len(out) and basis.holds_whole_members(out)


def folds_of(job: AdjustedJob, test_set: ScoreTests) -> Index:
    """Return the number of the fold of each row, -1 for priors, (rows,)."""
    rows = np.full(test_set.system.rows, -1, dtype=np.intp)
    for group in job.model.readings:
        fold = test_set.system.spread(group, job.folds[group.name].astype(float) + 1)
        rows = np.where(fold > 0, fold.astype(np.intp) - 1, rows)
    return rows


def fitted_without(test_set: ScoreTests, out: Index) -> FittedColumns:
    unit = np.zeros((test_set.system.rows, len(out)))
    unit[out, np.arange(len(out))] = 1.0
    return nothing_fitted(test_set.system).with_columns(test_set.system.seen(unit))


def _compared(
    test_set: ScoreTests, start: FittedColumns, trained: Selection, names: Sequence[NamedEffect], out: Index
) -> tuple[Held, Held]:
    """Return the prediction of a fold without and with effects, as the selection without the fold has them.

    In `start` the outliers of the fold are unknowns of their own, so they count for neither.
    """
    spots = {spot for name in names for spot in _spots(name)}

    def is_it(one: Chosen) -> bool:
        return test_set.families[one.family].alternatives[one.number].spot in spots

    own = [one for one in trained.named if is_it(one)]
    others = [one for one in trained.chosen if one not in own and one not in trained.unknown]
    before = _with_all(test_set, start, others)
    after = _with_all(test_set, before, own)
    return held_out_errors(test_set, before, out), held_out_errors(test_set, after, out)


def _with_all(test_set: ScoreTests, fitted: FittedColumns, chosen: Sequence[Chosen]) -> FittedColumns:
    """Return a fit with the columns that chosen members have in the whole measurement."""
    columns = [
        test_set.of_reading(one.number) if one.outlier else test_set.visible(one.family, one.number) for one in chosen
    ]
    return fitted.with_columns(np.concatenate(columns, axis=1)) if columns else fitted


def held_out_errors(test_set: ScoreTests, fitted: FittedColumns, out: Index) -> Held:
    """Return the log density of the held-out readings (multivariate t) and their errors of prediction."""
    from scipy.special import gammaln

    spectrum = _spectrum(test_set, fitted, out)
    values, kept = spectrum.values, spectrum.values > _DETERMINED
    r = fitted.residual[out]
    along = spectrum.vectors.T @ r
    rest_of_r = r - spectrum.vectors @ along if spectrum.others else np.zeros(len(r))
    own = float((along[kept] ** 2 / values[kept]).sum() + rest_of_r @ rest_of_r)
    k = int(kept.sum()) + spectrum.others
    rest = max(fitted.dof - k, 1.0)
    variance = max(fitted.squares - own, 1e-300) / rest
    score = float(
        gammaln((rest + k) / 2)
        - gammaln(rest / 2)
        - k / 2 * np.log(np.pi * rest * variance)
        + np.log(values[kept]).sum() / 2
        - (rest + k) / 2 * np.log1p(own / (rest * variance))
    )
    alike = test_set.system.alike[out]
    whole = spectrum.vectors[:, kept] @ (along[kept] / values[kept]) + rest_of_r
    shown = spectrum.shares - (spectrum.vectors[:, ~kept] ** 2).sum(axis=1)
    return Held(score, whole[alike] * test_set.system.scale[out][alike], float(shown[alike].sum()))


@dataclass(frozen=True)
class _Spectrum:
    """Eigenvectors of M_gg for some readings g."""

    values: Array
    vectors: Array
    """(readings, eigenvalues)"""
    others: int
    """Number of further eigenvectors with the eigenvalue 1"""
    shares: Array
    """Diagonal of the projector on all these eigenvectors, (readings,)"""


def _spectrum(test_set: ScoreTests, fitted: FittedColumns, out: Index) -> _Spectrum:
    """Return the spectrum of M_gg = I - b_g b_g'.

    If g has all readings of the points (or images) that it uses, M_gg is `P - s s'`: P projects the points out, and
    the columns s of the shared unknowns lie in its range. Then only s has eigenvalues other than 0 and 1.
    """
    basis = test_set.system.basis
    if not _by_members(basis, out):
        taken = np.concatenate([basis.rows(out), fitted.basis[out]], axis=1)
        values, vectors = np.linalg.eigh(np.eye(len(out)) - taken @ taken.T)
        return _Spectrum(values, vectors, 0, np.ones(len(out)))
    shared = np.concatenate([basis.shared[out], fitted.basis[out]], axis=1)
    squares, turn = np.linalg.eigh(shared.T @ shared)
    seen = squares > _DETERMINED**2
    vectors = shared @ (turn[:, seen] / np.sqrt(squares[seen]))
    shares = 1 - (basis.local[out] ** 2).sum(axis=1)
    return _Spectrum(1 - squares[seen], vectors, round(float(shares.sum())) - int(seen.sum()), shares)


def gain_of(pairs: Sequence[tuple[Held, Held]]) -> Gain:
    """Return the gain from the predictions of all folds without and with what is judged."""
    differences = np.array([after.score - before.score for before, after in pairs])
    spread = float(differences.std(ddof=1)) if len(differences) > 1 else float("inf")
    sides = list(zip(*pairs, strict=True))
    rms = [
        float(np.sqrt(sum((h.errors**2).sum() for h in side) / max(sum(h.directions for h in side), 1e-9)))
        for side in sides
    ]
    medians = [float(np.median(np.abs(np.concatenate([held.errors for held in side])))) for side in sides]
    total = float(differences.sum())
    std = spread * float(np.sqrt(len(differences)))
    return Gain(rms[0], rms[1], medians[0], medians[1], total, std, tuple(differences.tolist()))


def _spots(name: NamedEffect) -> list[tuple[str, tuple[str, ...]]]:
    return [name.alternative.spot, *(rival.alternative.spot for rival in name.rivals)]
