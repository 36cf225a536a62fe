"""Ring-coded targets: a centre dot, and around it a ring of twelve segments that carry the target's number.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

from collections import Counter
from functools import cache

import cv2
import numpy as np

from metrocli.arrays import Array, Picture
from metrocli.targets import blobs, ellipses
from metrocli.targets.blobs import Ellipse
from metrocli.targets.ellipses import FittedEllipse, of_ellipses
from metrocli.targets.find import FoundTargets, nothing
from metrocli.targets.pattern import Pattern

BITS = 12
FEWEST_ARCS = 2
"""Fewest arcs of a code: plain rings, and rings with a single gap, also occur on parts and are not targets."""

DOT, RING_FROM, RING_TO, SHEET = 1.0, 2.0, 3.0, 4.0
"""Radii of the centre dot, of the ring's inner and outer rim, and of the plain surroundings, in radii of the dot."""
_REACH = 1.5
"""Limit of the fit of the dot, in semi-axes: half way to the ring."""
_SAMPLES = 10
"""Directions in which a segment is read."""
_GAP, _AROUND = 1.5, 3.55
"""Radii at which only background is expected, in semi-axes of the dot: inside and outside the ring."""
_ACROSS = tuple(RING_FROM + part * (RING_TO - RING_FROM) for part in (0.3, 0.5, 0.7))
"""Radii at which the ring is read, in semi-axes of the dot."""
_PLAIN = 0.35
"""Largest deviation of the background's grey value, in units of the dot's contrast."""
_CLEAR = 0.2
"""Smallest distance of a segment's grey value from half the contrast, in units of the contrast."""


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

    Any two codes differ in at least two segments in every rotation: one misread segment makes the number of ones odd,
    so that it gives no code, and never another code.
    """
    return tuple(
        bits
        for bits in range(1 << BITS)
        if canonical(bits) == bits and bits.bit_count() % 2 == 0 and arcs(bits) >= FEWEST_ARCS
    )


def find(pattern: Pattern, picture: Picture) -> FoundTargets:
    """Return the coded targets of an image, named by their code; a code seen twice is left out, with a message."""
    starts = (start for start in blobs.ellipses(picture, pattern.polarity) if _worth_fitting(picture, start))
    fits = ellipses.fit_all(picture, starts, _REACH)
    read = [(code, fitted) for fitted in fits if (code := decode(picture, fitted)) is not None]
    counts = Counter(code for code, _ in read)
    twice = sorted(code for code, count in counts.items() if count > 1)
    single = sorted(((code, fitted) for code, fitted in read if counts[code] == 1), key=lambda item: item[0])
    reason = f"codes {', '.join(map(str, twice))} occur more than once" if twice else ""
    if not single:
        return nothing(reason or "no coded target in the image")
    return of_ellipses([str(code) for code, _ in single], [fitted for _, fitted in single], reason)


def decode(picture: Picture, fitted: FittedEllipse) -> int | None:
    """Return the code around a dot; None if there is no ring, or no code in use on it."""
    profile = _profile(picture, fitted.ellipse, (_GAP, *_ACROSS, _AROUND))
    if profile is None:
        return None
    level = (profile - fitted.background) / fitted.contrast
    if np.abs(level[0]).max() > _PLAIN or np.abs(level[-1]).max() > _PLAIN:
        return None
    bits = _bits(level[1:-1].mean(0))
    code = None if bits is None else canonical(bits)
    return code if code in codes() else None


def _worth_fitting(picture: Picture, start: Ellipse) -> bool:
    """Return whether the surroundings may be a gap and a ring: a quick check before the slow fit."""
    profile = _profile(picture, start, (0.0, _GAP, _ACROSS[1]))
    if profile is None:
        return False
    contrast = float(profile[0].mean() - profile[1].mean())
    ring = (profile[2] - profile[1].mean()) / (contrast or 1.0)
    return bool(contrast and np.ptp(profile[1]) < 2 * _PLAIN * abs(contrast) and ring.max() > 0.5)


def _profile(picture: Picture, ellipse: Ellipse, radii: tuple[float, ...]) -> Array | None:
    """Return grey values (radii, directions) on ellipses of the same shape; None if they leave the image.

    The radii are in semi-axes of the ellipse, so a circle around the dot in its own plane has one radius.
    """
    angle = np.arange(BITS * _SAMPLES) * (2 * np.pi / (BITS * _SAMPLES))
    circle = np.stack([np.cos(angle), np.sin(angle)])
    # the ring is seen as obliquely as the dot: circles about it are ellipses of the dot's shape
    offset = np.linalg.inv(ellipse.shape) @ circle
    reach = np.abs(offset).max(1) * max(radii) + 1
    height, width = picture.shape
    if not (reach[0] <= ellipse.u < width - 1 - reach[0] and reach[1] <= ellipse.v < height - 1 - reach[1]):
        return None
    u0, v0 = int(ellipse.u - reach[0]), int(ellipse.v - reach[1])
    part = picture[v0 : int(ellipse.v + reach[1]) + 2, u0 : int(ellipse.u + reach[0]) + 2]
    at = np.multiply.outer(np.array(radii), offset.T) + (ellipse.u - u0, ellipse.v - v0)
    grey = cv2.remap(part.astype(np.float32), at.astype(np.float32), None, cv2.INTER_LINEAR)  # type: ignore[call-overload]
    return np.asarray(grey, dtype=float)


def _bits(ring: Array) -> int | None:
    """Return the bits of a ring sampled at equal angles, up to a rotation; None if a segment is not clear.

    Where the segments begin is unknown: the phase with the clearest segments is taken.
    """
    clear, segments = max((_read(ring, phase) for phase in range(_SAMPLES)), key=lambda read: read[0])
    if clear < _CLEAR or segments.max() > 1 + 2 * _PLAIN or segments.min() < -_PLAIN:
        return None
    return int(sum(1 << place for place, level in enumerate(segments) if level > 0.5))


def _read(ring: Array, phase: int) -> tuple[float, Array]:
    """Return how clear the worst sample is, and the levels of the segments; only the middle of each is used."""
    parts = np.roll(ring, -phase).reshape(BITS, _SAMPLES)[:, _SAMPLES // 4 : _SAMPLES - _SAMPLES // 4]
    levels = parts.mean(1)
    side = np.where(levels > 0.5, 1, -1)
    return float(((parts - 0.5) * side[:, None]).min()), levels
