"""Probability that the beam stays in the range of the receiver, and the further poses that make it safe."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments import launch_unit as lu
from metrocli.tasks.locate_launch_unit.lines import Reach, ReceiverLine, across
from metrocli.tasks.locate_launch_unit.problem import build
from metrocli.tasks.locate_launch_unit.readings import AlignedPoses
from metrocli.tasks.locate_launch_unit.settings import LaunchUnitNoise
from metrocli.tasks.locate_launch_unit.simulation import aligned

_DRAWS = 1 << 15
"""Number of Monte Carlo draws; the standard uncertainty of a probability is 0.3 % at most"""


@dataclass(frozen=True)
class Window:
    """Range of the receiver."""

    straightness: float
    """Largest distance of the beam from the centre [mm]"""
    angle: float
    """Largest pitch and yaw [rad]"""


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of the location and of the commanded angles when a line is measured."""

    location: Array
    """Covariance of x y z gamma, (4, 4)"""
    encoder: float
    """Standard deviation of each commanded angle [rad]"""

    def without_location(self) -> Uncertainty:
        """Return the uncertainty that remains if the place and gamma are known exactly."""
        return Uncertainty(np.zeros_like(self.location), self.encoder)

    def draws(self) -> Array:
        """Return random errors of x y z gamma phi1 phi2 phi3 phi4, (8, n)."""
        standard = standard_draws()
        values, vectors = np.linalg.eigh(self.location)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        return np.concatenate([root @ standard[:4], self.encoder * standard[4:]])


@cache
def standard_draws() -> Array:
    """Return standard normal numbers (8, n), always the same ones so that plans are comparable."""
    draws = np.random.default_rng(20220704).normal(size=(8, _DRAWS))
    draws.setflags(write=False)
    return draws


def beam_errors(line: ReceiverLine) -> tuple[Array, Array, Array]:
    """Return the derivatives of the beam's offset at the unit, its direction, and the angles at the receiver.

    Each is (2, 8): beside and above the line, by x y z gamma phi1..phi4. If the encoders aim the beam along the line,
    it is off by `offset + s direction` at the distance s from the unit. The receiver sees it under the angle
    `direction` minus the error of its own encoders.
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
    """Monte Carlo simulation of the distance up to which the beam of one line stays in range."""

    line: ReceiverLine
    window: Window
    errors: Array
    """Random errors of x y z gamma phi1..phi4, (8, n)"""

    @cached_property
    def in_range_to(self) -> Array:
        """The distance up to which the beam, aimed by the encoders, stays in range, for each draw (n,).

        `|offset + s direction|` is convex in s. A beam in range at the nearest point thus stays so up to the larger
        root of `|offset + s direction| = radius`. The distance is 0 if the beam is out of range at the nearest point.
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
        """Return the probability that the beam stays in range up to a distance, or along the whole line if None."""
        return float((self.in_range_to >= (self.line.distance.max() if distance is None else distance)).mean())

    def safe_distance(self, confidence: float) -> float:
        """Return the distance [mm] up to which the beam stays in range with this probability."""
        return float(np.quantile(self.in_range_to, 1 - confidence, method="lower"))

    def probability_aligned(self) -> float:
        """Return the probability that the beam stays in range after both units are aligned by the receiver's readings.

        The alignment is done at the far end L. The beam then passes through the unit and that point, and is off by
        `offset (1 - s/L)` (Kuprin et al. fig. 15).
        """
        offset = beam_errors(self.line)[0] @ self.errors
        share = 1 - self.line.distance.min() / self.line.distance.max()
        return float((np.linalg.norm(share * offset, axis=0) <= self.window.straightness).mean())


def beam_position(line: ReceiverLine, uncertain: Uncertainty, distance: float) -> Array:
    """Return the covariance (2, 2) of the beam's position, beside and above the line, at a distance from the unit."""
    offset, turn, _ = beam_errors(line)
    by = offset + distance * turn
    whole = np.zeros((8, 8))
    whole[:4, :4] = uncertain.location
    whole[np.arange(4, 8), np.arange(4, 8)] = uncertain.encoder**2
    return np.asarray(by @ whole @ by.T)


_GRID = 5
"""Number of candidates along each axis"""
_MOST = 12
"""Largest number of poses to add"""


@dataclass(frozen=True)
class Further:
    """A pose to add, given that those before it in the list are added too."""

    receiver: Array
    """Position of the receiver, (3,)"""
    location: Array
    """Covariance of x y z gamma with this pose, (4, 4)"""


@dataclass(frozen=True)
class SafetyRequirements:
    """The lines that the poses must make safe, the range of the receiver, and the probability that counts as safe."""

    lines: Sequence[ReceiverLine]
    window: Window
    confidence: float

    def worst(self, uncertain: Uncertainty) -> float:
        """Return the probability that the beam stays in range along the least certain line, aimed by the encoders."""
        errors = uncertain.draws()
        return min(Margin(line, self.window, errors).probability() for line in self.lines)

    def worst_aligned(self, uncertain: Uncertainty) -> float:
        """Return the same probability after the units are aligned at the far end of the line."""
        errors = uncertain.draws()
        return min(Margin(line, self.window, errors).probability_aligned() for line in self.lines)

    def variance(self, locations: Array) -> Array:
        """Return the largest variance of a beam at the far end of any line, (n,), due to the location (n, 4, 4)."""
        variances = []
        for line in self.lines:
            offset, turn, _ = beam_errors(line)
            by = (offset + line.distance.max() * turn)[:, :4]
            variances.append(np.einsum("ai,nij,aj->n", by, locations, by))
        return np.asarray(np.max(variances, axis=0))


def candidates(place: Array, reach: Reach) -> Array:
    """Return a grid of receiver positions within reach of the unit, without beams near vertical, (n, 3)."""
    axes = [np.linspace(low, high, _GRID) for low, high in reach.box]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    away = np.linalg.norm(grid - place, axis=1)
    level = np.hypot(grid[:, 0] - place[0], grid[:, 1] - place[1]) > reach.nearest / 10
    return np.asarray(grid[(away >= reach.nearest) & (away <= reach.farthest) & level])


def information(values: Array, receivers: Array, noise: LaunchUnitNoise, distances: bool) -> Array:
    """Return the information on x y z gamma from an aligned pose at each place, `J' W J`, (n, 4, 4)."""
    spindle = np.zeros(len(receivers))
    angles, length = aligned(values[:3], values[3], receivers, spindle)
    distance = length if distances else np.full(len(receivers), np.nan)
    names = tuple(str(i) for i in range(len(receivers)))
    problem = build(AlignedPoses(names, receivers, np.zeros_like(receivers), spindle, angles, distance, {}), noise)
    total = np.zeros((len(receivers), len(values), len(values)))
    for group in problem.groups:
        for touch in group.linear(problem.blocks, frozenset({lu.UNIT})).touches:
            rows = group.observations.index[lu.RECEIVER]
            total[rows] += np.einsum("din,djn->nij", touch.jacobian, touch.jacobian)
    return total


def further(location: Array, wanted: SafetyRequirements, encoder: float, places: Array, gained: Array) -> list[Further]:
    """Return the poses to add until the least certain line is safe, at most 12.

    Each reduces the variance of the least certain beam at its far end the most. location is (4, 4); places (n, 3) are
    the candidates and gained (n, 4, 4) their information.
    """
    known, chosen = np.linalg.inv(location), list[Further]()
    while len(chosen) < _MOST and wanted.worst(Uncertainty(np.linalg.inv(known), encoder)) < wanted.confidence:
        locations = np.asarray(np.linalg.inv(known + gained), dtype=float)
        best = int(np.argmin(wanted.variance(locations)))
        known = known + gained[best]
        chosen.append(Further(places[best], locations[best]))
    return chosen
