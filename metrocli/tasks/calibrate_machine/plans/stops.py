"""Plan points at standstill: what those of the job and the proposed ones will determine."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import UndeterminedError
from metrocli.instruments.machine import POSITION
from metrocli.nc_program import Block as NcBlock
from metrocli.nc_program import Dwell, Feed, Stop, program
from metrocli.plan import Plan
from metrocli.result import Estimate
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import machine_of
from metrocli.tasks.calibrate_machine.files import NO_FILES
from metrocli.tasks.calibrate_machine.methods.poses import without_errors
from metrocli.tasks.calibrate_machine.methods.standstill import standstill
from metrocli.tasks.calibrate_machine.plans.planned import (
    PLACES,
    REST,
    Worth,
    planned,
    tracker_in_words,
    tracker_pose,
    worth_of,
)
from metrocli.tasks.calibrate_machine.plans.settings import PathPlan
from metrocli.tasks.calibrate_machine.problem import MachineProblem, tools_of
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.calibrate_machine.volume import grid_of, spread_over
from metrocli.tasks.calibrate_machine.warnings import identifiability_notes

_FEWEST, _GROWTH, _MOST = 12, 1.25, 5000


def plan_of_points(settings: Settings, points: Table | None) -> Plan:
    """Return what the job's points will determine, and propose points over the volume, as few as the ratio allows.

    The points follow a sequence that fills the volume evenly from its start on, so that place and time are not
    correlated. Raises UndeterminedError if even the longest list does not reach the wanted ratio.
    """
    wanted = settings.plan or PathPlan()
    own = []
    if points is not None:
        own = judged(f"the points of the job: {len(points)}", settings, _seen(settings, points))
    # Each point gives three coordinates and each knot has six errors: at least two points per knot are needed
    count = max(float(_FEWEST), 2 * sum(len(axis.knots) for axis in machine_of(settings).axes) / len(settings.tools))
    while True:
        table = all_over(settings, round(count))
        worth = worth_or_lack(settings, _seen(settings, table))
        if isinstance(worth, Worth) and worth.identified.ratio <= wanted.ratio:
            break
        if count > _MOST:
            raise UndeterminedError(f"{len(table)} points do not reach a ratio of {wanted.ratio:g}: give fewer knots")
        count *= _GROWTH
    names, tool = list(settings.tools), tools_of(table, settings)
    blocks: list[NcBlock] = []
    for k, name in enumerate(names):
        blocks.append(Stop(f"mount reflector {name}".strip()))
        blocks += visits(table.stacked(POSITION)[tool == k], wanted.feed)
    text = program(
        "metrocli points for calibrate-machine", [*PLACES, "a reading in each dwell"], blocks, wanted.control
    )
    where = tracker_in_words(machine_of(settings), wanted)
    notes = [*own, f"proposed: {len(table)} points", where, *identifiability_notes(worth.identified)[1:]]
    files: dict[str, Table | str] = {"points.csv": table, "points.nc": text}
    return planned(notes, (Estimate("points", float(len(table)), 0.0, "1"),), worth, files, [])


def visits(places: Array, feed: float) -> list[NcBlock]:
    """Return moves to places (n, 3) with a rest at each."""
    return [block for at in places.tolist() for block in (Feed(dict(zip("XYZ", at, strict=True)), feed), Dwell(REST))]


def all_over(settings: Settings, count: int) -> Table:
    """Return `count` points and the eight corners for each tool, one tool after the other.

    Each tool has its own piece of the Halton sequence. If the points went to the tools in turn, each of two tools
    would get only one half of X, and each of three tools only a third of Y (bases 2 and 3).
    """
    machine, names = machine_of(settings), list(settings.tools)
    corners, inside = grid_of(machine, (2, 2, 2)), spread_over(machine, count * len(names))
    pieces = np.split(inside, len(names), axis=1)
    position = np.round(np.concatenate([part for piece in pieces for part in (corners, piece)], axis=1), 2)
    table = Table.of({"point": [f"P{i + 1:03d}" for i in range(position.shape[1])], "x y z [mm]": position.T})
    return table if names == [""] else table.joined({"tool": np.repeat(np.array(names), 8 + count)})


def _seen(settings: Settings, table: Table) -> Callable[[], MachineProblem]:
    """Return a function that builds the adjustment of points, measured by a tracker on a machine without errors."""
    machine = machine_of(settings)
    pose = tracker_pose(machine.low, machine.high, settings.plan or PathPlan())
    return lambda: standstill(settings, without_errors(settings, table, NO_FILES, pose)[0])


def worth_or_lack(settings: Settings, problem: Callable[[], MachineProblem]) -> Worth | UndeterminedError:
    """Return what the readings of a problem will determine, or what they leave open."""
    try:
        return worth_of(settings, problem())
    except UndeterminedError as error:
        return error


def judged(head: str, settings: Settings, problem: Callable[[], MachineProblem]) -> list[str]:
    """Return lines of text on what the readings of the job will determine."""
    worth = worth_or_lack(settings, problem)
    lines: Sequence[str] = (
        identifiability_notes(worth.identified)[1:] if isinstance(worth, Worth) else str(worth).splitlines()
    )
    return [head, *(f"  {line}" for line in lines), ""]
