"""Choice of further poses that make the measuring lines safer, and the number needed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.frozen import dataclass
from metrocli.instruments import launch_unit as lu
from metrocli.tasks.locate_launch_unit.lines import Line, Reach
from metrocli.tasks.locate_launch_unit.margin import Margin, Uncertainty, Window, beam_errors
from metrocli.tasks.locate_launch_unit.problem import build
from metrocli.tasks.locate_launch_unit.readings import Readings
from metrocli.tasks.locate_launch_unit.settings import Noise
from metrocli.tasks.locate_launch_unit.simulation import aligned

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
class Wanted:
    """The lines that the poses must make safe, the range of the receiver, and the probability that counts as safe."""

    lines: Sequence[Line]
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


def information(values: Array, receivers: Array, noise: Noise, distances: bool) -> Array:
    """Return the information on x y z gamma from an aligned pose at each place, `J' W J`, (n, 4, 4)."""
    spindle = np.zeros(len(receivers))
    angles, length = aligned(values[:3], values[3], receivers, spindle)
    distance = length if distances else np.full(len(receivers), np.nan)
    names = tuple(str(i) for i in range(len(receivers)))
    problem = build(Readings(names, receivers, np.zeros_like(receivers), spindle, angles, distance, {}), noise)
    total = np.zeros((len(receivers), len(values), len(values)))
    for group in problem.groups:
        for touch in group.linear(problem.blocks, frozenset({lu.UNIT})).touches:
            rows = group.observations.index[lu.RECEIVER]
            total[rows] += np.einsum("din,djn->nij", touch.jacobian, touch.jacobian)
    return total


def further(location: Array, wanted: Wanted, encoder: float, places: Array, gained: Array) -> list[Further]:
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
