"""The texts of a figure: inside it and apart, with long names and flat volumes too."""

from __future__ import annotations

import warnings
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from matplotlib.text import Text
from plots import results

from metrocli import plots
from metrocli.plots import style
from metrocli.plots.plotted_points import sides
from metrocli.result import Result
from metrocli.table import Table
from metrocli.words import shortened

LONG = "Meßpunkt <b>„{}“</b> & Größe an der hinteren linken Flanke des großen Zahnrades Nr. {}"


def long_names() -> Result:
    """The network with long names of points and tracers, in which the length from C to L2 is wrong."""
    found = results.network()
    tables = {}
    for name, table in found.tables.items():
        columns = {
            key: np.array([LONG.format(one, one) for one in values]) if key in ("point", "tracer") else values
            for key, values in table.columns.items()
        }
        if name == "residuals":
            columns["normalised"] = np.array([0.1, -0.2, 0.3, 0.1, 0.2, -9.0])
        tables[name] = Table(columns, table.units)
    estimates = tuple(replace(one, name=LONG.format(one.name, one.name)) for one in found.estimates)
    return replace(found, tables=tables, estimates=estimates)


def flat_volume(high: float) -> Result:
    """A volume of 1500 mm, `high` mm and 400 mm with its uncertainty in three layers."""
    at = np.stack(np.meshgrid([0.0, 750.0, 1500.0], [0.0, high], [0.0, 200.0, 400.0]), axis=-1).reshape(-1, 3)
    columns = dict(zip("xyz", at.T, strict=True)) | dict.fromkeys(("u_x", "u_y", "u_z"), np.full(len(at), 0.05))
    table = Table(columns, dict.fromkeys(columns, "mm"))
    return Result("report-uncertainty", "", (), np.zeros((0, 0)), {}, {"map": table})


CASES = [
    (name, result)
    for result in (long_names(), flat_volume(1000.0), flat_volume(300.0))
    for name in plots.names_of(result)
]


def _is_name(text: str) -> bool:
    """Return whether a text is more than the number at a tick: ticks beyond the axes are not drawn."""
    return bool(text.strip("0123456789.−- "))


@pytest.mark.parametrize(("name", "result"), CASES, ids=lambda one: one if isinstance(one, str) else one.kind)
def test_all_texts_are_inside_the_figure_and_apart(name: str, result: Result) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with plots.drawn(name, plots.data_of(name, result)) as (canvas, _):
            style.arrange(canvas)
            canvas.figure.draw_without_rendering()
            wide, high = canvas.figure.bbox.width, canvas.figure.bbox.height
            texts = [one for one in canvas.figure.findobj(Text) if one.get_visible() and _is_name(one.get_text())]
            places = [(one.get_text(), one.get_window_extent()) for one in texts]
    beyond = [text for text, b in places if b.x0 < -1 or b.y0 < -1 or b.x1 > wide + 1 or b.y1 > high + 1]
    assert not beyond
    names = [one for one in places if "…" in one[0]]
    assert not [(a[0], b[0]) for a, b in combinations(names, 2) if a[1].overlaps(b[1])]


def test_two_names_side_by_side_go_apart() -> None:
    at = np.array([[0.0, 0.0], [1.0, -1.0], [50.0, 50.0]])
    assert sides(at, 0, 1) == (-1, 1) and sides(at, 1, 1) == (1, -1)


@pytest.mark.parametrize("letters", [2, 3, 9, 10])
def test_a_shortened_name_keeps_both_ends(letters: int) -> None:
    short = shortened("Flank-of-tooth-17L", letters)
    assert len(short) == letters and short.endswith("L") and "…" in short
    assert shortened("17L", letters) == "17L" if letters > 2 else True
