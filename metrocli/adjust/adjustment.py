"""The adjustment: weighted least squares by Gauss-Newton steps, and the covariance at their end.

Method: docs/algorithms/tiled-elimination.md (normal equations), docs/algorithms/free-networks.md (datum) and
docs/algorithms/rank-in-words.md (what is undetermined).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.allowance import take
from metrocli.adjust.datum import Datum, Frame
from metrocli.adjust.descent import Descent, IteratedSystem, cholesky_solve, held
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.outcome import Combination, Outcome
from metrocli.adjust.rank import open_combinations
from metrocli.adjust.schur.covariance import Covariance, shapes_of
from metrocli.adjust.schur.layout import arrange
from metrocli.adjust.schur.member_covariance import Gauge, MemberCovariance
from metrocli.adjust.schur.normals import Normals
from metrocli.adjust.schur.tiles import tiling_of
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class StoppingRule:
    """When an adjustment stops, and whether it computes a covariance."""

    limit: int = 1000
    """Largest number of steps"""
    tolerance: float = 1e-6
    """The last step is shorter than this, in standard deviations of the unknowns (root mean square)"""
    covariance: bool = True
    """Whether rank and covariance are computed at the end"""


def adjust(
    blocks: Iterable[Block], groups: Sequence[Group], datum: Datum | None = None, control: StoppingRule | None = None
) -> Solution:
    """Minimise the sum of squares of the whitened residuals over the free entries of the blocks.

    The method is Gauss-Newton; a step that would raise the sum is shortened by damping (Marquardt 1963), so the sum
    never rises. It stops when a step is short compared with the standard deviations, so the units of the unknowns do
    not matter. It also stops when the steps shrink so fast that the next one would be short (contraction of Newton
    steps, Deuflhard: Newton Methods for Nonlinear Problems, 2004). A singular problem ends with an outcome, not with
    an exception. Raises ValueError only if blocks and groups do not fit together.
    """
    control = control or StoppingRule()
    take()
    state = {block.name: block for block in blocks}
    layout = arrange(state, groups)
    problem = IteratedSystem(groups, layout, datum, tiling_of(groups, state, layout))
    unknowns = sum(int(block.free.sum()) for block in state.values())
    descent = Descent(problem, state, control.covariance)
    lost = Solution(Outcome.NO_START, state, tuple(groups), float("inf"), 0, unknowns)
    if not np.isfinite(descent.cost):
        # a start from which nothing can be predicted is often that of too few readings, which is the better message
        few = lost.observations < unknowns - len(datum.names if datum else ())
        return replace(lost, outcome=Outcome.TOO_FEW) if few else lost
    outcome = Outcome.ITERATION_LIMIT if control.limit else Outcome.CONVERGED
    iterations, small = 0, control.tolerance**2 * max(unknowns, 1)
    while iterations < control.limit and outcome is Outcome.ITERATION_LIMIT:
        take()
        iterations += 1
        outcome = descent.step(small, iterations == control.limit)
    # without a covariance the values are a start for another adjustment, which has a datum of its own
    if datum is not None and control.covariance and iterations and outcome is Outcome.CONVERGED:
        outcome = descent.restore_datum(small)
    solution = replace(lost, outcome=outcome, blocks=descent.state, cost=descent.cost, iterations=iterations)
    return _with_covariance(solution, problem, descent.here()) if control.covariance else solution


def covariance_at(blocks: Iterable[Block], groups: Sequence[Group], datum: Datum | None = None) -> Solution:
    """Return the covariance that an adjustment would have at these values, without changing them (for planning)."""
    return adjust(blocks, groups, datum, StoppingRule(limit=0))


def _with_covariance(solution: Solution, problem: IteratedSystem, normals: Normals) -> Solution:
    blocks, layout = solution.blocks, problem.layout
    try:
        matrix = normals.reduced()[0]
        frame = problem.frame(blocks, matrix, normals.diagonal)
    except np.linalg.LinAlgError:
        # nan in the place of the matrix: the members that are singular are named first, and need no reduced system
        matrix, frame = np.full((layout.width, layout.width), np.nan), None
    conditions = frame.reduced.shape[1] if frame else 0
    counted = replace(solution, conditions=conditions)
    # the datum's movements are held, so that they are not reported as undetermined
    stiff = held(matrix, frame, normals.diagonal)
    combinations: tuple[Combination, ...] = open_combinations(blocks, layout, normals, stiff)
    if combinations:
        # too few readings leave combinations open too; their number is the plainer cause
        few = counted.dof < 0
        return replace(counted, outcome=Outcome.TOO_FEW if few else Outcome.UNDETERMINED, undetermined=combinations)
    if counted.dof < 0:
        return replace(counted, outcome=Outcome.TOO_FEW)
    inverse = cholesky_solve(stiff, np.eye(layout.width)) if layout.width else np.zeros((0, 0))
    gauge = None
    if frame is not None and frame.datum.block == layout.eliminated:
        # the S-transformation needs the datum's members in the reduced system, and they have been eliminated
        inverse = _in_eliminated_datum(frame, normals, inverse)
        gauge = Gauge(frame, blocks[frame.datum.block])
    elif frame is not None:
        transform = frame.transform(layout)
        inverse = transform @ inverse @ transform.T
    # the products round differently on either side, and later Cholesky factors read one triangle only
    symmetric = (inverse + inverse.T) / 2
    members = MemberCovariance(normals.shape, normals.parts, problem.tiling.tiles, symmetric, gauge)
    return replace(counted, covariance=Covariance(layout, shapes_of(blocks), symmetric, members))


def _in_eliminated_datum(frame: Frame, normals: Normals, inverse: Array) -> Array:
    """Return the reduced covariance in a datum of inner constraints on the eliminated block.

    Let n_i be the noise of member i alone, of covariance D_i^-1, and `A = sum H_i W_i`. The movement that restores the
    datum is `h = H e = -A r + sum H_i n_i`, so `r' = r - E h = (I + E A) r - E sum H_i n_i`. The reduced unknowns r and
    the n_i are uncorrelated.
    """
    moments = [part.moments(frame.constraint(part.members)) for part in normals.parts]
    e = frame.reduced
    coupled, gram = (np.sum([moment[i] for moment in moments], axis=0) for i in (0, 1))
    transform = np.eye(len(inverse)) + e @ coupled
    return np.asarray(transform @ inverse @ transform.T + e @ gram @ e.T)
