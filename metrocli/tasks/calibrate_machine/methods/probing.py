"""probing: build the adjustment of balls on the workpiece that a probe at the spindle finds.

A reading is the displacement of a ball against the probe, `B_w b - B_t T` in the axes of the bed, as an R-test has it.
It is zero for a touch probe, since its commanded position is where it found the centre.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.instruments.axes.error_motion import Undisturbed
from metrocli.instruments.axes.kinematics import OF_TOOL, OF_WORKPIECE, FromBed, axes_of, seen_from_bed
from metrocli.instruments.axes.rotary import gauge
from metrocli.instruments.machine import Machine
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import commanded, error_blocks, machine_of, must_support
from metrocli.tasks.calibrate_machine.files import Files
from metrocli.tasks.calibrate_machine.methods.targets import Targets, balls_of, with_distances
from metrocli.tasks.calibrate_machine.problem import Problem, conditions, model_of
from metrocli.tasks.calibrate_machine.settings import Settings

READINGS = "probing"
DISPLACEMENTS = ("dx", "dy", "dz")
_FAR = 20.0
"""A ball that the nominal machine places farther from the probe than this [mm] is not the one that was probed"""


def probing(settings: Settings, table: Table, files: Files) -> Problem:
    """Return the adjustment problem; raises InputError if poses, balls and tools do not belong together."""
    if files.balls is None:
        raise InputError("probing needs the approximate places of the balls: `inputs: {balls: balls.csv}`")
    machine = machine_of(settings)
    blocks = error_blocks(machine, settings)
    position = commanded(machine, table)
    found = with_distances(balls_of(settings, blocks, table, files.balls), files.distances)
    must_support(machine, position, blocks)
    read = displacements(table)
    _must_meet(machine, position, found, read, table)
    seen = np.einsum("abn,bn->an", axes_of(machine, position, settings.sensor), read)
    n, place = position.shape[1], seen_from_bed(machine, position, machine.tools[found.tool].T, True)
    shares = {OF_WORKPIECE: np.ones(n), OF_TOOL: -np.ones(n)}
    observations = Observations(
        seen,
        np.full(1, settings.noise.probing or 0.0),
        machine.index(position) | found.index,
        keys=keys_of(table),
        conditions=conditions(machine, position, table, place) | shares | found.first_seen(table),
        components=("x", "y", "z"),
        unit="mm",
    )
    readings = Group(READINGS, Chain((Undisturbed(machine), FromBed(machine, True))), observations)
    unknowns = {**blocks, **found.blocks}
    names = list(settings.tools)
    return Problem(
        model_of(unknowns, readings, (*found.others, *gauge(machine, unknowns))),
        machine,
        np.ones(n),
        tuple(names[i] for i in np.unique(found.tool)),
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


def _must_meet(machine: Machine, position: Array, found: Targets, read: Array, table: Table) -> None:
    """Raise InputError if balls are not where the probe found them."""
    tools = seen_from_bed(machine, position, machine.tools[found.tool].T, True)
    balls = found.places(machine, position, "bed")
    off = np.linalg.norm(balls - tools - read, axis=0)
    if np.median(off) > _FAR:
        # a fault without a hint: a task then tries what may be wrong in the settings
        text = f"the probe is {np.median(off):.0f} mm from the listed balls in the median pose: chain, sense or `at` of"
        raise InputError(
            [table.fault(f"{text} the rotary axes, or the list of the balls, are those of another machine")]
        )
