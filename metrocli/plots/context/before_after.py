"""Normalised residuals of a job, and of the same job with a longer model, against what the change shows best."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.plots.against import CAPTION, LABELS, Panel, draw_panel, panel_of
from metrocli.plots.context import ResultContext
from metrocli.plots.magnify import MOST, words
from metrocli.plots.noise_bands import trend
from metrocli.plots.readings import PlottedResiduals, residuals_of
from metrocli.plots.style import Canvas
from metrocli.result import Result

_PLACES = 40
"""Most places of one kind that are looked at one by one"""
_FEWEST = 10
"""Fewest readings of a place"""


@dataclass(frozen=True)
class BeforeAfter:
    """What the figure shows: two panels over one covariate, of all readings or of those at one place."""

    about: str
    place: str
    """Empty for all readings"""
    before: Panel
    after: Panel
    readings: int
    rms: tuple[float, float]
    """Root mean square of w of all readings, before and after"""


@dataclass(frozen=True)
class _View:
    """Some readings over a covariate."""

    about: str
    place: str
    x: Array
    old: PlottedResiduals
    new: PlottedResiduals
    rows: Index

    @property
    def change(self) -> float:
        """How much more the means of bins differ from noise before than after, in standard deviations of noise."""
        return _structure(self.x, self.old.w[self.rows]) - _structure(self.x, self.new.w[self.rows])

    def panel(self, name: str, of: PlottedResiduals) -> Panel:
        """Return the panel of one of the two sets."""
        return panel_of(name, self.x, of.w[self.rows], lambda k: of.name(int(self.rows[k])), MOST // 2, len(self.rows))


def data(result: Result, context: ResultContext) -> BeforeAfter | None:
    """Return the readings that show the change best; None without an earlier result of the same readings."""
    if context.before is None:
        return None
    pairs = list(zip(residuals_of(context.before), residuals_of(result), strict=False))
    if not pairs or not all(_same_readings(*pair) for pair in pairs):
        return None
    views = [view for pair in pairs for view in _views(*pair)]
    if not views:
        return None
    view = max(views, key=lambda candidate: candidate.change)
    sets = list(zip(*pairs, strict=True))
    first, last = (
        float(np.sqrt(np.mean(np.concatenate([panel.w[panel.checked] for panel in side]) ** 2))) for side in sets
    )
    readings = sum(int(panel.checked.sum()) for panel in sets[1])
    before, after = view.panel("before", view.old), view.panel("after", view.new)
    return BeforeAfter(view.about, view.place, before, after, readings, (first, last))


def _same_readings(old: PlottedResiduals, new: PlottedResiduals) -> bool:
    """Return whether two sets are of the same readings in the same order."""
    if len(old.w) != len(new.w) or old.part != new.part:
        return False
    texts = [key for key in old.table if key in new.table and old.table.columns[key].dtype.kind in "US"]
    alike = all((old.table.columns[key] == new.table.columns[key]).all() for key in texts)
    values = [key for key in ("reading", "value", "t") if key in old.table and key in new.table]
    alike = alike and all(np.array_equal(old.table.columns[key], new.table.columns[key]) for key in values)
    return bool(texts) and alike


def _views(old: PlottedResiduals, new: PlottedResiduals) -> Iterator[_View]:
    """Yield all readings, and those of each place, over each covariate."""
    checked = old.checked & new.checked
    covariates = {**new.covariates, "order": np.arange(1.0, len(old.w) + 1)}
    for place, inside in [("", checked), *((name, checked & chosen) for name, chosen in new.places(_PLACES))]:
        rows = np.flatnonzero(inside)
        if len(rows) >= (_FEWEST if place else 1):
            yield from (_View(about, place, x[rows], old, new, rows) for about, x in covariates.items())


def _structure(x: Array, w: Array) -> float:
    """Return `(chi2 - m) / sqrt(2 m)` of the m means of bins: a few at most for pure noise."""
    structure = trend(x, w)
    m = len(structure.means)
    return float((((structure.means / structure.stds) ** 2).sum() - m) / np.sqrt(2 * m))


def height(pair: BeforeAfter) -> float:
    """Return the height of the figure in inches."""
    return 4.4


def draw(canvas: Canvas, pair: BeforeAfter) -> str:
    """Draw the figure and return its caption."""
    panels = canvas.axes(2, 1, sharex=True, sharey=True)
    for axes, panel in zip(panels, (pair.before, pair.after), strict=True):
        draw_panel(axes, panel, canvas.theme)
    room = max(residuals.room for residuals in (pair.before, pair.after))
    panels[0].set_ylim(-room, room)
    panels[1].set_xlabel(LABELS[pair.about])
    panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    first, last = pair.rms
    where = f"Shown are the {len(pair.after.w)} readings of {pair.place}, which changed most. " if pair.place else ""
    out = [f"{when.name}: {len(when.trend.beyond)} of {len(when.trend.means)}" for when in (pair.before, pair.after)]
    return (
        f"{where}{CAPTION} Means outside the band {', '.join(out)}. Root mean square of w of all {pair.readings} "
        f"readings: {first:.3g} before, {last:.3g} after, where 1 is expected.{_thinned(pair.after)}"
    )


def _thinned(panel: Panel) -> str:
    text = words(len(panel.rows), len(panel.w), "lowest and highest of each strip, the others at equal steps")
    return f" {text}" if text else ""
