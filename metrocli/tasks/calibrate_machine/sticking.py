"""Readings of a machine's measurement that stay the same at different places, as of a sensor that sticks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import Fault, InputError, NoSolutionError
from metrocli.instruments.six_dof import CHANNELS
from metrocli.instruments.tracker import POLAR
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.files import Files
from metrocli.tasks.calibrate_machine.methods.six_dof import unmeasured
from metrocli.tasks.calibrate_machine.methods.standstill import CARTESIAN
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.shared.lists import sticking

_PLACES = ("x", "y", "z", "a", "b", "c", "position")
"""Columns of where a machine stands"""


def stuck_channels(settings: Settings, files: Files) -> tuple[str, ...]:
    """Return which readings stay the same, in words."""
    lines: list[str] = []
    by_column = ((files.lines, "line"), (files.lengths, "station"))
    by_one = ((files.points, "the tracker"), (files.track, "the tracker"), (files.probing, "the probe"))
    for table, source in (*by_column, *by_one):
        if table is None or not any(place in table for place in _PLACES):
            continue
        # a channel of zeros was not measured, which is a fault of its own
        if table is files.lines and any(unmeasured(table)):
            continue
        names = table.texts(source) if source in table else [source] * len(table)
        sources, of = np.unique(np.array(names, dtype=str), return_inverse=True)
        for name, sigma in _noise(settings, table, table is files.track):
            # a track has its readings alone: where the others change, its place does
            at = np.stack([table.numbers(other) for other in _PLACES if other in table and other != name], axis=1)
            place = np.unique(np.nan_to_num(at), axis=0, return_inverse=True)[1].ravel()
            lines += sticking(table, name, (of, place), sources.tolist(), sigma)
    return tuple(lines)


def _noise(settings: Settings, table: Table, is_track: bool) -> Iterator[tuple[str, Array]]:
    """Yield each column of readings that can stick with its standard deviations (n,)."""
    ones = np.ones(len(table))
    laser = settings.noise.of_laser
    for name, sigma in zip(CHANNELS, (laser.displacement, *[laser.straightness] * 2, *[laser.angle] * 3), strict=True):
        yield name, sigma * ones
    if "length" in table:
        noise = settings.noise.of_lengths
        yield "length", np.hypot(noise.constant, noise.proportional * table.numbers("length"))
    if "ball" in table:
        # without displacements the places are those at which the ball was found
        found = ("dx", "dy", "dz") if "dx" in table else ("x", "y", "z")
        yield from ((name, (settings.noise.probing or 0.0) * ones) for name in found)
    tracker, cartesian = settings.noise.of_tracker, ("x", "y", "z") if is_track else CARTESIAN
    if all(name in table for name in cartesian):
        covariance = tracker.covariance(table.stacked(cartesian).T)
        yield from zip(cartesian, np.sqrt(np.einsum("iin->in", covariance)), strict=True)
    if all(name in table for name in POLAR):
        distance = table.numbers("distance")
        angle = tracker.lateral(distance) / np.maximum(distance, 1.0)
        yield from zip(POLAR, (angle, angle, tracker.beam * ones), strict=True)


@contextmanager
def naming(stuck: Sequence[str]) -> Iterator[None]:
    """Name readings that stay the same in each failure that they may have caused."""
    try:
        yield
    except InputError as error:
        raise InputError([*map(Fault, stuck), *error.faults]) from error
    except NoSolutionError as error:
        raise type(error)("\n  ".join([str(error), *stuck]), error.misfit, error.inputs) from error
