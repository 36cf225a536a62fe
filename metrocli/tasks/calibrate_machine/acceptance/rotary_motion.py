"""Error motion of rotary axes from their tables, as ISO 230-7 names it: radial, axial and tilt, with uncertainty."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.axes.rotary import RotaryAxis
from metrocli.instruments.machine import ANGLES, AXES, errors_of
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.acceptance.positioning import COVERAGE
from metrocli.tasks.calibrate_machine.tables import Tables


@dataclass(frozen=True)
class _Motion:
    """A motion of the turning part as a combination of the entries of tables."""

    axis: str
    name: str
    direction: str
    errors: tuple[str, ...]
    unit: str
    weights: Array
    """Of the tables of `errors` at each knot, (knots, errors)"""


def rotary_motion(tables: Tables, known: Collection[str]) -> dict[str, Table]:
    """Return the range of each error motion of the rotary axes with U (k = 2), of the errors that are known.

    The motion is that of the turning part: E of a head, -E of a table. In a rotating sensitive direction, that of a
    tool or a workpiece that turns with it, it is `E_X cos s + E_Y sin s` with the turn s of the turning part. Constants
    and what turns once are the place of the axis and the centring of the ball; the tables do not have them.
    Source: ISO 230-7:2015, 3.5 (radial, axial, tilt error motion; fixed and rotating sensitive direction).
    """
    axes = [axis for axis in tables.machine.axes if isinstance(axis, RotaryAxis)]
    motions = [motion for axis in axes for motion in _motions(axis) if set(motion.errors) <= set(known)]
    if not motions:
        return {}
    rows = [_range(tables, motion) for motion in motions]
    columns = {
        "axis": [motion.axis for motion in motions],
        "motion": [motion.name for motion in motions],
        "direction": [motion.direction for motion in motions],
        "errors": [" ".join(motion.errors) for motion in motions],
        "unit": [motion.unit for motion in motions],
    }
    return {"rotary_motion": Table.of({**columns, "low high range U_range": np.array(rows)})}


def _motions(axis: RotaryAxis) -> Iterator[_Motion]:
    """Yield the motions of an axis: radial and tilt in both fixed directions and in the rotating one, and axial."""
    i, n = axis.number, len(axis.knots)
    sign = 1.0 if axis.head else -1.0
    turn = sign * axis.sense * axis.knots
    j, k = (i + 1) % 3, (i + 2) % 3
    rotating = sign * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    for name, kinds, unit in (("radial", AXES, "mm"), ("tilt", ANGLES, "rad")):
        for across in (j, k):
            yield _Motion(
                axis.letter, name, kinds[across], (f"E{kinds[across]}{axis.letter}",), unit, np.full((n, 1), sign)
            )
        both = tuple(f"E{kinds[across]}{axis.letter}" for across in (j, k))
        yield _Motion(axis.letter, name, "rotating", both, unit, rotating)
    yield _Motion(axis.letter, "axial", AXES[i], (errors_of(axis.letter)[i],), "mm", np.full((n, 1), sign))


def _range(tables: Tables, motion: _Motion) -> tuple[float, float, float, float]:
    """Return the least and the largest value of a motion over the knots, its range, and U of this."""
    at = np.array([[i for i, (error, _) in enumerate(tables.entries) if error == name] for name in motion.errors]).T
    values = (motion.weights * tables.values[at]).sum(axis=1)
    low, high = int(np.argmin(values)), int(np.argmax(values))
    rows, change = np.concatenate([at[high], at[low]]), np.concatenate([motion.weights[high], -motion.weights[low]])
    variance = float(change @ tables.covariance[np.ix_(rows, rows)] @ change)
    size = float(values[high] - values[low])
    return float(values[low]), float(values[high]), size, COVERAGE * float(np.sqrt(max(variance, 0.0)))
