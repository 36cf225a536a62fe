"""Figures of positioning of one line, with their uncertainty (ISO 230-2:2014; ISO/TR 230-9)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass

FIGURES = ("A", "A_up", "A_down", "R", "R_up", "R_down", "B", "B_mean", "E", "E_up", "E_down", "M")
"""ISO 230-2: accuracy, repeatability, reversal value and its mean, systematic deviation, range of mean deviations"""
COVERAGE = 2.0
"""k of the stated U (ISO/TR 230-9)"""


def figures(up: Array, down: Array) -> dict[str, float]:
    """Return the figures from deviations (runs, targets) in the positive and in the negative direction [mm].

    x is the mean and s the standard deviation (n - 1) of the runs at a target; extremes are over the targets:

    - B = max |x_up - x_down|, B_mean the mean of `x_up - x_down` with its sign
    - M = range of (x_up + x_down)/2
    - E_up = range of x_up; E the range of all x
    - R_up = max 4 s_up; R = max(2 s_up + 2 s_down + |x_up - x_down|, 4 s_up, 4 s_down)
    - A_up = max(x_up + 2 s_up) - min(x_up - 2 s_up); A the same over both directions

    R and A are nan where a direction that they need has one run, all figures where it has none.
    """
    means, spread = at_each_target(up, down)
    return {
        name: form.value(means, spread) if all(map(len, _needed(name, up, down))) else float("nan")
        for name, form in _linear_forms(means, spread).items()
    }


def _needed(name: str, up: Array, down: Array) -> tuple[Array, ...]:
    """Return the runs that a figure needs: of one direction by the ending of its name, else of both."""
    sides = {"up": (up,), "down": (down,)}
    return sides.get(name.rpartition("_")[2], (up, down))


@dataclass(frozen=True)
class LineUncertainty:
    """How well the readings of a line are known."""

    reading: float
    """Standard uncertainty of a reading, independent of all others [mm]"""
    scale: float = 0.0
    """Relative standard uncertainty of all distances of the line in common (device, temperature, misalignment)"""


def expanded(up: Array, down: Array, targets: Array, known: LineUncertainty) -> dict[str, float]:
    """Return U (k = 2) of each figure: `2 sqrt(u_r^2 sum g_i^2 + u_s^2 (sum g_i p_i)^2)`.

    g is the derivative of the figure by each reading, p its position, u_r and u_s the uncertainties of a reading and
    of the scale. The contributions are those of ISO 230-2:2014, annex A; they are propagated by the GUM, as
    ISO/TR 230-9 asks, and not taken from the annex's formulas for five runs.
    """
    means, spread = at_each_target(up, down)
    values = figures(up, down)
    runs = np.maximum([[len(up)], [len(down)]], 1)
    expansions = {}
    for name, form in _linear_forms(means, spread).items():
        # by the readings x_i of n runs a mean has the derivatives 1/n, and s has (x_i - mean)/((n - 1) s). These are
        # orthogonal, with sums of squares 1/n and 1/(n - 1). Those of s add up to 0: the scale acts on means alone
        squares = (form.mean**2 / runs + form.spread**2 / np.maximum(runs - 1, 1)).sum()
        u = np.hypot(known.reading * np.sqrt(squares), known.scale * (form.mean * targets).sum())
        expansions[name] = float(COVERAGE * u) if np.isfinite(values[name]) else float("nan")
    return expansions


def at_each_target(up: Array, down: Array) -> tuple[Array, Array]:
    """Return means (nan of no run) and standard deviations (nan of one) at the targets, (2, targets) each."""
    missing = np.full(up.shape[1], np.nan)
    means = [runs.mean(axis=0) if len(runs) else missing for runs in (up, down)]
    return np.stack(means), np.stack([runs.std(axis=0, ddof=1) if len(runs) > 1 else missing for runs in (up, down)])


@dataclass(frozen=True)
class _LinearForm:
    """A figure as a linear form of means and standard deviations at targets: the factors of each, (2, targets)."""

    mean: Array
    spread: Array

    def value(self, means: Array, spread: Array) -> float:
        """Return the figure; nan if it has a mean of no run, or a standard deviation of one."""
        # factors of 0 are left out: 0 times nan would be nan
        return float((self.mean * means)[self.mean != 0].sum() + (self.spread * spread)[self.spread != 0].sum())


def _linear_forms(means: Array, spread: Array) -> dict[str, _LinearForm]:
    """Return each figure as the linear form that it is while its extremes stay at these targets.

    So its factors are its derivatives, too.
    """
    gap, zeros, m = means[0] - means[1], np.zeros_like(means), means.shape[1]

    def at(sides: Sequence[int], target: int, factor: float = 1.0) -> Array:
        """Return the factors of the values of some directions, 0 up and 1 down, at one target."""
        row = np.zeros_like(means)
        row[list(sides), target] = factor
        return row

    def systematic(sides: tuple[int, ...]) -> _LinearForm:
        ends = [divmod(int(pick(means[list(sides)])), m) for pick in (np.argmax, np.argmin)]
        high, low = (at((sides[side],), target) for side, target in ends)
        return _LinearForm(high - low, zeros)

    def accuracy(sides: tuple[int, ...]) -> _LinearForm:
        chosen, wide = means[list(sides)], 2 * spread[list(sides)]
        ends = [divmod(int(end), m) for end in (np.argmax(chosen + wide), np.argmin(chosen - wide))]
        high, low = (at((sides[side],), target) for side, target in ends)
        return _LinearForm(high - low, 2 * (high + low))

    def repeatability(side: int) -> _LinearForm:
        return _LinearForm(zeros, at((side,), int(np.argmax(spread[side])), 4.0))

    def reversal(target: int) -> Array:
        return float(np.sign(gap[target])) * (at((0,), target) - at((1,), target))

    widest, middle = int(np.argmax(2 * spread.sum(axis=0) + np.abs(gap))), means.mean(axis=0)
    both = _LinearForm(reversal(widest), at((0, 1), widest, 2.0))
    repeats = [both, repeatability(0), repeatability(1)]
    return {
        "A": accuracy((0, 1)), "A_up": accuracy((0,)), "A_down": accuracy((1,)),
        "R": max(repeats, key=lambda form: form.value(means, spread)), "R_up": repeats[1], "R_down": repeats[2],
        "B": _LinearForm(reversal(int(np.argmax(np.abs(gap)))), zeros),
        "B_mean": _LinearForm(np.repeat([[1.0], [-1.0]], m, axis=1) / m, zeros),
        "E": systematic((0, 1)), "E_up": systematic((0,)), "E_down": systematic((1,)),
        "M": _LinearForm(at((0, 1), int(np.argmax(middle)), 0.5) - at((0, 1), int(np.argmin(middle)), 0.5), zeros),
    }  # fmt: skip
