"""Find the pose of the tracker from points in both frames, and explain why points do not match."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.errors import Fault, InputError
from metrocli.geometry import poses

_FAR = 0.02
"""Largest median misfit as a share of the extent of the points; errors of machines are far smaller"""
_UNITS = (1e3, 1e-3, 25.4, 1 / 25.4)
_NEAR = 0.05
"""Relative difference of extents up to which a unit explains them"""
MIRRORED = "the tracker's frame is left-handed: two of mx, my, mz are swapped, or one of them has the wrong sign"
"""Hint for measured points that are a mirror image; both causes look the same, since the frame is estimated"""


def tracker_pose(measured: Array, nominal: Array, file: str) -> Array:
    """Return the pose of the tracker in the machine, (6,), from points (3, n).

    Raises InputError if the points do not match.
    """
    pose = np.asarray(poses.fit_pose(measured.T, nominal.T))
    if matches(pose, measured, nominal):
        return pose
    raise InputError([mismatch(measured, nominal, file)])


def matches(pose: Array, measured: Array, nominal: Array) -> bool:
    """Return whether most of the aligned points are as close to their nominal places as machine errors allow."""
    return miss(pose, measured, nominal) < _FAR * extent(nominal)


def miss(pose: Array, measured: Array, nominal: Array) -> float:
    """Return the median distance of the aligned points from their nominal places."""
    return float(np.median(np.linalg.norm(poses.apply(pose, measured.T) - nominal.T, axis=1)))


def extent(points: Array) -> float:
    """Return the root mean square distance of points (3, n) from their centre."""
    return float(np.sqrt(((points - points.mean(axis=1, keepdims=True)) ** 2).sum(axis=0).mean()))


def wrong_unit(measured: Array, nominal: Array) -> float | None:
    """Return the factor that corrects measured lengths if their unit is clearly wrong (m, inch), else None."""
    ratio = extent(nominal) / max(extent(measured), 1e-300)
    return next((unit for unit in _UNITS if abs(ratio / unit - 1) < _NEAR), None)


def mismatch(measured: Array, nominal: Array, file: str) -> Fault:
    """Return why measured points (3, n) do not match their nominal places: unit, mirror image or shape."""
    unit = wrong_unit(measured, nominal)
    if unit is not None:
        text = f"the measured coordinates are {1 / unit:.4g} times as large as the commanded ones"
        return Fault(text, file, hint="is their unit right? a column mx_m or x_m is in metres")
    mirrored = measured * [[1.0], [1.0], [-1.0]]
    if matches(poses.fit_pose(mirrored.T, nominal.T), mirrored, nominal):
        text = "the measured points are a mirror image of the commanded ones"
        return Fault(text, file, hint=MIRRORED)
    off = miss(poses.fit_pose(measured.T, nominal.T), measured, nominal)
    text = f"the measured points do not have the shape of the commanded ones: {off:.3g} mm off after the best alignment"
    return Fault(text, file, hint="is this the measurement of another path or list, or are rows missing or reordered?")
