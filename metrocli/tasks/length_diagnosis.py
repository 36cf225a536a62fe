"""A multilateration as diagnosis sees it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.observations import Index, Mask
from metrocli.adjust.solution import Solution
from metrocli.diagnosis.subject import Covariate, Delivered, Subject
from metrocli.effects import effects_of
from metrocli.effects.effect import ELAPSED, WARMING
from metrocli.effects.model import Model, with_conditions
from metrocli.instruments import tracer as t
from metrocli.tasks.length_network import LENGTHS
from metrocli.tasks.network_report import KIND
from metrocli.tasks.network_solve import Solved, refitted

FOLDS = 10


def subject(solved: Solved) -> Subject:
    """Return the subject of an adjusted network."""
    network = solved.network
    model = with_conditions(
        replace(network.model(), blocks=solved.solution.blocks, groups=solved.solution.groups, aspects=t.ASPECTS)
    )

    def refit(changed: Model, keep: Mapping[str, Mask]) -> Solution:
        return refitted(network.with_model(changed), keep[LENGTHS])

    group = model.readings[0]
    return Subject(
        KIND,
        model,
        effects_of(KIND),
        tuple(covariates(model)),
        ("tracer",),
        {LENGTHS: folds(group.observations.index[t.POINT], group.observations.conditions)},
        Delivered("point coordinates", t.POINT, (0, 1, 2), "um", "length"),
        refit,
    )


def covariates(model: Model) -> list[Covariate]:
    """Return what an unknown effect on lengths could vary with."""
    observations = model.readings[0].observations
    conditions = observations.conditions
    found = [
        Covariate(name, {LENGTHS: conditions[key]}, 6)
        for name, key in (("t_s", ELAPSED), ("temp_degC", WARMING))
        if key in conditions
    ]
    if ELAPSED not in conditions:
        found.append(Covariate("order of the readings", {LENGTHS: np.arange(observations.count, dtype=float)}, 6))
    beam = t.beams(model.blocks, observations)
    length = np.sqrt((beam**2).sum(axis=0))
    found.append(Covariate("length_mm", {LENGTHS: length}, 5))
    found.append(Covariate("beam azimuth", {LENGTHS: np.arctan2(beam[1], beam[0])}, 4, angle=True))
    found.append(Covariate("beam elevation", {LENGTHS: beam[2] / length}, 4))
    points = model.blocks[t.POINT].values[observations.index[t.POINT]].T
    found.append(Covariate("place of the point", {LENGTHS: np.ascontiguousarray(points)}, 3))
    return found


def folds(point: Index, conditions: Mapping[str, Array]) -> Index:
    """Return ten parts of about equally many points, in the order of time where there is one."""
    points = np.unique(point)
    when = conditions.get("t", np.arange(len(point), dtype=float))
    mean = np.bincount(point, when) / np.maximum(np.bincount(point), 1)
    rank = np.empty(len(mean), dtype=np.intp)
    rank[points[np.argsort(mean[points], kind="stable")]] = np.arange(len(points))
    return np.asarray(rank[point] * min(FOLDS, len(points)) // len(points))
