"""Statements of reports, each with a check by simulation apart from the program."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import stats

from benchmarks.apart.model import Array, Model

Rng = np.random.Generator
_SURE = 0.999
"""Probability of the intervals of simulated numbers: of twenty right statements one in fifty draws seems wrong"""
_DIGITS = 6e-3
"""Relative difference that a simulation without noise may have: stated digits, differences as derivatives"""
TRIALS = 1000


@dataclass(frozen=True)
class Simulated:
    """A number of a simulation, and whether the statement holds by it."""

    text: str
    holds: bool


@dataclass(frozen=True)
class Statement:
    """A number of a report with what it claims."""

    kind: str
    place: str
    claim: str
    stated: str
    check: Callable[[Rng], Simulated]


def of_share(hits: int, trials: int, least: float, most: float) -> Simulated:
    """Return a share, which holds if its interval reaches what was claimed."""
    low = float(stats.beta.ppf((1 - _SURE) / 2, hits, trials - hits + 1)) if hits else 0.0
    high = float(stats.beta.ppf((1 + _SURE) / 2, hits + 1, trials - hits)) if hits < trials else 1.0
    text = f"{hits / trials:.1%} of {trials} [{low:.1%}, {high:.1%}]"
    return Simulated(text, low <= most and high >= least)


def of_spread(values: Array, claimed: float, truth: float | None = None) -> Simulated:
    """Return the standard deviation of simulated values, which holds if its interval contains what was claimed.

    It is that from the truth, which contains a bias, where the truth is known.
    """
    n = len(values) - (truth is None)
    std = float(np.sqrt(((values - (values.mean() if truth is None else truth)) ** 2).sum() / n))
    low, high = (std * float(np.sqrt(n / stats.chi2.ppf(p, n))) for p in ((1 + _SURE) / 2, (1 - _SURE) / 2))
    return Simulated(f"{std:.3g} [{low:.3g}, {high:.3g}]", low <= claimed <= high)


def of_mean(sums: Array, dof: int) -> Simulated:
    """Return the mean of sums of squares, which holds if its interval contains the degrees of freedom."""
    off = float(stats.norm.ppf((1 + _SURE) / 2) * np.sqrt(2 * dof / len(sums)))
    mean = float(sums.mean())
    digits = max(1, -int(np.floor(np.log10(off))))
    text = f"{mean:.{digits}f} [{mean - off:.{digits}f}, {mean + off:.{digits}f}]"
    return Simulated(text, abs(mean - dof) < off)


def of_value(value: float, claimed: float, share: float = _DIGITS) -> Simulated:
    """Return a number that is computed without noise."""
    return Simulated(f"{value:.4g}", abs(value - claimed) <= share * abs(claimed))


def uncertainties(kind: str, place: str, model: Model, stated: Mapping[str, float], unit: str) -> Iterable[Statement]:
    """Yield the standard uncertainties: the errors of what adjusted simulated readings give."""

    def check(name: str) -> Callable[[Rng], Simulated]:
        def simulated(rng: Rng) -> Simulated:
            found = [model.quantities[name](model.adjusted(model.read(rng))[0]) for _ in range(TRIALS)]
            return of_spread(np.array(found), stated[name], model.quantities[name](model.truth))

        return simulated

    for name, std in stated.items():
        yield Statement(kind, place, f"standard uncertainty of {name}", f"{std:.3g} {unit}", check(name))


def detectable(
    kind: str, place: str, model: Model, stated: Mapping[tuple[str, ...], float], limits: tuple[float, float]
) -> Iterable[Statement]:
    """Yield the least errors of single readings that the test finds with 80 %; limits are critical_w and the noise.

    The noise is the larger of the declared and the found one, in declared ones.
    """
    critical, noise = limits

    def check(key: tuple[str, ...]) -> Callable[[Rng], Simulated]:
        def simulated(rng: Rng) -> Simulated:
            row, found = model.rows[key], 0
            for _ in range(TRIALS):
                readings = model.read(rng, noise)
                readings[row] += stated[key]
                left = model.adjusted(readings)[1][row]
                found += abs(left) / np.sqrt(model.redundancy[row]) > critical * noise
            return of_share(found, TRIALS, 0.8, 0.8)

        return simulated

    for key, size in stated.items():
        claim = f"an error of {'/'.join(key)} is found with 80 %"
        yield Statement(kind, place, claim, f"from {size:.3g}", check(key))


def false_alarms(kind: str, place: str, model: Model, critical: float, count: int) -> Statement:
    """Return the bound of the test of `count` single readings, which at most 5 % of measurements exceed."""

    def check(rng: Rng) -> Simulated:
        alarms = 0
        for _ in range(TRIALS):
            left = model.adjusted(model.read(rng))[1][:count]
            alarms += bool((np.abs(left) > critical * np.sqrt(model.redundancy[:count])).any())
        return of_share(alarms, TRIALS, 0.0, 0.05)

    return Statement(kind, place, f"|w| above {critical:.3f} without an error in at most 5 %", "5 %", check)


def degrees_of_freedom(kind: str, place: str, model: Model, dof: int) -> Statement:
    """Return the degrees of freedom: the mean of the sums of squares of residuals."""

    def check(rng: Rng) -> Simulated:
        sums = np.array([float((model.adjusted(model.read(rng))[1] ** 2).sum()) for _ in range(TRIALS)])
        return of_mean(sums, dof)

    return Statement(kind, place, "degrees of freedom", f"{dof}", check)


def global_test(kind: str, place: str, model: Model, facts: Mapping[str, float]) -> Statement:
    """Return the p-value: the share of measurements with a larger sum of squares."""

    def check(rng: Rng) -> Simulated:
        sums = [float((model.adjusted(model.read(rng))[1] ** 2).sum()) for _ in range(TRIALS)]
        p = facts["p_value"]
        return of_share(sum(one > facts["chi2"] for one in sums), TRIALS, p, p)

    return Statement(kind, place, f"p of chi2 {facts['chi2']:.1f}", f"{facts['p_value']:.4f}", check)


def noise_interval(kind: str, place: str, model: Model, noise: Mapping[str, list[float]]) -> Statement:
    """Return the interval of the true noise: at either bound 2.5 % of measurements lie beyond the ratio found."""

    def check(rng: Rng) -> Simulated:
        sums = np.array([(model.adjusted(model.read(rng))[1] ** 2).sum() for _ in range(TRIALS)])
        ratio, (low, high) = float(np.asarray(noise["ratio"])), noise["interval"]
        shown = np.sqrt(sums / sums.mean())
        beyond = int((low * shown > ratio).sum() + (high * shown < ratio).sum())
        return of_share(beyond, TRIALS, 0.05, 0.05)

    low, high = noise["interval"]
    return Statement(kind, place, "95 % interval of the noise ratio", f"{low:.3f} to {high:.3f}", check)


def moved_points(
    kind: str, place: str, model: Model, stated: Mapping[tuple[str, ...], tuple[float, float]]
) -> Iterable[Statement]:
    """Yield how far the point moves by an error of the least detectable size in one of its lengths."""

    def check(key: tuple[str, ...]) -> Callable[[Rng], Simulated]:
        def simulated(_: Rng) -> Simulated:
            readings = model.predict(model.truth)
            before = model.adjusted(readings)[0]
            readings[model.rows[key]] += stated[key][0]
            after = model.adjusted(readings)[0]
            names = [f"{key[0]}.{axis}" for axis in "xyz"]
            moved = [model.quantities[name](after) - model.quantities[name](before) for name in names]
            return of_value(float(np.linalg.norm(moved)), stated[key][1])

        return simulated

    for key, (size, move) in stated.items():
        claim = f"{size:.3g} mm in {'/'.join(key)} moves the point by"
        yield Statement(kind, place, claim, f"{move:.4g} mm", check(key))


def redundancies(kind: str, place: str, model: Model, stated: Mapping[tuple[str, ...], float]) -> Iterable[Statement]:
    """Yield the redundancies: the share of an error of a reading that stays in its residual."""

    def check(key: tuple[str, ...]) -> Callable[[Rng], Simulated]:
        def simulated(_: Rng) -> Simulated:
            readings, row = model.predict(model.truth), model.rows[key]
            readings[row] += model.sigma[row]
            return of_value(float(model.adjusted(readings)[1][row]), stated[key])

        return simulated

    for key, share in stated.items():
        yield Statement(kind, place, f"redundancy of {'/'.join(key)}", f"{share:.4f}", check(key))
