"""The design of a measurement of lengths: where points and tracers will be, and what is read when."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.table import Table

if TYPE_CHECKING:
    from metrocli.table import Values


class Pace(Protocol):
    """How time and temperature go on from point to point."""

    @property
    def interval(self) -> float | None:
        """Time from point to point"""

    @property
    def warming(self) -> float:
        """How much the air warms up from the first point to the last"""


_REFERENCE_DEGC = 20.0
"""Temperature at the first point (ISO 1)"""
_KEPT = ("point", "tracer", "t", "temp")


@dataclass(frozen=True)
class Planned:
    """A measurement before it is made: where the mover is sent, where the tracers stand, and what is read when."""

    points: Table
    tracers: Table
    lengths: Table | None = None
    """Its points, tracers, times and temperatures are read again; without it every tracer reads every point"""

    def design(self, pace: Pace | None) -> Table:
        """Return point, tracer and the conditions of each reading; times only where there is a pace."""
        if self.lengths is not None:
            return _with(self.lengths, {name: self.lengths.columns[name] for name in _KEPT if name in self.lengths})
        names, stations = self.points.texts("point"), self.tracers.texts("tracer")
        turn = np.repeat(np.arange(len(names)), len(stations)).astype(float)
        columns: dict[str, Values] = {"point": np.repeat(np.array(names), len(stations))}
        columns["tracer"] = np.tile(np.array(stations), len(names))
        if pace is not None and pace.interval is not None:
            columns["t"] = turn * pace.interval
        if pace is not None and pace.warming:
            columns["temp"] = _REFERENCE_DEGC + pace.warming * turn / max(len(names) - 1, 1)
        return Table(columns)

    def with_tracer(self, name: str, place: Array) -> Planned:
        """Return the measurement with one more tracer, which reads every point that is read."""
        row = {"tracer": name, **dict(zip("xyz", place.tolist(), strict=True))}
        added: dict[str, Values] = {key: np.array([row.get(key, np.nan)]) for key in self.tracers}
        more = replace(self, tracers=_with(self.tracers, _appended(self.tracers, added), False))
        if self.lengths is None:
            return more
        first = np.unique(self.lengths.columns["point"], return_index=True)[1]
        added = {key: values[first] for key, values in self.lengths.columns.items()}
        added["tracer"] = np.array([name] * len(first))
        return replace(more, lengths=_with(self.lengths, _appended(self.lengths, added), False))

    def of_points(self, rows: Index) -> Planned:
        """Return the measurement of some of its points."""
        fewer = replace(self, points=_chosen(self.points, rows))
        if self.lengths is None:
            return fewer
        kept = np.isin(self.lengths.columns["point"], fewer.points.columns["point"])
        return replace(fewer, lengths=_chosen(self.lengths, np.flatnonzero(kept)))


def _chosen(table: Table, rows: Index) -> Table:
    return _with(table, {name: values[rows] for name, values in table.columns.items()}, False)


def _appended(table: Table, added: dict[str, Values]) -> dict[str, Values]:
    return {key: np.concatenate([np.asarray(values), added[key]]) for key, values in table.columns.items()}


def _with(table: Table, columns: dict[str, Values], lines: bool = True) -> Table:
    return replace(table, columns=columns, lines=table.lines if lines else ())
