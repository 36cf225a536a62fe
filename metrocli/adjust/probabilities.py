"""Tails of the normal, chi-square, Student and F distributions for single numbers.

`scipy.special` has them too, but loading it takes longer than the adjustment of a small job. Formulas: Abramowitz and
Stegun: Handbook of Mathematical Functions, 1964.
"""

from __future__ import annotations

import math

# scipy.special would save 150 lines, and takes 0.35 s to load beside the 0.5 s of a small job (docs/decisions/153)
_STEPS = 10_000
"""Most terms of a series or a continued fraction: some six times the square root of the degrees of freedom"""
_SERIES = 2e6
"""Degrees of freedom of chi-square up to which these terms are enough"""
_SMALL = 1e-300
_MANY = 1e6
"""Degrees of freedom above which t is the normal distribution and a term; its own functions lose digits there"""
_STILL = 1e-14
"""Relative change below which an iteration ends"""
_ROUNDED = 1e-9
"""Relative change below which steps that do not shrink are rounding"""


def normal_bound(tail: float) -> float:
    """Return the value that a standard normal variable exceeds with probability `tail`.

    Newton's steps from the approximation of Hastings (Abramowitz and Stegun 26.2.22), which is off by up to 0.003.
    """
    # the approximation is for the upper half only
    if tail > 0.5:
        return -normal_bound(1 - tail)
    if tail <= 0:
        return math.inf
    t = math.sqrt(-2 * math.log(tail))
    bound = t - (2.30753 + 0.27061 * t) / (1 + t * (0.99229 + 0.04481 * t))
    for _ in range(4):
        density = math.exp(-bound * bound / 2) / math.sqrt(2 * math.pi)
        bound += (0.5 * math.erfc(bound / math.sqrt(2)) - tail) / density
    return bound


def chi_square_tail(dof: float, value: float) -> float:
    """Return the probability that chi-square with `dof` degrees of freedom exceeds `value`.

    It is the incomplete gamma function Q(dof/2, value/2): a series below its middle, a continued fraction above
    (Abramowitz and Stegun 6.5.29 and 6.5.31).
    """
    a, x = dof / 2, value / 2
    if not x > 0:
        return 1.0 if x <= 0 else float("nan")
    if math.isinf(x):
        return 0.0
    if dof > _SERIES:
        # of so many degrees the cube root is normal to 1e-8 (Wilson and Hilferty 1931); a series would need more terms
        root = 2 / (9 * dof)
        return math.erfc(((value / dof) ** (1 / 3) - 1 + root) / math.sqrt(2 * root)) / 2
    front = math.exp(a * math.log(x) - x - math.lgamma(a))
    return 1 - front * _series(a, x) if x < a + 1 else front * _fraction(a, x)


def chi_square_bound(dof: float, tail: float) -> float:
    """Return the value that chi-square with `dof` degrees of freedom exceeds with probability `tail`.

    Newton's steps from the approximation of Wilson and Hilferty (1931).
    """
    if tail <= 0:
        return math.inf
    third = 2 / (9 * dof)
    # the cube can be negative at few degrees of freedom, and Newton's steps need a start inside
    value = max(dof * (1 - third + normal_bound(tail) * math.sqrt(third)) ** 3, 1e-3 * dof)
    before = math.inf
    for _ in range(100):
        density = math.exp((dof / 2 - 1) * math.log(value / 2) - value / 2 - math.lgamma(dof / 2)) / 2
        step = (chi_square_tail(dof, value) - tail) / density
        # not below a tenth at once: a step from the flat tail would leave the range of the density
        value = max(value + step, value / 10)
        # of many degrees of freedom the tail is rounded so that the steps end above the limit
        if abs(step) <= _STILL * value or before <= abs(step) <= _ROUNDED * value:
            break
        before = abs(step)
    return value


def _series(a: float, x: float) -> float:
    term = total = 1 / a
    for n in range(1, _STEPS):
        term *= x / (a + n)
        total += term
        # a hundredth: the terms that follow add up to many times the last one where x is close to a
        if term < total * _STILL / 100:
            break
    return total


def _fraction(a: float, x: float) -> float:
    """Return the continued fraction of `Q Gamma(a) exp(x) / x^a` by the method of Lentz."""
    b = x + 1 - a
    c, d = 1 / _SMALL, 1 / b
    total = d
    for n in range(1, _STEPS):
        numerator, b = -n * (n - a), b + 2
        # a denominator of 0 is replaced by the smallest number (Lentz), which the next factor takes back
        d = 1 / (numerator * d + b or _SMALL)
        c = b + numerator / c or _SMALL
        total *= c * d
        if abs(c * d - 1) < _STILL:
            break
    return total


def student_bound(dof: float, tail: float) -> float:
    """Return the value that Student's t with `dof` degrees of freedom exceeds with probability `tail`, below 1/2.

    Newton's steps on the logarithm of the tail, from the bound of the normal distribution.
    """
    value, before = normal_bound(tail), math.inf
    if math.isinf(value):
        return value
    if dof > _MANY:
        return value + (value**3 + value) / (4 * dof)  # formula 26.7.5 there
    constant = math.lgamma((dof + 1) / 2) - math.lgamma(dof / 2) - math.log(dof * math.pi) / 2
    for _ in range(100):
        chance = student_tail(dof, value)
        density = math.exp(constant - (dof + 1) / 2 * math.log1p(value * value / dof))
        # the logarithm of the tail is nearly straight, so that the steps are few where the tail is 1e-12
        step = math.log(chance / tail) * chance / density
        value += step
        if abs(step) <= _STILL * value or before <= abs(step) <= _ROUNDED * value:
            break
        before = abs(step)
    return value


def student_tail(dof: float, value: float) -> float:
    """Return the probability that Student's t with `dof` degrees of freedom exceeds `value` (formula 26.7.1 there)."""
    if value < 0:
        return 1 - student_tail(dof, -value)
    if dof > _MANY:  # formula 26.7.8 there
        return math.erfc(value * (1 - 1 / (4 * dof)) / math.sqrt(2 + value * value / dof)) / 2
    return _beta(dof / 2, 0.5, dof / (dof + value * value)) / 2


def f_tail(dof: float, dof_below: float, value: float) -> float:
    """Return the probability that F with these degrees of freedom exceeds `value` > 0 (formula 26.6.2 there).

    It is nan without degrees of freedom.
    """
    if not (dof > 0 and dof_below > 0):
        return math.nan
    return _beta(dof_below / 2, dof / 2, dof_below / (dof_below + dof * value))


def _beta(a: float, b: float, x: float) -> float:
    """Return the incomplete beta function I_x(a, b) by its continued fraction (formula 26.5.8 there)."""
    if not 0 < x < 1:
        return x
    if x > (a + 1) / (a + b + 2):  # where the fraction of the other side converges fast
        return 1 - _beta(b, a, 1 - x)
    front = math.exp(
        math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x) - math.log(a)
    )
    c, d = 1.0, 1 / (1 - (a + b) * x / (a + 1) or _SMALL)
    total = d
    for n in range(1, _STEPS):
        for numerator in (
            n * (b - n) * x / ((a + 2 * n - 1) * (a + 2 * n)),
            -(a + n) * (a + b + n) * x / ((a + 2 * n) * (a + 2 * n + 1)),
        ):
            d = 1 / (numerator * d + 1 or _SMALL)
            c = numerator / c + 1 or _SMALL
            total *= c * d
        if abs(c * d - 1) < _STILL:
            break
    return front * total
