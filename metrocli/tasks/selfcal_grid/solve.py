"""Solution of a self-calibration: outliers reported or removed, each view left out in turn."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np

from metrocli.adjust.coupled_fields import FieldDesign, FieldSolution, adjust_fields, design_of
from metrocli.adjust.outcome import Outcome
from metrocli.adjust.probabilities import chi_square_tail
from metrocli.adjust.robust import FitQuality, Suspects, suspects
from metrocli.adjust.solution import Residuals, Solution
from metrocli.adjust.sparse.bordered_factor import OpenDesignError
from metrocli.arrays import Index, Mask
from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments import ball_grid as bg
from metrocli.tasks.selfcal_grid.determination.undetermined import determined, with_determined_datum
from metrocli.tasks.selfcal_grid.problem import GridProblem

_ROUNDS = 30
_TAKEN = 1e-9
"""Largest component of an effect, as a share of its reach, in a direction that the readings do not determine"""


@dataclass(frozen=True)
class AdjustedGrid:
    """An adjusted self-calibration."""

    problem: GridProblem
    """The problem with the readings that were used"""
    whole: GridProblem
    field_solution: FieldSolution
    residuals: tuple[Residuals, ...]
    """Residuals of each group of readings"""
    suspects: Suspects
    rejected: tuple[tuple[int, float], ...]
    """Rows left out, with their |w|"""

    @property
    def read(self) -> tuple[Residuals, ...]:
        """Residuals of the readings of balls, without those of calibrated lengths."""
        return self.residuals[:1]

    @property
    def design(self) -> FieldDesign:
        """Rank and covariance of the design."""
        return self.field_solution.design

    @property
    def solution(self) -> Solution:
        """Adjusted values and statistics."""
        return self.field_solution.solution

    @cached_property
    def determined(self) -> Mapping[str, Mask]:
        """Which entries of both fields and of the mountings are determined apart from rigid motion and scale."""
        return determined(self.problem, self.design)


@dataclass(frozen=True)
class LeftOut:
    """Test of one view against the others: by how much the sum of squares falls without it."""

    view: str
    chi2: float
    dof: int
    rest_chi2: float
    """Sum of squares of the other views alone"""
    rest_dof: int

    @property
    def p_value(self) -> float:
        """Probability of a fall at least as large if the view agrees with the others."""
        return _tail(self.chi2, self.dof)

    @property
    def rest_p_value(self) -> float:
        """Probability of a sum of squares at least as large as that of the others alone."""
        return _tail(self.rest_chi2, self.rest_dof)


def _tail(chi2: float, dof: int) -> float:
    # without the view the sum of squares must fall; a sum that rises is not the least one
    return chi_square_tail(dof, chi2) if dof > 0 and chi2 >= 0 else float("nan")


def design(problem: GridProblem) -> FieldDesign:
    """Return rank and covariance of the design.

    Raises UndeterminedError if there is one view only, the balls stand in one row, the views do not separate machine
    and artefact error, or they do not determine an effect of the job.
    """
    if len(problem.views) < 2:
        raise UndeterminedError(
            "one view shows only the sum of machine and artefact error: measure the artefact in another one too, "
            "turned by 90 deg or shifted by one pitch"
        )
    if np.linalg.matrix_rank(problem.grid.balls - problem.grid.balls[0]) < 2:
        raise UndeterminedError(
            "the balls stand in one row: no view shows a turn of the artefact about it; measure at least two rows"
        )
    try:
        field_design = design_of(problem.fields)
    except OpenDesignError as error:
        raise UndeterminedError(
            f"the views leave machine and artefact error undetermined: {error}; with views turned by 90 deg about two "
            "axes and one view shifted by a pitch, only the 13 directions of rigid motion and scale are undetermined"
        ) from error
    _refuse_absorbed(problem, field_design)
    return with_determined_datum(problem, field_design)


def _refuse_absorbed(problem: GridProblem, field_design: FieldDesign) -> None:
    """Raise UndeterminedError if the other unknowns can absorb an effect of the job in these views."""
    null = (
        field_design.null / np.maximum(np.abs(field_design.null).max(axis=0), 1e-300)
        if field_design.null.size
        else field_design.null
    )
    for effect in problem.effects:
        columns = field_design.partition.columns[effect.block]
        block = problem.fields.blocks[effect.block]
        reach = np.broadcast_to(block.reach, columns.shape)[columns >= 0]
        if (np.abs(null[columns[columns >= 0]]) > _TAKEN * reach[:, None]).any():
            raise UndeterminedError(
                f"these views do not determine {effect.label}: machine and artefact error absorb it; "
                f"to determine it, measure {effect.effect.reveal}"
            )


def solve(problem: GridProblem, remove: bool) -> AdjustedGrid:
    """Return the adjusted problem; with `remove`, adjust again without the worst outliers until none is left.

    Raises NotConvergedError, or UndeterminedError as `design` does.
    """
    out: dict[int, float] = {}
    whole = problem
    for _ in range(_ROUNDS):
        solved = _once(problem, whole, out)
        worst = _worst(solved, out) if remove else {}
        if not worst:
            break
        out |= worst
        keep: Mask = np.ones(whole.readings.observations.count, dtype=bool)
        keep[list(out)] = False
        problem = whole.only(keep)
    return solved


def _once(problem: GridProblem, whole: GridProblem, out: dict[int, float]) -> AdjustedGrid:
    adjusted: FieldSolution = adjust_fields(problem.fields, design(problem))
    solution = adjusted.solution
    if solution.outcome is not Outcome.CONVERGED:
        raise NotConvergedError(f"{solution.outcome.value} ({solution.iterations} steps)", solution.misfit)
    residuals = adjusted.residuals()
    tested = suspects(residuals[0], FitQuality(solution.cost, solution.dof, noise_known=True))
    return AdjustedGrid(problem, whole, adjusted, residuals, tested, tuple(sorted(out.items())))


def _worst(solved: AdjustedGrid, out: dict[int, float]) -> dict[int, float]:
    """Return the suspects to leave out next: row among all readings, and |w|."""
    rows, tests = solved.suspects.rows, solved.suspects.tests
    if not len(rows):
        return {}
    kept: Index = np.setdiff1d(np.arange(solved.whole.readings.observations.count), list(out))
    chosen = tests >= tests.max() / 2
    return {int(kept[row]): float(test) for row, test in zip(rows[chosen], tests[chosen], strict=True)}


def leave_one_out(solved: AdjustedGrid) -> list[LeftOut]:
    """Return for each view the fall of the sum of squares without it, and that of the degrees of freedom."""
    view = solved.problem.readings.observations.index[bg.VIEW]
    rows = []
    for n, left_out in enumerate(solved.problem.views):
        without = _adjusted(solved.problem.only(np.asarray(view != n)))
        if without is None:
            rows.append(LeftOut(left_out.name, float("nan"), 0, float("nan"), 0))
            continue
        fall, dof = solved.solution.cost - without.cost, solved.solution.dof - without.dof
        rows.append(LeftOut(left_out.name, fall, dof, without.cost, without.dof))
    return rows


def _adjusted(rest: GridProblem) -> Solution | None:
    """Return the adjustment of some views; None if there is one view only, it is too open, or does not converge."""
    if len(np.unique(rest.readings.observations.index[bg.VIEW])) < 2:
        return None
    try:
        solution = adjust_fields(rest.fields, design_of(rest.fields)).solution
    except OpenDesignError:
        return None
    return solution if solution.outcome is Outcome.CONVERGED else None
