"""Overstock of measured points over the ideal part, as a function of where the part lies, with both derivatives.

A step (u, v) of the pose moves the points in the part frame, `X' = Exp(v/L) (X - c) + c + u`. Here c is their centre
and L their root mean square distance from it, so that all six components are lengths of like effect.
Method: docs/algorithms/overstock-fit.md.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Protocol

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.geometry.rotations import cross_matrix, rotation_from_vector
from metrocli.geometry.surfaces import Shape


class Nominal(Protocol):
    """The ideal geometry of a part."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its surfaces."""

    def shape(self, points: Array, surface: Index) -> Shape:
        """Return distance, normal and curvature at points (n, 3), each on the surface of its index (n,)."""

    def smooth_normals(self, points: Array, surface: Index) -> Array:
        """Return the normals at points (n, 3) of the smooth surface that the geometry stands for."""

    def apart(self) -> Apart | None:
        """Return the geometry in which no surface holds points of another, and each goes on beyond its edges.

        None where this one is.
        """


class Apart(Nominal, Protocol):
    """An ideal geometry in which no surface holds points of another."""

    def beside(self, points: Array, surface: Index, limit: float) -> tuple[Index, Index]:
        """Return pairs (k,) of a point (n, 3) and another surface that may be within a limit of it."""


@dataclass(frozen=True)
class LinearStock:
    """The overstock near one pose."""

    points: Array
    """In the part frame (n, 3)"""
    shape: Shape
    centre: Array
    lever: float

    @property
    def overstock(self) -> Array:
        """Signed distance of each point from the ideal surface (n,) [mm]."""
        return self.shape.distance

    @property
    def movement(self) -> Array:
        """Derivative of each point by the step of the pose, (n, 3, 6)."""
        return self.movement_of(self.points)

    def movement_of(self, places: Array) -> Array:
        """Return the derivative of places (n, 3) of the part frame by the step of the pose, (n, 3, 6)."""
        turned = -cross_matrix(places - self.centre) / self.lever
        return np.concatenate([np.broadcast_to(np.eye(3), turned.shape), turned], axis=2)

    @cached_property
    def rows(self) -> Array:
        """Derivative of each overstock by the step of the pose, (n, 6)."""
        return self.rows_along(self.shape.normal)

    def rows_along(self, directions: Array) -> Array:
        """Return the derivative of `directions . X` by the step, directions (n, 3) -> (n, 6)."""
        return np.concatenate([directions, np.cross(self.points - self.centre, directions) / self.lever], axis=1)

    def turning(self, directions: Array) -> Array:
        """Return the second derivative of `sum directions . X` by the step, (6, 6).

        From `Exp(w) r = r + w x r + w x (w x r)/2`: the part in w is `(d r' + r d')/2 - (d.r) I`.
        """
        arms = self.points - self.centre
        both = directions.T @ arms
        second = np.zeros((6, 6))
        second[3:, 3:] = ((both + both.T) / 2 - np.trace(both) * np.eye(3)) / self.lever**2
        return second

    def curvature(self, weights: Array) -> Array:
        """Return the second derivative of `sum weights o` by the step of the pose, weights (n,) -> (6, 6)."""
        used = np.flatnonzero(weights)
        bend, moves = self.shape.bend[used] * weights[used, None, None], self.movement_of(self.points[used])
        bent: Array = moves.reshape(-1, 6).T @ (bend @ moves).reshape(-1, 6)
        return bent + self.turning(self.shape.normal * weights[:, None])

    def of(self, rows: Mask) -> LinearStock:
        """Return some of the points, with the same centre and lever."""
        return replace(self, points=self.points[rows], shape=self.shape.of(np.flatnonzero(rows)))

    def moved(self, to_part: Array, step: Array) -> Array:
        """Return a pose into the part frame (6,) after a step (6,)."""
        turn = rotation_from_vector(step[3:] / self.lever)
        shift = turn @ (to_part[:3] - self.centre) + self.centre + step[:3]
        return poses.pose(turn @ poses.rotation_of(to_part), shift)


@dataclass(frozen=True)
class Stock:
    """Measured points of a raw part and the ideal part."""

    nominal: Nominal
    measured: Array
    """(n, 3) in the measured frame [mm]"""
    surface: Index
    """Index of the surface of each point (n,)"""

    def at(self, to_part: Array) -> LinearStock:
        """Return the overstock where `to_part` (6,) brings the measured points into the part frame."""
        points = poses.apply(to_part, self.measured)
        centre = points.mean(axis=0)
        # a single point has no arm, and no turn that moves it
        lever = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean())) or 1.0
        return LinearStock(points, self.nominal.shape(points, self.surface), centre, lever)

    def smooth_rows(self, local: LinearStock) -> Array:
        """Return the derivative of each overstock by the step, (n, 6), but for what the facets of a mesh bring."""
        return local.rows_along(self.nominal.smooth_normals(local.points, self.surface))

    def of(self, rows: Index | Mask) -> Stock:
        """Return the stock of some of the points."""
        return replace(self, measured=self.measured[rows], surface=self.surface[rows])
