"""Effects on angles that encoders and trackers read."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from metrocli.adjust.model.chain import Local, Step, through
from metrocli.adjust.model.quantities import AtQuantity, OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.effects.acting import components
from metrocli.effects.effect import ELAPSED
from metrocli.effects.links.own import OwnTerms
from metrocli.expressions.expression import parse
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class EncoderOffset(AtQuantity):
    """Zero error of one encoder: `phi += offset` for one of the two angles; column offset [rad]."""

    component: int

    def step(self, value: Array, local: Local) -> Step:
        """Return the angles (2, n)."""
        by_block = np.zeros((2, 1, 1))
        by_block[self.component] = 1.0
        return Step(value + local.rows(self.block) * by_block[:, 0], np.eye(2)[:, :, None], {self.block: by_block})


@dataclass(frozen=True)
class EncoderLag(AtQuantity):
    """Lag of one encoder by its direction: `phi -= s width/2`, s the `direction`; column width [rad]."""

    component: int
    direction: str
    """Condition: 1 where the angle grew, -1 where it fell, 0 if it never moves"""

    def step(self, value: Array, local: Local) -> Step:
        """Return the angles (2, n)."""
        by_block = np.zeros((2, 1, value.shape[1]))
        by_block[self.component, 0] = -local.observations.conditions[self.direction] / 2
        return Step(value + local.rows(self.block) * by_block[:, 0], np.eye(2)[:, :, None], {self.block: by_block})


@dataclass(frozen=True)
class Harmonic(AtQuantity):
    """A harmonic of one encoder: `phi += c cos k phi + s sin k phi` for one of two angles; columns c, s [rad].

    k = 1 is an eccentric disc, k = 2 an oval or bent one.
    """

    component: int
    order: int = 1

    def step(self, value: Array, local: Local) -> Step:
        """Return the angles (2, n)."""
        c, s = local.rows(self.block)
        angle, n = self.order * value[self.component], value.shape[1]
        cos, sin = np.cos(angle), np.sin(angle)
        moved = value.copy()
        moved[self.component] += c * cos + s * sin
        by_angles = np.tile(np.eye(2)[:, :, None], n)
        by_angles[self.component, self.component] += self.order * (s * cos - c * sin)
        by_block = np.zeros((2, 2, n))
        by_block[self.component] = cos, sin
        return Step(moved, by_angles, {self.block: by_block})


@dataclass(frozen=True)
class NonOrthogonality(AtQuantity):
    """The tilt axis is not square to the base axis: `base += angle tan(tilt)`; column angle [rad]."""

    def step(self, value: Array, local: Local) -> Step:
        """Return the angles (2, n)."""
        angle, n = local.rows(self.block)[0], value.shape[1]
        tangent = np.tan(value[1])
        by_angles = np.tile(np.eye(2)[:, :, None], n)
        by_angles[0, 1] = angle * (1 + tangent**2)
        by_block = np.zeros((2, 1, n))
        by_block[0, 0] = tangent
        return Step(np.stack([value[0] + angle * tangent, value[1]]), by_angles, {self.block: by_block})


@dataclass(frozen=True)
class BaseTilt(AtQuantity):
    """The base axis is `Rx(tx) Ry(ty) z`, so the unit sees a beam b as `Ry(-ty) Rx(-tx) b`; columns tx, ty [rad]."""

    def step(self, value: Array, local: Local) -> Step:
        """Return the beam (3, n)."""
        tx, ty = local.rows(self.block)[:, 0]
        cx, sx, cy, sy = np.cos(tx), np.sin(tx), np.cos(ty), np.sin(ty)
        about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
        about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
        first = about_x @ value
        x, y, z = first
        seen = about_y @ first
        by_tx = about_y @ np.stack([np.zeros_like(y), z, -y])
        by_ty = np.stack([-sy * x - cy * z, np.zeros_like(y), cy * x - sy * z])
        by_beam = through(about_y[:, :, None], about_x[:, :, None])
        return Step(seen, by_beam, {self.block: np.stack([by_tx, by_ty], axis=1)})


POLAR = ("distance", "azimuth", "elevation")
"""What a tracker reads, in its own frame; the azimuth is `atan2(y, x)`, the elevation `atan2(z, sqrt(x^2 + y^2))`"""
_VARIABLES = components(POLAR, ("mm", "rad", "rad"))


@dataclass(frozen=True)
class TrackerReadings(OfBlock):
    """A tracker's distance, azimuth and elevation (mm, rad) are off by sums of terms in parameters and these three.

    The point seen in them moves by as much. Derivatives are exact: those of the terms, between those of the change to
    distance and angles and back. Points on the tracker's vertical axis have no azimuth.
    """

    name: str
    """Name of the effect, for messages"""
    adds: tuple[tuple[str, str], ...]
    """Which of the three, and what is added to it, such as `angle*tan(elevation)`"""
    parameters: tuple[str, ...]
    takes = gives = Quantity.POINT_IN_TRACKER

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n)."""
        polar, to_polar = _polar(value)
        moved = _terms(self).step(polar, local)
        before, _ = _cartesian(polar)
        after, back = _cartesian(moved.value)
        by_input = through(through(back, np.asarray(moved.by_input)), to_polar)
        # as a difference the effect adds exactly nothing where its parameters are 0
        return Step(value + (after - before), by_input, {self.block: through(back, moved.by_block[self.block])})


@lru_cache(maxsize=64)
def _terms(link: TrackerReadings) -> OwnTerms:
    """Return the terms of a link, parsed once."""
    adds = tuple((POLAR.index(which), parse(text)) for which, text in link.adds)
    return OwnTerms(link.block, link.gives, link.name, adds, link.parameters, (), _VARIABLES)


def tracker_readings(block: str, name: str, parameters: tuple[str, ...], adds: Mapping[str, str]) -> TrackerReadings:
    """Return the link of an effect that adds terms to some of distance, azimuth and elevation."""
    return TrackerReadings(block, name, tuple(adds.items()), parameters)


def _polar(point: Array) -> tuple[Array, Array]:
    """Return distance, azimuth and elevation (3, n) of points (3, n), and their derivatives (3, 3, n)."""
    x, y, z = point
    level, distance = np.hypot(x, y), np.linalg.norm(point, axis=0)
    by_point = np.zeros((3, 3, len(x)))
    by_point[0] = point / distance
    by_point[1, 0], by_point[1, 1] = -y / level**2, x / level**2
    by_point[2] = np.stack([-x * z / level, -y * z / level, level]) / distance**2
    return np.stack([distance, np.arctan2(y, x), np.arctan2(z, level)]), by_point


def _cartesian(polar: Array) -> tuple[Array, Array]:
    """Return points (3, n) of distance, azimuth and elevation (3, n), and their derivatives (3, 3, n)."""
    distance, azimuth, elevation = polar
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    zero = np.zeros_like(distance)
    beam, left, up = np.stack([ce * ca, ce * sa, se]), np.stack([-sa, ca, zero]), np.stack([-se * ca, -se * sa, ce])
    return distance * beam, np.stack([beam, distance * ce * left, distance * up], axis=1)


@dataclass(frozen=True)
class TrackerMoves(OfBlock):
    """The tracker drifts by `v t` along the machine's axes; columns vx, vy, vz [mm/s]."""

    takes = gives = Quantity.POINT_IN_MACHINE

    def step(self, value: Array, local: Local) -> Step:
        """Return the point (3, n), displaced by `-v t`, since the readings depend only on the relative position."""
        elapsed = local.observations.conditions[ELAPSED]
        moved = value - local.rows(self.block) * elapsed
        return Step(moved, np.eye(3)[:, :, None], {self.block: -np.eye(3)[:, :, None] * elapsed})
