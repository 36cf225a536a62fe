"""Targets from another result: their coordinates in the part frame, with the joint covariance of all of them.

The targets of a fitted part share the error of its pose, and errors of the network that measured them. So their
coordinates enter the adjustment as one correlated observation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group, prior_of_members, priors
from metrocli.arrays import Array, Mask
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.shared.images.simulation import true_targets
from metrocli.tasks.shared.images.target_list import TargetCoordinates
from metrocli.tasks.shared.part import Part, growth_of

FEWEST = 3
_AT_20 = (
    "the targets of the fit-part result are at 20 degC, and so is the part in the machine without `part:`; "
    "give its temperature there and its expansion"
)
_NO_ERROR = 1e-5
"""Standard deviation that every coordinate has besides, relative to the mean of all: targets whose errors follow from
those of others would have a covariance without inverse"""


@dataclass(frozen=True)
class TargetList:
    """Targets of a part with what is known of their errors."""

    table: Table
    covariance: Array | None = None
    """Joint covariance of all coordinates (m, 3, m, 3) [mm^2]; None for a list from a file: independent"""
    warnings: tuple[str, ...] = ()

    def priors(self, block: Block, sigma: Array, free: Mask) -> list[Group]:
        """Return what is known beforehand of the free coordinates (m, 3) of a block of these targets.

        That is one correlated observation of the targets of a fit, and one of each target of a file, with sigma (m, 3).
        """
        if self.covariance is None:
            return priors(block, sigma, free)
        rows = np.flatnonzero(free.all(axis=1))
        size = 3 * len(rows)
        chosen = self.covariance[rows][:, :, rows].reshape(size, size)
        return [prior_of_members(block, (0, 1, 2), chosen, rows)]

    def drawn(self, known: TargetCoordinates, rng: np.random.Generator) -> TargetCoordinates:
        """Return the targets with errors drawn from their covariance."""
        if self.covariance is None:
            return true_targets(known, rng)
        size = known.points.size
        root = np.linalg.cholesky(self.covariance.reshape(size, size))
        return replace(known, points=known.points + (root @ rng.normal(size=size)).reshape(-1, 3))


def target_list(targets: Table | Result, part: Part | None = None) -> TargetList:
    """Return the targets of a list, of a fit-part result, or of a network whose frame is the part's.

    Raises InputError if the result has fewer than three, or if they are not at 20 degC for a part of known temperature.
    """
    if isinstance(targets, Table):
        return TargetList(targets)
    if "targets" not in targets.tables:
        return _of_network(targets)
    cold = bool(growth_of(targets))
    if part is not None and not cold:
        raise InputError(
            "part: the targets of the fit-part result are not at 20 degC, and nobody knows how warm they were; give "
            "`part:` in its job too, with the temperature at which its points were measured"
        )
    warnings = () if part is not None or not cold else (_AT_20,)
    listed = targets.tables["targets"]
    if len(listed) < FEWEST:
        raise InputError(
            f"the fit-part result has {len(listed)} targets, and a part needs {FEWEST}: name them in its job, "
            "e.g. `targets: [T*]`, or by the surface `target` in its points"
        )
    covariance = _joint(targets.arrays["targets_own"], targets.arrays["targets_common"])
    table = _listed(listed.texts("target"), listed.stacked("xyz"), covariance, "the targets of the fit-part result")
    return TargetList(table, covariance if covariance.any() else None, warnings)


def _of_network(points: Result) -> TargetList:
    """Return the points of a network as targets."""
    table = points.tables["points"]
    joint = points.arrays.get("points_joint_covariance")
    if joint is None:
        raise InputError("the network has too many points to be targets: their joint covariance is not in its result")
    n = len(table)
    covariance = _regular(np.asarray(joint).reshape(n, 3, n, 3).copy())
    return TargetList(
        _listed(table.texts("point"), table.stacked("xyz"), covariance, "the points of the network"), covariance
    )


def _listed(names: Sequence[str], places: Array, covariance: Array, file: str) -> Table:
    std = np.sqrt(np.einsum("nknk->nk", covariance))
    return replace(Table.of({"target": names, "x y z [mm]": places, "sigma_x sigma_y sigma_z [mm]": std}), file=file)


def _joint(own: Array, common: Array) -> Array:
    """Return the covariance `own_i [i = j] + common_i common_j'` of own (m, 3, 3) and common (m, 3, k)."""
    joint: Array = np.einsum("iak,jbk->iajb", common, common, optimize=True)
    rows = np.arange(len(own))
    joint[rows, :, rows, :] += own
    return _regular(joint)


def _regular(joint: Array) -> Array:
    """Return a joint covariance (m, 3, m, 3) that has an inverse."""
    rows = np.arange(len(joint))
    mean = float(np.einsum("iaia->", joint)) / (3 * len(joint))
    joint[rows, :, rows, :] += _NO_ERROR**2 * mean * np.eye(3)
    return joint
