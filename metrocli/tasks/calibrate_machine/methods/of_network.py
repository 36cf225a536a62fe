"""Points of a network in the place of those of one tracker: their places, and the errors that they have in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import IDENTITY, Link, LinkContext, Step
from metrocli.adjust.model.groups import Group, prior
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.arrays import Array, Index
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.problem import NETWORK
from metrocli.tasks.shared.lists import matched
from metrocli.uncertainty.predicted import PredictedPlaces, points_of

_SINGULAR = 1e-6
"""Share of the mean variance that no direction falls below: a free datum leaves six directions without any"""
_FAR = 10.0
"""Plausible size of independent errors of the size 1: they are known before any reading"""
_MOST = 1800
"""Most errors that points have in common: each is an unknown of all readings"""
_POINT = "point of the network"
"""Index of the point of each reading"""


@dataclass(frozen=True)
class NetworkErrors:
    """Unknown errors of the points of a network, which have its joint covariance; empty for other points."""

    blocks: Mapping[str, Block] = field(default_factory=dict)
    index: Mapping[str, Index] = field(default_factory=dict)
    links: tuple[Link, ...] = ()
    others: tuple[Group, ...] = ()
    std: float = 0.0
    """Largest standard uncertainty of a coordinate [mm]"""


NONE = NetworkErrors()


@dataclass(frozen=True)
class JointErrors(OfBlock):
    """Link `X += L_i z`: errors of points with the covariance `L L'`, z independent errors of the size 1."""

    root: Array
    """L, (points, 3, k)"""
    # effects act before: one that stretched these errors too would make them small
    takes, gives = Quantity.POINT_IN_TRACKER, Quantity.POINT_IN_NETWORK

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the points (3, n), with their derivatives L by z, (3, k, n)."""
        own = np.moveaxis(self.root[local.observations.index[_POINT]], 0, -1)
        return Step(value + np.einsum("akn,k->an", own, local.members(self.block)[0]), IDENTITY, {self.block: own})


def measured_in(network: Result, points: Table) -> tuple[Array, Array, NetworkErrors]:
    """Return the places (3, n) of points in the frame of their network, a covariance (3, 3, n), and their errors.

    The joint covariance is that of the points' own errors with `L L'` of those in common. Together they are a
    generalised adjustment, in which each point keeps its own test. Raises InputError for a point that the network does
    not have, and for more common errors than fit into one table.
    """
    names = network.tables["points"].texts("point")
    places = points_of(network).of(matched(points, "point", names, "the points of the network"))
    own, root = _split(places, points)
    n, _, count = root.shape
    columns = tuple(f"z{j + 1}" for j in range(count))
    block = Block(NETWORK, np.zeros((1, count)), columns, reach=np.array(_FAR))
    known = prior(block, np.zeros(1, dtype=np.intp), np.ones((1, count)))
    std = float(np.sqrt(np.einsum("naa->na", places.covariance).max()))
    errors = NetworkErrors({NETWORK: block}, {_POINT: np.arange(n)}, (JointErrors(NETWORK, root),), (known,), std)
    return places.values.T, np.moveaxis(own, 0, -1), errors


def _split(places: PredictedPlaces, points: Table) -> tuple[Array, Array]:
    """Return the covariance of the points' own errors (n, 3, 3), and the root L (n, 3, k) of that in common.

    Of points that a network has without errors of their own, these are half of the least variance in any direction.
    """
    n, own = len(places.values), places.own
    least = _SINGULAR * float(np.einsum("naa->", places.covariance)) / (3 * n)
    apart = len(places.core) < 3 * n and bool((np.linalg.eigvalsh(own)[:, 0] > least).all())
    count = len(places.core) if apart else 3 * n
    if count > _MOST:
        text = f"the {n} points have {count} errors in common, more than the {_MOST} that are estimated together"
        raise InputError([points.fault(text, f"list at most {_MOST // 3} points of this network")])
    if apart:
        values, vectors = np.linalg.eigh(places.core)
        return own, places.common @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    flat = places.common.reshape(3 * n, -1)
    joint = (flat @ places.core @ flat.T).reshape(n, 3, n, 3)
    joint[np.arange(n), :, np.arange(n)] += own
    values, vectors = np.linalg.eigh(joint.reshape(3 * n, 3 * n))
    values = np.maximum(values, least)
    half = values[0] / 2
    return np.broadcast_to(half * np.eye(3), own.shape), (vectors * np.sqrt(values - half)).reshape(n, 3, 3 * n)
