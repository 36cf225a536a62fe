"""The memory that a diagnosis takes, estimated before anything is computed, and the part of a job that fits.

It is linear in the readings. A diagnosis that would take more than there is would be ended by the system without a
word. So a part of the points (images), drawn evenly, is diagnosed with all their readings.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.adjusted_job import AdjustedJob, MemberSubset
from metrocli.diagnosis.linear.linearised import local_members, shared_unknowns
from metrocli.diagnosis.linear.projection import MOST_NUMBERS, MOST_OF_STATE
from metrocli.diagnosis.linear.scans import most_tried
from metrocli.effects.effect import Effect
from metrocli.effects.model import Model
from metrocli.errors import InputError

_MOST = 4e9
"""Most memory that a diagnosis takes, wherever it runs [bytes]"""
_FIXED = 0.3e9
"""What it takes for few readings: noise that is drawn, samples, modules [bytes]"""
_COPIES, _HELD = 14, 8.75
"""How many copies of the derivatives by the shared unknowns, and of the columns of candidates, are held at once"""
_OF_STATE, _COPIES_OF_STATE = 400, 5
"""Columns of the parts of a state with much structure, if there is room for them, and copies of them"""
_FEWEST = 200
"""Fewest members of a part: of fewer, what they show would depend on which were drawn"""
_SEED = 22
_STATISTICS = "/sys/fs/cgroup/memory.stat"


def as_fits(job: AdjustedJob) -> AdjustedJob:
    """Return the job, or one of a part of its local members where all take more memory than there is.

    Raises InputError, with the numbers, if no part of them fits.
    """
    need, most = needed(job), at_hand()
    rows = sum(group.observations.readings.size for group in job.model.groups)
    dense = MOST_NUMBERS / (rows * max(shared_unknowns(job.model), 1))
    # few readings take what the program takes anyhow, so that fewer of them would not help
    if need <= max(most, 2 * _FIXED) and dense >= 1:
        return job
    # whole members, so that none is known worse than in the whole; detectable sizes grow as the root of the share
    # (docs/decisions/127-a-part-of-the-points.md)
    part = part_of(job, min((most - _FIXED) / (need - _FIXED), dense))
    if part is None:
        readings = sum(group.observations.readings.size for group in job.model.readings)
        raise InputError(
            f"diagnose needs about {need / 1e9:.1f} GB for {readings} readings, and can take {most / 1e9:.1f} GB\n"
            f"diagnose a part of the measurement, such as one point or pose in {math.ceil(need / most)}"
        )
    return part


def part_of(job: AdjustedJob, share: float) -> AdjustedJob | None:
    """Return the job with the readings of a share of its local members only, such as one point in three.

    One is drawn from each of as many stretches of equal length, so that no regular order of the members is met. The
    unknowns of the others are held. None if the job has no local members, or if too few would be left.
    """
    model, local = job.model, local_members(job.model)
    block = local.block
    if block is None:
        return None
    read = np.zeros(len(block.members), dtype=bool)
    for group in model.readings:
        if block.name in group.observations.index:
            read[group.observations.index[block.name]] = True
    members = np.flatnonzero(read & local.members)
    count = int(share * len(members))
    if count < _FEWEST:
        return None
    ends = np.linspace(0, len(members), count + 1).astype(int)
    there = ~local.members
    there[members[np.random.default_rng(_SEED).integers(ends[:-1], ends[1:])]] = True
    kept: dict[str, Mask] = {
        # all: a reading of two members is kept only if both are
        group.name: np.atleast_1d(there[np.atleast_2d(group.observations.index[block.name])].all(axis=0))
        for group in model.groups
        if block.name in group.chain.blocks and block.name in group.observations.index
    }
    groups = tuple(group.selected(kept[group.name]) if group.name in kept else group for group in model.groups)
    fewer = model.with_blocks({**model.blocks, block.name: replace(block, free=block.free & there[:, None])})
    datum = model.datum
    if datum is not None and datum.block == block.name:
        # a member that is held cannot define the frame of those that move
        datum = replace(datum, members=datum.members * there)
    return replace(
        job,
        model=replace(fewer, groups=groups, datum=datum),
        covariates=tuple(
            replace(
                covariate, values={name: _some(values, kept.get(name)) for name, values in covariate.values.items()}
            )
            for covariate in job.covariates
        ),
        folds={name: _some(values, kept.get(name)) for name, values in job.folds.items()},
        part=MemberSubset(block.name, count, len(members)),
    )


def _some(values: npt.NDArray[Any], kept: Mask | None) -> npt.NDArray[Any]:
    return values if kept is None else values[..., kept]


def needed(job: AdjustedJob) -> float:
    """Return the memory that a diagnosis takes at its largest, `f + 8 (n (14 u + 8.75 k) + 5 min(400 n, m))` [bytes].

    n are the rows, u the shared unknowns, k the columns of candidates that change a row; f is for few readings, m the
    largest number of elements of the columns of a state. The factors are those of measured networks of 3,000 to 100,000
    points with much structure.
    """
    rows = sum(group.observations.readings.size for group in job.model.groups)
    columns = _columns_of_effects(job, rows)
    of_state = _COPIES_OF_STATE * min(_OF_STATE * rows, MOST_OF_STATE)
    return float(_FIXED + 8.0 * (rows * (_COPIES * shared_unknowns(job.model) + _HELD * columns) + of_state))


def _columns_of_effects(job: AdjustedJob, rows: int) -> int:
    """Return how many columns of effects each row has at most, those of a step once."""
    sought = (effect for effect in job.effects if not effect.of_one_reading and effect.name not in job.not_sought)
    return sum(len(effect.parameters) * math.prod(_tried(job.model, effect, rows)) for effect in sought)


def _tried(model: Model, effect: Effect, rows: int) -> Iterator[int]:
    """Yield how many values of each scanned parameter are tried at most."""
    for parameter in () if effect.is_step else effect.scanned:
        place = model.places.get(parameter.place)
        yield most_tried(effect, rows) if place is None else len(place.names)


def at_hand() -> float:
    """Return the memory that a diagnosis can take [bytes]: what is free, within the limits of process and group."""
    return max(min(_MOST, *_free(), *_left_by_limits()), 0.0)


def _free() -> list[float]:
    """Return what the system and the control group of the process have left, where they say so."""
    limits = []
    for line in _text("/proc/meminfo").splitlines():
        if line.startswith("MemAvailable:"):
            limits.append(float(line.split()[1]) * 1024)
    most, taken = (_text(f"/sys/fs/cgroup/memory.{name}").strip() for name in ("max", "current"))
    if most.isdigit() and taken.isdigit():
        # files that were read stay in memory until it is needed
        kept = [float(line.split()[1]) for line in _text(_STATISTICS).splitlines() if line.startswith("inactive_file ")]
        limits.append(float(most) - float(taken) + sum(kept))
    return limits


def _left_by_limits() -> list[float]:
    try:
        import resource
    except ImportError:
        return []  # Windows sets no such limit
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    taken = _text("/proc/self/statm").split()
    if limit == resource.RLIM_INFINITY or not taken:
        return []
    return [limit - float(taken[0]) * resource.getpagesize()]


def _text(path: str) -> str:
    """Return the text of a file of the system; nothing where there is no such file."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError:
        return ""
