"""Identified effects: sizes with their covariance, level of the test, and the rivals that explain the readings as well.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.evidence.parts import Fixed
from metrocli.diagnosis.evidence.prices import ALIKE, gain_of_columns
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.diagnosis.linear.distributions import log_family, log_tail
from metrocli.diagnosis.linear.projection import FLAT, VISIBLE
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.frozen import dataclass
from metrocli.words import in_a_row

_NOT_APART, _WIDE = 6.6, 0.3
"""Non-centrality below which two effects cannot be distinguished, and the least cosine for that"""
_SHOWS = 1.0
"""Least gain of an effect that explains as well as another"""
_BLIND = 1e-2
"""Smallest part of a parameter in an unseen direction that leaves the parameter undetermined"""

Alias = tuple[str, float, float]
"""Another value of a scanned parameter that fits alike: its name, the value, and the odds against the chosen one"""


@dataclass(frozen=True)
class Rival:
    """Another effect that would explain the readings as well."""

    alternative: Candidate
    correlation: float
    """Cosine between the fitted signature of the identified effect and the span of the rival's columns"""
    odds: float
    """Ratio of its evidence to that of the identified effect"""
    beside: tuple[Candidate, ...] = ()
    """Other effects without which it does not"""

    def __str__(self) -> str:
        together = f" with {in_a_row([*map(str, self.beside)])}" if self.beside else ""
        return f"{self.alternative}{together}"


@dataclass(frozen=True)
class IdentifiedEffect:
    """An effect that the readings require, with the rivals that explain them as well."""

    key: tuple[int, int]
    """Family and number among the candidates"""
    alternative: Candidate
    log_level: float
    """ln of the level of its test beside all else, counted over all tests"""
    values: Array
    """Estimated parameters (one-step, linear)"""
    covariance: Array
    """Covariance of the parameters with the estimated noise, or with what leaving out units shows"""
    estimable: Mask
    """Which parameters the readings determine together; the others are taken as 0"""
    apart: Mask
    """Which parameters have no part in an unseen direction; the others are not determined individually"""
    rivals: tuple[Rival, ...]
    forms: tuple[Rival, ...]
    """Other forms of the same cause that explain the readings as well: by temperature for by time"""
    shows: float
    """Norm of its visible part in the readings, in standard deviations of the declared noise"""
    aliases: tuple[Alias, ...] = ()
    second: float = -np.inf
    """Net evidence of the best other effect in its place, in that of its own"""

    @property
    def level_of_size(self) -> float:
        """Level at which its size differs from 0 beside its covariance (chi-square)."""
        from scipy.special import chdtrc

        covariance, q = self.covariance[np.ix_(self.estimable, self.estimable)], int(self.estimable.sum())
        # in standard deviations, since parameters have different units; one without a variance has no size either
        std = np.sqrt(np.where(np.diag(covariance) > 0, np.diag(covariance), 1.0))
        own, inverse = (
            self.values[self.estimable] / std,
            np.linalg.pinv(covariance / std / std[:, None], hermitian=True),
        )
        return float(chdtrc(q, own @ inverse @ own)) if q else 0.0

    @property
    def taken_as_zero(self) -> tuple[str, ...]:
        """The parameters taken as 0, because the readings do not determine them beside the others."""
        return tuple(name for name, free in zip(self.alternative.parameters, self.estimable, strict=True) if not free)

    @property
    def known(self) -> dict[str, float]:
        """The parameters that are not estimated: the scanned ones, and those taken as 0."""
        return {**dict(self.alternative.scanned), **dict.fromkeys(self.taken_as_zero, 0.0)}


def identified(state: State, part: Fixed, with_rivals: bool = True) -> IdentifiedEffect:
    """Return an effect of a state with its sizes beside all else."""
    m = state.measurement
    family = m.families[part.family]
    less = state.beside(part)
    gram, right = (values[part.number] for values in less.left(part.family))
    raw = family.raw[part.number]
    estimable, apart = determined(gram, raw)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))[estimable]
    inverse = np.linalg.pinv(gram[np.ix_(estimable, estimable)] / scale / scale[:, None], 1e-11, hermitian=True)
    covariance = np.zeros(gram.shape)
    covariance[np.ix_(estimable, estimable)] = inverse / scale / scale[:, None]
    values = covariance @ right
    # rounding can make what an effect explains larger than all there is
    share = np.array(min(float(values @ right) / less.fit.squares, 1.0))
    rank = int(estimable.sum())
    single = float(log_tail(share, rank, max(less.freedoms - rank, 1.0)))
    level = float(log_family(single, m.prices.tests[part.family]))
    others, second = _rivals(less, part, values, state.variance) if with_rivals else ((), -np.inf)
    own = m.alternative(part.key)
    return IdentifiedEffect(
        part.key,
        own,
        level,
        values,
        covariance * state.variance,
        estimable,
        apart,
        tuple(rival for rival in others if rival.alternative.spot != own.spot),
        tuple(rival for rival in others if rival.alternative.spot == own.spot),
        float(np.sqrt(max(values @ family.gram[part.number] @ values, 0.0))),
        part.aliases,
        second,
    )


def all_identified(state: State, with_rivals: bool = True) -> tuple[IdentifiedEffect, ...]:
    """Return the identified effects of a state, in their order."""
    return tuple(identified(state, part, with_rivals) for part in state.named)


def determined(gram: Array, raw: Array) -> tuple[Mask, Mask]:
    """Return which parameters (q,) can be estimated together, and which have no part in an unseen direction.

    While a direction of the parameters is unseen, the parameter with the largest part in it is removed. `raw` are the
    norms of the whole columns, `gram` are the products of what is left of them.
    """
    size = np.where(raw > 0, raw, 1.0)
    scaled = gram / size / size[:, None]
    estimable = np.ones(len(raw), dtype=bool)
    values, vectors = np.linalg.eigh(scaled)
    open_ones = values <= max(VISIBLE**2, FLAT * values[-1])
    apart = np.linalg.norm(vectors[:, open_ones], axis=1) < _BLIND
    while estimable.sum() > 1:
        values, vectors = np.linalg.eigh(scaled[np.ix_(estimable, estimable)])
        if values[0] > max(VISIBLE**2, FLAT * values[-1]):
            break
        # the parameter that moves most along the unseen direction is the one that
        # the readings show least beside the others
        estimable[np.flatnonzero(estimable)[int(np.argmax(np.abs(vectors[:, 0])))]] = False
    return estimable, np.asarray(apart)


def explains_as_well(log_odds: Array, cosines2: Array, shown: Array | float) -> Mask:
    """Return which rivals explain the readings as well as an identified effect, (k,).

    `log_odds` is ln of the ratio of the evidence of each to its own. `cosines2` are the squared cosines of what both
    explain. `shown` is what the effect takes off the squares, over the variance. A rival has nearly as much evidence,
    or the readings cannot separate the two.
    """
    return np.asarray((log_odds > -ALIKE) | ((cosines2 > _WIDE**2) & ((1 - cosines2) * shown < _NOT_APART)))


def _rivals(less: State, part: Fixed, values: Array, variance: float) -> tuple[tuple[Rival, ...], float]:
    """Return the best form of each other effect and place that explains as well as an effect, and its other forms.

    `less` is the state without it. A rival has nearly as much evidence, or the readings cannot tell the two apart. Last
    is the net evidence of the best other effect, in that of the effect.
    """
    m = less.measurement
    own, squares, dof = m.alternative(part.key), less.fit.squares, less.freedoms
    t, q = (quantity[part.number] for quantity in less.of_family(part.family))
    # evidence less prices, as in the score
    mine = float(gain_of_columns(t, q, squares, dof)) - m.prices.of_columns(part.family, max(int(q), 1))
    whole = m.families[part.family].columns.whole([part.number], m.system.rows)[:, 0] @ values
    visible = less.seen(whole)
    shown = max(float(whole @ visible), 1e-300)
    # an effect that the state has already is beside the identified one, and not in its place
    taken = {m.alternative(other.key).spot for other in less.named}
    best, second = dict[object, Rival](), -np.inf
    for number, family in enumerate(m.families):
        if family.unknown:
            continue
        gram, _ = less.left(number)
        explained, rank = less.of_family(number)
        gain = gain_of_columns(explained, rank, squares, dof)
        along = family.columns.products(visible[:, None])[:, :, 0]
        cosine2 = np.clip(quadratic(gram, along, family.raw)[0] / shown, 0.0, 1.0)
        odds = gain - m.prices.of_ranks(number, rank) - mine
        # a term of a lens bends: about its own solution it may explain more
        of_own = {at: ahead for (of, at), ahead in part.rivals if of == number and np.isfinite(odds[at])}
        for at, ahead in of_own.items():
            odds[at] = max(odds[at], ahead)
        elsewhere = (at for at in np.argsort(-odds).tolist() if family.alternatives[at].spot not in {*taken, own.spot})
        second = max(second, float(odds[next(elsewhere, [])].max(initial=-np.inf)))
        possible = (gain > _SHOWS) & np.isfinite(odds)
        as_well = np.flatnonzero(possible & explains_as_well(odds, cosine2, t / variance)).tolist()
        for at in sorted({*as_well, *of_own}):
            other = family.alternatives[at]
            if other.form == own.form or (other.spot != own.spot and other.spot in taken):
                # another value of the same form is an alias and no rival; it is found where the scan is refined
                continue
            key = other.form if other.spot == own.spot else other.spot
            # clipped, since exp of a large network's evidence overflows
            rival = Rival(other, float(np.sqrt(cosine2[at])), float(np.exp(np.clip(odds[at], -700, 700))))
            if key not in best or best[key].odds < rival.odds:
                best[key] = rival
    return tuple(sorted(best.values(), key=lambda rival: -rival.odds)), 1 + second / max(mine, 1e-300)
