"""Tails of the F distribution as logarithms, which do not underflow.

Method: docs/algorithms/what-can-be-seen.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array

_TINY = 1e-280


def log_tail(share: Array, q: float, rest: float) -> Array:
    """Return ln P(T/S > share) for a share T/S of the sum of squares in q of q + rest normal directions.

    `F = (T/q)/((S - T)/rest)`; the tail is the incomplete beta function `I_(1-share)(rest/2, q/2)`.
    """
    from scipy.special import betainc, betaln

    left = np.clip(1 - share, 1e-300, 1.0)
    tail = betainc(rest / 2, q / 2, left)
    # betainc underflows; its leading term keeps the order of very small levels
    leading = rest / 2 * np.log(left) - np.log(rest / 2) - betaln(rest / 2, q / 2)
    leading += (q / 2 - 1) * np.log(np.maximum(1 - left, 1e-300))
    return np.asarray(np.where(tail > _TINY, np.log(np.maximum(tail, _TINY)), leading))


def log_family(log_p: Array | float, tests: float) -> Array:
    """Return ln of `1 - (1 - p)^tests`, the level of the smallest p-value of `tests` independent tests."""
    p = np.exp(np.asarray(log_p, dtype=float))
    # there `1 - (1 - p)^m` is m p to nine digits, and the logarithm of p, which may be below e^-700, stays exact
    small = p * tests < 1e-9
    whole = -np.expm1(tests * np.log1p(-np.minimum(p, 1 - 1e-16)))
    return np.asarray(np.where(small, np.minimum(log_p + np.log(tests), 0.0), np.log(np.maximum(whole, 1e-300))))


def single_level(level: float, tests: float) -> float:
    """Return the level of a single test for which the smallest of `tests` p-values has `level`."""
    return float(-np.expm1(np.log1p(-level) / tests))


def noncentrality(level: float, q: int, rest: float, power: float = 0.8) -> float:
    """Return the non-centrality at which an F test of a level has a power (Baarda 1968 for q = 1, infinite rest)."""
    from scipy.special import ncfdtrinc

    bound = critical(level, q, rest)
    parameter = float(ncfdtrinc(q, rest, 1 - power, bound))
    # ncfdtrinc fails where the bound is far out; at q F the power is about a half
    return parameter if np.isfinite(parameter) and parameter > 0 else float(q * bound)


def power(level: float, q: int, rest: float, noncentralities: Array) -> Array:
    """Return the power of an F test of a level at non-centralities."""
    from scipy.special import ncfdtr

    return np.asarray(1 - ncfdtr(q, rest, noncentralities, critical(level, q, rest)))


def critical(level: float, q: int, rest: float) -> float:
    """Return the critical F; for a level that can be below rounding by bisection of the logarithm of the tail."""
    from scipy.special import fdtri

    # `1 - level` keeps too few digits of smaller ones
    if level > 1e-12:
        return float(fdtri(q, rest, 1 - level))
    low, high = 0.0, 1.0 - 1e-12
    for _ in range(80):
        middle = (low + high) / 2
        inside = log_tail(np.array(middle), q, rest) > np.log(level)
        low, high = (middle, high) if inside else (low, middle)
    share = (low + high) / 2
    return share / (1 - share) * rest / q


def chi_interval(squares: float, dof: float, level: float = 0.95) -> tuple[float, float]:
    """Return the confidence interval of a standard deviation from a sum of squares, relative to the declared one."""
    from scipy.special import chdtri

    tail = (1 - level) / 2
    return float(np.sqrt(squares / chdtri(dof, tail))), float(np.sqrt(squares / chdtri(dof, 1 - tail)))
