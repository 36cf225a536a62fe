"""Propagation by the law of the GUM (JCGM 100): first and second order, several measurands, effective dof, k and U."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.probabilities import chi_square_bound, normal_bound, student_bound, student_tail
from metrocli.arrays import Array
from metrocli.expressions.derivatives import Jets, NoValueError
from metrocli.expressions.expression import Expression
from metrocli.frozen import dataclass
from metrocli.uncertainty.correlated import factor
from metrocli.uncertainty.inputs import Inputs
from metrocli.uncertainty.numbers import evaluate

GUARD = 1e-2
"""Tolerance when effective degrees of freedom are truncated to a whole number: 18.9987 counts as 19"""


@dataclass(frozen=True)
class Coverage:
    """Coverage of the expanded uncertainty: a probability, or a given factor k."""

    probability: float = 0.95
    k: float | None = None


@dataclass(frozen=True)
class LinearPropagation:
    """One measurand by the law of propagation."""

    value: float
    std: float
    sensitivities: Array
    """(n,)"""
    contributions: Array
    """(n,): |c_i| u(x_i)"""
    dof: float
    """Effective degrees of freedom (Welch-Satterthwaite), not truncated"""
    second_value: float
    """Second-order value `y + tr(H V)/2`"""
    second_std: float
    """NaN where the second-order terms make the variance negative"""
    nonlinear: float
    """Share of the second-order variance that is missing in the first order"""
    used: tuple[int, ...] = ()
    """Quantities that the model names"""
    notes: tuple[str, ...] = ()
    replaced: bool = False
    """The law of propagation does not apply: there is no derivative at the best estimates"""


@dataclass(frozen=True)
class Propagated:
    """All measurands of a job, with their joint covariance."""

    measurands: Mapping[str, LinearPropagation]
    covariance: Array


def propagate(models: Mapping[str, Expression], inputs: Inputs) -> Propagated:
    """Return each measurand by `u^2 = g' V g`, and to the second order.

    A model that has a value but no derivative at the best estimates is marked as `replaced`. Raises NoValueError if a
    model has no value there.

    Second order (JCGM 100, 5.1.2 note, with correlations): `y = f + tr(H V)/2`,
    `u^2 = g'Vg + tr(HVHV)/2 + sum_i (Vg)_i sum_jk f_ijk V_jk`.
    """
    attempts = {name: _attempt(model, inputs) for name, model in models.items()}
    # where contributions cancel, rounding may leave a variance below 0
    slopes = np.array([linear.sensitivities * (linear.std > 0) for linear in attempts.values()])
    return Propagated(attempts, slopes @ inputs.covariance @ slopes.T)


_HEAVY = 4.0
"""Degrees of freedom of a t distribution up to which the variance of a sample depends on chance"""
_ROUNDING = 1e-14
"""Contributions below this share of the value are rounding errors of derivatives that cancel"""


_HIGHER = "no first-order sensitivity: U = 0 lacks what higher orders change, Monte Carlo has it"


def _attempt(model: Expression, inputs: Inputs) -> LinearPropagation:
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return _linear(model, inputs)
    except NoValueError as error:
        # no derivative, but a value, as of |x| at 0: Monte Carlo has the uncertainty then
        value = float(evaluate(model, inputs.values))
        if not error.differentiable or not math.isfinite(value):
            raise
        nothing = np.zeros(len(inputs.names))
        return LinearPropagation(
            value, 0.0, nothing, nothing, math.inf, math.nan, math.nan, 0.0, notes=(error.message,), replaced=True
        )


def _linear(model: Expression, inputs: Inputs) -> LinearPropagation:
    names, values, covariance = inputs.names, inputs.values, inputs.covariance
    # only derivatives by the names in the model: a budget of a hundred quantities has models of a few
    used = [i for i, name in enumerate(names) if name in model.names]
    own = covariance[np.ix_(used, used)]
    algebra = Jets(model, tuple(names[i] for i in used), values)
    gradient = np.broadcast_to(model.carried_out(replace(algebra, order=1)).gradient, len(used))
    variance = max(float(gradient @ own @ gradient), 0.0)
    if not math.isfinite(variance):
        raise NoValueError("the uncertainty of the model is too large for a number", 0, "numbers reach to 1e150")
    # the third derivatives are needed along one direction only, `V g`
    jet = model.carried_out(replace(algebra, direction=own @ gradient))
    turned = np.broadcast_to(jet.hessian, own.shape) @ own
    more = 0.5 * float(np.trace(turned @ turned)) + float(np.sum(jet.along * own))
    slopes = np.zeros(len(names))
    slopes[used] = gradient
    # derivatives that cancel, as of x - x, leave rounding that would stand in a budget as a contributor
    if (np.abs(slopes) * np.sqrt(np.diag(covariance)) <= _ROUNDING * abs(float(jet.value))).all():
        slopes, variance = np.zeros(len(names)), 0.0
        # at a maximum the slopes are zero too, but there the second order is what the inputs change
        if max(math.sqrt(abs(more)), abs(float(np.trace(turned)))) <= _ROUNDING * abs(float(jet.value)):
            more, turned = 0.0, np.zeros_like(turned)
    dof, notes = effective_dof(inputs, slopes)
    if used and variance == 0 and more == 0 and covariance[used, used].any():
        acts = _acts(model, inputs, used, gradient)
        notes = (*notes, _HIGHER if acts else "depends on no input: what the inputs change cancels, up to rounding")
    if variance == 0 and more > 0:
        notes = (*notes, _HIGHER)
    # if the second-order terms make the variance negative, the expansion is not valid
    second = math.sqrt(variance + more) if 0 <= variance + more < math.inf else math.nan
    return LinearPropagation(
        value=float(jet.value),
        std=math.sqrt(variance),
        sensitivities=slopes,
        contributions=np.abs(slopes) * np.sqrt(np.diag(covariance)),
        dof=dof,
        second_value=float(jet.value) + 0.5 * float(np.trace(turned)),
        second_std=second,
        nonlinear=abs(more) / max(variance + more, variance) if max(variance + more, variance) > 0 else 0.0,
        used=tuple(used),
        notes=notes,
    )


def _acts(model: Expression, inputs: Inputs, used: Sequence[int], gradient: Array) -> bool:
    """Return whether the model changes with its inputs beyond rounding, as z**3 at 0 does, which has no slope."""
    best = np.array([inputs.quantities[i].value for i in used])
    root = factor(inputs.covariance[np.ix_(used, used)])
    # within their standard uncertainties, in directions of no symmetry
    points = best[:, None] + root @ np.random.default_rng(0).uniform(-1.0, 1.0, (root.shape[1], 9))
    values = inputs.values | {inputs.names[i]: row for i, row in zip(used, points, strict=True)}
    value = float(evaluate(model, inputs.values))
    # terms that cancel leave the rounding of their own size
    size = max(abs(value), float(np.abs(gradient) @ np.abs(best)))
    return bool((np.abs(evaluate(model, values) - value) > _ROUNDING * size).any())


def effective_dof(inputs: Inputs, slopes: Array) -> tuple[float, tuple[str, ...]]:
    """Return `u^4 / sum(u_i^4 / dof_i)` (JCGM 100, G.4.1), and notes; correlated quantities are one contribution.

    Correlated quantities with the same finite dof share them (readings taken together, H.2). The formula does not cover
    different dof in one contribution: the least of them is used, with a note.
    """
    total, weighted = 0.0, 0.0
    notes = []
    for group in inputs.groups:
        part = slopes[list(group)]
        variance = float(part @ inputs.covariance[np.ix_(group, group)] @ part)
        total += variance
        acting = [i for i in group if slopes[i] != 0 and inputs.covariance[i, i] > 0]
        dofs = {inputs.quantities[i].dof for i in acting}
        if len(dofs) > 1:
            names = ", ".join(inputs.quantities[i].name for i in acting)
            notes.append(f"{names} are correlated with different degrees of freedom; the least, {min(dofs):g}, is used")
        if dofs and math.isfinite(min(dofs)):
            weighted += variance**2 / min(dofs)
    return (total**2 / weighted if weighted > 0 else math.inf), tuple(notes)


def t_std(inputs: Inputs, slopes: Array) -> float:
    """Return the standard deviation of a linear model whose contributions with few dof have t distributions.

    The variance of a t distribution is `dof/(dof - 2)` times that of its scale; up to 4 dof trials show no size of it.
    """
    total = 0.0
    for group in inputs.groups:
        part = slopes[list(group)]
        variance = float(part @ inputs.covariance[np.ix_(group, group)] @ part)
        dof = min((inputs.quantities[i].dof for i in group), default=math.inf)
        wider = 1.0 if math.isinf(dof) else dof / (dof - 2) if dof > _HEAVY else math.inf
        total += variance * wider if variance > 0 else 0.0
    return math.sqrt(total)


def whole_dof(dof: float) -> float:
    """Return degrees of freedom truncated to a whole number, at least 1; inf stays inf."""
    return math.inf if not math.isfinite(dof) else float(max(math.floor(dof + GUARD), 1))


def coverage_factor(coverage: Coverage, dof: float) -> float:
    """Return k: as given, or from the t distribution with truncated effective dof (JCGM 100, G.6.4)."""
    if coverage.k is not None:
        return coverage.k
    tail = (1 - coverage.probability) / 2
    whole = whole_dof(dof)
    return student_bound(whole, tail) if math.isfinite(whole) else normal_bound(tail)


def covered(coverage: Coverage, dof: float) -> float:
    """Return the coverage probability: as given, or `2 T(k) - 1` of a given k.

    T is the t distribution with the truncated effective degrees of freedom (JCGM 100, G.6.4), the normal one if they
    are infinite.
    """
    if coverage.k is None:
        return coverage.probability
    whole = whole_dof(dof)
    return 1 - 2 * student_tail(whole, coverage.k) if math.isfinite(whole) else math.erf(coverage.k / math.sqrt(2))


def ellipsoid_factor(probability: float, measurands: int) -> float:
    """Return k_p of the joint ellipsoid of several measurands, root of the chi-squared quantile (JCGM 102, 6.5.2)."""
    return math.sqrt(chi_square_bound(measurands, 1 - probability))


def budget_order(linear: LinearPropagation) -> Sequence[int]:
    """Return the contributors of a model from the largest to the smallest."""
    return sorted(linear.used, key=lambda i: -float(linear.contributions[i]))
