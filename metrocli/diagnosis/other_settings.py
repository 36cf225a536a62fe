"""Settings that the readings contradict without being absurd: another setting fits them far better.

Method: docs/decisions/134-other-settings.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from metrocli.adjust.dense_jacobian import least_square, unit_noise
from metrocli.adjust.model.blocks import Array
from metrocli.adjust.probabilities import f_tail
from metrocli.diagnosis.adjusted_job import ABSURD, BETTER, AdjustedJob
from metrocli.diagnosis.trials import FAILURES, MOST_ROWS, Mistaken, Others, adjusted_trials
from metrocli.doubt import MANY_LEFT_OUT
from metrocli.effects.model import Model

_OTHER_FITS = 2.0
"""Another setting is reported if it makes the squared residuals so many times smaller, or with fewer unknowns any"""
_BY_CHANCE = 1e-4
"""Level of the F test that they are smaller by chance"""
_FEWER = 3.0
"""Another setting is reported, too, if it leaves out so many times fewer outliers"""
_BELOW_NOISE = 0.01
"""Share of their mean square below which the residuals fall with smaller numbers alone: then these show nothing"""
_SURELY = 1.05
"""A least mean square that is so many times what would do rules an adjustment out: it is known to a few thousandths"""
_MOST_FITTING, _LARGER_NOISE = 5_000, 2.0
"""Most readings of a job that is tried though its residuals are no more than so many standard deviations"""


def with_other_setting(job: AdjustedJob, others: Others) -> Mistaken | None:
    """Return the setting with which the readings of an adjusted job fit best, if they fit far better than with its own.

    Residuals of all are in the median standard deviations of the job. A common factor of these, as of a noise that
    follows the residuals, does not matter. Readings that are left out as outliers no longer contradict a setting: then
    one with which most of them fit is the better one.
    """
    readings = job.model.readings
    size = {group.name: np.median(group.observations.deviations, axis=1) for group in readings}
    # sizes are fixed: an estimated noise would grow with the wrong chain and hide it
    # (docs/decisions/134-other-settings.md)
    before, dof = _mean_square(job, size), _redundant(job)
    observed = [group.observations for group in readings]
    count, rows = sum(each.count for each in observed), sum(each.readings.size for each in observed)
    if count > (_MOST_FITTING if before <= _LARGER_NOISE**2 else MOST_ROWS):
        return None
    many = job.left_out >= MANY_LEFT_OUT
    hopeless = partial(_cannot_fit, size=size, most=before * _OTHER_FITS if many else before / _OTHER_FITS)
    trials = others(float(np.sqrt(before * rows / dof)), job.left_out, hopeless)
    each = [
        (not (many and other.left_out * _FEWER <= job.left_out), _mean_square(other, size), mistake, other)
        for mistake, _, other in adjusted_trials(trials)
    ]
    # numbers that are made smaller have smaller residuals, whatever is wrong
    each = [trial for trial in each if not trial[0] or before * trial[2].shrinks ** 2 >= _BELOW_NOISE * trial[1]]
    if not each:
        return None
    as_many, after, mistake, other = min(each, key=lambda trial: trial[:2])
    ratio = before / max(after, 1e-12)
    # one set of readings gives both squares, which then differ less than the independent ones of an F test
    as_good = (ratio < _OTHER_FITS and _redundant(other) <= dof) or f_tail(dof, dof, ratio) > _BY_CHANCE
    # what leaves the readings absurd has to explain nearly all of it
    if after > ABSURD**2 and ratio < BETTER**2 and as_many:
        return None
    if as_good and (as_many or ratio * _OTHER_FITS < 1):
        return None
    # a column in another unit is a slip, without a size that could be fitted; a setting was written on purpose
    on_purpose = as_many and not mistake.file
    if on_purpose and f_tail(dof, dof, _mean_square(_with_effects(job), size) / max(after, 1e-12)) > _BY_CHANCE:
        return None
    return Mistaken((mistake,), other, float(np.sqrt(before)), float(np.sqrt(after)), job.left_out)


def _with_effects(job: AdjustedJob) -> AdjustedJob:
    """Return the job with the effects in its model that explain most: likelier than a setting that does no better."""
    # most jobs never come here, and these load much (docs/decisions/154-loaded-where-used.md)
    from metrocli.diagnosis.evidence.identified import all_identified
    from metrocli.diagnosis.evidence.measured_job import measurement_of
    from metrocli.diagnosis.evidence.search import forward
    from metrocli.diagnosis.evidence.state import State
    from metrocli.diagnosis.extended_fit import extended_fit

    state = forward(State.of(measurement_of(job, quick=True)))
    return extended_fit(job, all_identified(state, with_rivals=False), {}) or job


def _cannot_fit(begun: Callable[[], Model], size: Mapping[str, Array], most: float) -> bool:
    """Return whether no weights and no values bring the mean square of `_mean_square` down to `most`."""
    try:
        model = begun()
    except FAILURES:
        return False
    units = [unit_noise(group, size[group.name][:, None]) for group in model.readings]
    least = sum(least_square(group, model.blocks) for group in units)
    return least > _SURELY * most * sum(group.observations.readings.size for group in units)


def _mean_square(job: AdjustedJob, size: Mapping[str, Array]) -> float:
    """Return the mean square of the residuals of a job, each over the size of its component."""
    rows = [group.residuals(job.model.blocks) / size[group.name][:, None] for group in job.model.readings]
    return float(np.mean(np.concatenate([row.ravel() for row in rows]) ** 2))


def _redundant(job: AdjustedJob) -> int:
    """Return the number of rows beyond the unknowns, at least 1."""
    rows = sum(group.residuals(job.model.blocks).size for group in job.model.groups)
    return max(rows - sum(int(block.free.sum()) for block in job.model.blocks.values()), 1)
