"""Locate a launch unit by the two closed solutions of Kuprin et al.; the adjustment starts from them."""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.instruments.launch_unit import direction


@dataclass(frozen=True)
class Beams:
    """The readings of receiver and launch unit in n poses; angles in rad, lengths in mm."""

    receiver: Array
    """Control points r of the receiver, (n, 3)"""
    base: Array
    """Base angle psi + phi4 of the receiver, (n,)"""
    tilt: Array
    """Tilt angle phi3 of the receiver, (n,)"""
    launch_base: Array
    """Base angle phi1 of the launch unit, for phi2 within +-90 degrees, (n,)"""
    distance: Array
    """Distance l of the control points, (n,); nan if not measured"""

    @property
    def towards(self) -> Array:
        """Unit vectors u from each receiver to the launch unit, (n, 3)."""
        return direction(self.base, self.tilt)

    @property
    def measured(self) -> Array:
        """Whether each pose has a distance, (n,)."""
        return np.isfinite(self.distance)


@dataclass(frozen=True)
class Meeting:
    """A place of the launch unit, and its derivatives by the readings."""

    place: Array
    """p, (3,)"""
    by_base: Array
    """dp / d(phi4), (n, 3)"""
    by_tilt: Array
    """dp / d(phi3), (n, 3)"""
    by_distance: Array
    """dp / dl, (n, 3)"""
    by_receiver: Array
    """dp / dr, (n, 3, 3), of which the last index is that of r"""


def across(towards: Array) -> Array:
    """Return the projectors `I - u u'` perpendicular to beams (n, 3), (n, 3, 3)."""
    return np.eye(3) - towards[:, :, None] * towards[:, None, :]


def spread(beams: Beams) -> float:
    """Return how much the beams differ in direction: the RMS sine of their angles to the best common direction."""
    smallest = float(np.linalg.eigvalsh(across(beams.towards).sum(axis=0))[0])
    return float(np.sqrt(max(smallest, 0.0)))


def lines(beams: Beams) -> Meeting:
    """Return the point nearest to all beams by least squares (Kuprin et al. eq. 5-6).

    `p = (sum M)^-1 sum M r`, `M = I - u u'`. Eq. 6 sums the distances, but the paper solves it by QR, which minimises
    their squares. The derivatives hold if the beams meet: a rotation du of a beam of length t moves its line by t du.
    """
    towards = beams.towards
    square = across(towards)
    inverse = np.linalg.inv(square.sum(axis=0))
    place = inverse @ np.einsum("nij,nj->i", square, beams.receiver)
    length = np.einsum("ni,ni->n", towards, place - beams.receiver)
    by_base, by_tilt = (turn * length[:, None] @ inverse for turn in _turns(beams))
    return Meeting(place, by_base, by_tilt, np.zeros_like(towards), inverse @ square)


def closed_loop(beams: Beams) -> Meeting:
    """Return the mean of the ends of the beams, `p = mean(r + l u)` (Kuprin et al. eq. 1-4).

    Eq. 1 as printed ends each loop in the control point of the launch unit. This does not depend on the unit's angles,
    so that the result does not contain gamma.
    """
    has = beams.measured
    length, n = np.where(has, beams.distance, 0.0), int(has.sum())
    towards = beams.towards
    place = (beams.receiver + length[:, None] * towards)[has].mean(axis=0)
    by_base, by_tilt = (turn * length[:, None] / n for turn in _turns(beams))
    by_receiver = np.where(has[:, None, None], np.eye(3), 0.0) / n
    return Meeting(place, by_base, by_tilt, np.where(has[:, None], towards, 0.0) / n, by_receiver)


def nearest(beams: Beams) -> Array:
    """Return the place (3,) that fits all beams best: beams with a distance count as points, others as lines."""
    towards, has = beams.towards, beams.measured
    # a point holds all three directions, a line the two across it
    square = np.where(has[:, None, None], np.eye(3), across(towards))
    ends = beams.receiver + np.where(has, beams.distance, 0.0)[:, None] * towards
    return np.asarray(np.linalg.solve(square.sum(axis=0), np.einsum("nij,nj->i", square, ends)))


def set_up_angle(beams: Beams) -> float:
    """Return gamma, the circular mean of the beam's azimuth at the launch unit minus phi1.

    The paper takes the arithmetic mean, which is wrong if the differences lie on both sides of +-180 degrees.
    """
    towards = beams.towards
    # minus u: the beam leaves the unit against the direction in which the receiver looks
    difference = np.arctan2(-towards[:, 1], -towards[:, 0]) - beams.launch_base
    # the mean of angles is that of their directions (docs/instruments/launch-unit.md)
    return float(np.arctan2(np.sin(difference).mean(), np.cos(difference).mean()))


def _turns(beams: Beams) -> tuple[Array, Array]:
    """Return du/d(phi4) and du/d(phi3), each (n, 3)."""
    quarter = np.pi / 2
    sideways = np.cos(beams.tilt)[:, None] * direction(beams.base + quarter, np.zeros_like(beams.tilt))
    return sideways, direction(beams.base, beams.tilt + quarter)
