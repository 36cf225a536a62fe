"""Warnings of a machine calibration, what its measurement determines and does not control, and how its stations lie."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from metrocli import units
from metrocli.diagnosis.adjusted_job import ABSURD
from metrocli.instruments.axes.rotary import turning_axes
from metrocli.instruments.machine import TOOL, Machine, errors_of
from metrocli.instruments.tracer import TRACER
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.methods.lengths import unseen_senses
from metrocli.tasks.calibrate_machine.rank.identifiability import Identifiability
from metrocli.tasks.calibrate_machine.rank.open_directions import line_of, stations_lie
from metrocli.tasks.calibrate_machine.settings import LENGTHS, ON_THE_FLY, Settings
from metrocli.tasks.calibrate_machine.solve import AdjustedMachine
from metrocli.tasks.calibrate_machine.tables import Tables
from metrocli.tasks.shared.environment import blocks_of
from metrocli.tasks.shared.lists import unless_without_noise
from metrocli.tasks.shared.mirror import hidden_by
from metrocli.tasks.shared.part import Warm
from metrocli.tasks.shared.statistics import REMOVE, REPEATS, beyond_bound, left_out, noise_warnings, with_tests
from metrocli.tasks.shared.uncontrolled import AIR, AIR_WORDS, ASSUMED, ASSUMED_CONTROL, Hidden, table_of
from metrocli.words import listed

WEAK = 10.0
"""Above this ratio of volume error to misfit, a good fit does not ensure a small error in the volume"""
_TOOL = units.parse_quantity("0.1 mm", "length")
_ARCSEC, _AWAY = units.parse_quantity("1 arcsec", "angle"), units.parse_quantity("300 mm", "length")
_STEEL = units.parse_quantity("11.5 ppm", "ratio")
_OF_INDEXERS = Hidden(
    "division and centring of indexer, polygon or mirror (what turns with it is taken for errors of the axis)",
    "1 arcsec, at 300 mm from the axis",
    _ARCSEC * _AWAY,
    "the same test with the indexer or the polygon turned on the table by some of its steps",
)


def cures(settings: Settings) -> tuple[str, ...]:
    """Return the settings that a warning may recommend for a method, of those that the job does not have."""
    if settings.method == ON_THE_FLY:
        return ()
    repeats = settings.method == LENGTHS and settings.noise.repeatability is None
    return (*((REMOVE,) if settings.outliers == "report" else ()), *((REPEATS,) if repeats else ()))


def machine_warnings(solved: AdjustedMachine, settings: Settings, more: Sequence[str]) -> list[str]:
    """Return the warnings of a calibration: readings, `more`, noise, undetermined errors, weak designs, outliers."""
    identified = solved.identified
    wording = cures(settings)
    stuck = unless_without_noise(solved.problem.stuck, solved.solution.sigma0)
    lines = [*solved.problem.warnings, *stuck, *more, *noise_warnings(solved.solution, wording, len(solved.rejected))]
    if identified.undetermined:
        lines.append(
            f"this measurement does not determine {' '.join(identified.undetermined)}: left out of the tables"
            + (f"; determined only together with them: {' '.join(identified.together)}" if identified.together else "")
            + f"; {_tools_lie(solved)}"
        )
    if identified.open_tools:
        lines.append(
            f"the error of tool {listed(identified.open_tools)} cannot be predicted: it depends on undetermined errors"
        )
    if identified.ratio > WEAK and not solved.problem.positioning_alone:
        size = f"{identified.ratio:.0f}" if math.isfinite(identified.ratio) else "any number of"
        lines.append(
            f"in the worst case the error in the volume is {size} times the misfit of the readings: "
            f"a good fit does not ensure a small error ({_better(solved)})"
        )
    rows, tests = solved.suspects.rows.tolist(), solved.suspects.tests.tolist()
    key, names = next(iter(solved.problem.readings.observations.keys)), solved.problem.names
    lines += left_out(with_tests([f"{key} {name}" for name, _ in solved.rejected], [w for _, w in solved.rejected]))
    if rows:
        suspected = with_tests([f"{key} {names[i]}" for i in rows], tests)
        lines.append(beyond_bound(suspected, solved.suspects.critical, REMOVE * (REMOVE in wording)))
    return lines


def _better(solved: AdjustedMachine) -> str:
    """Return what would reduce the ratio of volume error to misfit."""
    if TRACER not in solved.solution.blocks:
        return "`metrocli plan` proposes a measurement with a ratio of 4"
    lie = stations_lie(solved.solution.blocks[TRACER].values[:, :3])
    return f"{f'{lie}; ' if lie else ''}more stations around the volume reduce it, and `metrocli plan` proposes them"


def _tools_lie(solved: AdjustedMachine) -> str:
    """Return what the measured tools lack, and what would determine the errors that they leave open."""
    block = solved.solution.blocks[TOOL]
    vectors = block.values[[block.members.index(name) for name in solved.problem.tools_used]]
    way = line_of(vectors)
    if len(vectors) == 1:
        return "it has one tool: measure with tools of other length and offset to determine them"
    if way is not None:
        along = " ".join(f"{part:.2f}" for part in way)
        return (
            f"its {len(vectors)} tools lie on one line, along ({along}), and no tool is offset square to it: "
            "measure with one that is"
        )
    return "measure with tools of other length and offset to determine them"


_FAR_AWAY = 1.0
"""A line farther from its listed place than this [mm] was hardly meant"""
_MIRRORED = 0.2
_FEW = np.radians(30.0)
"""Below this range of an axis [rad] location and once-a-turn part have a correlation of -0.99"""


def misplaced(solved: AdjustedMachine) -> tuple[list[str], list[str]]:
    """Return doubts and warnings of rotary axes whose line is far from where the job lists it."""
    doubts, warnings = [], []
    given = solved.problem.readings.observations.conditions
    for axis in turning_axes(solved.problem.machine):
        block, turned = solved.solution.blocks[axis.location], float(np.ptp(given[axis.coordinate]))
        if turned < _FEW and block.free.any():
            warnings.append(
                f"{axis.letter} is turned by {np.degrees(turned):.0f} deg only: its location and the once-a-turn part "
                "of its tables are nearly the same; turn it farther"
            )
        # readings that contradict one another put an axis anywhere
        if solved.solution.sigma0 > ABSURD:
            continue
        across = [i for i in range(3) if i != axis.number]
        for i, off in zip(across, block.values[0, :2].tolist(), strict=True):
            where, size = f"{'xyz'[i]} of the place of {axis.letter}", units.sized(abs(off), "length")
            if abs(off) > _FAR_AWAY and abs(off + 2 * axis.at[i]) < _MIRRORED * abs(off):
                place = ", ".join(
                    f"{-coordinate if k == i else coordinate:g} mm" for k, coordinate in enumerate(axis.at)
                )
                doubts.append(f"{where} has the wrong sign: it is off by {size}; write at: [{place}]")
            elif abs(off) > _FAR_AWAY:
                warnings.append(f"{where} is {size} from that of the job: is `at` right?")
    return doubts, warnings


def identifiability_notes(identified: Identifiability) -> list[str]:
    """Return lines of text on what the measurement determines: rank, worst ratio, and undetermined errors."""
    lines = [f"rank {identified.rank} of {identified.unknowns} unknowns{_ratio(identified)}"]
    for name in identified.undetermined:
        partners = identified.partners[name]
        lines.append(f"  {name}: {'only together with ' + ' '.join(partners) if partners else 'not at all'}")
    if not identified.undetermined:
        lines.append("  every error is determined")
    if identified.zeros:
        lines.append(f"  no reading shows where the axes are at 0: {listed(identified.zeros)} count as given")
    return lines


def _ratio(identified: Identifiability) -> str:
    """Return what a misfit can mean in the volume; empty where only the positioning of single axes is known."""
    if identified.problem.positioning_alone:
        return ""
    ratio = f"{identified.ratio:.1f}" if math.isfinite(identified.ratio) else units.NOT_DETERMINED
    return f"; worst ratio of volume error to misfit {ratio}"


def uncontrolled(solved: AdjustedMachine, tables: Tables, settings: Settings) -> Table:
    """Return the settings and causes that the tables absorb, and the error in the volume from a plausible size.

    The uncertainty of a stated air is in the tables, and so is that of the scales of axes whose temperature is stated
    with its standard uncertainty.
    """
    return table_of((*hidden_by(solved.second), *_hidden(solved, tables, settings.scales), *_senses(tables, settings)))


def _senses(tables: Tables, settings: Settings) -> Iterator[Hidden]:
    """Yield the axes that may count backwards."""
    axes = unseen_senses(tables, settings)
    if axes:
        yield Hidden(
            f"sense of {listed(tuple(axes))}: an axis that counts backwards mirrors the stations as well (all tables)",
            "one of these axes mirrored",
            max(axes.values()),
            "rough places of the stations (`inputs: stations`), or a tool with another offset along each of these axes",
        )


def _hidden(solved: AdjustedMachine, tables: Tables, scales: Mapping[str, Warm]) -> Iterator[Hidden]:
    machine, alone = tables.machine, solved.problem.positioning_alone
    if machine.only_turns:
        if alone:
            yield _OF_INDEXERS
    else:
        yield from _of_scales(solved, machine, scales)
    tool = solved.solution.blocks[TOOL]
    if len(tool.members) < 2 and not tool.free.any() and not alone:
        names = [name for axis in machine.axes for name in errors_of(axis.letter) if name[1] in "ABC"]
        angles = [np.abs(tables.of(name)[1]).max(initial=0.0) for name in names]
        yield Hidden(
            "vector of the only tool (errors of a tool of another length)",
            "0.1 mm",
            _TOOL * float(np.nanmax(angles, initial=0.0)),
            "tools of different length, or the tool measured",
        )


def _of_scales(solved: AdjustedMachine, machine: Machine, scales: Mapping[str, Warm]) -> Iterator[Hidden]:
    """Yield what changes the scale of linear axes: the instrument and the temperature."""
    diagonal = machine.diagonal
    if not blocks_of(solved.solution):
        yield Hidden(
            "scale of the instrument: wavelength of the laser, refractive index (positioning errors)",
            AIR_WORDS,
            AIR * diagonal,
            "temperature and pressure of the air; a calibrated length",
        )
    else:
        yield Hidden(ASSUMED, AIR_WORDS, AIR * diagonal, ASSUMED_CONTROL)
    linear = [axis for axis in machine.axes if not axis.turns]
    if sum(scale.std > 0 for scale in scales.values()) < len(linear):
        yield Hidden(
            "temperature of the machine (positioning errors)",
            "1 K of steel (11.5 um/m)",
            _STEEL * diagonal,
            "temperature of the scales with its `std` (`scale:` at each axis); without `scale:` the tables hold at the "
            "temperature of the measurement",
        )
