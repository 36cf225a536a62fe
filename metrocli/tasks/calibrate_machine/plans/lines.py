"""Plan lines of a laser, or tests of the positioning alone: what those of the job and the proposed ones determine."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.instruments.axes.rotary import RotaryAxis
from metrocli.instruments.machine import Axis
from metrocli.instruments.six_dof import CHANNELS
from metrocli.nc_program import Block as NcBlock
from metrocli.nc_program import Dwell, Feed, Rapid, Stop, program
from metrocli.plan import Plan
from metrocli.result import Estimate
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import machine_of
from metrocli.tasks.calibrate_machine.methods.lines import MeasuredLines
from metrocli.tasks.calibrate_machine.methods.planned_lines import (
    beyond,
    columns_of,
    planned_lines,
    tests_of_positioning,
)
from metrocli.tasks.calibrate_machine.methods.poses import in_degrees
from metrocli.tasks.calibrate_machine.methods.six_dof import six_dof
from metrocli.tasks.calibrate_machine.plans.planned import PLACES, REST, Worth, planned
from metrocli.tasks.calibrate_machine.plans.pose_program import any_turn
from metrocli.tasks.calibrate_machine.plans.settings import PathPlan
from metrocli.tasks.calibrate_machine.plans.stops import judged, visits, worth_or_lack
from metrocli.tasks.calibrate_machine.settings import MachineSimulation, Settings
from metrocli.tasks.calibrate_machine.warnings import identifiability_notes

_COUNTED = "rotary axes count on through the turn, a little beyond both ends"
_TITLE, _RESTS = "metrocli lines for calibrate-machine", "a reading in each dwell"


def plan_of_lines(settings: Settings, lines: Table | None) -> Plan:
    """Return what the job's lines will determine, and propose lines along the axes and three face diagonals.

    Of a job that reads the positioning alone it proposes five runs to and fro along each of its axes.
    """
    own = [] if lines is None else judged("the lines of the job", settings, lambda: six_dof(settings, lines))
    wanted, machine = settings.plan or PathPlan(), machine_of(settings)
    alone = settings.reads_positioning
    if alone:
        given = tests_of_positioning(machine, [name[-1] for name in settings.estimated])
    else:
        given = planned_lines(machine, (settings.simulation or MachineSimulation()).step)
    places = {} if machine.turns else {"x y z [mm]": given.position.T}
    table = Table.of({**columns_of(machine, given), **places})
    read = table.joined(
        dict.fromkeys((f"e{axis}" for axis in given.names) if alone else CHANNELS, np.zeros(len(table)))
    )
    worth = worth_or_lack(settings, lambda: six_dof(settings, read))
    if not isinstance(worth, Worth):
        raise worth
    blocks: list[NcBlock] = []
    for k, name in enumerate(given.names):
        blocks.append(Stop(f"set the laser up along {name}"))
        if alone:
            axis = next(axis for axis in machine.axes if axis.letter == name.upper())
            blocks += _to_and_fro(axis, given, k, wanted.feed)
        else:
            blocks += visits(given.position[:, given.of == k].T, wanted.feed)
    text = program(_TITLE, [*([_COUNTED] if machine.turns else PLACES), _RESTS], blocks, wanted.control)
    notes = [*own, f"proposed: {len(given.names)} lines", *identifiability_notes(worth.identified)[1:]]
    ratio = worth.identified.ratio
    weak = f"the lines have a ratio of {ratio:.1f}, more than {wanted.ratio:g}: measure further lines at other places"
    files: dict[str, Table | str] = {"lines.csv": in_degrees(table), "lines.nc": text}
    figures = (Estimate("readings", float(len(table)), 0.0, "1"),)
    return planned(notes, figures, worth, files, [] if alone or ratio <= wanted.ratio else [weak])


def _to_and_fro(axis: Axis, lines: MeasuredLines, line: int, feed: float) -> Iterator[NcBlock]:
    """Yield moves to the targets of an axis with a rest at each; at a turn the axis goes beyond the target."""
    own, turns = lines.distance[lines.of == line], isinstance(axis, RotaryAxis)
    way = np.sign(np.diff(own, prepend=own[0], append=own[-1]))
    after = np.where(way[1:] == 0, way[:-1], way[1:])
    for target, fore, aft in zip(own.tolist(), way[:-1].tolist(), after.tolist(), strict=True):
        places = [target] if fore else [target - aft * beyond(axis), target]
        for place in places:
            at = {axis.letter: float(np.degrees(place)) if turns else place}
            yield Rapid(at, any_turn((axis,))) if turns else Feed(at, feed)
        yield Dwell(REST)
