"""Warnings of a self-calibration: noise, open directions, outliers, views that disagree, and what none shows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from metrocli import units
from metrocli.arrays import Array
from metrocli.table import Table
from metrocli.tasks.selfcal_grid.determination.undetermined import Open
from metrocli.tasks.selfcal_grid.problem import GridProblem
from metrocli.tasks.selfcal_grid.solve import AdjustedGrid, LeftOut
from metrocli.tasks.shared.statistics import beyond_bound, left_out, noise_warnings, with_tests
from metrocli.tasks.shared.uncontrolled import SCALE, SCALE_WORDS, Hidden, table_of
from metrocli.words import listed


def warnings(solved: AdjustedGrid, left_open: Open, std: Array, by_view: Sequence[LeftOut]) -> list[str]:
    """Return the warnings of a self-calibration; std is that of the machine error, inf where it is undetermined."""
    lines = noise_warnings(solved.solution, removed=len(solved.rejected))
    if left_open.families:
        open_share = float((~np.isfinite(std)).mean())
        lines += left_open.sentences()[1:]
        lines.append(
            f"{open_share:.0%} of the machine error's components are not determined. Their "
            "values are those with the least sum of squares of machine and artefact error. The datum is over the "
            "other components. The smooth form and length errors are not given"
        )
    rejected, suspected = dict(solved.rejected), solved.suspects
    lines += left_out(with_tests(_balls(solved.whole, rejected), rejected.values()))
    if len(suspected.rows):
        balls = with_tests(_balls(solved.problem, suspected.rows.tolist()), suspected.tests.tolist())
        lines.append(beyond_bound(balls, suspected.critical))
    return lines + _disagreeing(by_view)


def _balls(problem: GridProblem, rows: Iterable[int]) -> list[str]:
    """Return the names of some readings: view, and ball."""
    keys = problem.readings.observations.keys
    return [f"{keys['view'][n]}: ({keys['i'][n]}, {keys['j'][n]}, {keys['k'][n]})" for n in rows]


def contradicting(solved: AdjustedGrid) -> list[str]:
    """Return a doubt if calibrated lengths disagree with the readings or with each other."""
    if not solved.problem.scale_given:
        return []
    tests = np.abs(solved.residuals[1].normalised[0])
    keys = solved.problem.fields.groups[1].observations.keys
    message = [
        " to ".join(f"({', '.join(keys[f'{name}{end}'][n] for name in 'ijk')})" for end in "12")
        + f" |w| = {tests[n]:.1f}"
        for n in np.argsort(-tests)
        if tests[n] > solved.suspects.critical
    ]
    return [f"lengths do not agree with each other or with the readings: {listed(message, 5)}"] if message else []


def _disagreeing(by_view: Sequence[LeftOut]) -> list[str]:
    """Return a warning for the view that does not agree with the others, if the others fit without it."""
    bound = 0.01 / max(len(by_view), 1)
    odd = [left for left in by_view if left.p_value < bound and left.rest_p_value > bound]
    return [
        f"view '{left.view}' does not agree with the others, which fit without it: the sum of squares falls by "
        f"{left.chi2:.0f} for {left.dof} degrees of freedom (p = {left.p_value:.1g})"
        for left in sorted(odd, key=lambda left: left.p_value)[:1]
    ]


def uncontrolled(problem: GridProblem) -> Table:
    """Return what machine and artefact error absorb together, and the error over the grid from a plausible size."""
    return table_of(_rows(problem))


def _rows(problem: GridProblem) -> Iterator[Hidden]:
    extent = problem.grid.pitch * float(np.linalg.norm(np.ptp(problem.grid.sites, axis=0)))
    if problem.scale_given:
        growth = units.parse_quantity("1.15 ppm", "ratio")
        yield Hidden(
            "temperature of the calibrated lengths (scale of both errors)",
            "0.1 K of steel (1.15 um/m)",
            growth * extent,
            "the temperature of the artefact in each view",
        )
        return
    # the gauge gives half of a common scale to the machine, the other half to the artefact
    yield Hidden(
        "pitch of the artefact (scale of the machine error over the grid)",
        SCALE_WORDS,
        SCALE / 2 * extent,
        "a calibrated length of the artefact (inputs: lengths)",
    )
