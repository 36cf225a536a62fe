"""The codes of 12-bit ring targets: which there are, and how one is read whatever way up it is.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

from functools import cache

BITS = 12
FEWEST_ARCS = 2
"""Arcs that a ring has at least: plain rings, and rings with a single gap, occur on parts that are no targets."""

DOT, RING_FROM, RING_TO, SHEET = 1.0, 2.0, 3.0, 4.0
"""Radii of the centre dot, the ring's two rims and the plain surroundings, in radii of the dot."""


def canonical(bits: int) -> int:
    """Return the least of the twelve cyclic rotations of the bits."""
    return min((bits >> turn | bits << (BITS - turn)) & ((1 << BITS) - 1) for turn in range(BITS))


def arcs(bits: int) -> int:
    """Return the number of arcs of ones around the ring."""
    turned = bits >> 1 | (bits & 1) << (BITS - 1)
    return (bits & ~turned).bit_count()


@cache
def codes() -> tuple[int, ...]:
    """Return the codes in use: least rotations, an even number of ones, two arcs at least.

    Any two differ in two segments at least, however they are turned: one misread segment gives no code, never
    another one.
    """
    # an even number of ones: one misread segment makes it odd, so that it is no code
    return tuple(
        bits
        for bits in range(1 << BITS)
        if canonical(bits) == bits and bits.bit_count() % 2 == 0 and arcs(bits) >= FEWEST_ARCS
    )
