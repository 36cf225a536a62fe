"""Other meanings of the columns of poses, where the readings fit no place of the unit as they stand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np

from metrocli.instruments import launch_unit as lu
from metrocli.tasks.locate_launch_unit.problem import WEAK, build, uncertainty_along
from metrocli.tasks.locate_launch_unit.readings import ANGLES, AlignedPoses
from metrocli.tasks.locate_launch_unit.settings import LaunchUnitNoise
from metrocli.units import parse_quantity

_FITS = 30.0
"""Root mean square residual at the start, in standard deviations, below which a meaning of the columns fits"""
_ALIKE = 1.5
"""Meanings of the columns whose residuals differ by less than this factor fit equally well"""


def misread(readings: AlignedPoses, noise: LaunchUnitNoise) -> tuple[str, ...]:
    """Return the likely contents of the columns, the best first.

    The tuple is empty if the columns fit as labelled, or if no other meaning of them fits.
    """
    with np.errstate(all="ignore"):
        if misfit(readings, noise) <= _FITS:
            return ()
        fits = [(misfit(other, noise), text) for text, other in _others(readings)]
    best = min(value for value, _ in fits)
    return tuple(text for value, text in sorted(fits) if value <= min(_FITS, _ALIKE * best))


def misfit(readings: AlignedPoses, noise: LaunchUnitNoise) -> float:
    """Return the root mean square of the normalised residuals of the angles; inf if the beams do not meet."""
    if uncertainty_along(readings, noise) > WEAK:
        return float("inf")
    problem = build(readings, noise)
    ahead = np.einsum("ni,ni->n", readings.beams.towards, problem.blocks[lu.UNIT].values[0, :3] - readings.receiver)
    angles = [group for group in problem.groups if group.name != lu.DISTANCE]
    if not angles or (ahead <= 0).any():
        return float("inf")
    whitened = [group.observations.whitened(group.residuals(problem.blocks)) for group in angles]
    return float(np.nan_to_num(np.sqrt(np.mean(np.concatenate(whitened, axis=None) ** 2)), nan=np.inf))


def _others(readings: AlignedPoses) -> Iterator[tuple[str, AlignedPoses]]:
    degree = parse_quantity("1 deg", "angle")
    angles, spindle = readings.angles, readings.spindle
    gon = parse_quantity("1 gon", "angle") / degree
    units = (("radians, not degrees", 1 / degree), ("degrees, not radians", degree), ("gon, not degrees", gon))
    for text, factor in units:
        yield f"the encoder columns hold {text}", replace(readings, angles=angles * factor)
        yield (
            f"the encoder columns and the spindle's hold {text}",
            replace(readings, angles=angles * factor, spindle=spindle * factor),
        )
        yield f"the spindle's column holds {text}", replace(readings, spindle=spindle * factor)
    for order in permutations(range(len(ANGLES))):
        moved = [ANGLES[i] for i, at in enumerate(order) if i != at]
        if moved:
            what = f"{' and '.join(moved)} are swapped" if len(moved) == 2 else f"{', '.join(moved)} are mixed up"
            yield f"the columns {what}", replace(readings, angles=angles[list(order)])
    for size in (1, 2, 3):
        for chosen in combinations(range(len(ANGLES)), size):
            sign = np.where(np.isin(np.arange(len(ANGLES)), chosen), -1.0, 1.0)[:, None]
            names = " and ".join(ANGLES[i] for i in chosen)
            yield f"{names} count the other way round", replace(readings, angles=angles * sign)
    yield "the spindle's angle counts the other way round", replace(readings, spindle=-spindle)
    # the mirror image that the encoders alone give too: the readings cannot distinguish it
    yield "z has the wrong sign", replace(readings, receiver=readings.receiver * [1.0, 1.0, -1.0])
    back = angles * np.array([1.0, 1.0, -1.0, 1.0])[:, None] + np.array([0.0, 0.0, 0.0, np.pi])[:, None]
    yield (
        "phi3 and phi4 describe the beam as it travels, from the launch unit to the receiver (the mirror solution); "
        "they must describe the direction from the receiver to the launch unit",
        replace(readings, angles=back),
    )
