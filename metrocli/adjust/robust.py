"""Gross errors: a start that they do not spoil, and tests that reject single readings.

Method: docs/algorithms/robust-start.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.allowance import is_short
from metrocli.adjust.datum import Datum
from metrocli.adjust.medians import median, medians_of
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.probabilities import normal_bound, student_bound
from metrocli.adjust.solution import Residuals
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass

_MAD = 1.4826
"""Standard deviation of a normal sample divided by its median absolute deviation"""
# far above what chance gives in any sample (a normal one of a million reaches 5): a robust start costs steps that a
# sound job should not pay
_GROSS = 8.0
"""Residuals beyond this many robust standard deviations call for a robust start"""
_AS_OTHERS = 2.0
"""Residuals below so many robust standard deviations are of the size of the others: 3.5 sigma of image points"""
_WORSE = 2.0
"""A member fits far worse than others if its median residual is so many times the median of theirs"""
_TUKEY = 4.685
"""Tuning constant of Tukey's biweight: 95 % efficiency for normal errors"""
_POWER_80 = 0.8416212335729143
"""Normal quantile of a power of 80 %"""
_CONTROLLED = 1e-6
"""Redundancy below which a reading is uncontrolled"""
# exp(6 / 2) = 20: half of the difference of squared tests is that of the logarithms of the likelihoods
_ODDS = 6.0
"""Difference of two squared tests below which the odds are under e^3 = 20 to 1"""
SAME = 0.99
"""Correlation above which two tests are the same"""
_ROUNDS = 12
_NEAR = 0.1
"""A reweighted round but the last ends with a step below this, in standard deviations: the next weights change more"""
_RESERVE = 14
"""Steps that a try keeps for its adjustment"""
_ENOUGH = 8
"""A member with at least so many readings has a scale of its own"""


def robust_start(
    blocks: Iterable[Block],
    groups: Sequence[Group],
    names: Sequence[str],
    datum: Datum | None = None,
    within: str = "",
    always: bool = False,
) -> dict[str, Block]:
    """Return blocks near the solution, undisturbed by gross errors among the readings of some groups.

    A few steps are taken first, with weights 1/|v| if some readings are far off at the start. If residuals beyond 8
    robust standard deviations remain, the groups are reweighted in rounds: first with 1/|v| (least absolute
    deviations), then with Tukey's biweight. The scale of each round is the median of the residuals of a group. `within`
    names an index of the readings, such as the image, whose members have their own scale: an image still far off is
    not rejected as a whole. `always` reweights even if no residual remains beyond 8: several gross errors can spread
    over all residuals.
    """
    state: Mapping[str, Block] = {block.name: block for block in blocks}
    chosen = [group for group in groups if group.name in names]

    def shares() -> dict[str, Array]:
        return {group.name: _share(group, state, within) for group in chosen}

    start = {name: _least_absolute(share) if _is_gross(share) else None for name, share in shares().items()}
    held = _reweighted(groups, start)
    # few steps: the weights belong to the start, and are wrong as soon as the values have left it
    first = adjust(state.values(), held, datum, StoppingRule(limit=15, covariance=False))
    state = first.blocks
    # with one scale for all: a member that is lost as a whole hides behind its own
    if first.outcome is Outcome.NO_START or not (always or any(_is_gross(_share(group, state)) for group in chosen)):
        return dict(state)
    share = shares()
    for turn in range(_ROUNDS):
        if is_short(_RESERVE):
            break
        # least absolute deviations first: the biweight ignores what is far off, so it needs a start that is near
        weigh = _least_absolute if turn < _ROUNDS // 2 else _biweight
        spared = {name for name, sizes in share.items() if not (always or turn >= _ROUNDS // 2 or _is_gross(sizes))}
        held = _reweighted(groups, {name: None if name in spared else weigh(sizes) for name, sizes in share.items()})
        control = StoppingRule(limit=8, covariance=False)
        near = control if turn == _ROUNDS - 1 else replace(control, tolerance=_NEAR)
        state = adjust(state.values(), held, datum, near).blocks
        share = shares()
    return dict(state)


def _is_gross(share: Array) -> bool:
    """Return whether a reading is far off."""
    return bool(share.max(initial=0.0) > _GROSS)


def _least_absolute(share: Array) -> Array:
    """Return weights 1/|v|, at most 1."""
    return np.asarray(1 / np.maximum(share, 1.0))


def _biweight(share: Array) -> Array:
    """Return Tukey's biweight, 0 beyond the tuning constant."""
    return np.asarray(np.maximum(1 - (share / _TUKEY) ** 2, 0.0) ** 2)


def _reweighted(groups: Sequence[Group], weights: Mapping[str, Array | None]) -> list[Group]:
    # not 0: a member whose readings all have no weight would make the normal matrix singular
    kept = {name: None if factor is None else np.maximum(factor, 1e-12) for name, factor in weights.items()}
    return [replace(group, weights=kept[group.name]) if group.name in kept else group for group in groups]


def _share(group: Group, blocks: Mapping[str, Block], within: str = "") -> Array:
    """Return each residual's length in robust standard deviations: those of its member, if they are larger."""
    distance = _distances(group, blocks)
    # not 0: readings without noise, as simulated ones, have residuals of rounding only, and all of them would be gross
    scale = max(float(_MAD * median(distance)) if distance.size else 0.0, 1e-12)
    index = group.observations.index.get(within)
    if index is None:
        return np.asarray(distance / scale, dtype=float)
    # the larger of both: a member that fits better than the others must not make outliers of its ordinary readings
    return np.asarray(distance / np.maximum(scale, _member_scales(distance, index)[index]), dtype=float)


def _member_scales(distance: Array, index: Index) -> Array:
    """Return the robust standard deviation of each member with enough readings, 0 for the others."""
    counts = np.bincount(index)
    enough = counts >= _ENOUGH
    middle = np.cumsum(counts) - counts + counts // 2
    scales = np.zeros(len(counts))
    # sorted by member, then by length: the middle one of each member is its median
    scales[enough] = _MAD * distance[np.lexsort((distance, index))][middle[enough]]
    return scales


def gross(group: Group, blocks: Mapping[str, Block]) -> Array:
    """Return the length of each residual in robust standard deviations if it is above 8, else 0, (n,)."""
    share = _share(group, blocks)
    return np.where(share > _GROSS, share, 0.0)


def worst_member(group: Group, blocks: Mapping[str, Block], within: str) -> Array:
    """Return the lengths of the residuals of the member that fits far worse than others, 0 of these, (n,).

    The lengths are in robust standard deviations. A start with a scale of each member gives one that contradicts the
    others a full share of what both see, so it stands out by its median rather than by single residuals.
    """
    index, sizes = group.observations.index.get(within), _share(group, blocks)
    if index is None:
        return np.zeros_like(sizes)
    medians = np.nan_to_num(medians_of(sizes, index, int(index.max(initial=0)) + 1))
    worst = int(medians.argmax())
    return np.where((index == worst) & (medians[worst] > _WORSE * median(medians)), np.maximum(sizes, 1.0), 0.0)


def fitting(group: Group, blocks: Mapping[str, Block]) -> Mask:
    """Return whether each residual is of the size of the others, (n,)."""
    return _share(group, blocks) < _AS_OTHERS


def typical(group: Group, blocks: Mapping[str, Block]) -> float:
    """Return the median length of a group's residuals, in the unit of its readings."""
    residual = group.residuals(blocks)
    return float(median(np.nan_to_num(np.sqrt((residual**2).sum(axis=0)), nan=np.inf)))


def _distances(group: Group, blocks: Mapping[str, Block]) -> Array:
    residual = group.observations.whitened(group.residuals(blocks))
    # a reading that cannot be predicted is far off, not absent: else a start behind the camera would fit best
    distances: Array = np.nan_to_num(np.sqrt((residual**2).sum(axis=0)), nan=1e12, posinf=1e12)
    return distances


def critical_value(tests: int, level: float = 0.05) -> float:
    """Return the bound that the largest of `tests` normal |w| exceeds with probability `level` (Bonferroni)."""
    # half of the level, since |w| exceeds its bound on either side
    return normal_bound(level / (2 * max(tests, 1)))


def minimal_detectable(residuals: Residuals, critical: float, noise: float = 1.0) -> Array:
    """Return the error of each reading that is found with 80 % power, (d, n); inf if the reading is uncontrolled.

    It is `(critical + 0.84) noise sigma / sqrt(r)` for the test `|w| > critical noise` (Baarda 1968), r the redundancy.
    `noise` is that of the readings in units of the declared one, as the test takes it: residuals larger than declared
    raise its bound. The chance of an exceedance on the other side is below 1e-6 and left out.
    """
    controlled = residuals.redundancy > _CONTROLLED
    root = np.sqrt(np.where(controlled, residuals.redundancy, 1.0))
    return np.where(controlled, (critical + _POWER_80) * noise * residuals.sigma / root, np.inf)


def as_likely(squares: Array) -> Mask:
    """Return which readings are about as likely to be wrong as the one with the largest squared test, (n,).

    Without the reading in error, `v'Pv` falls by `w^2 sigma0^2`, and the likelihood of that error is `exp(w^2 / 2)`.
    The set contains the readings with odds above 1 to 20, and those whose tests correlate by more than 0.99 with the
    largest: an error of one shows in the others as `rho^2 w^2`.
    """
    most = float(squares.max(initial=0.0))
    # squared: `rho` relates the tests, `rho^2` their squares
    return np.asarray((squares > most - _ODDS) | (squares > SAME**2 * most))


@dataclass(frozen=True)
class Suspects:
    """Readings of a group whose residuals are too large to be due to chance."""

    rows: Index
    """Indices (k,) into the group"""
    tests: Array
    """Largest |w| of each, relative to the noise of the other readings, scaled so that `critical` is its bound (k,)"""
    critical: float


def apart(suspected: Suspects, residuals: Residuals, members: Index) -> Index:
    """Return which suspects (places among them) are wrong whatever the others are, and the worst of each member.

    An error that causes w_j changes another w_i by at most `sqrt(h_i h_j / (r_i r_j)) w_j` with leverage h = 1 - r
    (Cauchy-Schwarz on J Q J'). So a suspect whose test exceeds the bound by more than the sum over the other suspects
    of its member can be left out together with them. `members` (n,) is the member of each reading, such as its image.
    """
    member, tests = members[suspected.rows], suspected.tests
    # a reading that nothing else controls has no test, and would have an infinite lever
    redundancy = np.maximum(residuals.redundancy[:, suspected.rows], 1e-6)
    leverage, w = np.sqrt((1 - redundancy) / redundancy), np.abs(residuals.normalised[:, suspected.rows])
    # `tests` are scaled against the noise of the others, and the largest component carries that scale to all
    given = (leverage * w).sum(axis=0) * tests / np.maximum(w.max(axis=0, initial=0.0), 1e-300)
    # the sum over the member without the suspect itself
    taken = leverage.max(axis=0, initial=0.0) * (np.bincount(member, given)[member] - given if len(member) else given)
    # sorted by member, then by falling test: the first of each member is its worst
    order = np.lexsort((-tests, member))
    worst = order[np.flatnonzero(np.diff(member[order], prepend=-1))]
    return np.union1d(worst, np.flatnonzero(tests - taken > suspected.critical))


@dataclass(frozen=True)
class FitQuality:
    """How well an adjustment fits: the reference for the tests of single readings."""

    cost: float
    dof: int
    noise_known: bool
    """Whether the noise is declared, not estimated: then sigma0 counts as at least 1"""


def suspects(residuals: Residuals, fit: FitQuality) -> Suspects:
    """Return the readings whose largest |w| is too large to be due to chance, at 5 % over all readings.

    Each reading is compared with the noise of the others, `s_i^2 = (v'Pv - w_i'w_i) / (dof - d)` (external
    studentisation), so a gross error cannot hide in the sigma0 that it causes. With declared noise s_i is at least 1.
    """
    w = np.abs(residuals.normalised).max(axis=0)
    # taking a reading out frees one degree of freedom for each of its components
    rest = fit.dof - residuals.values.shape[0]
    bound = critical_value(residuals.values.size)
    if rest < 1:
        return Suspects(np.zeros(0, dtype=np.intp), np.zeros(0), bound)
    # rounding can make the part of one reading larger than the whole sum of squares
    own = np.minimum((residuals.normalised**2).sum(axis=0), fit.cost)
    others = np.sqrt((fit.cost - own) / rest)
    # a known noise stays the reference where the residuals happen to be smaller: else tests of good readings would grow
    unit = np.maximum(others, 1.0) if fit.noise_known else np.maximum(others, 1e-12)
    declared = fit.noise_known & (others <= 1.0)
    # compared with the noise of the others, w is Student's t: scaled so that `bound` is its bound as well
    largest = student_bound(rest, 0.05 / (2 * max(residuals.values.size, 1)))
    tests = w / unit * np.where(declared, 1.0, bound / largest)
    rows = np.flatnonzero(tests > bound)
    return Suspects(rows, tests[rows], bound)
