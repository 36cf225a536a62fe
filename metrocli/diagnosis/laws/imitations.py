"""Effects and smooth processes that only imitate a law: nothing better was among the candidates.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.diagnosis.laws.library import Library
from metrocli.diagnosis.laws.search import fits
from metrocli.diagnosis.laws.steps import LEVEL, Search, forward, plain_tests, refined_step, tests_of_terms
from metrocli.diagnosis.linear.fitted_columns import FittedColumns
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.selection.selection_state import Chosen, Selection
from metrocli.diagnosis.smooth_errors.process import Process

_FAR_MORE = 5.0
"""A law replaces effects if ln of its evidence exceeds theirs by this"""
_SHOWS = 10.0
"""ln of the evidence above which a term shows in its scan"""


def without_imitations(library: Library, selection: Selection, processes: Sequence[Process] = ()) -> Selection | None:
    """Return the selection without those of its effects that only imitate a law; None if nothing does.

    Effects can imitate a cause that is not among them, as three jumps do a saturation. They are left out if they are
    not significant beside the law, and if the law has far more evidence than they have. The evidence is
    `-n/2 ln S - q/2 ln n - sum ln m`, S the squares left, q the number of sizes, m the number of tests of each member.
    Smooth processes imitate a law too. The law has to exceed as well by how much they raise the log-likelihood, beside
    the effects for which they do not stand; then they are left out with the effects.
    """
    tests = selection.test_set
    sought = (selection.named or processes) and not tests.budget.ended and fits(tests.system)
    if not sought or not library.families:
        return None
    bare = _reduced(selection, selection.named)
    imitated = _of_names(selection, selection.named)
    if processes:
        stood_for = {lost.spot for process in processes for lost in process.instead_of}
        others = _reduced(selection, [one for one in selection.named if selection.alternative(one).spot in stood_for])
        imitated = max(imitated, _of_names(others, others.named) + sum(process.gain for process in processes))
    if not _could_exceed(bare, library, imitated):
        return None
    of_terms, start = tests_of_terms(bare, library)
    steps = forward(Search(of_terms, start, library), LEVEL)
    if not steps:
        return None
    columns = np.concatenate([one.columns for one in steps], axis=1)
    beside = start.with_columns(columns)
    idle = [one for one in selection.named if _log_level(tests, one, beside) > np.log(LEVEL)]
    kept = _reduced(selection, idle)
    fitted = kept.fitted(without=kept.unknown).with_columns(columns)
    counted = [_count(of_terms, one.family) for one in steps]
    counted += [_count(tests, one.family) for one in kept.named]
    scans = sum(one.term.form.scanned is not None for one in steps) + _scans(selection, kept.named)
    law = _evidence(fitted, start, counted, scans)
    return kept if (idle or processes) and law > imitated + _FAR_MORE else None


def _reduced(selection: Selection, gone: Sequence[Chosen]) -> Selection:
    """Return the selection without some members."""
    for one in gone:
        selection = selection.without(one)
    return selection


def _log_level(tests: ScoreTests, one: Chosen, fitted: FittedColumns) -> float:
    """Return ln of the level of a member beside a fit."""
    found = tests.score(one.family, fitted, [one.number])
    return tests.overall(tests.level(one.family, float(found.log_p[0])))


def _of_names(selection: Selection, names: Sequence[Chosen]) -> float:
    """Return the evidence of a selection without its smooth terms."""
    start = _reduced(selection, names)
    counted = [_count(selection.test_set, one.family) for one in names]
    fitted = selection.fitted(without=selection.unknown)
    return _evidence(fitted, start.fitted(without=start.unknown), counted, _scans(selection, names))


def _scans(selection: Selection, names: Sequence[Chosen]) -> int:
    return sum(len(selection.test_set.alternative(one.family, one.number).scanned) for one in names)


def _could_exceed(bare: Selection, library: Library, imitated: float) -> bool:
    """Return whether a single term, if it were the only one tried, could have far more evidence than this.

    A scan can miss most of a fast wave, so terms that show in it are refined.
    """
    start, plain = plain_tests(bare, library)
    search = Search(plain, start, library)
    nothing = _evidence(start, start, (), 0)
    for number, terms in enumerate(library.terms):
        score = plain.score(number, start)
        squares, rank = start.squares - float(score.gain[score.best]), float(score.rank[score.best])
        found = -start.dof / 2 * np.log(max(squares, 1e-300)) - rank / 2 * np.log(start.dof)
        if nothing + _SHOWS < found <= imitated + _FAR_MORE:
            step = refined_step(search, start, 0.0, number + 1, terms[score.best])
            found = _evidence(start.with_columns(step.columns), start, (), 0)
        if found > imitated + _FAR_MORE:
            return True
    return False


def _count(tests: ScoreTests, family: int) -> float:
    return float(np.log(tests.tests[family] * tests.causes))


def _evidence(fitted: FittedColumns, start: FittedColumns, counted: Sequence[float], scans: int) -> float:
    n, sizes = start.dof, start.dof - fitted.dof + scans
    return float(-n / 2 * np.log(fitted.squares) - sizes / 2 * np.log(n) - sum(counted))
