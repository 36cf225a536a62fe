"""Axes that count backwards: lengths fit the mirror image of a machine, whose stations are mirrored as well.

Tools that differ along the axis show it, and so do rough places of the stations in a list.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import Fault, InputError
from metrocli.instruments.machine import AXES, TOOL
from metrocli.tasks.calibrate_machine.settings import LENGTHS, Settings
from metrocli.tasks.calibrate_machine.tables import Tables
from metrocli.tasks.calibrate_machine.volume import grid_group, grid_of, without_rigid_motion
from metrocli.tasks.shared.tracers import LengthsToTracers

_NEARER = 0.25
"""The median distance of stations from their list has to fall below this share of itself when they are mirrored"""


def refuse_backwards(measured: Array, seen: LengthsToTracers) -> None:
    """Raise InputError if places of stations (n, 3) are near their list only with one axis mirrored about its middle.

    The middle is that of the reflectors, which tools carry away from the axes.

    Only places listed without a standard uncertainty are compared: the others are kept.
    """
    listed_at, sigma = seen.tracers.listed_at, seen.tracers.sigma
    rough = np.isfinite(listed_at).all(axis=1) & np.isnan(sigma).all(axis=1)
    if not rough.any():
        return
    measured, listed_at = measured[rough], listed_at[rough]
    twice = seen.points.min(axis=0) + seen.points.max(axis=0)
    mirrored = [_miss(np.where(np.arange(3) == axis, twice - measured, measured), listed_at) for axis in range(3)]
    axis = int(np.argmin(mirrored))
    if mirrored[axis] < _NEARER * _miss(measured, listed_at):
        raise InputError([_fault(AXES[axis], _miss(measured, listed_at), mirrored[axis], seen.file)])


def _miss(measured: Array, listed_at: Array) -> float:
    return float(np.median(np.linalg.norm(measured - listed_at, axis=1)))


def _fault(axis: str, as_read: float, mirrored: float, file: str) -> Fault:
    text = (
        f"the lengths place the stations {as_read:.0f} mm from their list, "
        f"and {mirrored:.0f} mm from it if {axis} counts the other way"
    )
    return Fault(text, file, hint=f"reverse the sense of {axis.lower()} in this file, or in the list of the stations")


def unseen_senses(tables: Tables, settings: Settings) -> dict[str, float]:
    """Return the axes whose sense no length shows, each with the change of the error in the volume [mm].

    It is `max |S e(S x) - e(x)|` with the mirror S of the axis about its middle, without shift and rotation of the
    whole.
    """
    if settings.method != LENGTHS or settings.inputs.stations is not None or tables.machine.turns:
        return {}
    counts = settings.volume.counts()
    position = grid_of(tables.machine, counts)
    motion = _error(tables, position)
    vectors = tables.blocks[TOOL].values
    alike = np.ptp(vectors, axis=0) <= settings.machine.tool_std
    backwards = {axis: _mirrored(motion, counts, axis) for axis in np.flatnonzero(alike).tolist()}
    return {AXES[axis]: _largest(mirrored - motion, position) for axis, mirrored in backwards.items()}


def _error(tables: Tables, position: Array) -> Array:
    """Return the error motion of the first tool at positions (3, n), (6, n)."""
    group = grid_group(tables.machine, position, 0)
    return group.chain.predict(tables.blocks, group.observations)


def _mirrored(motion: Array, counts: Sequence[int], axis: int) -> Array:
    """Return the error motion (6, n) on a grid of the machine of which an axis is mirrored about its middle."""
    mirrored = np.flip(motion.reshape(-1, *counts), axis + 1).reshape(motion.shape)
    mirrored[axis] *= -1
    return mirrored


def _largest(change: Array, position: Array) -> float:
    return float(np.linalg.norm(without_rigid_motion(change, position), axis=0).max())
