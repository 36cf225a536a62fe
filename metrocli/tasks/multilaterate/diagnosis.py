"""A multilateration in the form that diagnosis needs, and what lengths read one after the other share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from metrocli.adjust.clusters.robust import Clusters
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group, ReadBlock
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index, Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob, Delivered
from metrocli.effects.acting import NOMINAL
from metrocli.effects.covariates import Covariate
from metrocli.effects.effect import ELAPSED, WARMING
from metrocli.effects.estimates import free_blocks
from metrocli.effects.extension import with_conditions
from metrocli.effects.model import Model, Place
from metrocli.instruments import tracer as t
from metrocli.instruments.frames import DistanceBetween
from metrocli.tasks.multilaterate import KIND
from metrocli.tasks.multilaterate.effects import EFFECTS, RANGING
from metrocli.tasks.multilaterate.problem import LENGTHS
from metrocli.tasks.multilaterate.solve import AdjustedTracers, refitted
from metrocli.tasks.shared.diagnosed import FOLDS, in_order, in_parts, of_beam
from metrocli.tasks.shared.environment import blocks_of
from metrocli.tasks.shared.lists import unless_without_noise
from metrocli.tasks.shared.noise import POINTS_IN_TIME, JobNoise, count, in_blocks, job_noise
from metrocli.units import parse_quantity

_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
_BEYOND = 0.2
"""Share of its size by which the box of offered points exceeds points and tracers on each side"""
_BAR = parse_quantity("1 um", "length")
"""Standard uncertainty of an offered calibrated distance"""


def adjusted_job(solved: AdjustedTracers) -> AdjustedJob:
    """Return an adjusted network in the form that diagnosis needs."""
    network = solved.network
    model = with_conditions(replace(network.model, blocks=solved.solution.blocks, groups=solved.solution.groups))

    def refit(changed: Model, keep: Mapping[str, Mask]) -> Solution:
        return refitted(network.with_model(changed), keep[LENGTHS])

    group = model.readings[0]
    points = model.blocks[t.POINT].free.any()
    delivered = ("point coordinates", t.POINT) if points else ("places of the tracers", t.TRACER)
    return AdjustedJob(
        KIND.name,
        model,
        tuple(
            replace(effect, usual=RANGING.get(effect.name, effect.usual)) if network.absolute else effect
            for effect in EFFECTS
        ),
        tuple(covariates(model)),
        ("tracer",),
        {LENGTHS: folds(group.observations.index[t.POINT], group.observations.conditions)},
        Delivered(*delivered, (0, 1, 2), "um", "length"),
        refit,
        list_offset=solved.list_offset,
        left_out=len(solved.rejected),
        sharing=count(clusters_of(solved)),
        offers=offers,
        noticed=(*network.warnings, *unless_without_noise(network.stuck, solved.solution.sigma0)),
    )


def covariates(model: Model) -> Iterator[Covariate]:
    """Yield the quantities with which an unknown effect on lengths could vary."""
    group = model.readings[0]
    yield from in_order(group)
    yield from of_beam(group, t.beams(t.reach(), model.blocks, group.observations))
    points = model.blocks[t.POINT].values[group.observations.index[t.POINT]].T
    yield Covariate("place of the point", {LENGTHS: np.ascontiguousarray(points)})


def folds(point: Index, conditions: Mapping[str, Array]) -> Index:
    """Return the part of each length, (n,): ten parts with about equal numbers of points, in order of time if given."""
    number = np.unique(point, return_inverse=True)[1]
    when = conditions.get("t", np.arange(len(point), dtype=float))
    mean = np.bincount(number, when) / np.bincount(number)
    return in_parts(mean, min(FOLDS, len(mean)))[number]


_CLOSING = 4
"""One point in this many is measured again"""


def offers(model: Model) -> Iterator[tuple[str, Model]]:
    """Yield additional measurements that could be made, each with the extended model, the cheapest first."""
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
    if ELAPSED in observations.conditions:
        yield (
            "eight points all around the tracers, by all of them, at the beginning and at the end",
            _with_corners(model),
        )
    ends = _far_apart(model.blocks[t.POINT].values)
    names = [model.blocks[t.POINT].members[i] for i in ends]
    yield f"a calibrated distance from {names[0]} to {names[1]} (to 1 um)", _with_bar(model, ends)


def _with_repeats(model: Model, rows: Index, later: float, warmer: float = 0.0) -> Model:
    """Return the model with some readings repeated after the measurement.

    `later` is the break before the repetition, as a share of the duration of the measurement; `warmer` is in K.
    """
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
    repeated = old.followed_by(replace(new, conditions=conditions))
    return model.with_group(group.with_observations(repeated))


def _with_corners(model: Model) -> Model:
    """Return the model with new points, read at begin and end, at the corners of a box around tracers and points."""
    group, block, tracers = model.readings[0], model.blocks[t.POINT], model.blocks[t.TRACER]
    places = np.concatenate([block.values, tracers.values[:, :3]])
    low, high = places.min(axis=0), places.max(axis=0)
    corners = low + (high - low) * (_CORNERS * (1 + 2 * _BEYOND) - _BEYOND)
    names = tuple(f"corner {i}" for i in range(len(corners)))
    points = replace(
        block,
        values=np.concatenate([block.values, corners]),
        members=(*block.members, *names),
        free=np.concatenate([block.free, np.ones((len(corners), 3), dtype=bool)]),
    )
    m, old = len(tracers.members), group.observations
    corner, tracer = np.divmod(np.tile(np.arange(len(corners) * m), 2), m)
    rows = np.array([int(np.flatnonzero(old.index[t.TRACER] == j)[0]) for j in range(m)])[tracer]
    new = old.selected(rows)
    late = np.repeat([0.0, 1.0], len(corners) * m)
    span = {name: (values.min(), np.ptp(values)) for name, values in old.conditions.items() if name in ("t", ELAPSED)}
    conditions = {name: start + width * late for name, (start, width) in span.items()}
    conditions |= dict(zip(NOMINAL, corners[corner].T, strict=True))
    changed = new.with_index({t.POINT: len(block.members) + corner}).with_conditions(conditions)
    changed = replace(changed, keys={**new.keys, "point": tuple(names[i] for i in corner)})
    datum = model.datum
    if datum is not None:
        zeros = np.zeros(len(corners))
        datum = replace(
            datum,
            reference=np.concatenate([datum.reference, corners]),
            members=np.concatenate([datum.members, zeros]),
        )
    groups = tuple(
        replace(measured, observations=old.followed_by(changed)) if measured is group else _of_more(measured, points)
        for measured in model.groups
    )
    places_ = {**model.places, "point": Place(points.members, t.POINT)}
    whole = replace(model, blocks={**model.blocks, t.POINT: points}, groups=groups, datum=datum, places=places_)
    return with_conditions(whole)


def _of_more(group: Group, block: Block) -> Group:
    """Return a group of priors whose reference includes the new members of the block."""
    links = tuple(
        replace(link, reference=np.concatenate([link.reference, block.values[len(link.reference) :]]))
        if isinstance(link, ReadBlock) and link.block == block.name
        else link
        for link in group.chain.links
    )
    return replace(group, chain=Chain(links))


def _far_apart(points: Array) -> tuple[int, int]:
    """Return the rows of two points whose distance is about the largest of all."""
    first = int(np.argmax(((points - points.mean(axis=0)) ** 2).sum(axis=1)))
    return first, int(np.argmax(((points - points[first]) ** 2).sum(axis=1)))


def _with_bar(model: Model, ends: tuple[int, int]) -> Model:
    index = {t.POINT: np.array(ends)[:, None]}
    observations = Observations(np.zeros((1, 1)), np.array(_BAR), index, components=("length",), unit="mm")
    bar = Group("offered distance", Chain((DistanceBetween(t.POINT),)), observations)
    return replace(model, groups=(*model.groups, bar.with_observations(bar.simulated(model.blocks).observations)))


def noise_of(solved: AdjustedTracers, model: str, factor: float) -> JobNoise:
    """Return the noise of a solved network; raises UndeterminedError for fewer than ten points if it is structured."""
    estimates = (t.TRACER, *blocks_of(solved.solution), *free_blocks(solved.network.effects))

    def clusters() -> Clusters:
        # the lengths of a point are from several tracers, whose errors are independent of each other
        free = solved.network.datum is not None
        return Clusters({solved.group.name: clusters_of(solved)}, POINTS_IN_TIME, grows=False, free=free)

    return job_noise((solved.solution, factor), model, clusters, estimates)


def clusters_of(solved: AdjustedTracers) -> Index:
    """Return the block of points in time of each length used, (n,).

    All lengths of a point are in one block, so that each point belongs to one. Points follow each other by the mean
    time of their lengths, without times by the first length in the file.
    """
    observations = solved.group.observations
    point = observations.index[t.POINT]
    used, number = np.unique(point, return_inverse=True)
    return in_blocks(_order(observations.conditions.get("t"), number, len(used)))[number]


def _order(time: Array | None, number: Index, count: int) -> Array:
    """Return by what the points are in order, (count,)."""
    if time is not None:
        return np.asarray(np.bincount(number, time, count) / np.bincount(number, minlength=count))
    first = np.full(count, len(number), dtype=float)
    np.minimum.at(first, number, np.arange(len(number)))
    return first
