"""Candidates whose cause is not known: waves of a covariate, and a motion in proportion to one.

They are structure that no effect and no correlated error has: images in turn left and right, a unit that creeps.
Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob, Covariate
from metrocli.diagnosis.linear.candidates import Alternative, Family
from metrocli.diagnosis.linear.columns import Columns
from metrocli.diagnosis.linear.projection import System
from metrocli.effects.effect import Effect, Parameter

_STEPS = 6
"""Fewest different values of a covariate whose waves are tried"""
_MOST = 40
"""Largest number of frequencies, half a period over the range apart"""
_EFFECT = Effect("", "a cause that is not known", (Parameter("size"),))


def unknown_families(job: AdjustedJob, system: System) -> Iterator[Family]:
    """Yield the waves of each periodic covariate, and the motion in proportion to each that is one."""
    for covariate in job.covariates:
        columns = []
        if covariate.together:
            columns = [_motion(job, system, covariate)]
        elif covariate.periodic:
            columns = list(_waves(job, system, covariate))
        if columns:
            yield _family(system, covariate.name, columns)


def _family(system: System, name: str, columns: Sequence[Array]) -> Family:
    whole = Columns.of(np.stack(columns, axis=1))
    alternatives = tuple(Alternative(_EFFECT, (str(number),)) for number in range(len(columns)))
    return Family(f"varies with {name}", alternatives, whole, whole.norms(), whole.grams(system.basis), name)


def _motion(job: AdjustedJob, system: System, covariate: Covariate) -> Array:
    """Return the coordinates of a covariate, which are changes of the readings themselves, whitened."""
    found = np.zeros((system.rows, len(next(iter(covariate.values.values())))))
    for group in job.model.readings:
        d, n = group.observations.readings.shape
        rows = slice(system.first[group.name], system.first[group.name] + d * n)
        found[rows] = np.repeat(covariate.values[group.name].T, d, axis=0) / system.scale[rows][:, None]
    return found


def _waves(job: AdjustedJob, system: System, covariate: Covariate) -> Iterator[Array]:
    """Yield cosine and sine of each component, from one period over the range up to one in two steps (Nyquist)."""
    values = {name: one for name, one in covariate.values.items() if np.ndim(one) == 1}
    every = np.concatenate([*values.values(), np.zeros(0)])
    steps = np.unique(every)
    if len(steps) < _STEPS:
        return
    low, span = float(steps[0]), float(np.ptp(steps))
    turns = np.arange(1.0, (len(steps) - 1) / 2 + 0.1, 0.5)
    for turn in turns[:_MOST]:
        parts = []
        for group in job.model.readings:
            if group.name in values:
                d, n = group.observations.readings.shape
                phase = np.repeat(2 * np.pi * turn * (values[group.name] - low) / span, d)
                rows = slice(system.first[group.name], system.first[group.name] + d * n)
                own = np.zeros((system.rows, 2 * d))
                for component in range(d):
                    at = np.arange(rows.start, rows.stop)[component::d]
                    factor = group.observations.deviations.T.ravel()[component::d] / system.scale[at]
                    own[at, 2 * component] = np.cos(phase[component::d]) * factor
                    own[at, 2 * component + 1] = np.sin(phase[component::d]) * factor
                parts.append(own)
        yield np.concatenate(parts, axis=1)
