"""The adjusted self-calibration in the form that diagnosis works on, and what readings of a view share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.clusters.robust import MOST, growth, must_be_few, must_suffice
from metrocli.adjust.clusters.rows import rows_of_table
from metrocli.adjust.clusters.sample import ClusterSample
from metrocli.adjust.coupled_fields import CorrelatedDesign, FieldSolution, adjust_fields
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index, Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.effects.covariates import Covariate
from metrocli.effects.effect import ELAPSED
from metrocli.effects.extension import with_conditions
from metrocli.effects.model import Model
from metrocli.frozen import dataclass
from metrocli.instruments import ball_grid as bg
from metrocli.tasks.selfcal_grid import KIND
from metrocli.tasks.selfcal_grid.effects import EFFECTS
from metrocli.tasks.selfcal_grid.problem import READINGS, GridProblem
from metrocli.tasks.selfcal_grid.solve import AdjustedGrid
from metrocli.tasks.shared.diagnosed import FOLDS, in_order
from metrocli.tasks.shared.noise import Structured, count, in_blocks

_FEWEST = 4
"""Least number of coordinates that an effect must change: an effect on one reading only is an outlier"""


def adjusted_job(solved: AdjustedGrid) -> AdjustedJob:
    """Return an adjusted self-calibration in the form that diagnosis works on."""
    problem = solved.problem.held(solved.design)
    model = with_conditions(replace(problem.model_with_datum, blocks=solved.solution.blocks))

    def refit(changed: Model, keep: Mapping[str, Mask]) -> Solution:
        return adjust_fields(problem.with_model(changed).only(keep[READINGS]).fields).solution

    index = problem.readings.observations.index
    return AdjustedJob(
        KIND.name,
        model,
        EFFECTS,
        tuple(_covariates(model)),
        ("view",),
        {READINGS: folds(index[bg.ARTEFACT], index[bg.VIEW])},
        Delivered("machine error", bg.MACHINE, (0, 1, 2), "um", "length"),
        refit,
        left_out=len(solved.rejected),
        fewest=_FEWEST,
        single_components=True,
        sharing=sharing(solved),
        offers=lambda changed: offers(problem, changed),
    )


def _covariates(model: Model) -> Iterator[Covariate]:
    """Yield the quantities that an unknown effect could vary with: time, temperature, place in the machine."""
    group = model.readings[0]
    yield from in_order(group)
    nominal: Array = group.chain.predict(model.blocks, group.observations)
    yield Covariate("place in the machine", {READINGS: np.ascontiguousarray(np.round(nominal, 1))})


def offers(problem: GridProblem, model: Model) -> Iterator[tuple[str, Model]]:
    """Yield further measurements that would help, the cheapest first: words, and the model with their readings."""
    if ELAPSED in model.readings[0].observations.conditions:
        yield "each view forth and back, in the reverse order", _forth_and_back(model)
    yield "two more views, shifted by one pitch along y and along z", _with_views(problem, model)


def _forth_and_back(model: Model) -> Model:
    """Return the model with each view measured a second time, from its last ball to its first."""
    group = model.readings[0]
    old = group.observations
    time, view = old.conditions[ELAPSED], old.index[bg.VIEW]
    last = np.array([time[view == n].max(initial=0.0) for n in range(int(view.max()) + 1)])[view]
    # `t + 2 (last - t)`: mirrored about the last reading of the view
    later = {name: old.conditions[name] + 2 * (last - time) for name in ("t", ELAPSED) if name in old.conditions}
    return model.with_group(group.with_observations(old.followed_by(old.with_conditions(later))))


def _with_views(problem: GridProblem, model: Model) -> Model:
    """Return the model with two more views after the others, shifted by one pitch along y and along z."""
    group, old = model.readings[0], model.readings[0].observations
    views = (*problem.views, *(bg.View(f"+{'xyz'[a]}", np.eye(3), np.eye(3)[a]) for a in (1, 2)))
    ball = np.concatenate([np.arange(len(problem.grid.balls))] * 2)
    view = np.repeat([len(views) - 2, len(views) - 1], len(problem.grid.balls))
    sites = np.concatenate([view.sites(problem.grid.balls) for view in views[-2:]])
    at = bg.numbers_at(problem.grid.sites, sites)
    kept = np.flatnonzero(at >= 0)
    new = old.selected(np.zeros(len(kept), dtype=np.intp))
    index = {bg.MACHINE: at[kept], bg.ARTEFACT: ball[kept], bg.VIEW: view[kept]}
    more = {name: np.zeros(len(kept), dtype=np.intp) for name in old.index if name not in index}
    balls, pitch = problem.grid.balls[ball[kept]], problem.grid.pitch
    time = np.arange(1.0, len(kept) + 1) * float(np.ptp(old.conditions.get("t", np.zeros(2)))) / old.count
    conditions = {name: values.max() + time for name, values in old.conditions.items() if name in ("t", ELAPSED)}
    conditions[bg.HOLLOW] = bg.hollow(views, view[kept], balls, pitch)
    changed = new.with_index(index | more).with_conditions(conditions)
    mountings = model.blocks[bg.VIEW]
    block = bg.view_block(views, np.concatenate([mountings.values, np.zeros((2, 6))]))
    links = (bg.mounted(views, pitch) if isinstance(link, bg.Mounted) else link for link in group.chain.links)
    wider = replace(group, chain=Chain(tuple(links)), observations=old.followed_by(changed))
    return model.with_group(wider).with_blocks({**model.blocks, bg.VIEW: block})


def folds(ball: Index, view: Index) -> Index:
    """Return the part (0 to 9) of each reading for cross-validation.

    A ball with at most ten readings loses no more than one of them to each part.
    """
    # 3 and 10 have no common divisor: ten views of one ball are in ten parts
    return np.asarray((7 * ball + 3 * view + ball // FOLDS) % FOLDS)


_OVER = "blocks of successive balls"


@dataclass(frozen=True)
class _Robust:
    """The covariance of fields over clusters."""

    sample: ClusterSample
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
        columns = np.concatenate([self.design.partition.columns[name].ravel() for name in names])
        return np.asarray(columns[columns >= 0])


def with_structure(solved: AdjustedGrid) -> tuple[AdjustedGrid, Structured]:
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
    sample = ClusterSample.of(white, rows, rows.common, solved.solution.dof)
    correlated = CorrelatedDesign(
        design.partition, design.jacobian, design.reduction, design.constraint, sample.covariance()
    )
    estimates = (bg.VIEW, *(effect.block for effect in solved.problem.effects))
    robust = _Robust(sample, correlated, np.diag(white))
    structured = Structured(robust, (bg.MACHINE,), estimates, _OVER)
    return replace(solved, field_solution=FieldSolution(solved.solution, correlated)), structured


def sharing(solved: AdjustedGrid) -> int:
    """Return the number of blocks whose readings may share errors; 0 if the fields are too large for one table."""
    return count(clusters_of(solved)) if solved.design.partition.width <= MOST else 0


def clusters_of(solved: AdjustedGrid) -> Index:
    """Return the block of successive readings of one view of each reading, (n,); by time, else in the file's order."""
    observations = solved.problem.readings.observations
    view = observations.index[bg.VIEW]
    clusters, first = np.zeros(observations.count, dtype=np.intp), 0
    for number in np.unique(view).tolist():
        mine = np.flatnonzero(view == number)
        clusters[mine] = first + in_blocks(observations.order[mine])
        first = int(clusters[mine].max()) + 1
    return clusters
