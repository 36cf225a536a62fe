"""Targets of a fit-part result: their coordinates in the part frame, with the joint covariance of all of them.

The targets of a fitted part share the error of its pose, and errors of the network that measured them. So their
coordinates enter the adjustment as one correlated observation.
"""

from __future__ import annotations

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
from metrocli.tasks.shared.images.target_list import Targets
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

    def drawn(self, known: Targets, rng: np.random.Generator) -> Targets:
        """Return the targets with errors drawn from their covariance."""
        if self.covariance is None:
            return true_targets(known, rng)
        size = known.points.size
        root = np.linalg.cholesky(self.covariance.reshape(size, size))
        return replace(known, points=known.points + (root @ rng.normal(size=size)).reshape(-1, 3))


def target_list(targets: Table | Result, part: Part | None = None) -> TargetList:
    """Return the targets of a list or of a fit-part result.

    Raises InputError if the result has fewer than three, or if they are not at 20 degC for a part of known temperature.
    """
    if isinstance(targets, Table):
        return TargetList(targets)
    cold = bool(growth_of(targets))
    if part is not None and not cold:
        raise InputError(
            "part: the targets of the fit-part result are not at 20 degC, and nobody knows how warm they were; give "
            "`part:` in its job too, with the temperature at which its points were measured"
        )
    warnings = () if part is not None or not cold else (_AT_20,)
    found = targets.tables["targets"]
    if len(found) < FEWEST:
        raise InputError(
            f"the fit-part result has {len(found)} targets, and a part needs {FEWEST}: name them in its job, "
            "e.g. `targets: [T*]`, or by the surface `target` in its points"
        )
    covariance = _joint(targets.arrays["targets_own"], targets.arrays["targets_common"])
    std = np.sqrt(np.einsum("nknk->nk", covariance))
    columns = {"target": found.columns["target"], "x y z [mm]": found.stacked("xyz")}
    table = Table.of(columns | {"sigma_x sigma_y sigma_z [mm]": std})
    named = replace(table, file="the targets of the fit-part result")
    return TargetList(named, covariance if std.any() else None, warnings)


def _joint(own: Array, common: Array) -> Array:
    """Return the covariance `own_i [i = j] + common_i common_j'` of own (m, 3, 3) and common (m, 3, k)."""
    m = len(own)
    joint: Array = np.einsum("iak,jbk->iajb", common, common, optimize=True)
    rows = np.arange(m)
    mean = float(np.einsum("nkk->", own) + np.einsum("iaia->", joint)) / (3 * m)
    joint[rows, :, rows, :] += own + _NO_ERROR**2 * mean * np.eye(3)
    return joint
