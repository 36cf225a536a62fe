"""The codes of 12-bit ring targets: which codes are in use, and how a code is read in any rotation.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

from functools import cache

BITS = 12
FEWEST_ARCS = 2
"""Fewest arcs of a code: plain rings, and rings with a single gap, also occur on parts and are not targets."""

DOT, RING_FROM, RING_TO, SHEET = 1.0, 2.0, 3.0, 4.0
"""Radii of the centre dot, of the ring's inner and outer rim, and of the plain surroundings, in radii of the dot."""


def canonical(bits: int) -> int:
    """Return the least of the twelve cyclic rotations of the bits, which does not depend on the target's rotation."""
    return min((bits >> turn | bits << (BITS - turn)) & ((1 << BITS) - 1) for turn in range(BITS))


def arcs(bits: int) -> int:
    """Return the number of arcs of ones around the ring."""
    turned = bits >> 1 | (bits & 1) << (BITS - 1)
    return (bits & ~turned).bit_count()


@cache
def codes() -> tuple[int, ...]:
    """Return the codes in use: least rotations with an even number of ones and at least two arcs.

    Any two codes differ in at least two segments in every rotation. So one misread segment gives no code, and never
    another code.
    """
    # an even number of ones: one misread segment makes it odd, so that it is no code
    return tuple(
        bits
        for bits in range(1 << BITS)
        if canonical(bits) == bits and bits.bit_count() % 2 == 0 and arcs(bits) >= FEWEST_ARCS
    )
