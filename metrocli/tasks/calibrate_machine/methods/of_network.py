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
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.problem import NETWORK
from metrocli.tasks.shared.lists import matched
from metrocli.uncertainty.predicted import points_of

_SINGULAR = 1e-6
"""Share of the mean variance that no direction falls below: a free datum leaves six directions without any"""
_FAR = 10.0
"""Plausible size of independent errors of the size 1: they are known before any reading"""
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

    The joint covariance is `v I + L L'`: independent errors of a variance v, half of the least one in any direction,
    and errors in common. Together they are a generalised adjustment, in which each point keeps its own test. Raises
    InputError for a point that the network does not have.
    """
    names = network.tables["points"].texts("point")
    places = points_of(network).of(matched(points, "point", names, "the points of the network"))
    n, common = len(places.values), places.common.reshape(3 * len(places.values), -1)
    joint = common @ places.core @ common.T
    for i, own in enumerate(places.own):
        joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += own
    values, vectors = np.linalg.eigh(joint)
    values = np.maximum(values, _SINGULAR * values.mean())
    white = values[0] / 2
    root = (vectors * np.sqrt(values - white)).reshape(n, 3, -1)
    columns = tuple(f"z{j + 1}" for j in range(3 * n))
    block = Block(NETWORK, np.zeros((1, 3 * n)), columns, reach=np.array(_FAR))
    known = prior(block, np.zeros(1, dtype=np.intp), np.ones((1, 3 * n)))
    std = float(np.sqrt(np.diag(joint).max()))
    errors = NetworkErrors({NETWORK: block}, {_POINT: np.arange(n)}, (JointErrors(NETWORK, root),), (known,), std)
    return places.values.T, np.repeat(white * np.eye(3)[:, :, None], n, axis=2), errors
