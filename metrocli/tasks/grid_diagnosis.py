"""A self-calibration as diagnosis sees it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.coupled import adjust_fields
from metrocli.adjust.observations import Index, Mask
from metrocli.adjust.solution import Solution
from metrocli.diagnosis.subject import Covariate, Delivered, Subject
from metrocli.effects import effects_of
from metrocli.effects.effect import ELAPSED, WARMING
from metrocli.effects.model import Model, with_conditions
from metrocli.instruments import ball_grid as bg
from metrocli.tasks.grid_problem import READINGS
from metrocli.tasks.grid_report import KIND
from metrocli.tasks.grid_solve import Solved

FOLDS = 10
_FEWEST = 4
"""Components that an effect must touch: what touches one reading only is an outlier"""


def subject(solved: Solved) -> Subject:
    """Return the subject of an adjusted self-calibration."""
    problem = solved.problem
    model = with_conditions(replace(problem.model(), blocks=solved.solution.blocks))

    def refit(changed: Model, keep: Mapping[str, Mask]) -> Solution:
        return adjust_fields(problem.with_model(changed).only(keep[READINGS]).fields).solution

    index = problem.readings.observations.index
    return Subject(
        KIND,
        model,
        effects_of(KIND),
        tuple(_covariates(model)),
        ("view",),
        {READINGS: folds(index[bg.ARTEFACT], index[bg.VIEW])},
        Delivered("machine error", bg.MACHINE, (0, 1, 2), "um", "length"),
        refit,
        fewest=_FEWEST,
        single_components=True,
    )


def _covariates(model: Model) -> Iterator[Covariate]:
    """Yield what an unknown effect could vary with."""
    observations = model.readings[0].observations
    for name, key in (("t_s", ELAPSED), ("temp_degC", WARMING)):
        if key in observations.conditions:
            yield Covariate(name, {READINGS: observations.conditions[key]}, 6)
    if ELAPSED not in observations.conditions:
        yield Covariate("order of the readings", {READINGS: np.arange(observations.count, dtype=float)}, 6)
    nominal: Array = model.readings[0].chain.predict(model.blocks, observations)
    yield Covariate("place in the machine", {READINGS: np.ascontiguousarray(np.round(nominal, 1))}, 3)


def folds(ball: Index, view: Index) -> Index:
    """Return ten parts such that no ball loses more than one reading to a part, where it has no more than ten."""
    return np.asarray((7 * ball + 3 * view + ball // FOLDS) % FOLDS)
