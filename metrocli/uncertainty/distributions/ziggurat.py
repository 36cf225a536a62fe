"""Random numbers of the t distribution: a ziggurat of layers, from one random word each (Marsaglia and Tsang 2000).

Method: docs/algorithms/monte-carlo-chunks.md.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass

LAYERS, BEYOND = 512, (0.0047, 0.0055)
"""Number of layers, and what they have beyond the density's area, as a share of it: a constant, and one over dof"""
LEAST_DOF = 1.0
"""Least degrees of freedom of a ziggurat: the layers of fewer reach beyond what one word can resolve"""


def student_t(dof: float, rng: np.random.Generator, count: int) -> Array:
    """Return random numbers of the t distribution with `dof` degrees of freedom, any number above 0; (count,).

    `rng` gives words of 64 bits. Numbers of very few degrees of freedom end at infinity.
    """
    if dof < LEAST_DOF:
        return _polar(dof, rng, count)
    layers = layers_of(dof)
    words = rng.bit_generator.random_raw(count)
    # the lowest bits choose the layer: they are below the last digit of the number that the whole word gives
    layer = np.bitwise_and(words, np.uint64(LAYERS - 1)).view(np.int64)
    values: Array = words.view(np.int64).astype(float)
    values *= (layers.widths * 2.0**-63).take(layer, mode="clip")
    beyond = np.flatnonzero(np.abs(values) >= layers.inner.take(layer, mode="clip"))
    values[beyond] = layers.settled(values[beyond], layer[beyond], rng)
    return values


def _polar(dof: float, rng: np.random.Generator, count: int) -> Array:
    """Return the same by `t = sqrt(n (U^(-2/n) - 1)) cos(2 pi V)` (Bailey, Math. Comp. 62, 1994, 779); (count,)."""
    with np.errstate(over="ignore"):
        radius = np.sqrt(dof * np.expm1(2 / dof * rng.standard_exponential(count)))
    values: Array = radius * np.cos(2 * math.pi * rng.random(count))
    return values


@dataclass(frozen=True)
class Ziggurat:
    """Layers of equal area that cover the density `f(x) = (1 + x^2/dof)^(-(dof + 1)/2)` for x > 0.

    Layer 0 is the lowest, with the tail; one of width 0 is not there.
    """

    dof: float
    start: float
    """Where the tail begins"""
    widths: Array
    """(LAYERS,), that of layer 0 as if the tail were a part of the rectangle"""
    inner: Array
    """(LAYERS,): up to here the density covers the layer"""
    bottoms: Array
    """(LAYERS,): density at the lower edge"""
    area: float

    def settled(self, x: Array, layer: Index, rng: np.random.Generator) -> Array:
        """Return numbers of the places x beyond `inner`: x itself, one of the tail, or a new one; (n,)."""
        dof, start = self.dof, self.start**2
        chance = rng.random(len(x))
        lowest = layer == 0
        with np.errstate(divide="ignore"):  # of a layer that is not there, whose bottom is the top
            height = self.bottoms[layer] + self.area * chance / self.widths[layer]
        density = np.exp(-(dof + 1) / 2 * np.log1p(x * x / dof))
        # x^2 of the tail: of w = 1/(1 + x^2/n) the density is w^(n/2 - 1) (1 - w)^(-1/2), and the first factor is drawn
        tail = start + (dof + start) * np.expm1(2 / dof * rng.standard_exponential(len(x)))
        in_tail = chance**2 * tail * (dof + start) < start * (dof + tail)
        kept = np.where(lowest, in_tail, height < density)
        candidates = np.where(lowest, np.copysign(np.sqrt(tail), x), x)
        return np.where(kept, candidates, _polar(dof, rng, len(x)))


@cache
def layers_of(dof: float) -> Ziggurat:
    """Return the layers of a density, as many of LAYERS as reach its top; `dof` is at least LEAST_DOF."""
    # beyond 1e6 the density is that of a normal distribution, and the difference of the logarithms has no digits left
    few = min(dof, 1e6)
    half = math.sqrt(few * math.pi) / 2 * math.exp(math.lgamma(few / 2) - math.lgamma((few + 1) / 2))
    start = _start(dof, half * (1 + BEYOND[0] + BEYOND[1] / dof) / LAYERS)
    area, bottom = _lowest(dof, start), _density(dof, start)
    widths, bottoms, power = [area / bottom, start], [0.0, bottom], -2 / (dof + 1)
    while (bottom := bottom + area / widths[-1]) < 1:
        bottoms.append(bottom)
        widths.append(math.sqrt(dof * math.expm1(power * math.log(bottom))))
    missing = LAYERS - len(widths)
    assert missing >= 0
    every = np.array(widths + [0.0] * (missing + 1))
    return Ziggurat(dof, start, every[:-1], every[1:], np.array(bottoms + [1.0] * missing), area)


def _start(dof: float, area: float) -> float:
    """Return where the tail begins if layer 0 has an area."""
    low, high = 0.0, math.log(1e6)
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if _lowest(dof, math.exp(middle)) > area else (low, middle)
    return math.exp(low)


def _density(dof: float, x: float) -> float:
    return math.exp(-(dof + 1) / 2 * math.log1p(x * x / dof))


def _lowest(dof: float, start: float) -> float:
    """Return the area of layer 0: its rectangle, and what `Ziggurat.settled` draws in place of the tail."""
    return _density(dof, start) * (start + 1 / start + start / dof)
