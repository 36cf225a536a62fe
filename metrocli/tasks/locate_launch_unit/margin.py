"""Whether the beam stays in the receiver's range: how likely, given what is known of the unit and its encoders."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.tasks.locate_launch_unit.lines import Line, across

_DRAWS = 1 << 15
"""Probabilities are uncertain by 0.3 % at most"""


@dataclass(frozen=True)
class Window:
    """Range of the receiver."""

    straightness: float
    """Radius [mm]"""
    angle: float
    """Of pitch and of yaw [rad]"""


@dataclass(frozen=True)
class Uncertainty:
    """What is uncertain when a line is measured."""

    location: Array
    """Covariance of x y z gamma, (4, 4)"""
    encoder: float
    """Standard deviation of each angle that is commanded [rad]"""

    def without_location(self) -> Uncertainty:
        """Return what is left of it when the place and gamma are known exactly."""
        return Uncertainty(np.zeros_like(self.location), self.encoder)

    def draws(self) -> Array:
        """Return errors of x y z gamma phi1 phi2 phi3 phi4, (8, n)."""
        standard = standard_draws()
        values, vectors = np.linalg.eigh(self.location)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        return np.concatenate([root @ standard[:4], self.encoder * standard[4:]])


@cache
def standard_draws() -> Array:
    """Return standard normal numbers (8, n), the same each time, so that plans compare."""
    draws = np.random.default_rng(20220704).normal(size=(8, _DRAWS))
    draws.setflags(write=False)
    return draws


def beam_errors(line: Line) -> tuple[Array, Array, Array]:
    """Return the derivatives by x y z gamma phi1..phi4 of beam offset at the unit, of its direction, of the angles.

    Each (2, 8): beside and above. At the distance s from the unit the beam is off by `offset + s direction` where the
    encoders aim it along the line; the receiver sees it under the angle `direction` minus its own error.
    """
    beside, above, level = across(line.beam)
    offset, turn, seen = np.zeros((3, 2, 8))
    offset[:, :3] = np.stack([beside, above])
    turn[0, 3] = turn[0, 4] = level
    turn[1, 5] = 1.0
    seen[0, 7], seen[1, 6] = -level, 1.0
    return offset, turn, turn + seen


@dataclass(frozen=True)
class Margin:
    """How far the beam of one line stays in range, draw by draw."""

    line: Line
    window: Window
    errors: Array
    """Of x y z gamma phi1..phi4, (8, n)"""

    @cached_property
    def in_range_to(self) -> Array:
        """Return the distance up to which the beam, aimed by the encoders, stays in range, (n,).

        |offset + s direction| is convex in s, so it is in range between the nearest point and the larger root of
        `|offset + s direction| = radius` where it is at the nearest point; 0 where it is not.
        """
        offset, turn, angles = (by @ self.errors for by in beam_errors(self.line))
        a, b = (turn**2).sum(axis=0), (offset * turn).sum(axis=0)
        c = (offset**2).sum(axis=0) - self.window.straightness**2
        with np.errstate(all="ignore"):
            root = np.where(a > 0, (-b + np.sqrt(b * b - a * c)) / a, np.where(c <= 0, np.inf, np.nan))
        near = offset + self.line.distance.min() * turn
        good = (np.abs(angles) <= self.window.angle).all(axis=0)
        good &= (near**2).sum(axis=0) <= self.window.straightness**2
        return np.where(good, np.nan_to_num(root), 0.0)

    def probability(self, distance: float | None = None) -> float:
        """Return how likely the beam stays in range up to a distance, or along the whole line."""
        return float((self.in_range_to >= (self.line.distance.max() if distance is None else distance)).mean())

    def safe_distance(self, confidence: float) -> float:
        """Return the distance up to which the beam stays in range with this probability."""
        return float(np.quantile(self.in_range_to, 1 - confidence, method="lower"))

    def probability_aligned(self) -> float:
        """Return how likely the beam stays in range once both units are aligned by the receiver's own readings.

        That is done at the far end L; then the beam passes through the unit and that point, and is off by
        `offset (1 - s/L)` (Kuprin et al. fig. 15).
        """
        offset = beam_errors(self.line)[0] @ self.errors
        share = 1 - self.line.distance.min() / self.line.distance.max()
        return float((np.linalg.norm(share * offset, axis=0) <= self.window.straightness).mean())


def beam_position(line: Line, uncertain: Uncertainty, distance: float) -> Array:
    """Return the covariance (2, 2) of the beam's position, beside and above the line, at a distance from the unit."""
    offset, turn, _ = beam_errors(line)
    by = offset + distance * turn
    whole = np.zeros((8, 8))
    whole[:4, :4] = uncertain.location
    whole[np.arange(4, 8), np.arange(4, 8)] = uncertain.encoder**2
    return np.asarray(by @ whole @ by.T)
