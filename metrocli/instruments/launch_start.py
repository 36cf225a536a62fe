"""Where the beams meet: the two closed solutions of Kuprin et al., which also give the adjustment its start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.instruments.launch_unit import direction


@dataclass(frozen=True)
class Beams:
    """What the receiver says of the launch unit in n poses, and the launch unit's base angle."""

    receiver: Array
    """r, (n, 3)"""
    base: Array
    """psi + phi4, (n,)"""
    tilt: Array
    """phi3, (n,)"""
    launch_base: Array
    """phi1 with phi2 within +-90 degrees, (n,)"""
    distance: Array
    """(n,), nan where none was measured"""

    @property
    def towards(self) -> Array:
        """u: from each receiver to the unit, (n, 3)."""
        return direction(self.base, self.tilt)

    @property
    def measured(self) -> Array:
        """Which poses have a distance, (n,)."""
        return np.isfinite(self.distance)


@dataclass(frozen=True)
class Meeting:
    """A place of the unit, and what an error of each reading does to it."""

    place: Array
    """p, (3,)"""
    by_base: Array
    """dp / d(phi4), (n, 3)"""
    by_tilt: Array
    """dp / d(phi3), (n, 3)"""
    by_distance: Array
    """dp / dl, (n, 3)"""


def across(towards: Array) -> Array:
    """Return `I - u u'`, what is square to each beam, (n, 3) -> (n, 3, 3)."""
    return np.eye(3) - towards[:, :, None] * towards[:, None, :]


def spread(beams: Beams) -> float:
    """Return the smallest root mean square sine of the angles between the beams and any one direction."""
    smallest = float(np.linalg.eigvalsh(across(beams.towards).sum(axis=0))[0])
    return float(np.sqrt(max(smallest, 0.0)))


def lines(beams: Beams) -> Meeting:
    """Return the point nearest to all beams in least squares (Kuprin et al. eq. 5-6).

    `p = (sum M)^-1 sum M r`, `M = I - u u'`: eq. 6 sums the distances; the paper solves it by QR, which minimises their
    squares. The derivatives hold where the beams meet: a turn du of a beam of length t moves its line by t du.
    """
    towards = beams.towards
    square = across(towards)
    inverse = np.linalg.inv(square.sum(axis=0))
    place = inverse @ np.einsum("nij,nj->i", square, beams.receiver)
    length = np.einsum("ni,ni->n", towards, place - beams.receiver)
    by_base, by_tilt = (turn * length[:, None] @ inverse for turn in _turns(beams))
    return Meeting(place, by_base, by_tilt, np.zeros_like(towards))


def closed_loop(beams: Beams) -> Meeting:
    """Return the mean of the ends of the beams, `p = mean(r + l u)` (Kuprin et al. eq. 1-4).

    Eq. 1 as printed ends each loop in the unit's control point, whatever its angles are, so gamma is not in it.
    """
    has = beams.measured
    length, n = np.where(has, beams.distance, 0.0), int(has.sum())
    towards = beams.towards
    place = (beams.receiver + length[:, None] * towards)[has].mean(axis=0)
    by_base, by_tilt = (turn * length[:, None] / n for turn in _turns(beams))
    return Meeting(place, by_base, by_tilt, np.where(has[:, None], towards, 0.0) / n)


def nearest(beams: Beams) -> Array:
    """Return the place (3,) that fits beams and distances together: beams with a distance are points, others lines."""
    towards, has = beams.towards, beams.measured
    square = np.where(has[:, None, None], np.eye(3), across(towards))
    ends = beams.receiver + np.where(has, beams.distance, 0.0)[:, None] * towards
    return np.asarray(np.linalg.solve(square.sum(axis=0), np.einsum("nij,nj->i", square, ends)))


def set_up_angle(beams: Beams) -> float:
    """Return gamma, the circular mean of the beam's direction at the launch unit minus phi1.

    The paper takes the arithmetic mean, which is wrong where the differences lie on both sides of +-180 degrees.
    """
    towards = beams.towards
    difference = np.arctan2(-towards[:, 1], -towards[:, 0]) - beams.launch_base
    return float(np.arctan2(np.sin(difference).mean(), np.cos(difference).mean()))


def _turns(beams: Beams) -> tuple[Array, Array]:
    """Return du/d(phi4) and du/d(phi3), each (n, 3)."""
    quarter = np.pi / 2
    sideways = np.cos(beams.tilt)[:, None] * direction(beams.base + quarter, np.zeros_like(beams.tilt))
    return sideways, direction(beams.base, beams.tilt + quarter)
