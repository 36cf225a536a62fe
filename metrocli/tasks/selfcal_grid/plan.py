"""Planning of views before the measurement: undetermined directions and noise gain of planned and other views."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.arrays import Index
from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments import ball_grid as bg
from metrocli.plan import Plan
from metrocli.result import Estimate, ShownTable
from metrocli.table import Table
from metrocli.tasks.selfcal_grid import KIND
from metrocli.tasks.selfcal_grid.determination.undetermined import Open, candidates, determined, opened
from metrocli.tasks.selfcal_grid.problem import GridProblem, build
from metrocli.tasks.selfcal_grid.readings import GridReadings
from metrocli.tasks.selfcal_grid.settings import Settings, turn_in_words
from metrocli.tasks.selfcal_grid.simulation import balls_on, views_on_the_grid
from metrocli.tasks.selfcal_grid.solve import design

_TRIED = 5
"""Largest number of balls per side of the grid on which sets of views are compared; noise gains hardly depend on it"""
_WORKED_OUT = 11


@dataclass(frozen=True)
class _Worth:
    """What a set of views determines, and how well."""

    undetermined: Open
    gain: float
    """Root mean square standard uncertainty of the machine error over the noise; inf if a direction is open"""
    largest: float


@dataclass(frozen=True)
class _Given:
    """The part of the job that does not depend on the views."""

    settings: Settings
    lengths: Table | None

    def lengths_on(self, half: Index) -> Table | None:
        """Return the calibrated lengths on a grid, with ends beyond it moved to its rim; None without lengths."""
        if self.lengths is None:
            return None
        names = [[f"{name}{end}" for name in "ijk"] for end in "12"]
        ends = [np.clip(self.lengths.stacked(name), -half, half) for name in names]
        length = np.linalg.norm(ends[0] - ends[1], axis=1) * self.settings.grid.pitch
        kept = length > 0
        known = {"length": length[kept], "sigma": self.lengths.numbers("sigma")[kept]}
        of = {" ".join(name): end[kept] for name, end in zip(names, ends, strict=True)}
        return Table.of({**known, **of}) if kept.any() else None


def plan(settings: Settings, lengths: Table | None = None) -> Plan:
    """Return the undetermined directions and uncertainties of the planned views, and of sets with one more or less."""
    given = _Given(settings, lengths)
    views, half = views_on_the_grid(settings), settings.grid.half
    small = np.minimum(half, _TRIED // 2)
    own = _worth(views, np.minimum(half, _WORKED_OUT // 2), given)
    sets = [(words, some) for words, some in _sets(views) if all(len(balls_on(view, small)) for view in some)]
    table = _table([(words, _tried(some, small, given)) for words, some in sets])
    gain = Estimate("s_machine_error", 0.0, own.gain * settings.declared, "mm")
    most = Estimate("s_machine_error_max", 0.0, own.largest * settings.declared, "mm")
    size = " x ".join(str(2 * n + 1) for n in small.tolist())
    known = bool(np.isfinite(own.gain))
    notes = (
        *own.undetermined.sentences(),
        *([f"noise gain {own.gain:.3f} rms, {own.largest:.3f} at most"] if known else []),
        f"other sets of views, on a grid of {size}:",
    )
    figures = (gain, most) if known and not isinstance(settings.noise, str) else ()
    files = {"views_to_measure.csv": _sheet(settings, views)}
    return Plan(KIND.name, notes, figures, {"view_sets": table}, files, shown=(ShownTable("view_sets"),))


def _sets(views: Sequence[bg.View]) -> Iterator[tuple[str, list[bg.View]]]:
    """Yield the planned views, the planned views with one more, and with one less."""
    yield "planned", list(views)
    for words, view in candidates():
        yield f"with a view {words}", [*views, view]
    for left_out in views if len(views) > 2 else ():
        yield f"without '{left_out.name}'", [view for view in views if view is not left_out]


def _tried(views: Sequence[bg.View], half: Index, given: _Given) -> _Worth | None:
    try:
        return _worth(views, half, given)
    except UndeterminedError:
        return None


def _worth(views: Sequence[bg.View], half: Index, given: _Given) -> _Worth:
    problem = _problem(views, half, given)
    taken = design(problem)
    left_open = opened(problem, taken)
    std = np.where(determined(problem, taken)[bg.MACHINE], taken.std(bg.MACHINE), np.inf)[problem.grid.within > 0]
    std = std / given.settings.declared
    return _Worth(left_open, float(np.sqrt((std**2).mean())), float(std.max()))


def _problem(views: Sequence[bg.View], half: Index, given: _Given) -> GridProblem:
    """Return the adjustment of views with the readings of a grid without errors."""
    settings = given.settings
    each = [balls_on(view, half) for view in views]
    values = [view.sites(balls) * settings.grid.pitch for view, balls in zip(views, each, strict=True)]
    count = [len(balls) for balls in each]
    ball = np.concatenate(each)
    table = Table.of({"view": np.repeat([view.name for view in views], count), "i j k": ball})
    view = np.repeat(np.arange(len(views)), count)
    readings = GridReadings(tuple(views), view, ball, np.concatenate(values), table)
    return build(readings, (half, settings.grid.pitch), settings.declared, given.lengths_on(half))


def _table(rows: Sequence[tuple[str, _Worth | None]]) -> Table:
    listed = [
        (words, str(worth.undetermined.count), worth.gain, worth.largest) if worth else (words, "more", np.inf, np.inf)
        for words, worth in rows
    ]
    return Table.of_rows(("views", "undetermined", "noise_gain", "largest_gain"), listed)


def _sheet(settings: Settings, views: Sequence[bg.View]) -> Table:
    """Return the nominal place of each ball, in the order of the views."""
    each = [balls_on(view, settings.grid.half) for view in views]
    places = np.concatenate([view.sites(balls) for view, balls in zip(views, each, strict=True)]) * settings.grid.pitch
    ball = np.concatenate(each)
    count = [len(balls) for balls in each]
    names = {"view": [view.name for view in views], "mounting": [turn_in_words(view.turn) for view in views]}
    each_row = {name: np.repeat(texts, count) for name, texts in names.items()}
    return Table.of({**each_row, "i j k": ball.astype(np.int64), "x y z [mm]": places})
