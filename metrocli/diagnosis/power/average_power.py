"""The sizes at which an effect is found, and is distinguished from another, on average over its directions and forms.

Also the standard deviation at which a scatter of sizes at all places is found. Method:
docs/algorithms/evidence.md (what can be detected).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.evidence.variances import scattered_effects
from metrocli.diagnosis.hidden_change import UndetectedBias, hidden_by_scatter
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.diagnosis.linear.distributions import noncentrality, power
from metrocli.effects.effect import Effect
from metrocli.frozen import dataclass

_DIRECTIONS = 1000
_NODES = 80
"""Values of the non-centrality at which the power is computed; between them it is interpolated"""
_ALL = 0.99999
"""Power that counts as certain"""
_SMALLEST = 1e-3
"""The size over that at which every test is certain, at least"""
_NEVER = 1e150
"""Size that no instrument has; times a strength it is still a number"""
_HALVINGS = 25
_NOTHING = 1e-12
_SEEN = 1e-4
"""Smallest eigenvalue of a direction that counts, relative to the largest"""
_EIGHTY, _NINETY_FIVE = 0.84, 1.64
"""By how much the root of twice the gain must exceed what is needed, so that so many of 100 cases do"""
QUANTILE = 1.96
"""Normal quantile of 97.5 %"""
_STEPS, _WIDEST = 200, 1e4
"""Standard deviations that are tried, in equal ratios, up and down from the largest usual one by this factor"""


def size_found(grams: Array, ranks: Array, level: float, dof: int, wanted: float) -> float:
    """Return the size `a` at which visible forms of an effect are found with a mean power.

    The power at `a` is the mean of `P(F'(r, dof - r, a^2 d'Ad) > F_level)` over all forms and directions. Forms have
    Gram matrices A, `grams` (k, q, q), and ranks r, `ranks` (k,). Directions d are unit vectors of the q parameters.
    """
    # the mean over directions, not the least visible one, which can need ten times the usual size
    # (docs/decisions/068-stated-sizes.md)
    towards = directions(grams.shape[1])
    strengths = np.sqrt(np.maximum(np.einsum("da,kab,db->kd", towards, grams, towards), 0.0))
    seen = np.unique(ranks[ranks > 0])
    curves = [(strengths[ranks == r], *_curve(level, int(r), max(dof - int(r), 1))) for r in seen]

    def mean_power(size: float) -> float:
        total: float = sum(float(np.interp(size * some, roots, powers).sum()) for some, roots, powers in curves)
        return total / float(strengths.size)

    return _size(mean_power, wanted, max(float(roots[-1]) for _, roots, _ in curves) / float(strengths.max()))


def size_separated(gram: Array, confounded: Array, wanted: float) -> float:
    """Return the size `a` at which an effect is taken for itself and not for another with a mean probability.

    The probability is the mean of `Phi(a |Gd| sqrt((1 - rho) / 2))` over directions d: the larger of two correlated
    projections is that of the right one. G (n, q) is the whitened change of the readings, `gram` is G'G, and rho is
    the cosine of Gd with the span of the other's orthonormal columns b: `confounded` is b'G (p, q). A direction that
    the other can mimic counts as half a case.
    """
    from scipy.special import ndtr

    towards = directions(gram.shape[1])
    squares = np.einsum("da,ab,db->d", towards, gram, towards)
    shared = ((confounded @ towards.T) ** 2).sum(axis=0)
    cosine = np.sqrt(np.minimum(shared / np.maximum(squares, _NOTHING), 1.0))
    strengths = np.sqrt(squares * np.maximum(1 - cosine, _NOTHING) / 2)
    return _size(lambda size: float(ndtr(size * strengths).mean()), wanted, 1 / float(strengths.max()))


def _size(mean_power: Callable[[float], float], wanted: float, high: float) -> float:
    """Return the size with a mean power, which grows with the size; `high` is where the search begins."""
    # doubled without end: a size that the readings never find
    while mean_power(high) < wanted:
        high *= 2
        if high > _NEVER:
            return float("inf")
    low = high * _SMALLEST
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if mean_power(middle) >= wanted else (middle, high)
    return high


def directions(count: int) -> Array:
    """Return unit vectors (d, count) that are evenly spread over all directions."""
    from scipy.special import ndtri

    if count == 1:
        return np.ones((1, 1))
    # additive recurrence of Roberts (2018): multiples of powers of the root of x^(count + 1) = x + 1
    root = 2.0
    for _ in range(40):
        root = (1 + root) ** (1 / (count + 1))
    even = (0.5 + np.arange(1, _DIRECTIONS + 1)[:, None] * root ** -np.arange(1.0, count + 1)) % 1
    normal = ndtri(even)
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _curve(level: float, rank: int, rest: int) -> tuple[Array, Array]:
    """Return roots of non-centralities from 0 on, and the power at each."""
    roots = np.linspace(0.0, np.sqrt(noncentrality(level, rank, rest, _ALL)), _NODES)
    return roots, power(level, rank, rest, roots**2)


@dataclass(frozen=True)
class DetectableCandidate:
    """What the measurement can detect of one form of a cause at one place."""

    alternative: Candidate
    family: int
    number: int
    """Number of its alternative of median visibility, if it was scanned"""
    visible: float
    """Fraction of the signature that the unknowns do not absorb"""
    detectable: float
    """Size that is found in 80 of 100 cases, over all directions of its parameters and all values of its scan.

    It is counted over all that is tried; inf if nothing is visible.
    """
    undetected: UndetectedBias
    """Largest change of the delivered result by an effect that is not found with 95 % power"""
    assumed: float
    """Largest size that `undetected` counts with: the largest usual one, or that found with 95 % power if larger"""
    absorbed_by: tuple[str, ...]
    missed: bool = False
    """Whether its scan is too coarse for the readings, so that a form between two of its values can be missed"""
    upper: float = 0.0
    """Upper bound (97.5 %) of its size beside all that was found"""
    share: float = 1.0
    """Share of what the unknowns leave of it that random parts and other effects leave, too"""
    required: bool = False
    """Whether its evidence would name it, which held-out readings did not confirm"""
    by_law: bool = False
    """Whether a law that was found stands for it"""
    nonlinear: bool = False
    """Whether its change is not linear up to the size that would be excluded, so that none is"""

    @property
    def absorbers(self) -> str:
        """The unknowns that absorb it, in words."""
        return ", ".join(self.absorbed_by) or "the unknowns"

    @property
    def testable(self) -> bool:
        """Whether any part of it is visible."""
        return bool(np.isfinite(self.detectable))

    @property
    def plausible(self) -> float:
        """Largest usual size of the effect."""
        return self.alternative.effect.plausible

    @property
    def unit(self) -> str:
        """Of its size."""
        return self.alternative.effect.parameters[0].unit

    @property
    def dimension(self) -> str:
        """Of its size."""
        return self.alternative.effect.parameters[0].dimension

    @property
    def name(self) -> str:
        """Cause, form and place in words."""
        return self.alternative.words


@dataclass(frozen=True)
class ScatterCandidate:
    """What the measurement can detect of an effect that is sought at all its places at once only."""

    effect: Effect
    detectable: float
    """Standard deviation of its sizes that is found in 80 of 100 cases; inf if none is"""
    undetected: UndetectedBias
    """Change of the delivered result that is exceeded in 5 % of cases, by a scatter that is found with 95 % power"""
    required: bool = False
    """Whether its likelihood would name it, which held-out readings did not confirm"""
    upper: float = 0.0
    """Upper bound (97.5 %) of its standard deviation, beside all that was found"""

    @property
    def testable(self) -> bool:
        """Whether any standard deviation of it is found."""
        return bool(np.isfinite(self.detectable))

    @property
    def reason(self) -> str:
        """What makes it visible, where nothing of it is."""
        return f"it looks like noise of the readings; it would show by {self.effect.reveal}"


def scatter_candidates(state: State, noise: float = 1.0) -> tuple[ScatterCandidate, ...]:
    """Return what can be detected of effects that are sought throughout, for a noise in units of the declared one."""
    m = state.measurement
    required = {m.scatters[scatter.key[0]][0].name for scatter in scattered_effects(state) if scatter.net > 0}
    return tuple(
        _candidate(state, effect, noise, effect.name in required)
        for effect in m.job.effects
        if effect.throughout and effect.name not in m.job.not_sought and m.system.dof > 1
    )


def _candidate(state: State, effect: Effect, noise: float, required: bool) -> ScatterCandidate:
    m = state.measurement
    number = next((i for i, own in enumerate(m.scatters) if own[0].name == effect.name), None)
    if number is None:
        return ScatterCandidate(effect, float("inf"), UndetectedBias(0.0))
    part = m.scatter(number)
    # per unit of the parameters: the columns of a part are scaled by its unit
    left = part.columns.T @ state.seen(part.columns) * part.unit**-2
    eigenvalues, vectors = np.linalg.eigh(left)
    shows = eigenvalues > _SEEN * eigenvalues[-1]
    # eigenvalues in units of the noise: the size is sought for a noise of 1 and multiplied with it at the end
    seen = eigenvalues[shows], m.dof, effect.plausible / noise, part.price
    size, hidden = (_scatter_found(*seen, beyond) * noise for beyond in (_EIGHTY, _NINETY_FIVE))
    squares = (vectors[:, shows].T @ part.columns.T @ state.residual) ** 2 * part.unit**-2 / eigenvalues[shows]
    upper = _upper(eigenvalues[shows], squares, state.fit.squares, m.dof, effect.plausible / noise) * noise
    hides = hidden_by_scatter(m.job, m.system, m.scatters[number], hidden if np.isfinite(hidden) else effect.plausible)
    return ScatterCandidate(effect, size, hides, required, upper)


def _upper(eigenvalues: Array, squares: Array, every: float, dof: float, usual: float) -> float:
    """Return the largest standard deviation s that a likelihood ratio does not reject at 2.5 %.

    `squares` are those of the residual along directions of some eigenvalues, `every` all squares; the noise is 1.
    """
    tried = usual * np.geomspace(1 / _WIDEST, _WIDEST, _STEPS)
    grown = 1 + tried[:, None] ** 2 * eigenvalues
    left = np.maximum(every - squares.sum(), 0.0) + (squares / grown).sum(axis=1)
    # not 0: of readings without errors, as in a design, any noise is likelier than a scatter
    left = np.maximum(left, 1e-300)
    likelihood = -(dof * np.log(left) + np.log(grown).sum(axis=1)) / 2
    kept = np.flatnonzero(likelihood > likelihood.max() - QUANTILE**2 / 2)
    return float(tried[kept[-1]])


def _scatter_found(eigenvalues: Array, dof: float, usual: float, price: float, beyond: float) -> float:
    """Return the standard deviation s at which the mean gain of the log-likelihood exceeds a price with some power.

    With d the eigenvalues and nu the degrees of freedom it is `(nu ln(1 + s^2 sum d / nu) - sum ln(1 + s^2 d)) / 2`.
    The noise is not known, so it is 0 where the scatter looks like noise.
    """
    tried = usual * np.geomspace(1 / _WIDEST, _WIDEST, _STEPS)
    shown = tried[:, None] ** 2 * eigenvalues
    gain = (dof * np.log1p(shown.sum(axis=1) / dof) - np.log1p(shown).sum(axis=1)) / 2
    needed = float(np.sqrt(2 * price)) + beyond
    enough = np.flatnonzero(np.sqrt(np.maximum(2 * gain, 0.0)) > needed)
    return float(tried[enough[0]]) if enough.size else float("inf")
