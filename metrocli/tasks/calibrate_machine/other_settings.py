"""Other settings with which the readings of a machine may fit: its chain, and its tool vectors.

Every order of the axes fits some tables to the readings, and a repeatability or a noise that follows the residuals
takes what these tables leave. So neither shows that the order is wrong.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, permutations, product
from typing import Any

import numpy as np

from metrocli.arrays import Array
from metrocli.diagnosis.corrections import Mistake, other_columns, other_scales, parts
from metrocli.instruments.axes.chain import axis_order
from metrocli.instruments.machine import ANGLES, AXES
from metrocli.instruments.six_dof import CHANNELS
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.files import Files
from metrocli.tasks.calibrate_machine.machine_settings import MachineSettings, RotarySettings
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.job import Job
from metrocli.tasks.shared.lengths import ESTIMATED
from metrocli.tasks.shared.noise import DECLARED
from metrocli.tasks.shared.weather import other_weather
from metrocli.units.people import format_quantity
from metrocli.words import in_a_row

_VAGUE = 1.0
"""Standard uncertainty of tool vectors that are not as listed [mm]"""
_MOST_POSES, _MOST_LINES = 2_000, 12
"""Poses of six-dof up to which channels are tried, and lines up to which each is: every trial is an adjustment"""
_LARGEST, _USUAL = 2e-3, 3e-5
"""Displacements of an axis are below the first share of its travel, and of the size of the second"""
_Other = tuple[Mistake, MachineSettings]


def other_settings(job: Job[Settings, Files], fits: bool) -> Iterator[tuple[Mistake, Job[Settings, Files]]]:
    """Yield what may be wrong in the settings, with the job that is right then; weather alone if a noise fits."""
    yield from other_weather(job)
    noise = job.settings.noise
    if job.settings.angular:
        return
    if fits and noise.model == DECLARED and noise.repeatability != ESTIMATED:
        return
    listed = job.settings.machine
    turned = () if fits else (*_turned(listed), *_rotary(listed))
    for mistake, machine in (*_chains(listed), *_other_tools(listed), *turned):
        yield mistake, replace(job, settings=replace(job.settings, machine=machine))
    if not fits:
        yield from _rotary_positions(job)
        yield from _zenith(job)
        yield from _channels(job)
        yield from _displacement_alone(job)


def _rotary_positions(job: Job[Settings, Files]) -> Iterator[tuple[Mistake, Job[Settings, Files]]]:
    """Yield positions of rotary axes with the other sign or in another unit in the rows of one ball or tool.

    Those of all rows only where they are outside the range of their axis: else it counts the other way (`sense`).
    """
    for key in ("points", "lengths", "probing"):
        table: Table | None = getattr(job.files, key)
        names = [letter.lower() for letter in ANGLES if table is not None and letter.lower() in table]
        if table is None or not names or len(table) > _MOST_POSES:
            continue
        sources = product(names, parts(table, np.ones(len(table))))
        turning = [(name, *source) for name, source in sources if np.ptp(table.numbers(name)[source[1]])]
        turning = turning if len(turning) <= _MOST_LINES * len(names) else []
        ranges = {letter.lower(): axis.range for letter, axis in job.settings.machine.axes.turning.items()}
        of_all = [name for name in names if name in ranges and not _within(table.numbers(name), *ranges[name])]
        for name, where, rows in (*((name, "", np.ones(len(table), dtype=bool)) for name in of_all), *turning):
            of_source = f"{table.headings.get(name, name)} {where}".strip()
            words, write = f"{of_source} has the wrong sign", f"{of_source} with the other sign"
            turned = np.where(rows, -table.numbers(name), table.numbers(name))
            mistake = Mistake(key, words, write, file=table.file, sort="rotary positions")
            yield mistake, job.with_files(**{key: table.changed({name: turned})})
        for mistake, scaled in other_scales(key, table, [*([name] for name in names), names]):
            yield replace(mistake, sort="rotary positions"), job.with_files(**{key: scaled})


def _within(angle: Array, low: float, high: float) -> bool:
    return bool(low <= angle.min() and angle.max() <= high)


def _zenith(job: Job[Settings, Files]) -> Iterator[tuple[Mistake, Job[Settings, Files]]]:
    """Yield zenith distances that are called elevations."""
    points = job.files.points
    if points is not None and "elevation" in points:
        heading = points.headings.get("elevation", "elevation_rad")
        words, write = f"{heading} has zenith distances", f"90 deg minus the numbers of {heading}"
        mistake = Mistake("points", words, write, file=points.file, sort="zenith")
        other = points.joined({"elevation [rad]": np.pi / 2 - points.numbers("elevation")})
        yield mistake, job.with_files(points=other)


def _channels(job: Job[Settings, Files]) -> Iterator[tuple[Mistake, Job[Settings, Files]]]:
    """Yield channels of six-dof lines in another unit or with the other sign, in all or in one, and exchanged ones."""
    lines = job.files.lines
    if lines is None or any(channel not in lines for channel in CHANNELS) or len(lines) > _MOST_POSES:
        return
    values = {channel: lines.numbers(channel) for channel in CHANNELS}
    kinds, named = (CHANNELS[:3], CHANNELS[3:]), np.array(lines.texts("line"))

    def other(words: str, write: str, changed: Mapping[str, Array], columns: int = 1) -> tuple[Mistake, Any]:
        mistake = Mistake("lines", words, write, file=lines.file, sort="channels", columns=columns)
        return mistake, job.with_files(lines=lines.changed(changed))

    single = tuple((channel,) for channel in CHANNELS)
    columns = (*other_columns("lines", lines, kinds[0]), *other_columns("lines", lines, kinds[1]))
    single_lines = list(dict.fromkeys(named))
    few = len(single_lines) <= _MOST_LINES
    scales = other_scales("lines", lines, (("position",), *kinds, *single)) if few else ()
    for mistake, table in (*columns, *scales):
        # of one sort with the signs: the median of all channels fits whatever one of them is
        yield replace(mistake, sort="channels"), job.with_files(lines=table)
    for some in (*single, *kinds):
        names = in_a_row(some)
        signs = "has the wrong sign" if len(some) == 1 else "have the wrong signs"
        yield other(f"{names} {signs}", f"{names} with the other sign", {c: -values[c] for c in some}, len(some))
    for channel in CHANNELS:
        for line in single_lines if few else ():
            flipped = np.where(named == line, -values[channel], values[channel])
            of_line = f"{channel} of line {line}"
            yield other(f"{of_line} has the wrong sign", f"{of_line} with the other sign", {channel: flipped})
    for one, two in (pair for kind in kinds for pair in combinations(kind, 2)):
        write = f"{two} for {one} and {one} for {two} in the headings"
        yield other(f"{one} and {two} are swapped", write, {one: values[two], two: values[one]}, 2)
        # where outliers are left out, an exchange that makes more of them fits as well as what is wrong
        for line in single_lines if few and job.settings.outliers == "report" else ():
            mine, write = named == line, f"{two} for {one} and {one} for {two} in the rows of line {line}"
            swapped = {a: np.where(mine, values[b], values[a]) for a, b in ((one, two), (two, one))}
            yield other(f"{one} and {two} of line {line} are swapped", write, swapped, 2)


def _displacement_alone(job: Job[Settings, Files]) -> Iterator[tuple[Mistake, Job[Settings, Files]]]:
    """Yield the displacements of single axes in a smaller unit, where no axis has so large ones.

    Nothing else is read, so that residuals fall with any smaller unit, whatever is wrong.
    """
    lines = job.files.lines
    if lines is None or "position" not in lines or all(channel in lines for channel in CHANNELS):
        return
    for channel in (channel for channel in CHANNELS[:3] if channel in lines):
        own = np.array(lines.texts("axis")) == channel[1]
        position, read = lines.numbers("position")[own], lines.numbers(channel)[own]
        if own.any() and np.median(np.abs(read - np.median(read))) > _LARGEST * np.ptp(position):
            for mistake, table in other_columns("lines", lines, [channel], _USUAL * np.ptp(position)):
                yield mistake, job.with_files(lines=table)


def _chains(machine: MachineSettings) -> Iterator[_Other]:
    """Yield the other orders of the axes, with the bed at its place."""
    present = axis_order(machine.chain)
    for order in permutations(present):
        if order != present:
            chain = _in_order(machine.chain, order)
            mistake = Mistake("machine.chain", f"the order of the axes is {chain}", f"chain: {chain}")
            yield mistake, replace(machine, chain=chain)


def _in_order(chain: str, order: Sequence[int]) -> str:
    letters = iter(AXES[axis] for axis in order)
    return re.sub("[XYZ]", lambda _: next(letters), chain)


def _rotary(machine: MachineSettings) -> Iterator[_Other]:
    """Yield rotary axes that count the other way, stand at a mirrored place, or are on the other side of the bed."""
    for letter, axis in machine.axes.turning.items():
        key, where = letter.lower(), f"machine.axes.{letter.lower()}"
        mistake = Mistake(f"{where}.sense", f"{letter} counts the other way", f"sense: {-axis.sense}")
        yield mistake, _with_axis(machine, key, replace(axis, sense=-axis.sense))
        for at, size in enumerate(axis.at or ()):
            if size:
                place = tuple(-coordinate if k == at else coordinate for k, coordinate in enumerate(axis.at or ()))
                words = f"{'xyz'[at]} of the place of {letter} has the wrong sign"
                written = ", ".join(f"{coordinate:g} mm" for coordinate in place)
                mistake = Mistake(f"{where}.at", words, f"at: [{written}]")
                yield mistake, _with_axis(machine, key, replace(axis, at=place))
    if machine.turns:
        for chain in dict.fromkeys(_exchanged(machine.letters)):
            yield (
                Mistake("machine.chain", "tables and heads are exchanged", f"chain: {chain}"),
                replace(machine, chain=chain),
            )
        for chain in _reordered(machine.letters):
            words = f"the order of the rotary axes is that of {chain}"
            yield Mistake("machine.chain", words, f"chain: {chain}"), replace(machine, chain=chain)


def _with_axis(machine: MachineSettings, key: str, axis: RotarySettings) -> MachineSettings:
    changed: dict[str, Any] = {key: axis}
    return replace(machine, axes=replace(machine.axes, **changed))


def _exchanged(letters: Sequence[str]) -> Iterator[str]:
    """Yield the chains in which rotary axes are on the other side of the bed, tables outermost, heads at the tool."""
    bed = letters.index("b")
    tables, heads = ([name for name in side if name in ANGLES] for side in (letters[:bed], letters[bed + 1 :]))
    linear = "".join(letter for letter in letters if letter in AXES)
    for left in permutations(heads):
        for right in permutations(tables):
            chain = f"w{''.join(left)}b{linear}{''.join(right)}t"
            if len(left) + len(right) and chain != f"w{''.join(letters)}t":
                yield chain


def _reordered(letters: Sequence[str]) -> Iterator[str]:
    """Yield the chains in which two rotary axes have each other's place."""
    turning = [letter for letter in letters if letter in ANGLES]
    if len(turning) > 1:
        other = dict(zip(turning, reversed(turning), strict=True))
        yield f"w{''.join(other.get(letter, letter) for letter in letters)}t"


def _other_tools(machine: MachineSettings) -> Iterator[_Other]:
    """Yield tool vectors that the readings determine; they do not control a single one."""
    if len(machine.tools or {}) > 1 and machine.tool_std < _VAGUE:
        vague = format_quantity(_VAGUE, "mm")
        words = f"the readings see other tool vectors than those listed, as `tool_uncertainty: {vague}` shows"
        mistake = Mistake("machine.tools", words, "the tool vectors as measured")
        yield mistake, replace(machine, tool_uncertainty=_VAGUE)


def _turned(machine: MachineSettings) -> Iterator[_Other]:
    """Yield each tool vector of several, or one that turns, with a component of the other sign; and two exchanged."""
    tools = machine.tools or {}
    for name, vector in tools.items() if len(tools) > 1 or machine.turns else ():
        for at in (at for at, size in enumerate(vector) if size):
            turned = tuple(-coordinate if k == at else coordinate for k, coordinate in enumerate(vector))
            axis = "xyz"[at]
            mistake = Mistake(
                "machine.tools", f"{axis} of {name} has the wrong sign", f"{axis} of {name} with the other sign"
            )
            yield mistake, replace(machine, tools={**tools, name: turned})
    for first, other in combinations(tools, 2):
        words, names = f"the tools {first} and {other} are under each other's names", {first: other, other: first}
        vectors = {name: tools[names.get(name, name)] for name in tools}
        mistake = Mistake("machine.tools", words, f"the vector of {first} for {other}, and that of {other} for {first}")
        yield mistake, replace(machine, tools=vectors)
