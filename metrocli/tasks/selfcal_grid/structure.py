"""What readings of a view share that follow each other: the covariance over blocks of successive balls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.clusters.robust import MOST, growth, must_be_few, must_suffice
from metrocli.adjust.clusters.rows import rows_of_table
from metrocli.adjust.clusters.sample import Sample
from metrocli.adjust.coupled_fields import CorrelatedDesign, FieldSolution
from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.frozen import dataclass
from metrocli.instruments import ball_grid as bg
from metrocli.tasks.selfcal_grid.solve import Solved
from metrocli.tasks.shared.noise import Structured, count, in_blocks

_OVER = "blocks of successive balls"


@dataclass(frozen=True)
class _Robust:
    """The covariance of fields over clusters."""

    sample: Sample
    design: CorrelatedDesign
    white: Array
    """Variances of all unknowns for independent errors, (unknowns,)"""

    @property
    def clusters(self) -> int:
        """Number of clusters."""
        return len(self.sample.clusters)

    def inflation(self, names: Sequence[str]) -> float:
        """Return the root mean square growth of the standard uncertainties of blocks."""
        columns = self._columns(names)
        return growth(np.diag(self.design.matrix)[columns], self.white[columns])

    def dof(self, names: Sequence[str]) -> Array:
        """Return the degrees of freedom (k,) of the variances of the free entries of blocks."""
        return self.sample.dof(self._columns(names))

    def _columns(self, names: Sequence[str]) -> Index:
        found = np.concatenate([self.design.partition.columns[name].ravel() for name in names])
        return np.asarray(found[found >= 0])


def with_structure(solved: Solved) -> tuple[Solved, Structured]:
    """Return the adjustment with the covariance that lets successive readings of a view share errors.

    Raises UndeterminedError for too few readings, and InputError for more unknowns than fit into one table.
    """
    from scipy.sparse import eye_array

    design, groups = solved.design, solved.solution.groups
    must_be_few(design.partition.width)
    cluster = clusters_of(solved)
    must_suffice(count(cluster), _OVER)
    white = design.covariance(eye_array(design.partition.width, format="csr"))
    residual = [group.observations.whitened(group.residuals(solved.solution.blocks)) for group in groups]
    # a reading has its components one after the other: all of x, all of y, all of z
    of_rows = [np.tile(cluster, len(residual[0])), *(np.full(part.size, -1) for part in residual[1:])]
    rows = rows_of_table(design.jacobian, np.concatenate([part.ravel() for part in residual]), np.concatenate(of_rows))
    sample = Sample.of(white, rows, rows.common, solved.solution.dof)
    found = CorrelatedDesign(
        design.partition, design.jacobian, design.reduction, design.constraint, sample.covariance()
    )
    estimates = (bg.VIEW, *(one.block for one in solved.problem.effects))
    robust = _Robust(sample, found, np.diag(white))
    structured = Structured(robust, (bg.MACHINE,), estimates, _OVER)
    return replace(solved, found=FieldSolution(solved.solution, found)), structured


def sharing(solved: Solved) -> int:
    """Return the number of blocks whose readings may share errors; 0 if the fields are too large for one table."""
    return count(clusters_of(solved)) if solved.design.partition.width <= MOST else 0


def clusters_of(solved: Solved) -> Index:
    """Return the block of successive readings of one view of each reading, (n,); by time, else in the file's order."""
    observations = solved.problem.readings.observations
    view = observations.index[bg.VIEW]
    order = observations.conditions.get("t", np.arange(observations.count, dtype=float))
    found, first = np.zeros(observations.count, dtype=np.intp), 0
    for one in np.unique(view).tolist():
        mine = np.flatnonzero(view == one)
        found[mine] = first + in_blocks(order[mine])
        first = int(found[mine].max()) + 1
    return found
