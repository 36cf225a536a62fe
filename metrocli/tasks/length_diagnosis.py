"""A multilateration as diagnosis sees it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.chain import Chain
from metrocli.adjust.groups import Group
from metrocli.adjust.observations import Index, Mask, Observations
from metrocli.adjust.solution import Solution
from metrocli.diagnosis.subject import Covariate, Delivered, Subject
from metrocli.effects import effects_of
from metrocli.effects.effect import ELAPSED, WARMING
from metrocli.effects.model import Model, with_conditions
from metrocli.instruments import tracer as t
from metrocli.instruments.frames import DistanceBetween
from metrocli.tasks.length_network import LENGTHS
from metrocli.tasks.network_report import KIND
from metrocli.tasks.network_solve import Solved, refitted
from metrocli.units import parse_quantity

FOLDS = 10
_BAR = parse_quantity("1 um", "length")


def subject(solved: Solved) -> Subject:
    """Return the subject of an adjusted network."""
    network = solved.network
    model = with_conditions(
        replace(network.model(), blocks=solved.solution.blocks, groups=solved.solution.groups, aspects=t.ASPECTS)
    )

    def refit(changed: Model, keep: Mapping[str, Mask]) -> Solution:
        return refitted(network.with_model(changed), keep[LENGTHS])

    group = model.readings[0]
    points = model.blocks[t.POINT].free.any()
    delivered = ("point coordinates", t.POINT) if points else ("places of the tracers", t.TRACER)
    return Subject(
        KIND,
        model,
        effects_of(KIND),
        tuple(covariates(model)),
        ("tracer",),
        {LENGTHS: folds(group.observations.index[t.POINT], group.observations.conditions)},
        Delivered(*delivered, (0, 1, 2), "um", "length"),
        refit,
        offers=offers,
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


_CLOSING = 4
"""One point in so many is measured again"""


def offers(model: Model) -> Iterator[tuple[str, Model]]:
    """Yield what could be measured in addition, the cheapest first."""
    group = model.readings[0]
    observations = group.observations
    points = observations.index[t.POINT]
    some = np.flatnonzero(points % _CLOSING == 0)
    if ELAPSED in observations.conditions:
        first = f"every {_CLOSING}th point again at the end, by all tracers"
        yield first, _with_repeats(model, some, later=0.1)
        yield f"{first}, after a break as long as the measurement", _with_repeats(model, some, later=1.0)
    if WARMING in observations.conditions:
        yield (
            f"every {_CLOSING}th point again with the air 2 K warmer",
            _with_repeats(model, some, later=1.0, warmer=2.0),
        )
    ends = _far_apart(model.blocks[t.POINT].values)
    names = [model.blocks[t.POINT].members[i] for i in ends]
    yield f"a calibrated distance from {names[0]} to {names[1]} (to 1 um)", _with_bar(model, ends)


def _with_repeats(model: Model, rows: Index, later: float, warmer: float = 0.0) -> Model:
    """Return the model with some readings taken again, later by a share of the time that the measurement took."""
    group = model.readings[0]
    old = group.observations
    new = old.selected(rows)
    conditions = dict(new.conditions)
    if ELAPSED in conditions:
        span = float(np.ptp(old.conditions[ELAPSED]))
        turn = np.linspace(0, span * len(rows) / old.count, len(rows))
        shift = span * (1 + later) + turn - conditions[ELAPSED]
        conditions |= {name: conditions[name] + shift for name in ("t", ELAPSED) if name in conditions}
    if WARMING in conditions:
        last = float(old.conditions[WARMING][np.argmax(old.conditions.get(ELAPSED, np.zeros(1)))])
        conditions[WARMING] = np.full(len(rows), last + warmer)
    joined = replace(
        old,
        readings=np.concatenate([old.readings, new.readings], axis=1),
        sigma=np.concatenate([old.sigma, new.sigma], axis=1),
        index={name: np.concatenate([index, new.index[name]], axis=-1) for name, index in old.index.items()},
        keys={name: (*values, *new.keys[name]) for name, values in old.keys.items()},
        conditions={name: np.concatenate([values, conditions[name]]) for name, values in old.conditions.items()},
    )
    groups = tuple(replace(one, observations=joined) if one is group else one for one in model.groups)
    return replace(model, groups=groups)


def _far_apart(points: Array) -> tuple[int, int]:
    """Return two points that are nearly as far apart as any."""
    one = int(np.argmax(((points - points.mean(axis=0)) ** 2).sum(axis=1)))
    return one, int(np.argmax(((points - points[one]) ** 2).sum(axis=1)))


def _with_bar(model: Model, ends: tuple[int, int]) -> Model:
    index = {t.POINT: np.array(ends)[:, None]}
    observations = Observations(np.zeros((1, 1)), np.array(_BAR), index, components=("length",), unit="mm")
    bar = Group("offered distance", Chain((DistanceBetween(t.POINT),)), observations)
    return replace(model, groups=(*model.groups, bar.with_observations(bar.simulated(model.blocks).observations)))
