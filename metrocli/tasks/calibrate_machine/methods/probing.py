"""probing: build the adjustment of balls on the workpiece that a probe at the spindle finds.

A reading is the displacement of a ball against the probe, `B_w b - B_t T` in the axes of the bed, as an R-test has it.
It is zero for a touch probe, since its commanded position is where it found the centre.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index
from metrocli.errors import Fault, InputError
from metrocli.instruments.axes.error_motion import Undisturbed
from metrocli.instruments.axes.kinematics import OF_TOOL, OF_WORKPIECE, ON_WORKPIECE, FromBed, axes_of, seen_from_bed
from metrocli.instruments.axes.rotary import gauge
from metrocli.instruments.machine import Machine
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import commanded, error_blocks, machine_of, must_support, raise_if
from metrocli.tasks.calibrate_machine.files import Files
from metrocli.tasks.calibrate_machine.methods.targets import MeasuredTargets, balls_of, with_distances
from metrocli.tasks.calibrate_machine.problem import MachineProblem, conditions, model_of, tools_used
from metrocli.tasks.calibrate_machine.settings import Settings

READINGS = "probing"
DISPLACEMENTS = ("dx", "dy", "dz")
_FAR = 20.0
"""A ball that the nominal machine places farther from the probe than this [mm] is not the one that was probed"""


def probing(settings: Settings, table: Table, files: Files) -> MachineProblem:
    """Return the adjustment problem; raises InputError if poses, balls and tools do not belong together."""
    if files.balls is None:
        raise InputError("probing needs the approximate places of the balls: `inputs: {balls: balls.csv}`")
    machine = machine_of(settings)
    blocks = error_blocks(machine, settings)
    position = commanded(machine, table)
    targets = with_distances(balls_of(settings, blocks, table, files.balls), files.distances)
    must_support(machine, position, blocks)
    read = displacements(table)
    _must_meet(machine, position, targets, read, table)
    seen = np.einsum("abn,bn->an", axes_of(machine, position, settings.sensor), read)
    n, place = position.shape[1], seen_from_bed(machine, position, machine.tools[targets.tool].T, True)
    shares = {OF_WORKPIECE: np.ones(n), OF_TOOL: -np.ones(n)}
    observations = Observations(
        seen,
        np.full(1, settings.noise.probing or 0.0),
        machine.index(position) | targets.index,
        keys=keys_of(table),
        conditions=conditions(machine, position, table, place) | shares,
        components=("x", "y", "z"),
        unit="mm",
    )
    readings = Group(READINGS, Chain((Undisturbed(machine), FromBed(machine, True))), observations)
    unknowns = {**blocks, **targets.blocks}
    return MachineProblem(
        model_of(unknowns, readings, (*targets.others, *gauge(machine, unknowns))),
        machine,
        np.ones(n),
        tools_used(settings, targets.tool),
        targets.read_once,
    )


def displacements(table: Table) -> Array:
    """Return the displacements that were read, (3, n): zero for a touch probe.

    Raises InputError if some of dx, dy, dz are there and others not.
    """
    given = [name for name in DISPLACEMENTS if name in table]
    if not given:
        return np.zeros((3, len(table)))
    if len(given) < len(DISPLACEMENTS):
        missing = ", ".join(name for name in DISPLACEMENTS if name not in given)
        raise InputError([table.fault(f"{missing} is missing", "give dx, dy and dz, or none for a touch probe")])
    return table.stacked(DISPLACEMENTS).T


def keys_of(table: Table) -> dict[str, tuple[str, ...]]:
    """Return the names of the readings: the ball, and its how manieth probing."""
    balls = table.texts("ball")
    seen: dict[str, int] = {}
    number = []
    for ball in balls:
        seen[ball] = seen.get(ball, 0) + 1
        number.append(str(seen[ball]))
    return {"ball": tuple(balls), "probing": tuple(number)}


def _must_meet(machine: Machine, position: Array, targets: MeasuredTargets, read: Array, table: Table) -> None:
    """Raise InputError if balls are not where the probe found them, or have the names of others."""
    tools = seen_from_bed(machine, position, machine.tools[targets.tool].T, True) + read
    off = np.linalg.norm(targets.places(machine, position, "bed") - tools, axis=0)
    if (off <= _FAR).all():
        return
    balls = targets.blocks[ON_WORKPIECE]
    places = (np.broadcast_to(ball[:, None], tools.shape) for ball in balls.values)
    gaps = np.array([np.linalg.norm(seen_from_bed(machine, position, own, False) - tools, axis=0) for own in places])
    at, meets = gaps.argmin(axis=0), gaps.min(axis=0) <= _FAR
    if meets.mean() > 0.5:
        wrong = np.flatnonzero(meets & (off > _FAR))
        raise_if(_of_other_names(targets.fixed, at, wrong, balls.members, table))
    elif np.median(off) > _FAR:
        # a fault without a hint: a task then tries what may be wrong in the settings
        raise InputError(
            [
                table.fault(
                    f"the probe is {np.median(off):.0f} mm from the listed balls in the median pose: the tool, chain, "
                    "sense or `at` of the rotary axes, or the list of the balls, are those of another machine"
                )
            ]
        )


def _of_other_names(named: Index, at: Index, wrong: Index, names: Sequence[str], table: Table) -> Iterator[Fault]:
    """Yield faults of rows in which the probe is at another ball than the named one."""
    for first, other in combinations(range(len(names)), 2):
        both = np.isin(named, (first, other))
        if np.isin(np.flatnonzero(both), wrong).all() and (at[both] == first + other - named[both]).all():
            pair = names[first], names[other]
            text = f"{pair[0]} and {pair[1]} are exchanged: the probe finds each at the listed place of the other"
            yield table.fault(text, "exchange their names in the list of the balls, or in the column `ball`")
            wrong = wrong[~both[wrong]]
    have_it = "as the machine and the listed balls have it"
    yield from table.faults_at(
        wrong,
        lambda row: f"the probe is at {names[at[row]]}, not at {names[named[row]]}, {have_it}",
        lambda row: "is the name of the ball right?",
    )
